"""The weights-free `regions` as a provider: at once, everywhere, also without torch."""

from dataclasses import asdict, dataclass

from gaga_core.arrays import IntArray
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.base import ModelCard, Picture, fingerprint_of
from gaga_core.segmentation.regions import FURTHER_STEPS, NAME, RegionsConfig, regions_at

_VERSION = 4  # grows whenever the same picture and settings get other regions


@dataclass(frozen=True)
class RegionsProvider:
    """Regions of like color, split where the rendered surface bends; objects only by luck."""

    config: RegionsConfig
    name: str = NAME
    cues: frozenset[str] = frozenset({"depth"})

    @property
    def card(self) -> ModelCard:
        """What is written next to the masks."""
        return ModelCard("regions (no model)", settings=asdict(self.config))

    @property
    def work_width(self) -> int:
        """Pixels of the width at which pictures are processed."""
        return self.config.width

    def fingerprint(self) -> str:
        """Hash of the settings."""
        return fingerprint_of(NAME, _VERSION, self.card.settings)

    def label_map(self, picture: Picture) -> Stage[IntArray]:
        """Regions of a picture; one step, under a second at 480 pixels of width."""
        return (yield from self.label_maps(picture))[0]

    def label_maps(self, picture: Picture) -> Stage[tuple[IntArray, ...]]:
        """The label map, and those at `FURTHER_STEPS` times its detail, for about the same time."""
        yield Progress("Segment", 0, 1, "merge regions")
        steps = (1.0, *FURTHER_STEPS)
        found = regions_at(steps, picture.image, picture.depth, picture.normals, self.config)
        return tuple(found)
