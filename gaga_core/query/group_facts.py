"""Facts of a group that need no model: its place, size and colors.

Measured in three passes over the splats, robust against strays: boxes hold the middle of each axis
by opacity, colors are weighted with what is seen of a splat (opacity x its largest face x the
share of a few directions from which nothing of its own group hides it).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.color import SH_C0, sh_basis
from gaga_core.query.colors import LEVELS, NAMES, color_table
from gaga_core.scene.frame import inverse
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.orientation import estimate_up, upright_basis
from gaga_core.scene.scene import Placements, Scene, State
from gaga_core.scene.tint import mean_color

_BINS = 64
_TAIL = 0.02  # share of the opacity outside the box on each side of an axis
_AREA_MAX = 4.0  # splats larger than this times their group's mean count as this large
_FLAT = 0.12  # thinnest extent of a flat group, share of its longest
_VAST = 0.6  # a flat group this long, share of the whole scene's diagonal, is a wall or floor
# ... or so wide: the walls of the demo have 0.48 and 0.49, what is flat there and no wall 0.16
_WIDE = 0.4  # root of length times breadth, share of the diagonal
_CARRIES = 3  # a flat group under at least this many others, and under a third of all, is a floor
_THICK, _CARRIES_ALL = 0.3, 0.8  # so is one up to this thin under this share of all: a tabletop
_THIN_ONES = 64  # of the longest thin groups: smaller ones are no floor
# Splats that cover their group's largest face less than this (2 pi opacity x area; a closed surface
# covers it twice and more), in a group this many times as long as the median: scattered crumbs.
_COVER, _LONG = 1.75, 2.0
_ENCLOSES = 0.5  # a group around this share of the cameras is the room
_DENSE = 1 << 22  # up to here group ids are looked up in a table


@dataclass(frozen=True, eq=False)
class GroupFacts:
    """One row per group that has a live splat, by id; 0 (no group) is among them.

    Lengths are scene units. ``centre``, ``lo`` and ``hi`` are in the upright frame, whose z axis
    points up: p_upright = frame @ p_world.
    """

    ids: IntArray  # (G,) ascending
    counts: LongArray  # (G,) splats
    frame: DoubleArray  # (3, 3) upright_from_world
    centre: DoubleArray  # (G, 3) of what lies inside the box
    lo: DoubleArray  # (G, 3) robust box
    hi: DoubleArray  # (G, 3)
    extents: DoubleArray  # (G, 3) along the principal axes, longest first
    colors: DoubleArray  # (G, 14) share of each of `colors.NAMES`
    vivid: DoubleArray  # (G, 14) the same, each color counted as far as it is typical
    rgb: DoubleArray  # (G, 3) mean color
    background: BoolArray  # (G,) floor, walls, the room, scattered bits, what is in no group
    seen: FloatArray  # (N, 4) of each splat, see `seen_colors`

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def size(self) -> DoubleArray:
        """Edge (G,) of a cube as large as the group."""
        return np.cbrt(self.extents.prod(axis=1))

    @property
    def height(self) -> DoubleArray:
        """Extent (G,) along up."""
        return self.hi[:, 2] - self.lo[:, 2]

    def row(self, group: int) -> int | None:
        """Row of a group; None when it has no splats."""
        at = int(np.searchsorted(self.ids, group))
        return at if at < len(self.ids) and self.ids[at] == group else None


@dataclass(frozen=True, eq=False)
class Spread:
    """Where splats (N) stand in the upright frame, and the robust boxes of their groups (G)."""

    points: FloatArray  # (N, 3)
    area: FloatArray  # (N,) negative = does not count
    lo: FloatArray  # (G, 3)
    hi: FloatArray  # (G, 3)


def group_facts(scene: Scene, cameras: Sequence[Camera] = ()) -> GroupFacts:
    """Measure every group of ``scene``; splats that are deleted do not count, hidden ones do.

    ``cameras`` say which way is up and what surrounds them. About 300 ms per million splats.
    """
    # Imported when first needed: importing numba takes a large part of the launch time.
    from gaga_core.query.group_facts_kernels import tally_looks
    from gaga_core.raster.cpu.prepare import for_kernel

    frame = upright_basis(estimate_up(cameras))
    rows, ids = compact_rows(scene.labels)
    n_groups = len(ids)
    matrix = np.ascontiguousarray(frame @ scene.placements.matrix)
    spread, weight, sums = _spread(scene, rows, n_groups, matrix)
    points, area, lo, hi = spread.points, spread.area, spread.lo, spread.hi
    placement = for_kernel(scene.placement, np.int32)
    table = color_table()
    looks = np.zeros((n_groups, table.shape[1] + 4))
    moments = np.zeros((n_groups, 10))
    with np.errstate(invalid="ignore", divide="ignore"):
        area_max = np.nan_to_num(_AREA_MAX * sums[:, 2] / sums[:, 1]).astype(np.float32)
    views = view_axes(frame, cameras)
    tints = for_kernel(scene.placements.color, np.float64)
    seen_as = seen_colors(scene, rows, spread, matrix, views)
    looked = rows, placement, tints, seen_as, points, area, weight
    tally_looks(*looked, lo, hi, area_max, table, LEVELS, looks, moments)
    live = np.flatnonzero(sums[:, 0] > 0)
    n = len(NAMES)
    seen = np.maximum(looks[live, -1:], 1e-30)
    looks, low, high = looks[live], lo[live].astype(np.float64), hi[live].astype(np.float64)
    middle, extents = _shape(moments[live], high - low)
    return GroupFacts(
        ids=ids[live],
        counts=sums[live, 0].astype(np.int64),
        frame=frame,
        centre=low + middle,
        lo=low,
        hi=high,
        extents=extents,
        colors=looks[:, :n] / seen,
        vivid=looks[:, n : 2 * n] / seen,
        rgb=looks[:, 2 * n : 2 * n + 3] / seen,
        background=_background(ids[live], low, high, extents, frame, cameras)
        | _scattered(extents, sums[live, 2]),
        seen=seen_as,
    )


def _spread(
    scene: Scene, rows: IntArray, n_groups: int, matrix: DoubleArray
) -> tuple[Spread, FloatArray, DoubleArray]:
    """Where splats stand in the frame that ``matrix`` (P, 3, 4) brings placements into; their
    opacities (N,), and the sums (G, 8) of `weigh_splats`."""
    from gaga_core.query.group_facts_kernels import weigh_splats
    from gaga_core.raster.cpu.prepare import for_kernel

    n, g = len(scene), scene.gaussians
    points, area = np.zeros((n, 3), np.float32), np.zeros(n, np.float32)
    weight = np.zeros_like(g.logit_opacities)
    sums = np.zeros((n_groups, 8))
    state, placement = for_kernel(scene.state, np.uint8), for_kernel(scene.placement, np.int32)
    raw = (g.means, g.log_scales, g.logit_opacities)
    means, sizes, logits = (for_kernel(values, np.float32) for values in raw)
    growth = np.abs(np.linalg.det(matrix[:, :, :3])) ** (2 / 3)
    placed = placement, matrix, growth
    weigh_splats(rows, state, *placed, means, sizes, logits, points, area, weight, sums)
    lo, hi = _boxes(rows, points, area, weight, sums)
    return Spread(points, area, lo, hi), weight, sums


_KEPT: WeakKeyDictionary[Scene, tuple[tuple[object, ...], GroupFacts]] = WeakKeyDictionary()


def facts_of(scene: Scene, cameras: Sequence[Camera] = ()) -> GroupFacts:
    """`group_facts`, measured again only when splats, groups or placements have changed."""
    r = scene.revision
    key = (r.splats, r.labels, r.state, r.placement, r.placements, tuple(map(id, cameras)))
    kept = _KEPT.get(scene)
    if kept is not None and kept[0] == key:
        return kept[1]
    facts = group_facts(scene, cameras)
    _KEPT[scene] = (key, facts)
    return facts


def compact_rows(labels: IntArray) -> tuple[IntArray, IntArray]:
    """Row (N,) of each splat's group among the ids (G,) that occur, ascending."""
    top = int(labels.max(initial=0))
    if len(labels) == 0 or top >= _DENSE or int(labels.min()) < 0:
        ids, rows = np.unique(labels, return_inverse=True)
        return rows.astype(np.int32), ids.astype(np.int32)
    ids = np.flatnonzero(np.bincount(labels, minlength=top + 1)).astype(np.int32)
    lookup = np.zeros(top + 1, np.int32)
    lookup[ids] = np.arange(len(ids), dtype=np.int32)
    return lookup[labels], ids


