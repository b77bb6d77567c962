"""The weights-free `regions` as a provider: at once, everywhere, also without torch."""

from dataclasses import asdict, dataclass

from gaga_core.arrays import IntArray
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.base import ModelCard, Picture, fingerprint_of
from gaga_core.segmentation.regions import NAME, RegionsConfig, regions

_VERSION = 2  # grows whenever the same picture and settings get other regions


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
        yield Progress("Segment", 0, 1, "merge regions")
        return regions(picture.image, picture.depth, picture.normals, self.config)
