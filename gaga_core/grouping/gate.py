"""Which Gaussians lie behind a mask: the depth gate of section 3.2.

For the depths D of a mask's pixels, with quartiles Q1 and Q3 and IQR = Q3 - Q1, the gate keeps the
Gaussians whose centre projects into the mask and whose camera depth z obeys

    D_min < z < D_max_inlier = Q3 + f IQR,  f = 1.

The released code has another gate, without a depth map: of the Gaussians whose centres project into
the same mask and the same patch of the picture, it keeps the front share.
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.camera import NEAR, Camera
from gaga_core.grouping.gate_kernels import masks_of_centres
from gaga_core.masks import dense_labels
from gaga_core.threads import run_chunks

_CHUNK = 65536  # Gaussians in one piece of work
_TABLE_IDS = 1 << 20  # ids below this are counted in a table, which is faster than a sort


@dataclass(frozen=True)
class GateConfig:
    """Settings of the gate; the defaults are the paper's."""

    iqr_factor: float = 1.0  # f
    iqr_floor: float = 0.0  # least IQR, as a share of the mask's median depth; 0 = the paper
    guard_near: bool = False  # also accept depths from Q1 - f IQR on; False = from D_min on
    alpha_min: float = 0.5  # pixels of less opacity have no depth
    patches: int = 32  # a side, of the released gate
    front: float = 0.2  # share of a mask's Gaussians in a patch that it keeps, at least one

    def __post_init__(self) -> None:
        if self.iqr_factor < 0 or self.iqr_floor < 0:
            raise ValueError("iqr_factor and iqr_floor must not be negative")
        if not 0 < self.alpha_min <= 1:
            raise ValueError(f"alpha_min: {self.alpha_min} is not in (0, 1]")
        if self.patches < 1 or not 0 < self.front <= 1:
            raise ValueError("patches: at least 1; front: in (0, 1]")


@dataclass(frozen=True, eq=False)
class ViewMasks:
    """The label map of a view with ids made dense, so that tables can be indexed by mask."""

    labels: IntArray  # (H, W) 0 = none, masks 1..M
    ids: IntArray  # (M + 1,) the id each mask has in the file, increasing; entry 0 is 0

    def __len__(self) -> int:
        return len(self.ids) - 1

    @staticmethod
    def of(labels: IntArray) -> "ViewMasks":
        """Dense masks of a label map (H, W); ids may have gaps and be as large as int32 holds."""
        check_shape("labels", labels, ("H", "W"), np.int32)
        if int(labels.max(initial=0)) >= _TABLE_IDS or int(labels.min(initial=0)) < 0:
            return ViewMasks(*dense_labels(labels))
        present = np.bincount(labels.ravel(), minlength=1) > 0
        present[0] = True
        lookup = (np.cumsum(present) - 1).astype(np.int32)
        return ViewMasks(lookup[labels], np.flatnonzero(present).astype(np.int32))


def depth_bounds(
    masks: ViewMasks,
    depth: FloatArray,  # (H, W) camera depth, scene units
    alpha: FloatArray,  # (H, W)
    config: GateConfig,
) -> DoubleArray:
    """Open interval (low, high) of accepted depths of every mask, (M + 1, 2).

    A mask without a pixel of valid depth gets an empty interval, and so does row 0. The cost is
    one sort of the pixels, whatever the number of masks.
    """
    check_shape("depth", depth, masks.labels.shape)
    check_shape("alpha", alpha, masks.labels.shape)
    values, offsets = _sorted_depths(masks, depth, alpha, config.alpha_min)
    bounds = np.tile([np.inf, -np.inf], (len(masks) + 1, 1))
    filled = np.flatnonzero(np.diff(offsets) > 0)
    if len(filled) == 0:
        return bounds
    first, count = offsets[filled], np.diff(offsets)[filled]
    q1, median, q3 = (_quantiles(values, first, count, q) for q in (0.25, 0.5, 0.75))
    width = config.iqr_factor * np.maximum(q3 - q1, config.iqr_floor * median)
    d_min = values[first].astype(np.float64)
    bounds[filled, 0] = np.minimum(d_min, q1 - width) if config.guard_near else d_min
    bounds[filled, 1] = q3 + width
    return bounds


def open_bounds(masks: ViewMasks) -> DoubleArray:
    """Bounds (M + 1, 2) that accept any depth: the paper's ablation "all Gaussians"."""
    return np.tile([-np.inf, np.inf], (len(masks) + 1, 1))


