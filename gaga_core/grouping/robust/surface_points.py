"""Points on the surfaces that the masks show, and the mask that each point shows in every view.

Two masks of different views are compared by points that both views really see, found by comparing
depths, instead of by Gaussians whose centres project into them: points inside a mask, away from its
ragged edge, are reliable.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_matrix

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import NEAR, Camera
from gaga_core.geometry import turned
from gaga_core.grouping.gate import ViewMasks
from gaga_core.progress import Progress, Stage

_TOLERANCE = 0.02  # share of its depth by which a point may miss the surface that a view shows
_FLAT = 0.05  # share of the depth by which neighbours of a sampled pixel may differ
_BY_AREA = 40  # times ``per_mask`` more points of a mask that fills the picture
DEPTH_BYTES = 1 << 29

LoadMasks = Callable[[Camera], ViewMasks]


class DepthMaps:
    """Depth maps of many views, thinned out so that all of them fit into ``budget`` bytes."""

    def __init__(self, views: Sequence[Camera], budget: int = DEPTH_BYTES) -> None:
        n_bytes = sum(4 * camera.width * camera.height for camera in views)
        # One depth for so many pixels along either side.
        self.stride = max(1, int(np.ceil(np.sqrt(n_bytes / budget))))
        self._by_view: dict[str, FloatArray] = {}  # 0 = nothing there

    def add(self, view: str, depth: FloatArray, alpha: FloatArray, alpha_min: float) -> None:
        """Keep the depths (H, W) of a view where it is opaque."""
        thin = slice(None, None, self.stride)
        there = alpha[thin, thin] >= alpha_min
        self._by_view[view] = np.where(there, depth[thin, thin], np.float32(0))

    def at(self, view: str, rows: LongArray, columns: LongArray) -> FloatArray:
        """Depths at pixels (P,) of a view."""
        return self._by_view[view][rows // self.stride, columns // self.stride]


def sample_points(
    views: Sequence[Camera],
    load_masks: LoadMasks,
    depths: DepthMaps,
    per_mask: int,
    max_points: int,
) -> Stage[DoubleArray]:
    """Points (S, 3) of the world, at least ``per_mask`` in each mask as far as it has pixels, and
    more in larger ones: of a floor of few points those of objects on it, at its rims, are most.

    View by view, a mask that already shows enough points of earlier views adds none, so their
    number grows with the scene, not with the number of views. When it would exceed ``max_points``,
    a quarter of ``per_mask`` or more goes, and as large a part of the points of every mask.
    """
    points, rank = np.zeros((0, 3)), np.zeros(0)
    rng = np.random.default_rng(0)
    for i, camera in enumerate(views):
        yield Progress("Sample surfaces", i, len(views), camera.name)
        masks = load_masks(camera)
        shown = _masks_at(camera, masks, _inner(masks, 1), depths, points)
        count = np.bincount(shown, minlength=len(masks) + 1)
        area = np.bincount(masks.labels.ravel(), minlength=len(masks) + 1) / masks.labels.size
        size = 1 + _BY_AREA * area
        wanted = np.ceil(per_mask * size).astype(np.int64) - count
        pixels = _pixels_to_add(camera, masks, depths, wanted, rng)
        mask = masks.labels.ravel()[pixels]
        rows, columns = np.divmod(pixels, camera.width)
        z = depths.at(camera.name, rows, columns).astype(np.float64)
        added = to_world(camera, lifted(camera, rows, columns, z))
        ranks = (count[mask] + _ranks(mask)) / size[mask]
        points, rank = np.concatenate([points, added]), np.concatenate([rank, ranks])
        while len(points) > max_points and per_mask > 1:
            per_mask = 3 * per_mask // 4
            points, rank = points[rank < per_mask], rank[rank < per_mask]
    return points[:max_points]


def masks_of_points(
    points: DoubleArray,  # (S, 3) world
    views: Sequence[Camera],
    load_masks: LoadMasks,
    depths: DepthMaps,
) -> Stage[IntArray]:
    """The dense mask id (S, V) that each point shows in each view; 0 = hidden, outside, unsure."""
    result = np.zeros((len(points), len(views)), np.int32)
    for i, camera in enumerate(views):
        yield Progress("Find surfaces", i, len(views), camera.name)
        masks = load_masks(camera)
        result[:, i] = _masks_at(camera, masks, _inner(masks, 1), depths, points)
    return result


def _masks_at(
    camera: Camera, masks: ViewMasks, sure: BoolArray, depths: DepthMaps, points: DoubleArray
) -> IntArray:
    """The mask (S,) that each point shows in one view, 0 = none."""
    result = np.zeros(len(points), np.int32)
    inside, rows, columns, z = in_picture(camera, points)
    depth = depths.at(camera.name, rows, columns)
    seen = sure[rows, columns] & (np.abs(z - depth) < _TOLERANCE * depth)
    result[inside[seen]] = masks.labels[rows[seen], columns[seen]]
    return result


def in_picture(
    camera: Camera, points: DoubleArray
) -> tuple[LongArray, LongArray, LongArray, DoubleArray]:
    """Indices (K,) of the points (S, 3) that fall into a picture, whatever hides them, their pixels
    (rows (K,), columns (K,)) and camera depths (K,)."""
    pixels, z = camera.project(points)
    u, v = pixels.T
    shown = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    inside = np.flatnonzero((z > NEAR) & shown)
    columns, rows = pixels[inside].astype(np.int64).T
    return inside, rows, columns, z[inside]


def lifted(camera: Camera, rows: LongArray, columns: LongArray, z: DoubleArray) -> DoubleArray:
    """Points (..., 3), camera frame, behind the centres of pixels at depths ``z`` (...)."""
    x = (columns + 0.5 - camera.K[0, 2]) / camera.K[0, 0] * z
    y = (rows + 0.5 - camera.K[1, 2]) / camera.K[1, 1] * z
    return np.stack([x, y, z], axis=-1)


def to_world(camera: Camera, points: DoubleArray) -> DoubleArray:
    """Points (P, 3) of the camera's frame in the world."""
    pose = camera.world_from_cam
    return turned(points, pose[:3, :3]) + pose[:3, 3]


