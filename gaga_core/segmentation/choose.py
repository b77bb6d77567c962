"""Providers of masks by name, and which of them can be used on this machine.

torch and transformers are imported when a model's provider is made, not when the list is shown.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gaga_core.errors import GagaError, cure_without
from gaga_core.io.json_file import convert_json
from gaga_core.io.masks.label_maps import MaskRecord
from gaga_core.segmentation.base import FlattenConfig, ModelCard, ModelProvider, Provider
from gaga_core.segmentation.models.catalogue import KNOWN, KnownModel
from gaga_core.segmentation.models.weights import (
    Weights,
    find_weights,
    models_folder,
    own_models,
    weights_at,
    weights_id,
    where_to_put,
)
from gaga_core.segmentation.regions import NAME as REGIONS
from gaga_core.segmentation.regions import RegionsConfig
from gaga_core.segmentation.settings import Device, GeneratorConfig, Profile, UniversalConfig

if TYPE_CHECKING:
    from torch.nn import Module

    from gaga_core.segmentation.base import MaskMaker
    from gaga_core.segmentation.sam import SamPrompter

_NO_TRANSFORMERS = f"The package transformers is missing. Install it: {cure_without('models')}."


@dataclass(frozen=True)
class ProviderSettings:
    """Settings of every kind of provider; each takes what concerns it."""

    regions: RegionsConfig = field(default_factory=RegionsConfig)
    """Of "regions"."""
    generator: GeneratorConfig | None = None
    """Of models prompted with points; None = the defaults of the model and the device."""
    points_per_side: int = 0
    """Overrides that of ``generator``; 0 = does not. 1..128."""
    crop_layers: int = 0
    """Overrides that of ``generator``; 0 = does not. 0..3."""
    profile: Profile = "default"
    """paper: the published settings, where ``generator`` gives none of its own: of models prompted
    with points 64 points a side and predicted IoU 0.7; of universal ones every query above the
    least confidence, however little of it stays visible."""
    universal: UniversalConfig = field(default_factory=UniversalConfig)
    """Of Mask2Former-like models."""
    flatten: FlattenConfig = field(default_factory=FlattenConfig)
    """How overlapping masks become one map; all models."""
    device: Device = "auto"
    """Where models run: auto takes CUDA where torch has it."""

    def __post_init__(self) -> None:
        if self.points_per_side < 0 or self.crop_layers < 0:
            raise ValueError("points_per_side or crop_layers is negative")

    def generator_of(self, model_type: str, *, on_gpu: bool) -> GeneratorConfig:
        """Settings for a model of ``model_type``."""
        config = self.generator
        if config is None and self.profile == "paper":
            config = GeneratorConfig.of_paper(on_gpu=on_gpu)
        config = config or GeneratorConfig.of(model_type, on_gpu=on_gpu)
        side, layers = self.points_per_side, self.crop_layers
        return replace(
            config,
            points_per_side=side or config.points_per_side,
            crop_layers=layers or config.crop_layers,
        )

    def flatten_of(self, family: str) -> FlattenConfig:
        """How masks of a model of ``family`` become one map; the 10 % rule is for SAM alone in the
        published code."""
        if self.profile == "paper" and family == "universal":
            return replace(self.flatten, min_visible=0.0)
        return self.flatten


def recorded_settings(record: MaskRecord) -> ProviderSettings:
    """The settings that made recorded masks; ``GagaError`` when the record is damaged."""
    values, where = record.settings, "The record of these masks"
    if record.provider == REGIONS:
        return ProviderSettings(regions=convert_json(values, RegionsConfig, where))
    if "points_per_side" in values:
        return ProviderSettings(
            generator=convert_json(values, GeneratorConfig, where),
            flatten=convert_json(values, FlattenConfig, where),
        )
    flat = {key.removeprefix("flatten_"): v for key, v in values.items() if "flatten_" in key}
    return ProviderSettings(
        universal=convert_json(values, UniversalConfig, where),
        flatten=convert_json(flat, FlattenConfig, where),
    )


@dataclass(frozen=True)
class ProviderEntry:
    """One line of the list of providers."""

    name: str
    title: str
    is_available: bool
    reason: str  # why it cannot be used, and what to do; "" when it can
    kind: str  # "regions", "known" or "own"
    path: Path | None = None  # of the weights
    megabytes: int = 0  # of the weights, about; 0 = none, or not known
    licence: str = ""
    page: str = ""
    note: str = ""


def available_providers() -> tuple[ProviderEntry, ...]:
    """Every provider that is known or found here; quick, imports neither torch nor transformers."""
    has_package = importlib.util.find_spec("transformers") is not None
    note = "needs no model; quick, and much rougher than one"
    entries = [ProviderEntry(REGIONS, "Regions of color and depth", True, "", "regions", note=note)]
    entries += [_known_entry(model, has_package) for model in KNOWN]
    for name, weights in own_models(KNOWN).items():
        reason = "" if has_package else _NO_TRANSFORMERS
        files = weights.path.iterdir() if weights.path.is_dir() else [weights.path]
        size = round(sum(file.stat().st_size for file in files if file.is_file()) / 1e6)
        title = f"{weights.model_type} in {weights.path}"
        entries.append(
            ProviderEntry(name, title, has_package, reason, "own", weights.path, size, "its own")
        )
    return tuple(entries)


def promptable_models() -> tuple[ProviderEntry, ...]:
    """The models here that can segment one object, see `prompter_named`; those that are known
    come first, the smallest of a family before the others."""
    return tuple(
        entry
        for entry in available_providers()
        if entry.is_available and entry.path is not None and weights_at(entry.path).family == "sam"
    )


def provider_named(
    name: str, *, weights: Path | None = None, settings: ProviderSettings | None = None
) -> Provider:
    """The provider called ``name``, ready for pictures; its weights are read at the first one.

    ``weights`` is a model's folder or a sam_vit_*.pth file; any ``name`` will do with it, and is
    that of the masks' folder. Raises ``GagaError`` that says what to put where.
    """
    settings = settings or ProviderSettings()
    if name == REGIONS:
        if weights is not None:
            raise GagaError("The provider regions takes no weights. Choose a model's name.")
        from gaga_core.segmentation.regions import RegionsProvider

        return RegionsProvider(settings.regions)
    if not name or name.startswith(".") or set(name) & set('/\\:*?"<>|'):
        raise GagaError(f"{name!r} cannot be the name of a folder of masks. Choose a plain name.")
    model = next((known for known in KNOWN if known.name == name), None)
    found = _weights_of(name, model, weights)
    if importlib.util.find_spec("transformers") is None:
        raise GagaError(_NO_TRANSFORMERS)
    title = model.title if model else f"{found.model_type} ({found.path.name})"
    from gaga_core.segmentation.loading import choose_device

    flatten, device = settings.flatten_of(found.family), choose_device(settings.device)
    load: Callable[[], MaskMaker]
    if found.family == "sam":
        from gaga_core.segmentation.sam import load_sam

        generator = settings.generator_of(found.model_type, on_gpu=device.type != "cpu")
        load = partial(load_sam, _network(found), generator, device)
        changing = asdict(generator) | asdict(flatten)
        del changing["points_per_batch"]
    else:
        from gaga_core.segmentation.universal import load_universal

        load = partial(load_universal, found.path, settings.universal, device)
        changing = {f"flatten_{key}": value for key, value in asdict(flatten).items()}
        changing = asdict(settings.universal) | changing
    licence, page = (model.licence, model.page) if model else ("", "")
    card = ModelCard(title, licence, str(found.path), page, changing)
    return ModelProvider(name, card, weights_id(found), load, flatten)


def prompter_named(
    name: str, *, weights: Path | None = None, device: Device = "auto"
) -> "SamPrompter":
    """The Segment Anything model called ``name``, ready to segment one object; read when used.

    ``weights`` as in `provider_named`. Raises ``GagaError`` for other models, and where it says
    what to put where.
    """
    model = next((known for known in KNOWN if known.name == name), None)
    found = _weights_of(name, model, weights)
    if found.family != "sam":
        raise GagaError(f"{name} cannot segment a single object. Choose a Segment Anything model.")
    if importlib.util.find_spec("transformers") is None:
        raise GagaError(_NO_TRANSFORMERS)
    from gaga_core.segmentation.loading import choose_device
    from gaga_core.segmentation.sam import SamPrompter

    return SamPrompter(_network(found), choose_device(device))


def _known_entry(model: KnownModel, has_package: bool) -> ProviderEntry:
    try:
        found, reason = find_weights(model), ""
    except GagaError as error:
        found, reason = None, str(error)
    if found is None:
        reason = reason or where_to_put(model)
    elif not has_package:
        reason = _NO_TRANSFORMERS
    path, said = found.path if found else None, (model.licence, model.page, model.note)
    known = (model.name, model.title, not reason, reason)
    return ProviderEntry(*known, "known", path, model.megabytes, *said)


def _weights_of(name: str, model: KnownModel | None, weights: Path | None) -> Weights:
    if weights is not None:
        return weights_at(weights)
    if model is not None:
        found = find_weights(model)
        if found is None:
            raise GagaError(f"There are no weights of {model.title} here. {where_to_put(model)}")
        return found
    own = own_models(KNOWN)
    if name in own:
        return own[name]
    known = ", ".join([REGIONS, *(model.name for model in KNOWN), *own])
    raise GagaError(
        f"There is no mask provider {name!r}. Choose one of {known}; or name a model's folder as "
        f"its weights; or put the folder into {models_folder()}."
    )


def _network(weights: Weights) -> "Callable[[], Module]":
    """What loads a model prompted with points, from a folder or an original checkpoint."""
    from gaga_core.segmentation.loading import load_folder
    from gaga_core.segmentation.sam_checkpoint import load_sam_checkpoint

    if weights.path.is_dir():
        return partial(load_folder, "mask_generation", weights.path)
    return partial(load_sam_checkpoint, weights.path)
