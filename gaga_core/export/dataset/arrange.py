"""What stands where: supports found under objects, other places on them, and objects left out."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.color import dc_from_rgb, rgb_from_dc
from gaga_core.export.dataset.views import number_of, rng_of
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.glb import placed
from gaga_core.scene.edits.values import joined
from gaga_core.scene.orientation import upright_basis
from gaga_core.scene.selection.bounds import robust_box

_INSIDE = 0.98  # share of an object's splats along each axis that make its box
_FOOT = 0.08  # of the height: splats so near the lowest one are the foot
_IN = 0.5  # share of an object's foot in the box of another one that then holds it
_NEAR = 0.12  # of the object's width: how far from the foot its support may be, up or down
_CELLS = 14  # of a support's map along a usual object
_MOST_CELLS = 600  # of a side of a support's map
_CARRIES = 0.6  # share of the foot under which there must be a support
_PLACES = 60  # that are tried for an object
_GAP = 1  # cells between objects
_MOVES = 0.6  # share of the movable objects that move in one arrangement
_MOST_MOVED = 4  # objects: the hole of each has to be filled
_SOLID = 0.3  # opacity of a splat that may carry or hinder


@dataclass(frozen=True, eq=False)
class Item:
    """An object of the scene as it is."""

    group: int
    splats: LongArray  # (K,) rows of the Gaussians
    centre: DoubleArray  # (3,) of its box, world: the origin of its own frame
    size: DoubleArray  # (3,) edges of the box
    digest: str  # of which splats it has


@dataclass(frozen=True, eq=False)
class Support:
    """What an object stands on: a plane across ``up``, with its map of cells."""

    height: float
    carries: BoolArray  # (n, m) the plane is there
    taken: IntArray  # (n, m) group that stands there, 0 = free, -1 = several or something else
    corner: DoubleArray  # (2,) upright x and y of the first cell
    cell: float


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Motions of objects, and who is gone."""

    motions: Mapping[int, DoubleArray]  # (4, 4) world, of the objects that stand elsewhere
    removed: frozenset[int]

    @property
    def is_as_it_is(self) -> bool:
        """Whether nothing is changed."""
        return not self.motions and not self.removed

    @property
    def touched(self) -> tuple[int, ...]:
        """Objects that are not where they stood, ascending."""
        return tuple(sorted({*self.motions, *self.removed}))

    def digest(self) -> str:
        """Of what stands where."""
        moved = [(g, np.round(m, 9).tolist()) for g, m in sorted(self.motions.items())]
        return hashlib.blake2b(repr((moved, sorted(self.removed))).encode()).hexdigest()[:16]