def _inner(masks: ViewMasks, radius: int) -> BoolArray:
    """Pixels (H, W) farther than ``radius`` from another label; all of a mask that has none."""
    side = 2 * radius + 1
    lowest = ndimage.minimum_filter(masks.labels, side, mode="nearest")
    highest = ndimage.maximum_filter(masks.labels, side, mode="nearest")
    inner = (lowest == highest) & (masks.labels > 0)
    thin = np.bincount(masks.labels[inner], minlength=len(masks) + 1) == 0
    thin[0] = False
    result: BoolArray = inner | thin[masks.labels]
    return result


def _pixels_to_add(
    camera: Camera,
    masks: ViewMasks,
    depths: DepthMaps,
    wanted: LongArray,  # (M + 1,) may be negative
    rng: np.random.Generator,
) -> LongArray:
    """Flat indices (P,) of up to ``wanted`` pixels of each mask, sorted by mask: well inside it and
    where depth is smooth, or what there is."""
    depth = full_size(camera, depths)
    rough = ndimage.maximum_filter(depth, 3) - ndimage.minimum_filter(depth, 3)
    usable = _inner(masks, 2) & (depth > 0)
    smooth = usable & (rough < _FLAT * depth)
    none = np.bincount(masks.labels[smooth], minlength=len(masks) + 1) == 0
    pixels = np.flatnonzero(smooth | (usable & none[masks.labels]))
    pixels = rng.permutation(pixels)
    mask = masks.labels.ravel()[pixels]
    few = len(masks) < 1 << 16  # numbers of 16 bits are sorted by their digits
    order = np.argsort(mask.astype(np.uint16) if few else mask, kind="stable")
    pixels, mask = pixels[order], mask[order]
    return pixels[_ranks(mask) < wanted[mask]]


def full_size(camera: Camera, depths: DepthMaps) -> FloatArray:
    """The kept depths (H, W) of a view, at its size; 0 = nothing there."""
    rows, columns = np.arange(camera.height), np.arange(camera.width)
    return depths.at(camera.name, rows[:, None], columns[None, :])


def _ranks(sorted_ids: IntArray) -> LongArray:
    """The place (P,) of each entry among those of its id."""
    place = np.arange(len(sorted_ids))
    return place - np.searchsorted(sorted_ids, sorted_ids)


# --- Counts of the points of each cluster in each mask of each view, as a sparse table.