def patches_of_masks(masks: ViewMasks, patches: int) -> tuple[ViewMasks, IntArray]:
    """The masks cut along a grid of ``patches`` a side, and the mask (C + 1,) of each piece."""
    height, width = masks.labels.shape
    rows, columns = (np.arange(n, dtype=np.int32) * patches // n for n in (height, width))
    cell = rows[:, None] * np.int32(patches) + columns
    n_cells = np.int32(patches * patches)
    pieces = ViewMasks.of(np.where(masks.labels > 0, masks.labels * n_cells + cell, np.int32(0)))
    return pieces, pieces.ids // n_cells


def front_bounds(
    means: FloatArray,  # (N, 3) world
    camera: Camera,
    pieces: ViewMasks,  # of `patches_of_masks`
    front: float,
    rows: IntArray | None = None,  # as in `gaussians_of_masks`
) -> DoubleArray:
    """Bounds (C + 1, 2) that accept the ``front`` share of the Gaussians of each piece, at least
    one; of equal depths all or none."""
    piece_of = gaussians_of_masks(means, camera, pieces, open_bounds(pieces), rows)
    behind = np.flatnonzero(piece_of)
    a, b, c, d = camera.cam_from_world[2].astype(np.float64)
    x, y, z = means[behind].T.astype(np.float64)
    depth = a * x + b * y + c * z + d  # in the order of the kernel: to be compared with its depths
    order = np.lexsort((depth, piece_of[behind]))
    count = np.bincount(piece_of[behind], minlength=len(pieces) + 1)
    kept = np.maximum((front * count).astype(np.int64), 1)
    last = np.cumsum(count) - count + kept - 1
    bounds = np.tile([np.inf, -np.inf], (len(pieces) + 1, 1))
    some = np.flatnonzero(count)
    bounds[some, 0] = -np.inf
    bounds[some, 1] = np.nextafter(depth[order[last[some]]], np.inf)
    return bounds


def gaussians_of_masks(
    means: FloatArray,  # (N, 3) world, C-contiguous
    camera: Camera,
    masks: ViewMasks,
    bounds: DoubleArray,  # (M + 1, 2)
    rows: IntArray | None = None,  # (K,) the only ones whose centres the picture can show
) -> IntArray:
    """The mask (N,) that each Gaussian belongs to, 0 = none: G(m) for all masks at once.

    Masks of one view share no pixel and the centre is one pixel, so a Gaussian is in at most one
    G(m). Linear in N, or K, and independent of the number of masks.
    """
    check_shape("means", means, ("N", 3), np.float32)
    check_shape("labels", masks.labels, (camera.height, camera.width), np.int32)
    if rows is not None:
        result = np.zeros(len(means), np.int32)
        result[rows] = gaussians_of_masks(means.take(rows, axis=0), camera, masks, bounds)
        return result
    mask_of = np.zeros(len(means), np.int32)
    pose = np.array(camera.cam_from_world[:3], np.float64, order="C")
    lens = np.array([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]], np.float64)
    # Another mutability or layout would compile the kernel again.
    points = np.require(means, requirements=["C", "W"])
    labels = np.require(masks.labels, requirements=["C", "W"])

    def work(start: int, stop: int) -> None:
        masks_of_centres(points, pose, lens, labels, bounds, NEAR, start, stop, mask_of)

    run_chunks(work, len(means), _CHUNK)
    return mask_of


def _sorted_depths(
    masks: ViewMasks, depth: FloatArray, alpha: FloatArray, alpha_min: float
) -> tuple[FloatArray, LongArray]:
    """Valid depths sorted by (mask, depth), and where each mask begins, (M + 2,).

    Bits of positive floats order like the floats, so one integer sort does both.
    """
    valid = (masks.labels > 0) & (alpha >= alpha_min) & (depth > 0) & np.isfinite(depth)
    keys = masks.labels[valid].astype(np.uint64) << np.uint64(32)
    keys |= depth[valid].astype(np.float32).view(np.uint32)
    keys.sort()
    edges = np.arange(len(masks) + 2, dtype=np.uint64) << np.uint64(32)
    values = (keys & np.uint64(0xFFFFFFFF)).astype(np.uint32).view(np.float32)
    return values, np.searchsorted(keys, edges).astype(np.int64)


def _quantiles(values: FloatArray, first: LongArray, count: LongArray, q: float) -> DoubleArray:
    """Quantile ``q`` of each run [first, first + count), as ``numpy.quantile`` interpolates."""
    position = q * (count - 1)
    lower = np.floor(position).astype(np.int64)
    a = values[first + lower].astype(np.float64)
    b = values[first + np.minimum(lower + 1, count - 1)].astype(np.float64)
    t = position - lower
    result: DoubleArray = np.where(t < 0.5, a + (b - a) * t, b - (b - a) * (1 - t))
    return result
