"""Mask providers that run a model: the families differ in `MaskMaker` alone."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.base import ModelCard, Picture, ScoredMasks, fingerprint_of
from gaga_core.segmentation.flatten import FlattenConfig, flatten, flatten_levels

MaskMaker = Callable[[UInt8Array], Stage[ScoredMasks]]  # of a picture (H, W, 3) RGB


@dataclass(frozen=True)
class ModelProvider:
    """Masks of everything in a picture by a model. ``load`` is called at the first picture."""

    name: str
    card: ModelCard
    weights_id: str  # hash of the weights
    load: Callable[[], MaskMaker]
    flatten: FlattenConfig
    cues: frozenset[str] = frozenset()
    work_width: int = 0

    def fingerprint(self) -> str:
        """Hash of weights and of the settings that change masks."""
        return fingerprint_of(self.weights_id, self.card.settings)

    def label_map(self, picture: Picture) -> Stage[IntArray]:
        """Label map of a picture."""
        return (yield from self.label_maps(picture))[0]

    def label_maps(self, picture: Picture) -> Stage[tuple[IntArray, ...]]:
        """The label map, and those of wholes and of parts where masks contain each other."""
        scored = yield from self.masks(picture)
        return flatten(scored, self.flatten), *(flatten_levels(scored, self.flatten) or ())

    def masks(self, picture: Picture) -> Stage[ScoredMasks]:
        """The scored masks before they are flattened, the best first."""
        if "_make" not in self.__dict__:
            yield Progress("Segment", 0, 0, f"load {self.card.model}")
        return (yield from self._make(picture.image))

    @cached_property
    def _make(self) -> MaskMaker:
        return self.load()