@dataclass(frozen=True, eq=False)
class Leaders:
    """Of the masks of a view the group of most points and the next one, 0 = none."""

    first: IntArray  # (M + 1,)
    n_first: DoubleArray  # (M + 1,) points of it
    second: IntArray  # (M + 1,)
    n_second: DoubleArray  # (M + 1,)
    total: DoubleArray  # (M + 1,) points of all groups

    @staticmethod
    def of(table: csr_matrix) -> "Leaders":
        """``table`` (M + 1, G + 1) as in `PointTables`. Of equal counts the lower group."""
        n, starts = table.shape[0], table.indptr
        lengths = np.diff(starts)
        row = np.repeat(np.arange(n), lengths)
        order = np.lexsort((table.indices, -table.data, row))
        groups, counts = np.zeros((2, n), np.int32), np.zeros((2, n))
        for place in (0, 1):
            has = lengths > place
            at = order[starts[:-1][has] + place]
            groups[place, has], counts[place, has] = table.indices[at], table.data[at]
        total = np.bincount(row, table.data, n).astype(np.float64)
        return Leaders(groups[0], counts[0], groups[1], counts[1], total)

    def by_mask(self, ids: IntArray) -> dict[int, tuple[int, float, int, float]]:
        """By the ``ids`` (M + 1,) of the masks: the group of most points and the next one, each
        followed by its share of the points."""
        total = np.maximum(self.total, 1)
        columns = (self.first, self.n_first / total, self.second, self.n_second / total)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return dict(zip(ids.tolist(), rows, strict=True))


@dataclass(frozen=True, eq=False)
class PointTables:
    """For each view a sparse table (M + 1, C + 1) of points; row 0 and column 0 are empty.

    The views' rows lie below each other in one matrix: a dense table of many masks and groups
    would cost their product in each view.
    """

    counts: csr_matrix  # (R, C + 1) float64, columns of a row ascending
    first_row: LongArray  # (V + 1,) where the rows of each view begin

    def __len__(self) -> int:
        return len(self.first_row) - 1

    def __getitem__(self, v: int) -> csr_matrix:
        return self.counts[self.first_row[v] : self.first_row[v + 1]]

    def __iter__(self) -> Iterator[csr_matrix]:
        return (self[v] for v in range(len(self)))

    @property
    def width(self) -> int:
        """C + 1."""
        return int(self.counts.shape[1])

    def view_of_row(self) -> LongArray:
        """The view (R,) that each row belongs to."""
        return np.repeat(np.arange(len(self)), np.diff(self.first_row))

    def entries(self) -> tuple[LongArray, LongArray, DoubleArray]:
        """Row, column and number of points (E,) of the cells that have any, row by row."""
        rows = np.repeat(np.arange(self.counts.shape[0]), np.diff(self.counts.indptr))
        return rows, self.counts.indices.astype(np.int64), self.counts.data

    def seen(self) -> DoubleArray:
        """How many points (V, C + 1) of each cluster each view shows."""
        rows, columns, data = self.entries()
        cells = self.view_of_row()[rows] * self.width + columns
        found = np.bincount(cells, data, len(self) * self.width).astype(np.float64)
        return found.reshape(len(self), self.width)


@dataclass(frozen=True, eq=False)
class Sightings:
    """Which points show in which masks."""

    row: IntArray  # (E,) mask, counted through all views
    point: IntArray  # (E,)
    first_row: LongArray  # (V + 1,)

    @staticmethod
    def of(mask_of: IntArray, sizes: Sequence[int]) -> "Sightings":
        """``mask_of`` (S, V) has the mask of each point in each view, 0 = none; ``sizes`` the rows
        of each view's table: masks + 1."""
        first_row = np.append(0, np.cumsum(sizes)).astype(np.int64)
        point, view = np.nonzero(mask_of)
        row = first_row[view] + mask_of[point, view]
        return Sightings(row.astype(np.int32), point.astype(np.int32), first_row)

    def tables(self, cluster: IntArray) -> PointTables:
        """Points of each cluster, ``cluster`` (S,) has 1.. or 0 = none."""
        column = cluster[self.point]
        known = column > 0
        shape = (int(self.first_row[-1]), int(cluster.max(initial=0)) + 1)
        ones = np.ones(int(known.sum()))
        counts = csr_matrix((ones, (self.row[known], column[known])), shape=shape)
        counts.sum_duplicates()
        counts.sort_indices()
        return PointTables(counts, self.first_row)


def point_tables(mask_of: IntArray, cluster: IntArray, sizes: Sequence[int]) -> PointTables:
    """For each view how many points of each cluster show in each mask.

    ``mask_of`` (S, V), 0 = none; ``cluster`` (S,) 1.., 0 = none; ``sizes``: masks + 1 of each view.
    """
    return Sightings.of(mask_of, sizes).tables(cluster)
