"""Clean an object: add what belongs to it, remove floaters and what belongs to others.

Labels by vote are wrong where pictures say little: inside (no picture shows it), along contacts
(a splat covers pixels of both sides), and in the air (a floater takes the mask behind it). Four
tests, each on what lies where now (placements applied):

* neighbours: each splat asks its nearest ones, weighted by opacity and likeness of color. A splat
  of the object that its neighbours disown goes to the group around it; one that the object
  surrounds comes in.
* enclosure: a splat inside the object's hull that sees the object in nearly all directions comes
  in, unless its neighbours confirm that it is another object. Seeing it all around, not the hull
  alone, is what spares the table under an object and the floor under a chair.
* distance: outliers by their distance to the object's other splats, relative to their size (plain
  statistical removal takes the large splats of smooth surfaces for outliers), sooner if faint.
* components: small ones that no chain of neighbours joins to the rest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.color import rgb_from_dc
from gaga_core.errors import GagaError, counted
from gaga_core.progress import Progress, Stage
from gaga_core.scene.edits.objects import set_labels
from gaga_core.scene.edits.placement import recolor
from gaga_core.scene.edits.splats import delete, isolate, select
from gaga_core.scene.edits.values import Edit, SetLabels, together
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.objects import group_indices, selected_groups
from gaga_core.scene.orientation import even_directions
from gaga_core.scene.scene import Revision, Scene, State, of_scene_now
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.bounds import within
from gaga_core.threads import n_threads

_OURS = -1  # label of the object's splats while it is being cleaned
_COLOR_WIDTH = 0.1  # RGB difference at which a neighbour's word counts 0.6
_N_HULL_DIRECTIONS = 64  # in which the hull is measured
_N_WITNESSES = 128  # splats of the object that are looked at to see whether it surrounds a point
_BLOCK = 4096  # points tested against all witnesses at a time
_ZERO_SHARE = 0.38  # a direction component under this share is 0: 26 sectors of similar size
_N_SECTORS = 26
_N_USUAL = 12  # splats of an object: among fewer no distance is usual
_N_LINKS = 6  # neighbours in the object that a splat is compared with


class CleanReason(IntEnum):
    """Reason why a splat is added or removed."""

    NEIGHBOURS = 1  # its neighbours are of the object / of another
    INSIDE = 2  # comes in: the object is all around it
    STRAY = 3  # goes: a floater, or in a small part apart


@dataclass(frozen=True)
class CleanConfig:
    """Settings of `clean_object`."""

    neighbours: int = 16  # that a splat asks
    disowned: float = 0.15  # a splat goes when its own group has less than this share of its vote
    majority: float = 0.6  # a splat without a group comes in above this share
    rounds: int = 3  # of the neighbours' vote: errors lie in patches
    hull: Literal["none", "surrounded", "convex"] = "surrounded"  # convex: all in the hull come in
    surrounded: float = 0.75  # share of directions in which the object must be seen
    confirmed: float = 0.5  # share of its vote by which another object keeps a splat in the hull
    reach: float = 1.5  # IQRs around the quartiles: the object's box without its floaters
    outlier_factor: float = 3.0  # IQRs above Q3 at which a distance is an outlier
    outlier_least: float = 4.0  # times the usual distance: below, nothing is an outlier
    faint: float = 0.2  # opacity under which that limit falls, to half of it
    part: float = 0.02  # share of the object's surface under which a part apart is dropped
    gap: float = 0.08  # of the object's diagonal: a part nearer than this to the rest is not apart

    def __post_init__(self) -> None:
        shares = (self.disowned, self.majority, self.surrounded, self.confirmed, self.part)
        if not all(0 <= share <= 1 for share in shares) or not 0 < self.faint <= 1:
            raise ValueError("shares and opacities must lie in 0..1")
        if self.neighbours < 4 or self.rounds < 0 or self.reach < 0 or self.outlier_least <= 0:
            raise ValueError("neighbours, rounds, reach, outlier_least: too small")
        if self.hull not in ("none", "surrounded", "convex"):
            raise ValueError(f"hull: {self.hull!r} is none of 'none', 'surrounded', 'convex'")


@dataclass(frozen=True, eq=False)
class _Pool:
    """The object's splats and those around it: P splats, columns in one order."""

    rows: LongArray  # (P,) increasing rows of the scene
    points: DoubleArray  # (P, 3) world
    labels: IntArray  # (P,) group
    colors: FloatArray  # (P, 3) as photographed: a recolor does not change what belongs together
    opacities: FloatArray  # (P,)
    sizes: DoubleArray  # (P,) standard deviation, geometric mean of the two longer axes
    free: BoolArray  # (P,) may change: not locked
    tree: cKDTree


