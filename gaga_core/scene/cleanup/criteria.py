"""The tests that `clean` is made of: neighbours, enclosure, distance, islands."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.color import rgb_from_dc
from gaga_core.kernels import n_threads
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import world_means

COLOR_WIDTH = 0.1  # RGB difference at which a neighbour's word counts 0.6
_FACES = 64  # directions in which the hull is measured
_WITNESSES = 128  # splats of the object that are looked at to see whether it surrounds a point
_BLOCK = 4096  # points tested against all witnesses at a time
_DEAD = 0.38  # a direction component under this share counts as 0: 26 sectors of similar size
_SECTORS = 26
_FEWEST = 12


@dataclass(frozen=True, eq=False)
class Pool:
    """The object's splats and those around it: P splats, columns in one order."""

    rows: LongArray  # (P,) increasing rows of the scene
    points: DoubleArray  # (P, 3) world
    labels: IntArray  # (P,) group
    colors: FloatArray  # (P, 3) as photographed: a recolor does not change what belongs together
    opacities: FloatArray  # (P,)
    sizes: DoubleArray  # (P,) standard deviation, geometric mean of the two longer axes
    free: BoolArray  # (P,) may change: not locked
    tree: cKDTree


def gather_pool(scene: Scene, members: LongArray, reach: float) -> tuple[Pool, BoolArray]:
    """The members (K,) and everything in their box, and which of the pool are members (P,).

    The box is that of the members between Q1 - reach IQR and Q3 + reach IQR per axis, so that
    floaters do not blow it up. Deleted splats and those at no finite place take no part.
    """
    alive = ~scene.has(State.DELETED)
    points = world_means(scene)
    own = points[members]
    own = own[np.isfinite(own).all(axis=1)]
    chosen = np.zeros(len(scene), np.bool_)
    if len(own):
        lo, hi = inlier_box(own, reach)
        chosen = alive.copy()
        for axis in range(3):
            chosen &= (points[:, axis] >= lo[axis]) & (points[:, axis] <= hi[axis])
    chosen[members] = alive[members]
    rows = np.flatnonzero(chosen)
    rows = rows[np.isfinite(points[rows]).all(axis=1)]
    is_member = np.zeros(len(scene), np.bool_)
    is_member[members] = True
    g = scene.gaussians
    near = points[rows].astype(np.float64)
    longer = np.sort(g.log_scales[rows], axis=1)[:, 1:].astype(np.float64).mean(axis=1)
    table = scene.placements
    stretch = np.cbrt(np.abs(np.linalg.det(table.matrix[:, :, :3])))[scene.placement[rows]]
    with np.errstate(over="ignore"):
        opacities = 1 / (1 + np.exp(-g.logit_opacities[rows]))
    pool = Pool(
        rows=rows,
        points=near,
        labels=scene.labels[rows],
        colors=np.clip(rgb_from_dc(g.sh[rows, 0]), 0, 1).astype(np.float32),
        opacities=np.nan_to_num(opacities.astype(np.float32)),
        sizes=np.exp(np.clip(longer, -60, 60)) * stretch,
        free=~scene.has(State.LOCKED)[rows],
        tree=cKDTree(near, balanced_tree=False, compact_nodes=False),
    )
    return pool, is_member[rows]


def inlier_box(points: FloatArray | DoubleArray, reach: float) -> tuple[DoubleArray, DoubleArray]:
    """Corners (3,) of Q1 - reach IQR .. Q3 + reach IQR per axis of points (K, 3)."""
    q1, q3 = np.percentile(points, [25, 75], axis=0)
    # A flat object has no IQR across: a share of its greatest one keeps the box from closing.
    width = np.maximum(q3 - q1, 0.05 * (q3 - q1).max()) * reach
    return q1 - width, q3 + width