def items_of(
    gaussians: Gaussians, labels: IntArray, groups: IntArray, least: int = 4
) -> tuple[Item, ...]:
    """The objects ``groups`` (G,), ascending, of at least so many splats."""
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], groups)
    ends = np.searchsorted(labels[order], groups, side="right")
    found = []
    for group, start, end in zip(groups.tolist(), starts, ends, strict=True):
        splats = order[start:end]
        if len(splats) < least:
            continue
        lo, hi = robust_box(gaussians.means[splats], _INSIDE)
        digest = hashlib.blake2b(splats.tobytes(), digest_size=8).hexdigest()
        found.append(Item(group, splats, (lo + hi) / 2, hi - lo, digest))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Room:
    """Points of the scene in an upright frame, and the objects that can stand elsewhere."""

    upright: DoubleArray  # (3, 3) upright_from_world
    points: DoubleArray  # (N, 3) upright
    labels: IntArray  # (N,)
    solid: BoolArray  # (N,)
    items: tuple[Item, ...]
    supports: Mapping[int, Support]  # of objects that stand on a plane and carry nothing

    @staticmethod
    def of(
        gaussians: Gaussians, labels: IntArray, items: tuple[Item, ...], up: DoubleArray
    ) -> "Room":
        """Look for what each object stands on."""
        upright = upright_basis(up)
        points = gaussians.means.astype(np.float64) @ upright.T
        solid = (gaussians.opacities > _SOLID) & np.isfinite(points).all(axis=1)
        bare = Room(upright, points, labels, solid, items, {})
        below = {item.group: bare._under(item) for item in items}
        carriers = {support for support, _ in below.values() if support > 0}
        carriers |= bare._holders()
        usual = float(np.median([max(item.size) for item in items])) if items else 1.0
        supports = {}
        for item in items:
            support, height = below[item.group]
            if support >= 0 and item.group not in carriers:
                supports[item.group] = bare._map(item, support, height, usual)
        return replace(bare, supports=supports)

    def _holders(self) -> set[int]:
        """Objects that others stand in, as a vase with flowers."""
        feet = {item.group: self._foot(item) for item in self.items}
        found = set()
        for holder in self.items:
            box = self.points[holder.splats]
            lo, hi = np.percentile(box, 2, axis=0), np.percentile(box, 98, axis=0)
            lo[2] += _FOOT * (hi[2] - lo[2])
            for group, foot in feet.items():
                inside = ((foot > lo) & (foot < hi)).all(axis=1)
                if group != holder.group and len(foot) and inside.mean() > _IN:
                    found.add(holder.group)
                    break
        return found

    def _foot(self, item: Item) -> DoubleArray:
        """The lowest splats (K, 3) of an object, upright."""
        own = self.points[item.splats[self.solid[item.splats]]]
        if len(own) < 4:
            return own[:0]
        low, high = np.percentile(own[:, 2], [1, 99])
        return np.asarray(own[own[:, 2] < low + _FOOT * (high - low) + 1e-9])

    def _under(self, item: Item) -> tuple[int, float]:
        """The group that carries an object, and how high its plane is; -1: none does."""
        foot = self._foot(item)
        if len(foot) == 0:
            return -1, 0.0
        low = float(np.median(foot[:, 2]))
        lo, hi = foot[:, :2].min(axis=0), foot[:, :2].max(axis=0)
        width = float(max(hi - lo))
        near = self.solid & (self.labels != item.group)
        near &= (self.points[:, :2] > lo - width / 2).all(axis=1)
        near &= (self.points[:, :2] < hi + width / 2).all(axis=1)
        reach = _NEAR * max(float(np.median(item.size)), width)
        near &= np.abs(self.points[:, 2] - low) < reach
        ids, counts = np.unique(self.labels[near], return_counts=True)
        if len(ids) == 0 or counts.max() < 8:
            return -1, 0.0
        support = int(ids[counts.argmax()])
        heights = self.points[near & (self.labels == support), 2]
        return support, float(np.median(heights))

    def _map(self, item: Item, support: int, height: float, usual: float) -> Support:
        """Cells of the plane of ``support`` and what stands on it."""
        thick = 0.5 * _NEAR * max(float(np.median(item.size)), 1e-9)
        plane = self.solid & (self.labels == support)
        plane &= np.abs(self.points[:, 2] - height) < thick
        flat = self.points[plane, :2]
        lo, hi = np.percentile(flat, 1, axis=0), np.percentile(flat, 99, axis=0)
        cell = max(usual / _CELLS, float(max(hi - lo)) / _MOST_CELLS, 1e-9)
        shape = tuple(int(n) for n in np.ceil((hi - lo) / cell) + 1)
        carries = np.zeros(shape, np.bool_)
        at, inside = _cells(flat, lo, cell, shape)
        carries[tuple(at[inside].T)] = True
        # A splat is wider than a cell, and objects hide what they stand on.
        carries = ndimage.binary_closing(np.pad(carries, 4), iterations=4)[4:-4, 4:-4]
        carries = np.asarray(ndimage.binary_fill_holes(carries))
        taken = np.zeros(shape, np.int32)
        above = self.solid & (self.points[:, 2] > height + thick) & (self.labels != support)
        above &= self.points[:, 2] < height + 2 * float(max(item.size))
        at, inside = _cells(self.points[above, :2], lo, cell, shape)
        groups = np.where(self.labels[above] > 0, self.labels[above], -1)[inside]
        rows = tuple(at[inside].T)
        taken[rows] = groups
        several = np.zeros(shape, np.bool_)
        several[rows] = taken[rows] != groups
        return Support(height, carries, np.where(several, -1, taken), lo, cell)

    def arranged(self, seed: int, index: int, *, moves: bool, removes: bool) -> Arrangement:
        """Arrangement ``index`` of a seed: who moves where, and who is gone."""
        gone: frozenset[int] = frozenset()
        movable = sorted(self.supports, key=lambda g: number_of(seed, index, "order", g))
        if removes and movable:
            gone = frozenset(movable[:1])
        motions: dict[int, DoubleArray] = {}
        rest = [group for group in movable if group not in gone]
        wanted = [
            g
            for k, g in enumerate(rest)
            if k == 0 or number_of(seed, index, "moves", g) % 1000 < 1000 * _MOVES
        ]
        places = dict[int, tuple[DoubleArray, float]]()  # upright x, y and radius
        for group in wanted[:_MOST_MOVED] if moves else ():
            motion = self._elsewhere(group, gone, places, rng_of(seed, index, "place", group))
            if motion is not None:
                motions[group] = motion
        return Arrangement(motions, gone)

    def _elsewhere(
        self,
        group: int,
        gone: frozenset[int],
        places: dict[int, tuple[DoubleArray, float]],
        rng: np.random.Generator,
    ) -> DoubleArray | None:
        """World map (4, 4) to a free place on the same support; None where none was found."""
        support = self.supports[group]
        item = next(item for item in self.items if item.group == group)
        own = self.points[item.splats[self.solid[item.splats]]]
        middle = (own[:, :2].min(axis=0) + own[:, :2].max(axis=0)) / 2
        shape = own[:, :2] - middle
        radius = float(np.linalg.norm(shape, axis=1).max())
        free = np.isin(support.taken, [0, group, *gone])
        free = ~ndimage.binary_dilation(~free, iterations=_GAP)
        where = np.argwhere(support.carries & free)
        for _ in range(_PLACES if len(where) else 0):
            angle = rng.uniform(0, 2 * np.pi)
            spot = support.corner + (where[rng.integers(len(where))] + 0.5) * support.cell
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            at, inside = _cells(
                shape @ turn.T + spot, support.corner, support.cell, support.carries.shape
            )
            cells = tuple(at[inside].T)
            if not inside.all() or not free[cells].all():
                continue
            if support.carries[cells].mean() < 1 - (1 - _CARRIES) / 4:
                continue
            if any(np.linalg.norm(spot - p) < radius + r for p, r in places.values()):
                continue
            places[group] = spot, radius
            motion = np.eye(4)
            motion[:2, :2] = turn
            motion[:2, 3] = spot - turn @ middle
            basis = np.eye(4)
            basis[:3, :3] = self.upright
            return np.asarray(basis.T @ motion @ basis, np.float64)
        return None