def _boxes(
    rows: IntArray,
    points: FloatArray,
    area: FloatArray,
    weight: FloatArray,
    sums: DoubleArray,
) -> tuple[FloatArray, FloatArray]:
    """Robust boxes lo, hi (G, 3): quantiles of histograms, looked at twice."""
    from gaga_core.query.group_facts_kernels import tally_axes

    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.nan_to_num(sums[:, 3:6] / sums[:, 1:2])
        variance = np.nan_to_num(sums[:, 6] / sums[:, 1]) - (mean**2).sum(axis=1)
    reach = 4 * np.sqrt(np.maximum(variance, 1e-12))[:, None]
    lo, hi = (mean - reach).astype(np.float32), (mean + reach).astype(np.float32)
    bins = np.zeros((len(sums), 3, _BINS), np.float32)
    for last in (False, True):
        bins[:] = 0
        per_unit = (_BINS / np.maximum(hi - lo, 1e-12)).astype(np.float32)
        tally_axes(rows, points, area, weight, lo, per_unit, bins)
        # The first look only finds where to look closely, so it is wider.
        below = _quantile(bins, _TAIL if last else _TAIL / 4)
        above = _BINS - _quantile(bins[..., ::-1], _TAIL if last else _TAIL / 4)
        slack = 0.0 if last else 0.6
        lo, hi = lo + (below - slack) / per_unit, lo + (above + slack) / per_unit
        lo, hi = lo.astype(np.float32), hi.astype(np.float32)
    return lo, hi