def neighbours_of(pool: Pool, which: LongArray, k: int) -> tuple[IntArray, FloatArray]:
    """Nearest other splats (Q, k) of the pool's splats ``which`` and their distances (Q, k).

    Where the pool is smaller the splat itself fills up, at distance 0.
    """
    k_there = min(k + 1, len(pool.rows))
    distance, near = pool.tree.query(pool.points[which], k=k_there, workers=n_threads())
    near = np.asarray(near).reshape(len(which), k_there)
    distance = np.asarray(distance).reshape(len(which), k_there)
    # The splat itself is first, but for others at the very same place.
    itself = near == which[:, None]
    itself[~itself.any(axis=1), -1] = True
    keep = ~itself
    out_near = np.repeat(which[:, None], k, axis=1).astype(np.int32)
    out_distance = np.zeros((len(which), k), np.float32)
    out_near[:, : k_there - 1] = near[keep].reshape(len(which), k_there - 1)
    out_distance[:, : k_there - 1] = distance[keep].reshape(len(which), k_there - 1)
    return out_near, out_distance


def vote_weights(pool: Pool, which: LongArray, near: IntArray) -> FloatArray:
    """What each neighbour's word counts (Q, k): opacity times likeness of color."""
    difference = np.zeros(near.shape, np.float32)
    for channel in range(3):
        color = pool.colors[:, channel]
        difference += (color[near] - color[which][:, None]) ** 2
    weights = np.exp(difference * np.float32(-0.5 / COLOR_WIDTH**2))
    weights += np.float32(1e-6)  # with no neighbour of its color, all of them decide
    weights *= pool.opacities[near] + np.float32(1e-3)
    weights[near == which[:, None]] = 0
    result: FloatArray = weights
    return result


def share_of(agrees: BoolArray, weights: FloatArray) -> FloatArray:
    """Share (Q,) of the neighbours' weight (Q, k) that agrees."""
    total = weights.sum(axis=1)
    result: FloatArray = (weights * agrees).sum(axis=1) / np.maximum(total, np.float32(1e-20))
    return result


def strongest(labels: IntArray, weights: FloatArray) -> IntArray:
    """The label (Q,) of greatest summed weight in each row of ``labels`` (Q, k)."""
    sums = np.zeros(labels.shape, np.float32)
    for j in range(labels.shape[1]):
        sums += weights[:, j : j + 1] * (labels == labels[:, j : j + 1])
    best: IntArray = labels[np.arange(len(labels)), sums.argmax(axis=1)]
    return best


def inside_hull(points: DoubleArray, hull_of: DoubleArray) -> BoolArray:
    """Which ``points`` (Q, 3) lie in the convex hull of ``hull_of`` (K, 3), measured in 64
    directions: a little larger than the hull, exact for nothing, sound for flat sets too."""
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(_FACES)
    z = 1 - 2 * (np.arange(_FACES) + 0.5) / _FACES
    ring = np.sqrt(1 - z * z)
    directions = np.stack([ring * np.cos(turn), ring * np.sin(turn), z])
    inside = np.ones(len(points), np.bool_)
    for direction in directions.T:
        left = np.flatnonzero(inside)
        reach = hull_of @ direction
        along = points[left] @ direction
        inside[left] = (along <= reach.max()) & (along >= reach.min())
    return inside


