"""Bounds of splats: boxes that are robust to a few stray splats."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, check_shape
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import along, axes_of_points, turned
from gaga_core.scene.orientation import Pose, pose_of
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means

_BOUNDS_SAMPLE = 200_000  # splats looked at: percentiles of more would not differ

_WHOLE = 0.996  # share of the splats of a whole scene, along each axis
_MUCH_LARGER = 2.0  # times the box of the middle: then the rest is far background


def robust_box(points: AnyArray, share: float = 0.9) -> tuple[DoubleArray, DoubleArray]:
    """Corners lo, hi (3,) of the box that holds the middle ``share`` of points (N, 3) per axis.

    Points that are not finite do not count; a unit box around the origin when none are left.
    """
    check_shape("points", points, ("N", 3))
    step = max(1, len(points) // _BOUNDS_SAMPLE)
    sample = np.asarray(points[::step], np.float64)
    sample = sample[np.isfinite(sample).all(axis=1)]
    if len(sample) == 0:
        return np.full(3, -0.5), np.full(3, 0.5)
    return _middle(sample, share)


def _middle(points: DoubleArray, share: float) -> tuple[DoubleArray, DoubleArray]:
    """Ends lo, hi (3,) of the middle ``share`` of points (N, 3) along each axis."""
    tail = (1 - share) / 2 * 100
    lo, hi = np.percentile(points, [tail, 100 - tail], axis=0)
    return lo, hi


def within(points: AnyArray, lo: AnyArray, hi: AnyArray) -> BoolArray:
    """Which of the points (N, 3) lie in the box from ``lo`` to ``hi`` (3,).

    Axis by axis takes a third of the time of rows of three truth values.
    """
    inside = np.ones(len(points), np.bool_)
    for axis in range(3):
        inside &= (points[:, axis] >= lo[axis]) & (points[:, axis] <= hi[axis])
    return inside


def splat_box(
    scene: Scene, indices: IntArray | None = None, share: float = 0.9
) -> tuple[DoubleArray, DoubleArray]:
    """The robust box of splats (K,), placements applied; of all that are visible by default."""
    rows = np.flatnonzero(scene.visible).astype(np.int32) if indices is None else indices
    step = max(1, len(rows) // _BOUNDS_SAMPLE)
    return robust_box(world_means(scene, rows[::step]), share)


# --- The parts of an object without its floaters.

# Chosen on the 51 objects of the demo, of which 7 boxes shrink by a tenth or more: half and twice
# the gap, or the part, change at most one of them by as much.
_GAP = 0.04  # side of a cell, of the diagonal of the middle: cells apart are parts apart
_NEXT = 1.8  # cells: distance up to which two cells touch, corner to corner (sqrt 3)
_PART = 0.05  # of the mass: smaller parts apart are floaters
_MOST_FLOATERS = 0.2  # of the mass: else the cells are too small for so few splats
_MOST_CELLS = 2000  # along an axis, from the middle: what is farther counts as there


def main_parts(points: AnyArray, mass: AnyArray) -> BoolArray:
    """Which of the points (N, 3) belong to large connected parts by their ``mass`` (N,); (N,).

    Points in neighbouring cells of a grid are connected; parts of little mass are floaters.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree  # a good part of the launch time

    kept: BoolArray = np.isfinite(np.asarray(points)).all(axis=1)
    own = np.asarray(points, np.float64)[kept]
    weight = np.asarray(mass, np.float64)[kept]
    if len(own) == 0 or not 0 < weight.sum() < np.inf:
        return kept
    lo, hi = _middle(own, 0.8)
    side = _GAP * float(np.linalg.norm(hi - lo))
    while side > 0:
        cells = np.clip(np.floor((own - lo) / side), -_MOST_CELLS, _MOST_CELLS)
        places, which = np.unique(cells, axis=0, return_inverse=True)
        pairs = cKDTree(places).query_pairs(_NEXT, output_type="ndarray")
        links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(places), len(places)))
        _, part_of_cell = connected_components(links, directed=False)
        part = part_of_cell[which.ravel()]
        masses = np.bincount(part, weight)
        is_large = masses >= _PART * weight.sum()
        if masses[is_large].sum() >= (1 - _MOST_FLOATERS) * weight.sum():
            kept[kept] = is_large[part]
            break
        side *= 2
    return kept


SHARE = 0.98  # of an object's splats that its box holds, along each axis
_WHOLE_OBJECT = 0.5  # share of an object's splats from which on it is among splats as a whole


