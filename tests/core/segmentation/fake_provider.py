"""A provider whose label maps are plain to see, and that counts how often it is asked."""

from dataclasses import dataclass, field

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.base import ModelCard, Picture, fingerprint_of


@dataclass(eq=False)
class Quarters:
    """Four masks, one a quarter of the picture; remembers its pictures."""

    setting: int = 1
    name: str = "quarters"
    cues: frozenset[str] = frozenset()
    work_width: int = 0
    seen: list[Picture] = field(default_factory=list)

    @property
    def card(self) -> ModelCard:
        return ModelCard("four quarters", "MIT", settings={"setting": self.setting})

    def fingerprint(self) -> str:
        return fingerprint_of(self.setting)

    def label_map(self, picture: Picture) -> Stage[IntArray]:
        self.seen.append(picture)
        for i in range(3):
            yield Progress("Segment", i, 3, f"step {i}")
        h, w = picture.image.shape[:2]
        y, x = np.mgrid[:h, :w]
        labels: IntArray = (1 + 2 * (y >= h // 2) + (x >= w // 2)).astype(np.int32)
        return labels
