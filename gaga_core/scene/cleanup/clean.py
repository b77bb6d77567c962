"""Clean an object: add what belongs to it, remove floaters and what belongs to others.

Labels by vote are wrong where pictures say little: inside (no picture shows it), along contacts
(a splat covers pixels of both sides), and in the air (a floater takes the mask behind it). Four
tests, each on what lies where now (placements applied):

* neighbours: each splat asks its nearest ones, weighted by opacity and likeness of color. A splat
  of the object that its neighbours disown goes to the group around it; one that the object
  surrounds comes in.
* enclosure: a splat inside the object's hull that sees the object in nearly all directions comes
  in, unless its neighbours confirm that it is another object. Seeing it all around, not the hull
  alone, is what spares the table under a mug and the floor under a chair.
* distance: outliers by their distance to the object's other splats, relative to their size (plain
  statistical removal takes the large splats of smooth surfaces for outliers), sooner if faint.
* components: small ones that no chain of neighbours joins to the rest.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, FloatArray, IntArray, LongArray
from gaga_core.errors import GagaError
from gaga_core.scene.cleanup import criteria as steps
from gaga_core.scene.edits.objects import set_labels
from gaga_core.scene.edits.values import SetLabels
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene

OURS = -1  # label of the object's splats while it is being cleaned


class CleanReason(IntEnum):
    """Why a splat comes in or goes."""

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
class CleanPreview:
    """What cleaning would change. Nothing is changed yet."""

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
        """How many splats for which reason."""
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
            f"Adds {len(self.add):,} splats ({c['inside']:,} inside), "
            f"removes {len(self.remove):,} ({c['stray']:,} floaters)."
        )


def clean_object(
    scene: Scene, target: int | AnyArray, config: CleanConfig | None = None
) -> CleanPreview:
    """What belongs to an object and what does not: a group id, or rows (K,) / a mask (N,).

    ``scene`` is not changed: `cleaned_labels` makes the edit. Locked
    splats neither come nor go, deleted ones take no part, hidden ones do. The same scene gives the
    same preview. Raises ``GagaError`` when the object has no splats, or for group 0.
    """
    config = config or CleanConfig()
    group, members = _members(scene, target)
    pool, member = steps.gather_pool(scene, members, config.reach)
    if not member.any():
        raise GagaError("The object has no splats to clean. Choose another.")
    labels = np.where(member, OURS, pool.labels)
    inside = np.zeros(len(labels), np.bool_)
    asked = _ask(pool, member, config)
    for _ in range(config.rounds):
        if not _vote(pool, asked, labels, config):
            break
    if not (labels == OURS).any():  # scattered splats: the vote says nothing about an object
        labels = np.where(member, OURS, pool.labels)
    if config.hull != "none":
        inside = _take_inside(pool, labels, config)
    stray = _drop_strays(pool, asked, labels, inside, config)
    return _preview(pool, group, member, labels, inside, stray)


def cleaned_labels(scene: Scene, preview: CleanPreview, title: str = "Clean") -> SetLabels | None:
    """The edit that gives and takes the splats of ``preview``; None when nothing changes.

    Raises ``GagaError`` for a free choice of splats, which has no group to join.
    """
    if preview.group == 0:
        raise GagaError("These splats are no one group. Group them first, or clean the selection.")
    joined = np.full(len(preview.add), preview.group, np.int32)
    rows = np.concatenate([preview.add, preview.remove])
    labels = np.concatenate([joined, preview.remove_groups])
    order = np.argsort(rows, kind="stable")
    return set_labels(scene, rows[order], labels[order], title)


@dataclass(frozen=True, eq=False)
class _Asked:
    """The splats that vote: the object's and those that touch it."""

    which: LongArray  # (Q,) places in the pool; the object's first
    near: IntArray  # (Q, k) places in the pool
    distance: FloatArray  # (Q, k)
    weights: FloatArray  # (Q, k)


def _members(scene: Scene, target: int | AnyArray) -> tuple[int, LongArray]:
    if isinstance(target, int | np.integer):
        if target == 0:
            raise GagaError('"unassigned" is no object. Choose an object to clean.')
        return int(target), group_indices(scene, int(target)).astype(np.int64)
    return 0, sorted_indices(target, len(scene))


def _ask(pool: steps.Pool, member: BoolArray, config: CleanConfig) -> _Asked:
    """Neighbours of the members and of everything that is a neighbour of one."""
    own = np.flatnonzero(member)
    near, distance = steps.neighbours_of(pool, own, config.neighbours)
    touching = np.zeros(len(member), np.bool_)
    touching[near.ravel()] = True
    touching &= ~member
    others = np.flatnonzero(touching)
    near_others, distance_others = steps.neighbours_of(pool, others, config.neighbours)
    which = np.concatenate([own, others])
    near = np.concatenate([near, near_others])
    distance = np.concatenate([distance, distance_others])
    return _Asked(which, near, distance, steps.vote_weights(pool, which, near))