def object_points(
    scene: Scene, rows: IntArray, most: int = _BOUNDS_SAMPLE, *, turns_along: bool = True
) -> tuple[FloatArray, float]:
    """Centres (M, 3), world, of splats (K,) without floaters; of at most so many that say as much.

    Also the share of them that a box is to hold, along each axis: of several objects all, as each
    one has lost its own strays; among all a small one would count as such. What position, box and
    size of objects count, in the window, in scripts and in exports. Floaters are told along the
    axes of the file, which turn along with the objects, or along those of the world.
    """
    some = rows[:: max(1, -(-len(rows) // most))]
    labels = _whole(scene, rows)[scene.labels[some]]
    order = np.argsort(labels, kind="stable")
    objects = np.split(order, 1 + np.flatnonzero(np.diff(labels[order])))
    means_of = _unplaced_means if turns_along else world_means
    if len(objects) == 1:
        return world_means(scene, some[object_parts(scene, some, means_of)]), SHARE
    kept = np.zeros(len(some), np.bool_)
    for rows_of in objects:
        own = rows_of[object_parts(scene, some[rows_of], means_of)]
        if len(own):
            means = means_of(scene, some[own])
            kept[own] = within(means, *_middle(means.astype(np.float64), SHARE))
    return world_means(scene, some[kept]), 1.0


def middle_pose(scene: Scene, splats: IntArray, points: AnyArray, share: float) -> Pose:
    """The pose of splats (K,), at least one, about the middle of the box of ``points`` (M, 3) and
    ``share``, see `object_points`: the box that turns with them, so that turning keeps its middle.
    """
    pose = pose_of(scene, splats, np.zeros(3))
    lo, hi = robust_box(points @ pose.turn, share)
    return replace(pose, centre=pose.turn @ ((lo + hi) / 2))


def _unplaced_means(scene: Scene, splats: IntArray) -> DoubleArray:
    """Centres (K, 3), as if the placement of the first of the splats was undone for all: to the
    digits of float32 they do not change when all are moved together."""
    rows, row_of = np.unique(scene.placement[splats], return_inverse=True)
    whole = np.tile(np.eye(4), (len(rows), 1, 1))
    whole[:, :3] = scene.placements.matrix[rows]
    means = scene.gaussians.means[splats].astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):  # centres that are not finite stay so
        matrix = (np.linalg.inv(whole[row_of[:1]]) @ whole)[row_of, :3]
        moved = np.einsum("nij,nj->ni", matrix[:, :, :3], means) + matrix[:, :, 3]
        return moved.astype(np.float32).astype(np.float64)


def object_parts(
    scene: Scene,
    splats: IntArray,
    means_of: Callable[[Scene, IntArray], AnyArray] = _unplaced_means,
) -> BoolArray:
    """Which of the splats (K,) of one object are no floaters (K,); not changed by moving it, unless
    ``means_of`` tells where they are in the world."""
    return main_parts(means_of(scene, splats), splat_mass(scene.gaussians, splats))


def _whole(scene: Scene, rows: IntArray) -> IntArray:
    """For each group, by id: itself where splats (K,) hold most of it, else the largest of those:
    loose splats and edges of neighbours are judged with that as its own strays are."""
    top = int(scene.labels.max(initial=0)) + 1
    n = np.bincount(scene.labels[rows], minlength=top)
    n_all = np.bincount(scene.labels[scene.visible], minlength=top)
    whole = n > _WHOLE_OBJECT * n_all
    whole[0] = False
    largest = int(np.argmax(np.where(whole, n, -1)))
    return np.where(whole, np.arange(len(n)), largest).astype(np.int32)


def splat_mass(gaussians: Gaussians, rows: IntArray | None = None) -> DoubleArray:
    """Opacity times area (K,) of splats, as far as they are comparable: scene units squared."""
    at = slice(None) if rows is None else rows
    longer = np.sort(gaussians.log_scales[at], axis=1)[:, 1:].astype(np.float64).sum(axis=1)
    opacities = gaussians.logit_opacities[at].astype(np.float64).reshape(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        mass = np.exp(np.minimum(longer, 80.0)) / (1 + np.exp(-opacities))
    return np.nan_to_num(mass)


def object_box(scene: Scene, rows: IntArray) -> tuple[DoubleArray, DoubleArray]:
    """The box lo, hi (3,) of splats (K,), world, without strays and floaters."""
    return robust_box(*object_points(scene, rows))


def whole_box(scene: Scene) -> tuple[DoubleArray, DoubleArray]:
    """The box lo, hi (3,) of all visible splats but a few strays; `splat_box` where it would be
    much larger than that: the far background of a scene, not a whole object."""
    near, whole = splat_box(scene), splat_box(scene, share=_WHOLE)
    sizes = [float(np.linalg.norm(hi - lo)) for lo, hi in (near, whole)]
    return whole if sizes[1] <= _MUCH_LARGER * sizes[0] else near


# Chosen on the garden of Mip-NeRF 360, whose table with its surroundings has a box of 4.2 of 27
# units: 0.3 and 0.9 give 4.7 and 3.8.
_SEEN = 0.5  # of the most photos that show a splat (90th percentile): so many show the subject
_SEEN_SAMPLE, _SEEN_PHOTOS = 20_000, 24  # splats and photos looked at


def subject_box(scene: Scene, cameras: Sequence[Camera] = ()) -> tuple[DoubleArray, DoubleArray]:
    """The box lo, hi (3,) of what to look at in a scene: `splat_box`, or where that is much larger,
    as with a far background, the box of the visible splats that many of the photos have in the
    picture. ``cameras`` are those of the photos."""
    whole = splat_box(scene)
    rows = np.flatnonzero(scene.visible).astype(np.int32)
    means = world_means(scene, rows[:: max(1, len(rows) // _SEEN_SAMPLE)]).astype(np.float64)
    if len(means) == 0 or not cameras:
        return whole
    n_seen = np.zeros(len(means))
    for camera in cameras[:: max(1, len(cameras) // _SEEN_PHOTOS)]:
        pixels, depth = camera.project(means)
        n_seen += (depth > 0) & (np.abs(pixels / [camera.width, camera.height] - 0.5) <= 0.5).all(1)
    subject = robust_box(means[n_seen >= max(_SEEN * np.percentile(n_seen, 90), 1)])
    sizes = [float(np.linalg.norm(hi - lo)) for lo, hi in (subject, whole)]
    return subject if n_seen.any() and sizes[1] > _MUCH_LARGER * sizes[0] else whole


# --- The smallest oriented box around points.


_ORIENTED_BOX_SAMPLE = 20_000  # points looked at
_N_HULL = 4  # points of a hull
_FLAT = 1e-9  # size under which a side counts as none
_DIGITS = 6  # of components that are compared
_EQUAL = 1e-9  # share by which sizes differ that count as equal, and radians


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """A box with axes of its own, the longest first."""

    centre: DoubleArray  # (3,)
    axes: DoubleArray  # (3, 3) rotation; columns are the directions of the sides
    size: DoubleArray  # (3,) lengths of the sides, descending

    def corners(self) -> DoubleArray:
        """The corners (8, 3); bit i of the number says which end of side i."""
        signs = np.array([[(k >> i & 1) - 0.5 for i in range(3)] for k in range(8)])
        return self.centre + (signs * self.size) @ self.axes.T


def oriented_box(points: AnyArray, share: float = 0.98) -> OrientedBox | None:
    """The box that holds the middle ``share`` of points (N, 3) along each of its axes.

    Of the boxes with a side along a principal axis, and across it along an edge of the hull
    (rotating calipers, Toussaint 1983), it is the smallest. None without finite points.
    """
    check_shape("points", points, ("N", 3))
    finite = np.asarray(points, np.float64)
    finite = finite[np.isfinite(finite).all(axis=1)]
    if len(finite) == 0:
        return None
    sample = finite[:: max(1, len(finite) // _ORIENTED_BOX_SAMPLE)]
    principal = axes_of_points(sample)[:, ::-1].T
    places = turned(sample, principal)
    lo, hi = _middle(places, share)
    inner = sample[within(places, lo, hi)]
    inner = inner if len(inner) >= _N_HULL else sample
    boxes = [_along(sample, principal.T, share)]
    for normal in principal:
        boxes += [_along(sample, axes, share) for axes in _calipers(inner, normal)]
    volumes = [float(np.prod(np.maximum(box.size, _FLAT))) for box in boxes]
    return boxes[_least(np.array(volumes))]


def _least(values: DoubleArray) -> int:
    """The first of the least values (n,)."""
    return int(np.argmax(values <= values.min() + _EQUAL * abs(values.min())))


def _calipers(points: DoubleArray, normal: DoubleArray) -> list[DoubleArray]:
    """Axes (3, 3) with one along ``normal``: of the smallest rectangle around the points."""
    from scipy.spatial import ConvexHull, QhullError  # a good part of the launch time

    side = np.cross(normal, np.eye(3)[np.argmin(np.round(np.abs(normal), _DIGITS))])
    side /= np.linalg.norm(side)
    across = np.cross(normal, side)
    plane = np.column_stack([along(points, side), along(points, across)])
    try:
        hull = plane[ConvexHull(plane).vertices]
    except QhullError:  # on a line, or one point
        return []
    edges = np.roll(hull, -1, axis=0) - hull
    quarter = np.arctan2(edges[:, 1], edges[:, 0]) % (np.pi / 2)
    angles = np.unique(np.where(quarter > np.pi / 2 - _EQUAL, 0.0, quarter))
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)  # (A, 2)
    forth = hull @ ways.T
    over = hull @ np.stack([-ways[:, 1], ways[:, 0]])
    best = ways[_least(np.ptp(forth, axis=0) * np.ptp(over, axis=0))]
    first = best[0] * side + best[1] * across
    return [np.column_stack([first, np.cross(normal, first), normal])]


def _along(points: DoubleArray, axes: DoubleArray, share: float) -> OrientedBox:
    lo, hi = _middle(turned(points, axes.T), share)
    size = hi - lo
    step = max(_EQUAL * float(size.max()), np.finfo(np.float64).tiny)
    order = np.argsort(-np.round(size / step), kind="stable")
    ordered = axes[:, order]
    largest = np.round(np.abs(ordered), _DIGITS).argmax(axis=0)  # the first one, made positive
    ordered *= np.sign(ordered[largest, np.arange(3)])
    ordered[:, 2] = np.cross(ordered[:, 0], ordered[:, 1])
    return OrientedBox(axes @ ((lo + hi) / 2), ordered, size[order])
