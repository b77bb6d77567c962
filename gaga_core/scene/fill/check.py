"""Look at a filled hole: whatever new splats change next to it is taken out again."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Frame, Rasterizer
from gaga_core.scene.edits.values import joined
from gaga_core.scene.fill.chart import OPAQUE, Chart, above_surface, tolerance_of
from gaga_core.scene.fill.views import SeenView

_VIEWS = 16  # of those that show most of the hole
_ROUNDS = 3  # of taking splats out
_CHANGE = 0.03  # of a color (0..1): what changes more outside the hole is wrong
_FALL = 0.02  # of alpha: what loses more is wrong
_WRONG = 0.2  # of a splat's weight: it goes when so much is in wrong pixels
_LEAST_KEPT = 0.8  # share of the splats under which a hole that hardly shows is left as it is
_GAPES = 0.2  # root mean square of a color's change (0..1) from which on a hole shows clearly
_MOST_WRONG = 0.1  # wrong pixels for each one that gains, above which nothing is kept
_SHOWS = 0.15  # root mean square of a color's change (0..1): a hole changed less hardly shows
_EDGE = 2  # pixels by which an outline may err


@dataclass(frozen=True, eq=False)
class _Look:
    camera: Camera
    open: Frame  # the picture without the object
    hole: BoolArray  # (H, W) pixels that show the hole
    points: DoubleArray  # (H * W, 3) where their rays meet its plane


def accepted(
    rest: Gaussians,
    fresh: Gaussians,
    without: BoolArray,
    chart: Chart,
    views: tuple[SeenView, ...],
    rasterizer: Rasterizer,
) -> BoolArray:
    """Which of the new splats ``fresh`` (K,) are kept; none when the others still do harm.

    ``rest``: (N,) what is left of the scene; ``without`` (N,): rows that go when the hole is
    filled. Compared are pictures before and after. Outside the hole's pixels no color may change,
    nor where a photo showed the surface, but for the dark of a gap; inside them the surface may
    not get thinner, and nothing may stand above it. Nothing is kept where the picture in the hole
    hardly changes: large neighbours show through in about the right color already. Nor where it
    changes little and many splats would have to go, which looks spotty.
    """
    kept = np.ones(len(fresh), np.bool_)
    looks = _looks(rest, chart, views, rasterizer)
    stay = rest.take(~without)
    for last in [False] * _ROUNDS + [True]:
        rows = np.flatnonzero(kept)
        if len(looks) == 0 or len(rows) == 0:
            break
        filled = joined(stay, fresh.take(rows))
        weights = np.zeros((len(filled), 2), np.float32)
        wrong = gained = 0
        change = 0.0
        for look in looks:
            after = rasterizer.render(filled, look.camera)
            bad, good = _judged(look, after, chart)
            change += float(((_shown(after) - _shown(look.open))[good] ** 2).mean(axis=1).sum())
            rasterizer.vote(filled, look.camera, bad.astype(np.int32), weights)
            wrong, gained = wrong + int(bad.sum()), gained + int(good.sum())
        if change <= _SHOWS**2 * gained:
            break
        own = weights[len(stay) :]
        harmful = own[:, 1] > _WRONG * own.sum(axis=1)
        if last or not harmful.any():
            if wrong > _MOST_WRONG * gained:
                break
            return kept
        kept[rows[harmful]] = False
        if kept.mean() < _LEAST_KEPT and change <= _GAPES**2 * gained:
            break
    return np.zeros_like(kept)


def _judged(look: _Look, after: Frame, chart: Chart) -> tuple[BoolArray, BoolArray]:
    """Pixels (H, W) that got worse, and those of the hole that are surface now."""
    changed = np.abs(_shown(after) - _shown(look.open)).max(axis=2)
    less = after.alpha < np.minimum(look.open.alpha, OPAQUE) - _FALL
    above = above_surface(look.camera, after.median_depth.ravel(), look.points, chart.plane)
    top = float(chart.height[chart.known].max(initial=0.0)) + tolerance_of(chart)
    less |= (above > top).reshape(less.shape) & (changed > _CHANGE)
    bad: BoolArray = np.where(look.hole, less, changed > _CHANGE)
    nearer = (after.median_depth > 0) & (
        (look.open.median_depth == 0) | (after.median_depth < look.open.median_depth)
    )
    good: BoolArray = look.hole & nearer & ~less
    return bad, good


def _shown(frame: Frame) -> DoubleArray:
    return np.clip(frame.image.astype(np.float64), 0, 1)


def _looks(
    rest: Gaussians, chart: Chart, views: tuple[SeenView, ...], rasterizer: Rasterizer
) -> list[_Look]:
    """The views that show most of the hole, with it open."""
    found: list[tuple[SeenView, BoolArray, DoubleArray]] = []
    for view in views:
        points, hits = _on_plane(view.camera, chart)
        if hits.any():
            found.append((view, hits, points))
    found.sort(key=lambda one: -int(one[1].sum()))
    looks = []
    for view, hits, points in found[:_VIEWS]:
        frame = rasterizer.render(rest, view.camera)
        above = above_surface(view.camera, frame.median_depth.ravel(), points, chart.plane)
        shows = above < tolerance_of(chart)  # nothing that stays stands before it
        hole = ndimage.binary_dilation((hits & shows).reshape(frame.alpha.shape), iterations=_EDGE)
        # What the photo showed stays, but for the dark of a gap.
        row, column, _ = chart.cells(chart.plane.local(points))
        gap = (hits & shows & chart.again[row, column]).reshape(hole.shape)
        hole &= ~view.is_clear | ndimage.binary_dilation(gap)
        looks.append(_Look(view.camera, frame, hole, points))
    return looks


def _on_plane(camera: Camera, chart: Chart) -> tuple[DoubleArray, BoolArray]:
    """Where the ray of each pixel meets the plane (H * W, 3), and whether in the hole (H * W,)."""
    row, column = np.indices((camera.height, camera.width)).reshape(2, -1) + 0.5
    rays = np.stack([column, row, np.ones(len(row))], axis=1) @ np.linalg.inv(camera.K).T
    rays = rays @ camera.cam_from_world[:3, :3]
    plane = chart.plane
    falls = rays @ plane.axes[:, 2]
    height = float((camera.position - plane.origin) @ plane.axes[:, 2])
    far = np.where(np.abs(falls) > 1e-9, -height / np.where(falls == 0, 1.0, falls), -1.0)
    points = camera.position + far[:, None] * rays
    at_row, at_column, inside = chart.cells(plane.local(points))
    hole = ndimage.binary_dilation(chart.hole)
    hits: BoolArray = (far > 0) & (falls < 0) & inside & hole[at_row, at_column]
    return points, hits