def _vote(pool: steps.Pool, asked: _Asked, labels: IntArray, config: CleanConfig) -> bool:
    """One round of the neighbours' vote, written into ``labels`` (P,); False when all agree."""
    said, mine = labels[asked.near], labels[asked.which]
    own_share = steps.share_of(said == mine[:, None], asked.weights)
    our_share = steps.share_of(said == OURS, asked.weights)
    may = pool.free[asked.which]
    disowned = may & (own_share < config.disowned)
    joins = may & (mine == 0) & (our_share > config.majority)
    claimed = np.flatnonzero(disowned & (mine > 0) & (our_share > 0))
    joins[claimed] = steps.strongest(said[claimed], asked.weights[claimed]) == OURS
    leaves = np.flatnonzero(disowned & (mine == OURS))
    weights = np.where(said[leaves] == OURS, 0, asked.weights[leaves])
    to = steps.strongest(said[leaves], weights)
    # Unlabelled neighbours disown nothing that the object surrounds: they are left-overs too.
    ours = pool.points[labels == OURS]
    hidden = np.flatnonzero(to == 0)
    seen = steps.surrounded(pool.points[asked.which[leaves[hidden]]], ours)
    stays = np.zeros(len(leaves), np.bool_)
    stays[hidden] = seen >= config.surrounded
    stays |= to == OURS
    labels[asked.which[leaves[~stays]]] = to[~stays]
    labels[asked.which[joins]] = OURS
    return bool(joins.any() or not stays.all())


def _take_inside(pool: steps.Pool, labels: IntArray, config: CleanConfig) -> BoolArray:
    """Write what lies inside the object into ``labels`` (P,), and return which that is."""
    ours = pool.points[labels == OURS]
    lo, hi = steps.inlier_box(ours, config.reach)
    ours = ours[((ours >= lo) & (ours <= hi)).all(axis=1)]
    rest = np.flatnonzero((labels != OURS) & pool.free)
    rest = rest[steps.inside_hull(pool.points[rest], ours)] if len(ours) else rest[:0]
    if config.hull == "surrounded":
        rest = rest[steps.surrounded(pool.points[rest], ours) >= config.surrounded]
    near, _ = steps.neighbours_of(pool, rest, config.neighbours)
    agrees = labels[near] == labels[rest][:, None]
    share = steps.share_of(agrees, steps.vote_weights(pool, rest, near))
    inside = np.zeros(len(labels), np.bool_)
    inside[rest[(labels[rest] == 0) | (share < config.confirmed)]] = True
    labels[inside] = OURS
    return inside


def _drop_strays(
    pool: steps.Pool, asked: _Asked, labels: IntArray, inside: BoolArray, config: CleanConfig
) -> BoolArray:
    """Write strays out of ``labels`` (P,), and return which they are (P,)."""
    ours = (labels == OURS) & ~inside
    rows = np.flatnonzero(ours[asked.which])
    rows = rows[np.argsort(asked.which[rows], kind="stable")]
    settings = steps.StraySettings(
        config.outlier_factor, config.outlier_least, config.faint, config.part, config.gap
    )
    stray = steps.strays(pool, ours, asked.near[rows], asked.distance[rows], settings) & pool.free
    gone = rows[stray[asked.which[rows]]]
    said = labels[asked.near[gone]]
    weights = np.where(said == OURS, 0, asked.weights[gone])
    to = steps.strongest(said, weights)
    share = steps.share_of(said == to[:, None], asked.weights[gone])
    labels[asked.which[gone]] = np.where((share >= config.confirmed) & (to != OURS), to, 0)
    return stray


def _preview(
    pool: steps.Pool,
    group: int,
    member: BoolArray,
    labels: IntArray,
    inside: BoolArray,
    stray: BoolArray,
) -> CleanPreview:
    add = np.flatnonzero(~member & (labels == OURS))
    remove = np.flatnonzero(member & (labels != OURS))
    return CleanPreview(
        group=group,
        before=pool.rows[member].astype(np.int32),
        add=pool.rows[add].astype(np.int32),
        add_reasons=np.where(inside[add], CleanReason.INSIDE, CleanReason.NEIGHBOURS).astype(
            np.int32
        ),
        remove=pool.rows[remove].astype(np.int32),
        remove_reasons=np.where(stray[remove], CleanReason.STRAY, CleanReason.NEIGHBOURS).astype(
            np.int32
        ),
        remove_groups=labels[remove],
    )
