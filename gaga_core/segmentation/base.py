"""What every source of 2D masks is: a picture in, a label map out.

A provider knows one picture at a time; that its ids do not agree between views is what the memory
bank is for (section 3.2). Models that score their masks give `ScoredMasks`, and `flatten` makes one
label map of them.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, FloatArray, IntArray, UInt8Array, check_shape
from gaga_core.progress import Stage


@dataclass(frozen=True, eq=False)
class Picture:
    """One view as a provider sees it. Cues are rendered from splats; most providers ignore them."""

    image: UInt8Array  # (H, W, 3) RGB
    depth: FloatArray | None = None  # (H, W) camera depth in scene units, 0 = nothing there
    normals: FloatArray | None = None  # (H, W, 3) unit, camera frame, 0 = nothing there

    def __post_init__(self) -> None:
        check_shape("image", self.image, ("H", "W", 3), np.uint8)
        if self.image.size == 0:
            raise ValueError(f"image: empty, got {self.image.shape}")
        size = self.image.shape[:2]
        if self.depth is not None:
            check_shape("depth", self.depth, size, np.float32)
        if self.normals is not None:
            check_shape("normals", self.normals, (*size, 3), np.float32)


@dataclass(frozen=True, eq=False)
class ScoredMasks:
    """Masks of one picture, which may overlap, each kept as its bounding box's part."""

    height: int
    width: int
    boxes: IntArray  # (M, 4) x0, y0, x1, y1 pixels; x1 and y1 lie outside
    crops: tuple[BoolArray, ...]  # M of (y1 - y0, x1 - x0)
    scores: FloatArray  # (M,) confidence, 0..1 for most models

    def __post_init__(self) -> None:
        n = len(self.crops)
        check_shape("boxes", self.boxes, (n, 4), np.int32)
        check_shape("scores", self.scores, (n,), np.float32)

    def __len__(self) -> int:
        return len(self.crops)

    @property
    def areas(self) -> AnyArray:
        """Pixels of each mask (M,) int64."""
        return np.array([np.count_nonzero(crop) for crop in self.crops], np.int64)

    def mask(self, index: int) -> BoolArray:
        """One mask (H, W) in the whole picture."""
        whole = np.zeros((self.height, self.width), np.bool_)
        x0, y0, x1, y1 = self.boxes[index]
        whole[y0:y1, x0:x1] = self.crops[index]
        return whole


def scored_masks(
    masks: Iterable[BoolArray],  # M of (H, W); read once, one at a time
    scores: Sequence[float] | FloatArray,  # (M,)
    height: int,
    width: int,
) -> ScoredMasks:
    """Whole masks cut to their boxes; empty ones are left out. Raises ``ValueError`` on shapes."""
    boxes, crops, kept = [], [], []
    for i, mask in enumerate(masks):
        check_shape("mask", mask, (height, width), np.bool_)
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if len(rows) == 0:
            continue
        x0, y0, x1, y1 = columns[0], rows[0], columns[-1] + 1, rows[-1] + 1
        boxes.append((x0, y0, x1, y1))
        crops.append(np.ascontiguousarray(mask[y0:y1, x0:x1]))
        kept.append(i)
    return ScoredMasks(
        height,
        width,
        np.array(boxes, np.int32).reshape(-1, 4),
        tuple(crops),
        np.asarray(scores, np.float32).reshape(-1)[kept],
    )


@dataclass(frozen=True)
class ModelCard:
    """What is written next to masks about where they come from."""

    model: str  # name of the model
    licence: str = ""
    source: str = ""  # file or folder of the weights; "" when there are none
    page: str = ""  # where the model is described
    settings: dict[str, object] = field(default_factory=dict)  # that change the masks; plain JSON


class Provider(Protocol):
    """A source of masks. Loads its weights at the first picture."""

    @property
    def name(self) -> str:
        """Name of the folder of its label maps in SCENE/masks."""
        ...

    @property
    def card(self) -> ModelCard:
        """Model, licence and settings."""
        ...

    @property
    def cues(self) -> frozenset[str]:
        """Which of a picture's "depth" and "normals" it can use."""
        ...

    @property
    def work_width(self) -> int:
        """Width in pixels beyond which a picture gains nothing; 0 = none."""
        ...

    def fingerprint(self) -> str:
        """Changes whenever the same picture could get other masks: hash of weights and settings."""
        ...

    def label_map(self, picture: Picture) -> Stage[IntArray]:
        """Labels (H, W) int32 of a picture: 0 = none, 1..M dense; the same at every call."""
        ...


def fingerprint_of(*parts: object) -> str:
    """Hash (32 hex digits) of plain JSON values."""
    text = json.dumps(parts, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:32]