def _cells(
    points: DoubleArray, corner: DoubleArray, cell: float, shape: tuple[int, ...]
) -> tuple[LongArray, BoolArray]:
    """Cells (N, 2) of points (N, 2), and which of them are on the map."""
    at = np.floor((points - corner) / cell).astype(np.int64)
    inside: BoolArray = np.all((at >= 0) & (at < np.array(shape)), axis=1)
    return at, inside


@dataclass(frozen=True, eq=False)
class Hole:
    """What an object leaves behind when it goes (`fill.fill.Filling`, of the rows of pictures)."""

    unseen: LongArray  # (U,) rows that go with it
    splats: Gaussians  # (F,) that fill the hole
    labels: IntArray  # (F,)
    stained: LongArray  # (S,) rows that lay in its shadow
    gains: FloatArray  # (S, 3) by these factors they grow lighter


def composed(
    gaussians: Gaussians,
    labels: IntArray,
    items: Sequence[Item],
    arrangement: Arrangement,
    holes: Sequence[Hole],
) -> tuple[Gaussians, IntArray]:
    """Splats and labels of an arrangement; ``holes`` are of its touched objects, may be none."""
    if arrangement.is_as_it_is:
        return gaussians, labels
    stays, gain = np.ones(len(labels), np.bool_), np.ones((len(labels), 3), np.float32)
    for hole in holes:
        stays[hole.unseen] = False
        gain[hole.stained] = np.maximum(gain[hole.stained], hole.gains)
    moved: list[Gaussians] = []
    ids: list[IntArray] = []
    for item in items:
        if item.group in arrangement.touched:
            stays[item.splats] = False
        if item.group in arrangement.motions:
            moved.append(placed(gaussians.take(item.splats), arrangement.motions[item.group]))
            ids.append(np.full(len(item.splats), item.group, np.int32))
    rows = np.flatnonzero(stays)
    rest, gain = gaussians.take(rows), gain[rows]
    sh = rest.sh * gain[:, None]
    sh[:, 0] = dc_from_rgb(rgb_from_dc(rest.sh[:, 0]) * gain)
    result = replace(rest, sh=np.where((gain == 1).all(axis=1)[:, None, None], rest.sh, sh))
    for part in (*(hole.splats for hole in holes), *moved):
        result = joined(result, part)
    return result, np.concatenate([labels[rows], *(hole.labels for hole in holes), *ids])