def surrounded(points: DoubleArray, object_points: DoubleArray) -> DoubleArray:
    """Share (Q,) of 26 directions in which each point sees the object (K, 3)."""
    step = max(1, len(object_points) // _WITNESSES)
    witnesses = object_points[::step].astype(np.float32)
    result = np.zeros(len(points))
    for start in range(0, len(points), _BLOCK):
        part = slice(start, start + _BLOCK)
        to = witnesses[None] - points[part, None].astype(np.float32)
        limit = _DEAD * np.sqrt((to * to).sum(axis=2, keepdims=True))
        sign = (to > limit).astype(np.int32) - (to < -limit)
        sector = np.int32(1) << ((sign[..., 0] + 1) * 9 + (sign[..., 1] + 1) * 3 + sign[..., 2] + 1)
        seen = np.bitwise_or.reduce(sector, axis=1) & ~np.int32(1 << 13)  # 13: no direction
        result[part] = np.bitwise_count(seen) / _SECTORS
    return result


@dataclass(frozen=True)
class StraySettings:
    """When a splat is astray."""

    iqr_factor: float  # ratio above Q3 + this IQR ...
    least: float  # ... and above this: even objects lose nothing
    faint: float  # opacity under which the limit falls, to half of it
    part: float  # share of the object's surface under which a part apart is dropped
    gap: float  # of the object's diagonal: a part nearer than this to the rest is not apart


def strays(
    pool: Pool, member: BoolArray, near: IntArray, distance: FloatArray, settings: StraySettings
) -> BoolArray:
    """Members (P,) that are far from the object's other splats, or in a small part apart.

    ``near`` and ``distance`` (K, k): neighbours of the members, in their order. A splat's distance
    is compared with what is usual in the object, times its own size over the usual size where it is
    larger, and less if it is faint.
    """
    own = np.flatnonzero(member)
    result = np.zeros(len(pool.rows), np.bool_)
    if len(own) < _FEWEST:
        return result  # nothing is usual among so few
    near, distance = _own_neighbours(pool, own, member, near, distance)
    found = np.isfinite(distance)
    n_found = found.sum(axis=1)
    spacing = np.where(found, distance, 0).sum(axis=1) / np.maximum(n_found, 1)
    size = pool.sizes[own]
    typical = max(float(np.median(spacing)), 1e-30)
    typical_size = max(float(np.median(size)), 1e-30)
    ratio = spacing / (typical * np.maximum(1, size / typical_size))
    q1, q3 = np.percentile(ratio, [25, 75])
    limit = max(q3 + settings.iqr_factor * (q3 - q1), settings.least)
    solid = np.clip(pool.opacities[own] / settings.faint, 0.5, 1)
    result[own] = (ratio > limit * solid) | (n_found == 0)
    linked = found & (distance <= limit * typical * np.maximum(1, size / typical_size)[:, None])
    result[own] |= _small_parts(pool, own, near, linked, settings)
    return result


def _own_neighbours(
    pool: Pool, own: LongArray, member: BoolArray, near: IntArray, distance: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Neighbours that are members, at most 6; others have infinite distance."""
    few = 6
    foreign = ~member[near] | (near == own[:, None])
    distance = np.where(foreign, np.float32(np.inf), distance)
    lonely = np.flatnonzero((~foreign).sum(axis=1) < few)
    if len(lonely):
        tree = cKDTree(pool.points[own], balanced_tree=False, compact_nodes=False)
        k = min(few + 1, len(own))
        d, i = tree.query(pool.points[own[lonely]], k=k, workers=n_threads())
        d, i = np.asarray(d).reshape(len(lonely), k), np.asarray(i).reshape(len(lonely), k)
        near, distance = near.copy(), distance.copy()
        near[lonely, :k] = own[i]
        distance[lonely] = np.inf
        distance[lonely, :k] = np.where(i == lonely[:, None], np.inf, d)
    order = np.argsort(distance, axis=1, kind="stable")[:, :few]
    rows = np.arange(len(own))[:, None]
    return near[rows, order], distance[rows, order]


def _small_parts(
    pool: Pool, own: LongArray, near: IntArray, linked: BoolArray, settings: StraySettings
) -> BoolArray:
    """Members (K,) in small parts that lie apart from the rest of the object."""
    place = np.zeros(len(pool.rows), np.int64)
    place[own] = np.arange(len(own))
    a, j = np.nonzero(linked)
    b = place[near[a, j]]
    n = len(own)
    graph = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
    n_parts, part_of = connected_components(graph, directed=False)
    area = np.minimum(pool.sizes[own] ** 2, 100 * np.median(pool.sizes[own] ** 2))
    surface = np.bincount(part_of, pool.opacities[own] * area)
    small = surface < settings.part * surface.sum()
    small[surface.argmax()] = False
    points = pool.points[own]
    lo, hi = inlier_box(points, 1.0)
    gap = settings.gap * float(np.linalg.norm(hi - lo))
    # Petals, slats and wicks are small parts too, but near the rest, or near one that is.
    fresh = points[~small[part_of]]
    while small.any() and len(fresh):
        left = np.flatnonzero(small[part_of])
        tree = cKDTree(fresh, balanced_tree=False, compact_nodes=False)
        distance, _ = tree.query(points[left], distance_upper_bound=gap, workers=n_threads())
        joined = np.zeros(n_parts, np.bool_)
        joined[part_of[left[np.isfinite(distance)]]] = True
        small &= ~joined
        fresh = points[joined[part_of]]
    result: BoolArray = small[part_of]
    return result