def _quantile(bins: FloatArray, share: float) -> DoubleArray:
    """Bin position (G, 3) under which ``share`` of a histogram's content lies."""
    total = np.cumsum(bins, axis=-1, dtype=np.float64)
    wanted = share * total[..., -1:]
    at = np.minimum((total < wanted).sum(axis=-1), bins.shape[-1] - 1)
    inside = np.take_along_axis(bins, at[..., None], axis=-1)[..., 0].astype(np.float64)
    upto = np.take_along_axis(total, at[..., None], axis=-1)[..., 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.nan_to_num((wanted[..., 0] - (upto - inside)) / inside)
    return at + np.clip(part, 0, 1)


def _shape(moments: DoubleArray, sides: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Mean position over the box's corner (G, 3), and principal extents (G, 3), longest first.

    An extent is that of a uniform bar of the same variance, sqrt(12 times it).
    """
    weight = moments[:, :1]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(weight > 0, moments[:, 1:4] / weight, sides / 2)
        second = np.where(weight > 0, moments[:, 4:] / weight, 0)
    xx, xy, xz, yy, yz, zz = second.T
    matrix = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    matrix = matrix - mean[:, :, None] * mean[:, None, :]
    variance = np.maximum(np.linalg.eigvalsh(matrix), 0)[:, ::-1]
    return mean, np.sqrt(12 * variance)


def _scattered(extents: DoubleArray, area: DoubleArray) -> BoolArray:
    """Groups (G,) that are fragments of other objects over a large area, not one object."""
    cover = 2 * np.pi * area / np.maximum(extents[:, 0] * extents[:, 1], 1e-30)
    long = extents[:, 0] > _LONG * np.median(extents[:, 0]) if len(extents) else extents[:, 0] > 0
    return (cover < _COVER) & long


def _background(
    ids: IntArray,
    lo: DoubleArray,
    hi: DoubleArray,
    extents: DoubleArray,
    frame: DoubleArray,
    cameras: Sequence[Camera],
) -> BoolArray:
    """Groups (G,) that are never meant by "the largest": splats of no group; what surrounds half of
    the cameras; flat ones as long or wide as much of the scene, or under many of the others."""
    result = ids <= 0
    if len(ids) == 0:
        return result
    if cameras:
        eyes = np.stack([c.position for c in cameras]) @ frame.T
        inside = ((eyes >= lo[:, None]) & (eyes <= hi[:, None])).all(axis=2)
        result |= inside.mean(axis=1) >= _ENCLOSES
    whole = float(np.linalg.norm(hi.max(axis=0) - lo.min(axis=0)))
    centre = (lo + hi) / 2
    n_groups = int((ids > 0).sum())
    n_others = max(n_groups - 1, 1)
    thin = np.flatnonzero(extents[:, 2] < _THICK * extents[:, 0])
    for k in thin[np.argsort(-extents[thin, 0], kind="stable")][:_THIN_ONES]:
        over = ((centre[:, :2] >= lo[k, :2]) & (centre[:, :2] <= hi[k, :2])).all(axis=1)
        smaller = extents[:, 0] < 0.5 * extents[k, 0]
        carried = int((over & smaller & (centre[:, 2] > centre[k, 2]) & (ids > 0)).sum())
        flat = extents[k, 2] < _FLAT * extents[k, 0]
        share = 1 / 3 if flat else _CARRIES_ALL
        carries = carried >= max(_CARRIES, share * n_others)
        # What is alone in its file, a guitar say, or next to its own copy, is behind nothing.
        n_smaller = int((smaller & (ids > 0)).sum())
        is_behind = n_groups > 1 and 2 * n_smaller >= n_others
        breadth = float(np.sqrt(extents[k, 0] * extents[k, 1]))
        is_large = extents[k, 0] >= _VAST * whole or breadth >= _WIDE * whole
        is_vast = flat and is_large and is_behind
        result[k] |= carries or is_vast
    return result


# --- Colors of splats as seen from outside their group: what a person calls the group's color.
# The white inside of a blue cup, and the sheen that spherical harmonics show in a few directions,
# say nothing of the color that a search asks for. Each group is drawn alone, orthographically, as
# a small picture of depths from a few directions; a splat counts as often as it lies at the front,
# with the color that it has in those directions.


_CELLS, _FEW_CELLS = 24, 6  # along each side of a view of a group
_PER_CELL = 6  # splats of the group, so that what is behind cannot be seen between them
_MANY_GROUPS = 8192  # from here on all views have few cells
_N_VIEWS = 6  # at most
_DEGREE = 2  # of the spherical harmonics that count
_ELEVATION = 0.6  # of the views without cameras, radians over the ground


def view_axes(frame: DoubleArray, cameras: Sequence[Camera]) -> DoubleArray:
    """Axes (V, 3, 3), rows right, down, forward, in the upright frame ``frame`` (3, 3), of a few
    views: those of ``cameras`` that differ most, else from around and a little above."""
    if cameras:
        turned = np.stack([camera.cam_from_world[:3, :3] for camera in cameras]) @ frame.T
        forward = turned[:, 2]
        chosen = [0]
        while len(chosen) < min(_N_VIEWS, len(cameras)):
            chosen.append(int((forward @ forward[chosen].T).max(axis=1).argmin()))
        return np.ascontiguousarray(turned[chosen])
    around = np.arange(_N_VIEWS - 1) * 2 * np.pi / (_N_VIEWS - 1)
    level = np.cos(_ELEVATION)
    down = np.full(len(around), -np.sin(_ELEVATION))
    forward = np.stack([-level * np.cos(around), -level * np.sin(around), down], axis=1)
    right = np.stack([-np.sin(around), np.cos(around), np.zeros(len(around))], axis=1)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def seen_colors(
    scene: Scene, rows: IntArray, spread: Spread, matrix: DoubleArray, views: DoubleArray
) -> FloatArray:
    """Color in 0..1 of each splat as seen in ``views`` (V, 3, 3), and the share of them in which
    nothing of its own group hides it: (N, 4). What is hidden in all has its mean color.

    ``rows`` (N,) are groups; ``matrix`` (P, 3, 4) brings placements into the frame of the views.
    """
    from gaga_core.query.group_facts_kernels import add_seen, nearest_depths
    from gaga_core.raster.cpu.prepare import for_kernel

    sh = for_kernel(scene.gaussians.sh, np.float32)
    n_groups = len(spread.lo)
    cells = _CELLS if n_groups < _MANY_GROUPS else _FEW_CELLS
    counts = np.bincount(rows, minlength=n_groups)
    own = np.clip(np.sqrt(counts / _PER_CELL), _FEW_CELLS, cells)  # groups use the middle of a view
    centre = (spread.lo.astype(np.float64) + spread.hi) / 2
    diagonal = np.linalg.norm(spread.hi.astype(np.float64) - spread.lo, axis=1)
    per_unit = own / np.maximum(diagonal, 1e-12)
    placement = for_kernel(scene.placement, np.int32)
    degree = min(_DEGREE, scene.gaussians.sh_degree)
    seen = np.zeros((len(scene), 4), np.float32)
    depths = np.empty((n_groups, cells, cells), np.float32)
    for axes in views:
        depths[:] = np.inf
        forward = axes[2] @ matrix[:, :, :3]  # (P, 3) in the placements' frames
        forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
        basis = np.ascontiguousarray(sh_basis(forward, degree))
        shared = spread.points, spread.area, axes, centre, per_unit, depths
        nearest_depths(rows, *shared)
        add_seen(rows, placement, *shared, sh, basis, seen)
    times = seen[:, 3:]
    plain = 0.5 + np.float32(SH_C0) * sh[:, 0]
    seen[:, :3] = np.where(times > 0, seen[:, :3] / np.maximum(times, 1), plain)
    seen[:, 3] /= len(views)
    return seen


def colors_outside(scene: Scene, splats: IntArray, cameras: Sequence[Camera] = ()) -> FloatArray:
    """`seen_colors` (K, 4) of ``splats`` (K,) as one group, where their files have them.

    The same however they are grouped, and wherever they were moved or turned to since.
    ``cameras`` are those of the photos in the frame in which the scene was opened.
    """
    taken = scene.gaussians.bare(splats)
    used, first, places = np.unique(scene.placement[splats], return_index=True, return_inverse=True)
    back = inverse(scene.frame.world)
    sources = scene.source[splats[first]].tolist()  # all splats of a row are of one file
    home = np.array([(back @ scene.motion_of(source))[:3] for source in sources])
    part = Scene.of(taken)
    part.placement, part.placements = places.astype(np.int32), Placements.identity(len(used))
    frame = upright_basis(estimate_up(cameras))
    rows, matrix = np.zeros(len(splats), np.int32), np.ascontiguousarray(frame @ home)
    spread, _, _ = _spread(part, rows, 1, matrix)
    return seen_colors(part, rows, spread, matrix, view_axes(frame, cameras))


_MOST_COLORED = 50_000  # splats that stand for more of them in a color


def part_for_color(splats: AnyArray) -> IntArray:
    """At most 50,000 of ``splats`` (K,), evenly taken, that stand for all in a color."""
    part: IntArray = splats[:: max(1, -(-len(splats) // _MOST_COLORED))]
    return part


def outside_color(scene: Scene, splats: IntArray, cameras: Sequence[Camera] = ()) -> DoubleArray:
    """Mean color (3,) of ``splats`` (K,) from outside, 0..1, as they are drawn: see
    `colors_outside` and `gaga_core.scene.tint.mean_color`; mid grey when there are none."""
    part = part_for_color(sorted_indices(splats, len(scene)))
    return mean_color(scene, part, colors_outside(scene, part, cameras) if len(part) else None)


# --- Digests of groups: equal while a group has the same splats with the same look.


_MIX = np.array([0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D, 0x27D4EB2F], np.int64)


def group_digests(scene: Scene) -> tuple[IntArray, LongArray]:
    """Groups (G,) of ``scene`` that have live splats, without 0, and their digests (G,).

    A digest changes when splats join or leave, move or are recolored; not with the group's id or
    name, nor with what else is in the scene.
    """
    rows, ids = compact_rows(scene.labels)
    g, p = scene.gaussians, scene.placements
    words = _bits(g.means) @ _MIX[:3]
    words = words * 31 + _bits(g.sh[:, 0]) @ _MIX[1:]
    words ^= _bits(g.logit_opacities[:, None])[:, 0]
    placed = [
        int.from_bytes(
            hashlib.blake2b(m.tobytes() + c.tobytes() + o.tobytes(), digest_size=7).digest()
        )
        for m, c, o in zip(p.matrix, p.color, p.opacity, strict=True)
    ]
    words ^= np.array(placed, np.int64)[scene.placement]
    words += np.arange(len(words)) * 7046029254386353131
    words = (words ^ (words >> 30)) * -4658895280553007687
    words = (words ^ (words >> 27)) * -7723592293110705685
    words ^= words >> 31
    kept = np.flatnonzero(~scene.has(State.DELETED))
    digest = np.zeros(len(ids), np.int64)
    np.add.at(digest, rows[kept], words[kept])  # a sum: the order does not matter
    counts = np.bincount(rows[kept], minlength=len(ids))
    live = np.flatnonzero((counts > 0) & (ids > 0))
    return ids[live], digest[live]


def _bits(values: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> LongArray:
    """The bits of float32 numbers, as int64."""
    return np.ascontiguousarray(values, np.float32).view(np.int32).astype(np.int64)
