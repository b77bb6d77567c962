"""What came, went or moved between two captures that are aligned, object by object.

An object of one capture is gone from the other where photos of the other look through its place, or
see another color there; hidden there, or outside of all pictures, nothing is said. What went and
what came with the same shape and color moved. Both are asked of rendered depth, not of nearby
splats: two trainings put splats of one wall in different places, but the wall's surface stays.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import linear_sum_assignment

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.color import rgb_from_dc
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import turned
from gaga_core.progress import Progress, Stage, part, portion
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.captures.alignment import Capture
from gaga_core.scene.frame import inverse, length_text, scale_of
from gaga_core.scene.objects import group_name
from gaga_core.scene.selection.click import click_views

STAGE = "Compare the captures"
Kind = Literal["came", "went", "moved"]


@dataclass(frozen=True)
class ChangeConfig:
    """What counts as a change. Chosen on four draws of the demo with three objects moved, drawn and
    trained: in the middle of what lists the same, from half to twice of each (experiments.md)."""

    side: int = 320  # pixels of a view that is looked into
    opaque: float = 0.3  # opacity of a splat, alpha of a pixel, from which it shows a surface
    depth: float = 0.02  # of the depth: what is that much nearer or farther is another surface
    thin: float = 0.25  # ... or by that much of the thing's own size, if that is less
    color: float = 0.35  # mean difference of channels, from which it is another thing
    seen: float = 0.2  # share of a group's splats that must be seen
    free: float = 0.25  # share of the looks at its place that nothing in front of it may hide
    gone: float = 0.75  # share of these that must be gone
    partly: float = 0.28  # ... of what stands where another thing stood, if it came from elsewhere
    least_move: float = 0.5  # of its own size: what moved less is the same thing, seen otherwise
    sides: float = 55.0  # degrees between views that show a thing, or half of what the best seen
    # one has: from fewer sides nobody knows how far away it is
    fewest: int = 30  # opaque splats of an object: smaller ones are crumbs
    alike: float = 0.17  # share of colors in common, less the mean difference of log extents, from
    # which two are one thing that moved


_CONFIG = ChangeConfig()


@dataclass(frozen=True)
class Change:
    """One object that is not where it was."""

    kind: Kind
    name: str
    first: int | None  # its group in the first capture; None: it came
    second: int | None  # ... in the second; None: it went
    distance: float = 0.0  # that it moved, units of the first capture

    def sentence(self, *, is_metric: bool) -> str:
        """ "teapot moved by 32.0 cm"."""
        if self.kind != "moved":
            return f"{self.name} {self.kind}"
        return f"{self.name} moved by {length_text(self.distance, is_metric=is_metric)}"

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {
            "kind": self.kind,
            "name": self.name,
            "first_group": self.first,
            "second_group": self.second,
            "distance": self.distance,
        }


@dataclass(frozen=True, eq=False)
class _Side:
    """Surface of a capture: K opaque splats, and views of it."""

    capture: Capture
    gaussians: Gaussians  # all visible splats, world
    rows: LongArray  # (K,) opaque ones in groups
    labels: IntArray  # (K,)
    means: DoubleArray  # (K, 3)
    colors: DoubleArray  # (K, 3)
    views: tuple[Camera, ...]


def find_changes_stage(
    first: Capture,
    second: Capture,
    world: DoubleArray,  # (4, 4) first_from_second
    rasterizer: Rasterizer,
) -> Stage[tuple[Change, ...]]:
    """Objects that came, went or moved, by kind and name.

    Both captures need splats; one without groups has no objects that could have changed.
    """
    a = yield from portion(_side(first), 0, 0, STAGE)
    b = yield from portion(_side(second), 0, 0, STAGE)
    looks_a = yield from part(_look(a, b, world, rasterizer), 0, 2, STAGE)
    looks_b = yield from part(_look(b, a, inverse(world), rasterizer), 1, 2, STAGE)
    scale = scale_of(world)
    went = [_Thing.of(a, *one, 1.0) for one in _gone(a, looks_a, looks_b)]
    came = [_Thing.of(b, *one, scale) for one in _gone(b, looks_b, looks_a)]
    found, taken = [], set[int]()
    pairs = _pairs(went, came)
    for i, thing in enumerate(went):
        if (j := pairs.get(i)) is not None:
            far = float(
                np.linalg.norm(
                    turned(came[j].centre[None], world[:3, :3])[0] + world[:3, 3] - thing.centre
                )
            )
            taken.add(j)
            if far >= _CONFIG.least_move * thing.size:
                found.append(Change("moved", thing.name, thing.group, came[j].group, far))
        elif thing.share >= _CONFIG.gone:
            found.append(Change("went", thing.name, thing.group, None))
    for j, thing in enumerate(came):
        if j not in taken and thing.share >= _CONFIG.gone:
            found.append(Change("came", thing.name, None, thing.group))
    return tuple(sorted(found, key=lambda change: (change.kind, change.name)))


def _side(capture: Capture) -> Stage[_Side]:
    assert capture.scene is not None
    scene = capture.scene
    shown = np.flatnonzero(scene.visible)
    gaussians = yield from bake_stage(scene)
    labels = scene.labels[shown]
    rows = np.flatnonzero((labels > 0) & (gaussians.opacities >= _CONFIG.opaque))
    colors = np.clip(rgb_from_dc(gaussians.sh[rows, 0]), 0, 1).astype(np.float64)
    views = tuple(
        view.at_most(_CONFIG.side) for view in click_views(capture.cameras, gaussians.means)
    )
    means = gaussians.means[rows].astype(np.float64)
    return _Side(capture, gaussians, rows, labels[rows], means, colors, views)


@dataclass(frozen=True, eq=False)
class _Looks:
    """What the views of a capture show of its own groups, and of the splats of the other one."""

    sides: DoubleArray  # (G,) widest angle between views that show a group of its own, degrees
    looks: LongArray  # (K,) views in which a splat of the other would be
    there: LongArray  # (K,) ... that show it
    away: LongArray  # (K,) ... that look through its place, or see another color there


def _look(
    side: _Side,
    other: _Side,
    side_from_other: DoubleArray,  # (4, 4)
    rasterizer: Rasterizer,
) -> Stage[_Looks]:
    """Look at both captures from the views of one ``side``."""
    points = turned(other.means, side_from_other[:3, :3]) + side_from_other[:3, 3]
    looks, there, away = np.zeros((3, len(points)), np.int64)
    groups, own = np.unique(side.labels, return_inverse=True)
    of = np.unique(other.labels, return_inverse=True)[1]
    size = _sizes(other) * scale_of(side_from_other)
    shown = np.zeros((len(groups), len(side.views)))
    for i, view in enumerate(side.views):
        yield Progress(STAGE, i, len(side.views), view.name)
        frame = rasterizer.render(side.gaussians, view)
        inside, depths, (u, v) = _inside(view, side.means)
        off = frame.median_depth[v, u] / depths - 1
        is_shown = (frame.alpha[v, u] >= _CONFIG.opaque) & (np.abs(off) <= _CONFIG.depth)
        shown[:, i] = np.bincount(own[inside[is_shown]], minlength=len(groups))
        inside, depths, (u, v) = _inside(view, points)
        surface, off = frame.alpha[v, u] >= _CONFIG.opaque, frame.median_depth[v, u] / depths - 1
        near = np.minimum(_CONFIG.thin * size[of[inside]] / depths, _CONFIG.depth)
        same = surface & (np.abs(off) <= near)
        differs = np.abs(frame.image[v, u] - other.colors[inside]).mean(axis=1) > _CONFIG.color
        looks[inside] += 1
        there[inside] += same & ~differs
        away[inside] += (surface & (off > near)) | (same & differs)
    positions = np.array([view.position for view in side.views])
    sides = np.zeros(len(groups))
    for k in range(len(groups)):
        mine = own == k
        ways = positions[shown[k] >= _CONFIG.seen * mine.sum()] - np.median(
            side.means[mine], axis=0
        )
        ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
        if len(ways):
            sides[k] = np.degrees(np.arccos(np.clip((ways @ ways.T).min(), -1, 1)))
    return _Looks(sides, looks, there, away)


def _inside(view: Camera, points: DoubleArray) -> tuple[LongArray, DoubleArray, LongArray]:
    """Indices (K,) of points (N, 3) in front of a view, their depths (K,) and pixels (2, K)."""
    pixels, depths = view.project(points)
    inside = np.flatnonzero(view.shows(pixels, depths))
    return inside, depths[inside], pixels[inside].astype(np.int64).T


def _gone(side: _Side, own: _Looks, others: _Looks) -> list[tuple[int, float]]:
    """Groups of ``side`` of which the ``others`` see a part not to be there, and how large that is,
    as a share of what they see."""
    looks, there, away = others.looks, others.there, others.away
    groups, of = np.unique(side.labels, return_inverse=True)
    n_all = np.bincount(of)
    seen, gone = there + away > 0, away > there
    n_seen = np.bincount(of[seen], minlength=len(groups))
    share = np.bincount(of[seen & gone], minlength=len(groups)) / np.maximum(n_seen, 1)
    is_known = (n_all >= _CONFIG.fewest) & (n_seen >= _CONFIG.seen * n_all)
    n_looks, n_free = np.bincount(of, weights=looks), np.bincount(of, weights=there + away)
    is_known &= n_free >= _CONFIG.free * n_looks
    is_known &= own.sides >= min(_CONFIG.sides, float(own.sides.max(initial=0)) / 2)
    found = zip(groups[is_known].tolist(), share[is_known].tolist(), strict=True)
    return [
        (g, part) for g, part in found if part >= _CONFIG.partly and g not in side.capture.behind
    ]


def _sizes(side: _Side) -> DoubleArray:
    """Sizes (G,) of the groups of a side, in its units."""
    of = np.unique(side.labels, return_inverse=True)[1]
    return np.array([_size(side.means[of == i]) for i in range(int(of.max(initial=-1)) + 1)])


def _size(points: DoubleArray) -> float:
    """Twice the mean distance of points (N, 3) to their middle: about the diameter of a ball."""
    return 2 * float(np.linalg.norm(points - np.median(points, axis=0), axis=1).mean())


@dataclass(frozen=True, eq=False)
class _Thing:
    """Place, shape and color of an object that is not where it was."""

    group: int
    share: float  # that is seen not to be there in the other capture
    name: str
    size: float  # units of the first capture
    centre: DoubleArray  # (3,) world of its capture
    extents: DoubleArray  # (3,) log of its standard deviations, units of the first capture
    hues: DoubleArray  # (B,) share of the splats in each cell of RGB

    @staticmethod
    def of(side: _Side, group: int, share: float, scale: float) -> "_Thing":
        """A group of a capture whose units are ``scale`` units of the first one."""
        assert side.capture.scene is not None
        rows = np.flatnonzero(side.labels == group)
        centre = np.median(side.means[rows], axis=0)
        off = np.linalg.norm(side.means[rows] - centre, axis=1)
        rows = rows[off <= np.quantile(off, _CORE)]  # without strays
        spread = np.linalg.eigvalsh(np.cov(side.means[rows].T)) * scale**2
        cells = (side.colors[rows] * (_LEVELS - 1) + 0.5).astype(np.int64) @ (
            _LEVELS**2,
            _LEVELS,
            1,
        )
        counts = np.bincount(cells, minlength=_LEVELS**3) / len(rows)
        # Blurred: trained colors are not those of another training to the digit.
        hues = gaussian_filter(counts.reshape([_LEVELS] * 3), _BLUR, mode="nearest").ravel()
        name = group_name(side.capture.scene, group)
        extents, size = 0.5 * np.log(np.maximum(spread, 1e-12)), scale * _size(side.means[rows])
        return _Thing(group, share, name, size, centre, extents, hues)


_CORE = 0.9  # share of a group's splats that its place and shape are measured of
_LEVELS = 5  # of each channel, of which colors are counted
_BLUR = 0.7  # levels, standard deviation


def _pairs(went: Sequence[_Thing], came: Sequence[_Thing]) -> dict[int, int]:
    """Which of ``came`` is which of ``went``: the same shape and color."""
    if not went or not came:
        return {}
    shape = np.array([[np.abs(a.extents - b.extents).mean() for b in came] for a in went])
    hues = np.array([[np.minimum(a.hues, b.hues).sum() for b in came] for a in went])
    share = np.array([[(a.share, b.share) for b in came] for a in went])
    fits = (hues - shape >= _CONFIG.alike) & (share.max(axis=2) >= _CONFIG.gone)
    cost = np.where(fits, 3 + shape - hues - share.sum(axis=2), 1e6)
    rows, columns = linear_sum_assignment(cost)
    return {int(i): int(j) for i, j in zip(rows, columns, strict=True) if fits[i, j]}
