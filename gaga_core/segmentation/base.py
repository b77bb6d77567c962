"""The interface of sources of 2D masks: a picture in, a label map out.

A provider knows one picture at a time; that its ids do not agree between views is what the memory
bank is for (section 3.2). Models that score their masks give `ScoredMasks`, and `flatten` makes one
label map of them.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from gaga_core.arrays import (
    AnyArray,
    BoolArray,
    FloatArray,
    IntArray,
    LongArray,
    UInt8Array,
    check_shape,
)
from gaga_core.errors import GagaError
from gaga_core.progress import Progress, Stage
from gaga_core.settings import setting

# Of the masks of a picture: 500 masks, each in a sixth of a picture of 24 megapixels.
_MOST_BYTES = 2 << 30


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
    """Whole masks cut to their boxes; empty ones are left out.

    Raises ``ValueError`` on shapes, ``GagaError`` when they take too much memory.
    """
    boxes, crops, kept, n_bytes = [], [], [], 0
    for i, mask in enumerate(masks):
        check_shape("mask", mask, (height, width), np.bool_)
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if len(rows) == 0:
            continue
        x0, y0, x1, y1 = columns[0], rows[0], columns[-1] + 1, rows[-1] + 1
        boxes.append((x0, y0, x1, y1))
        crops.append(np.ascontiguousarray(mask[y0:y1, x0:x1]))
        n_bytes += crops[-1].nbytes
        if n_bytes > _MOST_BYTES:
            raise GagaError(
                f"The first {i + 1} masks of a picture of {height:,} x {width:,} pixels take more "
                f"than {_MOST_BYTES >> 20:,} MB. Make fewer of them, or of a smaller picture."
            )
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
    """The source of masks, written next to them."""

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


# --- Scored, overlapping masks -> one label map, as the paper does (section 4.1).


MOST_LABELS = 65535  # of a 16-bit label map


@dataclass(frozen=True)
class FlattenConfig:
    """Which masks stay when they are painted over each other."""

    min_score: float = 0.5
    """Confidence under which a mask is left out (section 4.1). 0..1."""
    min_visible: float = setting(0.10, "Least visible share", least=0.0, most=0.9)
    """A mask of which this share or less is left uncovered is dropped; its pixels become none, as
    in the published code. 0..1; 0 keeps all that can be seen."""

    def __post_init__(self) -> None:
        if not 0 <= self.min_visible < 1:
            raise ValueError(f"min_visible: expected 0 <= x < 1, got {self.min_visible}")


def flatten(scored: ScoredMasks, config: FlattenConfig | None = None) -> IntArray:
    """Label map (H, W) int32 of ``scored``: 0 = none, 1 = the most confident mask, dense.

    Masks are painted from the least to the most confident, so that the most confident lies on top;
    of equal ones the smaller. Raises ``GagaError`` when more masks stay than 16 bits hold.
    """
    areas = scored.areas
    best_first = np.lexsort((np.arange(len(scored)), areas, -scored.scores))
    return _painted(scored, areas, best_first, config or FlattenConfig())


def flatten_levels(
    scored: ScoredMasks, config: FlattenConfig | None = None
) -> tuple[IntArray, IntArray] | None:
    """Label maps (H, W) int32 of wholes and of parts; None where no mask lies in another.

    The largest masks lie on top in the first map, the smallest ones in the second: of masks that
    contain each other (Segment Anything's whole, part and subpart) each pixel shows the outermost
    and the innermost. Other rules are those of `flatten`.
    """
    config, areas = config or FlattenConfig(), scored.areas
    ids = np.arange(len(scored))
    small_first = np.lexsort((ids, -scored.scores, areas))
    large_first = np.lexsort((ids, -scored.scores, -areas))
    wholes = _painted(scored, areas, large_first, config)
    parts = _painted(scored, areas, small_first, config)
    return None if _is_same_partition(wholes, parts) else (wholes, parts)


def _painted(
    scored: ScoredMasks, areas: LongArray, order: LongArray, config: FlattenConfig
) -> IntArray:
    """Dense labels (H, W) of the masks, those that come first in ``order`` (M,) on top."""
    order = order[(scored.scores[order] >= config.min_score) & (areas[order] > 0)]
    painted = np.zeros((scored.height, scored.width), np.int32)
    for rank in range(len(order), 0, -1):
        x0, y0, x1, y1 = scored.boxes[order[rank - 1]]
        painted[y0:y1, x0:x1][scored.crops[order[rank - 1]]] = rank
    visible = np.bincount(painted.ravel(), minlength=len(order) + 1)[1:]
    stays = visible > config.min_visible * areas[order]
    n_labels = int(stays.sum())
    if n_labels > MOST_LABELS:
        raise GagaError(
            f"There are {n_labels} masks in one picture, a label map holds {MOST_LABELS}. "
            "Raise the least confidence."
        )
    lookup = np.zeros(len(order) + 1, np.int32)
    lookup[1:][stays] = np.arange(1, n_labels + 1)
    labels: IntArray = lookup[painted]
    return labels


def _is_same_partition(one: IntArray, other: IntArray) -> bool:
    """Whether two label maps (H, W) with dense ids differ in their ids alone."""
    key = one.astype(np.int64) * (int(other.max(initial=0)) + 1) + other
    n_pairs = len(np.unique(key))
    return n_pairs == len(np.unique(one)) == len(np.unique(other))


# --- Mask providers that run a model: the families differ in `MaskMaker` alone.


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