def _gather_pool(scene: Scene, members: LongArray, reach: float) -> tuple[_Pool, BoolArray]:
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
        lo, hi = _inlier_box(own, reach)
        chosen = alive & within(points, lo, hi)
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
    pool = _Pool(
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


def _inlier_box(points: FloatArray | DoubleArray, reach: float) -> tuple[DoubleArray, DoubleArray]:
    """Corners (3,) of Q1 - reach IQR .. Q3 + reach IQR per axis of points (K, 3)."""
    q1, q3 = np.percentile(points, [25, 75], axis=0)
    # A flat object has no IQR across: a share of its greatest one keeps the box from closing.
    width = np.maximum(q3 - q1, 0.05 * (q3 - q1).max()) * reach
    return q1 - width, q3 + width


def _neighbours_of(pool: _Pool, which: LongArray, k: int) -> tuple[IntArray, FloatArray]:
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


def _vote_weights(pool: _Pool, which: LongArray, near: IntArray) -> FloatArray:
    """What each neighbour's word counts (Q, k): opacity times likeness of color."""
    difference = np.zeros(near.shape, np.float32)
    for color in pool.colors.T:
        difference += (color[near] - color[which][:, None]) ** 2
    weights = np.exp(difference * np.float32(-0.5 / _COLOR_WIDTH**2))
    weights += np.float32(1e-6)  # with no neighbour of its color, all of them decide
    weights *= pool.opacities[near] + np.float32(1e-3)
    weights[near == which[:, None]] = 0
    return weights


def _share_of(agrees: BoolArray, weights: FloatArray) -> FloatArray:
    """Share (Q,) of the neighbours' weight (Q, k) that agrees."""
    total = weights.sum(axis=1)
    return (weights * agrees).sum(axis=1) / np.maximum(total, np.float32(1e-20))


def _strongest(labels: IntArray, weights: FloatArray) -> IntArray:
    """The label (Q,) of greatest summed weight in each row of ``labels`` (Q, k)."""
    sums = np.zeros(labels.shape, np.float32)
    for j in range(labels.shape[1]):
        sums += weights[:, j : j + 1] * (labels == labels[:, j : j + 1])
    return labels[np.arange(len(labels)), sums.argmax(axis=1)]


def _inside_hull(points: DoubleArray, hull_of: DoubleArray) -> BoolArray:
    """Which ``points`` (Q, 3) lie in the convex hull of ``hull_of`` (K, 3), measured in 64
    directions: a little larger than the hull, exact for nothing, sound for flat sets too."""
    inside = np.ones(len(points), np.bool_)
    for direction in even_directions(_N_HULL_DIRECTIONS):
        left = np.flatnonzero(inside)
        reach = hull_of @ direction
        along = points[left] @ direction
        inside[left] = (along <= reach.max()) & (along >= reach.min())
    return inside


def _surrounded(points: DoubleArray, object_points: DoubleArray) -> DoubleArray:
    """Share (Q,) of 26 directions in which each point sees the object (K, 3)."""
    step = max(1, len(object_points) // _N_WITNESSES)
    witnesses = object_points[::step].astype(np.float32)
    result = np.zeros(len(points))
    for start in range(0, len(points), _BLOCK):
        part = slice(start, start + _BLOCK)
        to = witnesses[None] - points[part, None].astype(np.float32)
        limit = _ZERO_SHARE * np.sqrt((to * to).sum(axis=2, keepdims=True))
        sign = (to > limit).astype(np.int32) - (to < -limit)
        sector = np.int32(1) << ((sign[..., 0] + 1) * 9 + (sign[..., 1] + 1) * 3 + sign[..., 2] + 1)
        seen = np.bitwise_or.reduce(sector, axis=1) & ~np.int32(1 << 13)  # 13: no direction
        result[part] = np.bitwise_count(seen) / _N_SECTORS
    return result


def _strays(
    pool: _Pool, member: BoolArray, near: IntArray, distance: FloatArray, config: CleanConfig
) -> BoolArray:
    """Members (P,) that are far from the object's other splats, or in a small part apart.

    ``near`` and ``distance`` (K, k): neighbours of the members, in their order. A splat's distance
    is compared with what is usual in the object, times its own size over the usual size where it is
    larger, and less if it is faint.
    """
    own = np.flatnonzero(member)
    result = np.zeros(len(pool.rows), np.bool_)
    if len(own) < _N_USUAL:
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
    limit = max(q3 + config.outlier_factor * (q3 - q1), config.outlier_least)
    solid = np.clip(pool.opacities[own] / config.faint, 0.5, 1)
    result[own] = (ratio > limit * solid) | (n_found == 0)
    linked = found & (distance <= limit * typical * np.maximum(1, size / typical_size)[:, None])
    result[own] |= _small_parts(pool, own, near, linked, config)
    return result


def _own_neighbours(
    pool: _Pool, own: LongArray, member: BoolArray, near: IntArray, distance: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Neighbours that are members, at most 6; others have infinite distance."""
    foreign = ~member[near] | (near == own[:, None])
    distance = np.where(foreign, np.float32(np.inf), distance)
    lonely = np.flatnonzero((~foreign).sum(axis=1) < _N_LINKS)
    if len(lonely):
        tree = cKDTree(pool.points[own], balanced_tree=False, compact_nodes=False)
        k = min(_N_LINKS + 1, len(own))
        d, i = tree.query(pool.points[own[lonely]], k=k, workers=n_threads())
        d, i = np.asarray(d).reshape(len(lonely), k), np.asarray(i).reshape(len(lonely), k)
        near, distance = near.copy(), distance.copy()
        near[lonely, :k] = own[i]
        distance[lonely] = np.inf
        distance[lonely, :k] = np.where(i == lonely[:, None], np.inf, d)
    order = np.argsort(distance, axis=1, kind="stable")[:, :_N_LINKS]
    rows = np.arange(len(own))[:, None]
    return near[rows, order], distance[rows, order]


def _small_parts(
    pool: _Pool, own: LongArray, near: IntArray, linked: BoolArray, config: CleanConfig
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
    small = surface < config.part * surface.sum()
    small[surface.argmax()] = False
    points = pool.points[own]
    lo, hi = _inlier_box(points, 1.0)
    gap = config.gap * float(np.linalg.norm(hi - lo))
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
    return small[part_of]


@dataclass(frozen=True, eq=False)
class CleanPreview:
    """Changes of a cleaning; nothing is changed yet."""

    group: int  # of the object; 0 for a free choice of splats
    before: IntArray  # (K,) rows of the object now, increasing
    add: IntArray  # (A,) rows, increasing
    add_reasons: IntArray  # (A,) Reason
    remove: IntArray  # (R,) rows, increasing
    remove_reasons: IntArray  # (R,) Reason
    remove_groups: IntArray  # (R,) the group that each goes to, 0 = none

    @property
    def after(self) -> IntArray:
        """Rows (L,) of the object when cleaned, increasing."""
        kept = np.setdiff1d(self.before, self.remove, assume_unique=True)
        return np.union1d(kept, self.add).astype(np.int32)

    @property
    def counts(self) -> dict[str, int]:
        """Number of splats by reason."""
        return {
            "neighbours_in": int((self.add_reasons == CleanReason.NEIGHBOURS).sum()),
            "inside": int((self.add_reasons == CleanReason.INSIDE).sum()),
            "neighbours_out": int((self.remove_reasons == CleanReason.NEIGHBOURS).sum()),
            "stray": int((self.remove_reasons == CleanReason.STRAY).sum()),
        }

    def __bool__(self) -> bool:
        """Whether anything would change."""
        return len(self.add) > 0 or len(self.remove) > 0

    def sentence(self) -> str:
        """For people: "Adds 12 splats (9 inside), removes 30 (21 floaters)."."""
        if not self:
            return "Nothing to clean: every splat of the object fits."
        c = self.counts
        return (
            f"Adds {counted(len(self.add), 'splat')} ({c['inside']:,} inside), "
            f"removes {len(self.remove):,} ({counted(c['stray'], 'floater')})."
        )


def clean_object(
    scene: Scene, target: int | AnyArray, config: CleanConfig | None = None
) -> CleanPreview:
    """Which splats to add to an object and to remove: a group id, or rows (K,) / a mask (N,).

    ``scene`` is not changed: `cleaned_labels` makes the edit. Locked splats neither come nor go,
    deleted ones take no part, hidden ones do. The same scene gives the same preview. Raises
    ``GagaError`` when the object has no splats, or for group 0.
    """
    config = config or CleanConfig()
    if isinstance(target, int | np.integer):
        if target == 0:
            raise GagaError('"unassigned" is no object. Choose an object to clean.')
        group, members = int(target), group_indices(scene, int(target)).astype(np.int64)
    else:
        group, members = 0, sorted_indices(target, len(scene))
    pool, member = _gather_pool(scene, members, config.reach)
    if not member.any():
        raise GagaError("The object has no splats to clean. Choose another.")
    labels = np.where(member, _OURS, pool.labels)
    inside = np.zeros(len(labels), np.bool_)
    asked = _ask(pool, member, config)
    for _ in range(config.rounds):
        if not _vote(pool, asked, labels, config):
            break
    if not (labels == _OURS).any():  # scattered splats: the vote says nothing about an object
        labels = np.where(member, _OURS, pool.labels)
    if config.hull != "none":
        inside = _take_inside(pool, labels, config)
    stray = _drop_strays(pool, asked, labels, inside, config)
    add = np.flatnonzero(~member & (labels == _OURS))
    remove = np.flatnonzero(member & (labels != _OURS))
    comes = np.where(inside[add], CleanReason.INSIDE, CleanReason.NEIGHBOURS)
    goes = np.where(stray[remove], CleanReason.STRAY, CleanReason.NEIGHBOURS)
    return CleanPreview(
        group=group,
        before=pool.rows[member].astype(np.int32),
        add=pool.rows[add].astype(np.int32),
        add_reasons=comes.astype(np.int32),
        remove=pool.rows[remove].astype(np.int32),
        remove_reasons=goes.astype(np.int32),
        remove_groups=labels[remove],
    )


def cleaned_labels(scene: Scene, preview: CleanPreview) -> SetLabels | None:
    """The edit that gives and takes the splats of ``preview``; None when nothing changes.

    Raises ``GagaError`` for a free choice of splats, which has no group to join.
    """
    if preview.group == 0:
        raise GagaError("These splats are not one group. Group them first, or clean the selection.")
    joined = np.full(len(preview.add), preview.group, np.int32)
    rows = np.concatenate([preview.add, preview.remove])
    labels = np.concatenate([joined, preview.remove_groups])
    order = np.argsort(rows, kind="stable")
    return set_labels(scene, rows[order], labels[order], "Clean")


@dataclass(frozen=True, eq=False)
class _Asked:
    """The splats that vote: the object's and those that touch it."""

    which: LongArray  # (Q,) places in the pool; the object's first
    near: IntArray  # (Q, k) places in the pool
    distance: FloatArray  # (Q, k)
    weights: FloatArray  # (Q, k)


def _ask(pool: _Pool, member: BoolArray, config: CleanConfig) -> _Asked:
    """Neighbours of the members and of everything that is a neighbour of one."""
    own = np.flatnonzero(member)
    near, distance = _neighbours_of(pool, own, config.neighbours)
    touching = np.zeros(len(member), np.bool_)
    touching[near.ravel()] = True
    touching &= ~member
    others = np.flatnonzero(touching)
    near_others, distance_others = _neighbours_of(pool, others, config.neighbours)
    which = np.concatenate([own, others])
    near = np.concatenate([near, near_others])
    distance = np.concatenate([distance, distance_others])
    return _Asked(which, near, distance, _vote_weights(pool, which, near))


def _vote(pool: _Pool, asked: _Asked, labels: IntArray, config: CleanConfig) -> bool:
    """One round of the neighbours' vote, written into ``labels`` (P,); False when all agree."""
    said, mine = labels[asked.near], labels[asked.which]
    own_share = _share_of(said == mine[:, None], asked.weights)
    our_share = _share_of(said == _OURS, asked.weights)
    may = pool.free[asked.which]
    disowned = may & (own_share < config.disowned)
    joins = may & (mine == 0) & (our_share > config.majority)
    claimed = np.flatnonzero(disowned & (mine > 0) & (our_share > 0))
    joins[claimed] = _strongest(said[claimed], asked.weights[claimed]) == _OURS
    leaves = np.flatnonzero(disowned & (mine == _OURS))
    weights = np.where(said[leaves] == _OURS, 0, asked.weights[leaves])
    to = _strongest(said[leaves], weights)
    # Unlabelled neighbours disown nothing that the object surrounds: they are left-overs too.
    ours = pool.points[labels == _OURS]
    hidden = np.flatnonzero(to == 0)
    seen = _surrounded(pool.points[asked.which[leaves[hidden]]], ours)
    stays = np.zeros(len(leaves), np.bool_)
    stays[hidden] = seen >= config.surrounded
    stays |= to == _OURS
    labels[asked.which[leaves[~stays]]] = to[~stays]
    labels[asked.which[joins]] = _OURS
    return bool(joins.any() or not stays.all())


def _take_inside(pool: _Pool, labels: IntArray, config: CleanConfig) -> BoolArray:
    """Write what lies inside the object into ``labels`` (P,), and return which that is."""
    ours = pool.points[labels == _OURS]
    lo, hi = _inlier_box(ours, config.reach)
    ours = ours[within(ours, lo, hi)]
    rest = np.flatnonzero((labels != _OURS) & pool.free)
    rest = rest[_inside_hull(pool.points[rest], ours)] if len(ours) else rest[:0]
    if config.hull == "surrounded":
        rest = rest[_surrounded(pool.points[rest], ours) >= config.surrounded]
    near, _ = _neighbours_of(pool, rest, config.neighbours)
    agrees = labels[near] == labels[rest][:, None]
    share = _share_of(agrees, _vote_weights(pool, rest, near))
    inside = np.zeros(len(labels), np.bool_)
    inside[rest[(labels[rest] == 0) | (share < config.confirmed)]] = True
    labels[inside] = _OURS
    return inside


def _drop_strays(
    pool: _Pool, asked: _Asked, labels: IntArray, inside: BoolArray, config: CleanConfig
) -> BoolArray:
    """Write strays out of ``labels`` (P,), and return which they are (P,)."""
    ours = (labels == _OURS) & ~inside
    rows = np.flatnonzero(ours[asked.which])
    rows = rows[np.argsort(asked.which[rows], kind="stable")]
    stray = _strays(pool, ours, asked.near[rows], asked.distance[rows], config) & pool.free
    gone = rows[stray[asked.which[rows]]]
    said = labels[asked.near[gone]]
    weights = np.where(said == _OURS, 0, asked.weights[gone])
    to = _strongest(said, weights)
    share = _share_of(said == to[:, None], asked.weights[gone])
    labels[asked.which[gone]] = np.where((share >= config.confirmed) & (to != _OURS), to, 0)
    return stray


DROPPED = (0.93, 0.36, 0.26)  # color of splats that would leave the object; RGB 0..1
TAKEN_IN = (0.20, 0.60, 1.00)  # of splats that would join it: apart for color-blind eyes too
_KEPT_OPACITY = 0.35  # factor for the rest of the object: what lies inside is seen
_OTHER_OPACITY = 0.06  # for everything else: floaters are mostly behind or inside of something
_SHOWN_OPACITY = 20.0  # factor for those that come and go: floaters are faint
_GRAY = np.tile([0.85 * 0.299, 0.85 * 0.587, 0.85 * 0.114, 0.05], (3, 1))  # (3, 4) Rec. 601 luma
_STAGE = "Clean up"


@of_scene_now
def clean_object_stage(scene: Scene, group: int) -> Stage[CleanPreview]:
    """`clean_object` of one object, as the scene is at the call."""
    yield Progress(_STAGE, 0, 0)
    preview = clean_object(scene, group)
    yield Progress(_STAGE, 1, 1)
    return preview


@of_scene_now
def clean_objects_stage(scene: Scene, groups: Sequence[int]) -> Stage[IntArray]:
    """Clean objects one after the other; labels (N,) after all. The scene is not changed."""
    yield Progress(_STAGE, 0, len(groups))
    for i, group in enumerate(groups):
        # The next object sees what the earlier ones added and removed.
        edit = cleaned_labels(scene, clean_object(scene, group))
        if edit is not None:
            edit.apply(scene)
        yield Progress(_STAGE, i + 1, len(groups))
    return scene.labels


def cleaning_tint(scene: Scene, preview: CleanPreview) -> Edit | None:
    """The edit that shows a preview in the picture; it is never to become an entry.

    What would go is `DROPPED`, what would come is `TAKEN_IN`; everything else is gray and seen
    through.
    """
    kept = np.setdiff1d(preview.before, preview.remove, assume_unique=True)
    others = np.ones(len(scene), np.bool_)
    others[preview.before] = others[preview.add] = False
    dropped, taken_in = (np.column_stack([np.zeros((3, 3)), rgb]) for rgb in (DROPPED, TAKEN_IN))
    return _in_turn(
        scene,
        "Preview of the cleaning",
        lambda s: recolor(s, others, _GRAY, _OTHER_OPACITY),
        lambda s: recolor(s, kept, _GRAY, _KEPT_OPACITY),
        lambda s: recolor(s, preview.remove, dropped, _SHOWN_OPACITY),
        lambda s: recolor(s, preview.add, taken_in, _SHOWN_OPACITY),
    )


def relabel(scene: Scene, labels: IntArray) -> Edit | None:
    """Take the labels (N,) of cleaned objects over."""
    rows = np.flatnonzero(labels != scene.labels)
    return set_labels(scene, rows, labels[rows], "Clean")


def cleaned_edit(scene: Scene, preview: CleanPreview, title: str) -> Edit | None:
    """Give and take the splats of ``preview``, and select the object as it is then.

    An object that is isolated stays so: what it loses is hidden, what it gains is shown.
    """
    is_alone = bool((scene.labels[scene.visible] == preview.group).all())
    return _in_turn(
        scene,
        title,
        lambda s: cleaned_labels(s, preview),
        lambda s: select(s, preview.after),
        lambda s: isolate(s, preview.after) if is_alone else None,
    )


def isolate_cleaned(
    scene: Scene,
    groups: Sequence[int],
    labels: IntArray,
    title: str,
    also: IntArray | Sequence[int] = (),
) -> Edit | None:
    """Take the labels (N,) of cleaned objects over, and hide all but these and ``also`` (K,)."""
    objects = _rows_of(scene, groups, labels)
    shown = objects.copy()
    shown[np.asarray(also, np.int32)] = True
    return _in_turn(
        scene,
        title,
        lambda s: relabel(s, labels),
        lambda s: select(s, objects),
        lambda s: isolate(s, shown),
    )


def delete_cleaned(
    scene: Scene, groups: Sequence[int], labels: IntArray, title: str
) -> Edit | None:
    """Take the labels (N,) of cleaned objects over, and delete these objects.

    Their floaters go too: they would be left in the air without an object.
    """
    wanted = np.array(groups, np.int32)
    floaters = np.isin(scene.labels, wanted) & (labels == 0)
    rows = _rows_of(scene, groups, labels) | floaters
    return _in_turn(scene, title, lambda s: relabel(s, labels), lambda s: delete(s, rows))


def cleaned_copy(scene: Scene, groups: Sequence[int], labels: IntArray) -> Scene:
    """A copy with the labels (N,) of cleaned objects in which these objects are selected."""
    copy = replace(scene, labels=labels, revision=Revision())
    edit = select(copy, _rows_of(scene, groups, labels))
    if edit is not None:
        edit.apply(copy)
    return copy


def whole_objects(scene: Scene) -> tuple[int, ...]:
    """The selected objects when the selection is whole objects and nothing else; else none."""
    groups = selected_groups(scene)
    selected = scene.has(State.SELECTED)
    members = _rows_of(scene, groups, scene.labels) & ~scene.has(State.LOCKED)
    if (selected & ~members).any() or (members & scene.visible & ~selected).any():
        return ()
    return tuple(int(group) for group in groups)


def _rows_of(scene: Scene, groups: Sequence[int] | IntArray, labels: AnyArray) -> BoolArray:
    """Splats (N,) of these groups that are not deleted."""
    return np.isin(labels, np.asarray(groups, np.int32)) & ~scene.has(State.DELETED)


def _in_turn(scene: Scene, title: str, *builds: Callable[[Scene], Edit | None]) -> Edit | None:
    """One edit of several, each built on what the ones before it make of ``scene``."""
    work = replace(scene, revision=Revision())
    made = []
    for build in builds:
        edit = build(work)
        if edit is not None:
            edit.apply(work)
            made.append(edit)
    return together(title, made)
