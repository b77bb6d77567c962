"""The settings of a mask provider that have a slider, and their bounds."""

from dataclasses import dataclass, replace
from typing import Literal

from gaga_core.segmentation.choose import ProviderEntry, ProviderSettings
from gaga_core.segmentation.models.weights import family_of, weights_at
from gaga_core.segmentation.settings import GeneratorConfig

Family = Literal["regions", "sam", "universal", ""]
Part = Literal["regions", "generator", "universal", "flatten"]


@dataclass(frozen=True)
class Slider:
    """One setting."""

    part: Part  # field of `ProviderSettings`
    field: str
    label: str
    low: float
    high: float
    hint: str
    is_whole: bool = False
    is_logarithmic: bool = False


# fmt: off
_FLATTEN = (
    Slider("flatten", "min_visible", "Least visible share", 0.0, 0.9,
           "A mask of which less stays uncovered by more confident ones is dropped"),
)
SLIDERS: dict[Family, tuple[Slider, ...]] = {
    "": (),
    "regions": (
        Slider("regions", "detail", "Detail", 0.2, 5.0,
               "2: about twice as many regions, 0.5: about half", is_logarithmic=True),
        Slider("regions", "crease", "Weight of creases", 0.0, 100.0,
               "How much an edge in depth keeps regions apart; needs splats"),
    ),
    "sam": (
        Slider("generator", "points_per_side", "Points along each side", 4, 64,
               "More find smaller things; time grows with the square", is_whole=True),
        Slider("generator", "pred_iou_thresh", "Least quality", 0.0, 1.0,
               "That the model predicts for its own mask"),
        Slider("generator", "stability_score_thresh", "Least stability", 0.0, 1.0,
               "How little a mask may change when it is cut tighter or wider"),
        Slider("generator", "crop_layers", "Closer looks", 0, 3,
               "Also look at 4, 16, ... crops, for small things; takes longer", is_whole=True),
        *_FLATTEN,
    ),
    "universal": (
        Slider("universal", "min_score", "Least confidence", 0.0, 1.0,
               "Surer masks only, or more of them"),
        Slider("universal", "max_overlap", "Most overlap", 0.1, 1.0,
               "Of two masks that share more than this, the less confident one is dropped"),
        *_FLATTEN,
    ),
}
# fmt: on


def family(entry: ProviderEntry) -> Family:
    """Return the kind of settings that a provider takes; "" while its weights are not here."""
    if entry.kind == "regions":
        return "regions"
    found = family_of(_model_type(entry))
    return "sam" if found == "sam" else "universal" if found == "universal" else ""


def value_of(settings: ProviderSettings, slider: Slider, entry: ProviderEntry) -> float:
    """Return the value of a slider: the provider's own default until it is moved."""
    if slider.part == "flatten":
        return float(getattr(settings.flatten_of(family(entry)), slider.field))
    part = getattr(settings, slider.part) or _defaults(entry, settings)
    return float(getattr(part, slider.field))


def with_value(
    settings: ProviderSettings, slider: Slider, entry: ProviderEntry, value: float
) -> ProviderSettings:
    """Return the settings with a slider moved, inside its bounds."""
    if slider.part == "generator" and settings.generator is None:
        settings = replace(settings, generator=_defaults(entry, settings))
    bounded = min(max(value, slider.low), slider.high)
    change = {slider.field: round(bounded) if slider.is_whole else bounded}
    if slider.part == "flatten" and family(entry) == "universal":  # no longer the profile's
        settings = replace(settings, flatten=settings.flatten_of("universal"), profile="default")
    changed = replace(getattr(settings, slider.part), **change)
    if slider.part == "regions":
        return replace(settings, regions=changed)
    if slider.part == "universal":
        return replace(settings, universal=changed)
    if slider.part == "flatten":
        return replace(settings, flatten=changed)
    return replace(settings, generator=changed)


def has_profile(entry: ProviderEntry) -> bool:
    """Whether the paper publishes settings for models of this kind."""
    return family(entry) in ("sam", "universal")


def with_profile(settings: ProviderSettings, *, paper: bool) -> ProviderSettings:
    """Return the settings with the paper's published ones, or the defaults, in place of sliders."""
    fresh = ProviderSettings(regions=settings.regions, device=settings.device)
    return replace(fresh, profile="paper" if paper else "default")


def _defaults(entry: ProviderEntry, settings: ProviderSettings) -> GeneratorConfig:
    """Return those of a SAM on the CPU; settings that were not touched follow the device."""
    return settings.generator_of(_model_type(entry), on_gpu=False)


def _model_type(entry: ProviderEntry) -> str:
    return weights_at(entry.path).model_type if entry.path is not None else ""
