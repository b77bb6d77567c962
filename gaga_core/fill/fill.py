"""Find what a removed object hid, and make the splats and colors that fill it."""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.color import LUMA, dc_from_rgb, rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.fill.chart import (
    OPAQUE,
    Chart,
    above_surface,
    chart_of,
    continued_color,
    drawn,
    smooth_base,
    tolerance_of,
)
from gaga_core.fill.inpaint import Inpainter
from gaga_core.fill.shadows import foot_cells, gains, shadow_of, splat_gains, taken_cells
from gaga_core.fill.surfaces import AROUND, FillConfig, Seen, SeenView, seen_stage, surfaces_around
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import turned
from gaga_core.progress import Progress, Stage, portion
from gaga_core.raster.base import Frame, Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.edits.placement import recolor
from gaga_core.scene.edits.splats import append_made, delete
from gaga_core.scene.edits.values import Edit, joined, together
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.objects import group_name
from gaga_core.scene.scene import Revision, Scene, State
from gaga_core.scene.selection.algebra import world_means

T = TypeVar("T")

# --- New splats for a hole: copies of pieces of the surface around it, in the colors of its chart.


_PIECE = 5.0  # side of a copied piece, spacings of the splats
_SMALL, _INWARD = 0.4, 0.5  # largest deviation: in spacings, and in ways to the hole's edge
_UNDER = 0.5  # spacings under the surface, so that what is there already is drawn over them
_ROUNDS = 3  # of correcting colors by what is drawn
_GAP_ROUNDS = 5  # of splats for what the pieces leave open
_THIN = 0.9  # alpha under which a cell gets a splat more
_MOST_GAIN = 0.5  # of a color, in a round


def new_splats(
    gaussians: Gaussians,
    chart: Chart,
    color: DoubleArray,
    height: DoubleArray,
    rasterizer: Rasterizer,
    seed: int,
) -> Gaussians:
    """Splats that show ``color`` (H, W, 3) at ``height`` (H, W) in the chart's hole.

    Density, sizes, opacities, view dependence and extra columns are those of the splats around:
    the hole is laid out in pieces, each with the splats of a piece of the known surface.
    """
    rng = np.random.default_rng(seed)
    donors, places = _laid_out(gaussians, chart, rng)
    usable = _usable(gaussians, chart)
    for _ in range(_GAP_ROUNDS):
        fresh = _placed(gaussians, chart, height, donors, places)
        gaps = _gaps(gaussians, fresh, chart, rasterizer)
        if len(gaps) == 0:
            break
        donors = np.concatenate([donors, rng.choice(usable, len(gaps))])
        places = np.concatenate([places, gaps])
    return _colored(_placed(gaussians, chart, height, donors, places), chart, color, rasterizer)


def _placed(
    gaussians: Gaussians,
    chart: Chart,
    height: DoubleArray,
    donors: LongArray,
    places: DoubleArray,
) -> Gaussians:
    """Copies of ``donors`` (K,) at ``places`` (K, 2) under the surface, as uneven as there."""
    local = chart.plane.local(gaussians.means[donors].astype(np.float64))
    most = 3 * chart.plane.thickness
    lift = np.clip(local[:, 2] - chart.at(chart.height, local), -most, most)
    under = _UNDER * chart.plane.spacing
    target = np.column_stack([places, chart.at(height, places) + lift - under])
    # Large splats would lie over what is known next to the hole.
    inward = chart.at(ndimage.distance_transform_edt(chart.hole) * chart.step, places)
    largest = np.log(np.maximum(_SMALL * chart.plane.spacing, _INWARD * inward))
    copies = gaussians.take(donors)
    return replace(
        copies,
        means=chart.plane.world(target).astype(np.float32),
        log_scales=np.minimum(copies.log_scales, largest[:, None]).astype(np.float32),
    )


def _gaps(
    gaussians: Gaussians, fresh: Gaussians, chart: Chart, rasterizer: Rasterizer
) -> DoubleArray:
    """Where on the plane the hole is still seen through (K, 2), a spacing apart."""
    both = joined(gaussians.take(chart.plane.splats), fresh)
    _, _, alpha = drawn(both, chart.plane, chart.corner, chart.step, chart.shape, rasterizer)
    thin = chart.hole & (alpha < _THIN)
    every = max(1, round(chart.plane.spacing / chart.step))
    # The thinnest cell of its surroundings; equal ones are distinguished by their place.
    order = np.arange(thin.size).reshape(thin.shape) * 1e-9
    key = np.where(thin, 1 - alpha + order, 0)
    peak = thin & (key >= ndimage.maximum_filter(key, size=every))
    return chart.uv()[peak]


def _usable(gaussians: Gaussians, chart: Chart) -> LongArray:
    """Rows of the splats of the known surface (K,)."""
    splats = chart.plane.splats
    row, column, inside = chart.cells(chart.plane.local(gaussians.means[splats].astype(np.float64)))
    return splats[inside & chart.known[row, column]]


def _laid_out(
    gaussians: Gaussians, chart: Chart, rng: np.random.Generator
) -> tuple[LongArray, DoubleArray]:
    """Rows of donors (K,), and where on the plane their copies come (K, 2)."""
    plane = chart.plane
    rows = _usable(gaussians, chart)
    local = plane.local(gaussians.means[rows].astype(np.float64))[:, :2]
    side = max(3, round(_PIECE * plane.spacing / chart.step))
    solid = ndimage.minimum_filter(chart.known, size=side)
    if not solid.any():
        solid = chart.known
    middles = np.argwhere(solid)
    taken, places = [], []
    piece = side * chart.step
    for top in range(0, chart.shape[0], side):
        for left in range(0, chart.shape[1], side):
            part = chart.hole[top : top + side, left : left + side]
            if not part.any():
                continue
            middle = middles[rng.integers(len(middles))]
            from_uv, to_uv = (
                np.array(
                    [chart.corner[0] + chart.step * column, chart.corner[1] - chart.step * row]
                )
                for row, column in (middle + 0.5, (top + side / 2, left + side / 2))
            )
            near = (np.abs(local - from_uv) < piece / 2).all(axis=1)
            moved = local[near] + (to_uv - from_uv)
            r, c, ok = chart.cells(moved)
            ok &= chart.hole[r, c]
            taken.append(rows[near][ok])
            places.append(moved[ok])
    return np.concatenate([rows[:0], *taken]), np.concatenate([np.zeros((0, 2)), *places])


def _colored(
    fresh: Gaussians, chart: Chart, color: DoubleArray, rasterizer: Rasterizer
) -> Gaussians:
    """The splats in such colors that the chart, drawn from them, is ``color``."""
    local = chart.plane.local(fresh.means.astype(np.float64))
    rgb = chart.at(color, local)
    sh = fresh.sh.copy()
    for _ in range(_ROUNDS):
        sh[:, 0] = dc_from_rgb(rgb.astype(np.float32))
        fresh = replace(fresh, sh=sh.copy())
        shown, _, alpha = drawn(
            fresh, chart.plane, chart.corner, chart.step, chart.shape, rasterizer
        )
        wrong = np.where((alpha > 0.3)[:, :, None] & chart.hole[:, :, None], color - shown, 0)
        rgb = rgb + np.clip(chart.at(wrong, local), -_MOST_GAIN, _MOST_GAIN)
    sh[:, 0] = dc_from_rgb(rgb.astype(np.float32))
    return replace(fresh, sh=sh)


# --- One share of all that is done for a fill.

_STAGE = "Fill the hole"
_STEPS = 1000  # of the whole
# What parts cost, in the time in which a view is drawn once, on two cores. On four objects of the
# demo and three of ycb_table: to find the surfaces 6 to 75, a chart 1 to 37, a surface without a
# hole 8 to 12, one with a hole 110 to 190; and to look behind the object, which draws every view
# four times, 0.3 to 0.53 of the whole.
_FOUND, _CHART, _SURFACE, _HOLE = 40.0, 10.0, 10.0, 110.0
_LOOKS = 0.4  # share of the whole
# Seconds of the whole on two cores, a splat and view: those objects took 0.85 to 1.2 times as long.
_USUAL = 2e-6
_COLORS, _LAID = 0.2, 0.6  # of what a hole takes: until its colors, and its splats, are known


def _at(share: float, message: str = "") -> Progress:
    return Progress(_STAGE, round(_STEPS * share), _STEPS, message)


# --- Check a filled hole: what new splats change next to it is undone.


_VIEWS = 16  # of those that show most of the hole
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


def accepted_stage(
    rest: Gaussians,
    fresh: Gaussians,
    without: BoolArray,
    chart: Chart,
    views: tuple[SeenView, ...],
    rasterizer: Rasterizer,
) -> Stage[BoolArray]:
    """Find which of the new splats ``fresh`` (K,) are kept; none when the others still do harm.

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
    for i, last in enumerate([False] * _ROUNDS + [True]):
        rows = np.flatnonzero(kept)
        if len(looks) == 0 or len(rows) == 0:
            break
        filled = joined(stay, fresh.take(rows))
        weights = np.zeros((len(filled), 2), np.float32)
        wrong = gained = 0
        change = 0.0
        for k, look in enumerate(looks):
            # Most often it ends with the first: each takes half of what is left.
            yield _at(1 - 0.5**i * (1 - 0.5 * k / len(looks)))
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
    found = [(view, *_on_plane(view.camera, chart)) for view in views]
    found = [one for one in found if one[2].any()]
    found.sort(key=lambda one: -int(one[2].sum()))
    looks = []
    for view, points, hits in found[:_VIEWS]:
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


# --- Fill what a part of an object hid, surface by surface, and take its shadow off them.


_RIM_SPLAT = 0.8  # spacings: largest deviation of a seen splat that is made again
_THING = 3.0  # sizes of the object: what is larger is no object that stands on the surface
_BASE = 3.0  # cells: what is finer is texture
# On layers, chosen on the demo's teapot: largest deviation of a seen splat that is made again,
# spacings; a factor of a shadow from which on a cell next to the hole is made again, and how many
# cells from the hole; cells between splats of one layer.
_LAYER_SPLAT, _DEEP, _DEEP_CELLS, _BETWEEN = 1.6, 1.2, 8, 2


@dataclass(frozen=True, eq=False)
class _Shadow:
    """The correction that removes it."""

    factors: DoubleArray  # (H, W, 3)
    is_cast: bool  # its outline is that of the object


class Work:
    """Findings for each part of the object."""

    def __init__(
        self,
        gaussians: Gaussians,
        labels: IntArray,
        is_object: BoolArray,
        seen: Seen,
        rasterizer: Rasterizer,
        config: FillConfig,
    ) -> None:
        self.gaussians, self.labels, self.is_object = gaussians, labels, is_object
        self.seen, self.rasterizer, self.config = seen, rasterizer, config
        self.is_known = seen.known
        self.points = gaussians.means.astype(np.float64)
        sizes = _sizes(self.points, labels)
        self.size = float(sizes[is_object].max())
        # Other objects that the photos showed.
        may_stand = (sizes < _THING * self.size) | (not labels.any())  # by their height alone
        self.is_thing = ~is_object & self.is_known & may_stand
        self.inpainter: Inpainter | None = None  # None: colors continue the surroundings
        self.is_refused = False  # a hole that was found is left open
        self.made: list[Gaussians] = []
        self.groups: list[IntArray] = []
        self.gain = np.ones((len(gaussians), 3))
        self.dropped = np.zeros(len(gaussians), np.bool_)
        self.locked = np.zeros(len(gaussians), np.bool_)  # neither goes nor is lightened

    def fill(self, part: BoolArray) -> Stage[None]:
        """Fill behind the splats ``part`` (N,) of the object, surface by surface."""
        own = self.points[part]
        usable = self.is_known & ~self.is_object
        charts: list[Chart] = []
        planes = surfaces_around(self.gaussians, self.labels, part, usable, self.config)
        # Most often there is one hole.
        whole_cost = _FOUND + (_CHART + _SURFACE) * len(planes) + _HOLE - _SURFACE
        for i, plane in enumerate(planes):
            yield _at((_FOUND + _CHART * i) / whole_cost)
            how = self.seen.views, self.rasterizer, self.config
            charts.append(chart_of(self.gaussians, plane, own, *how))
        thick = float(np.median(self.gaussians.scales[part].min(axis=1)))
        inside = _inside(own, self.points, thick)
        within = ~self.is_object & ~self.is_known & ~self.locked & inside
        for chart in charts:  # what lies on a surface is not in the object
            within &= ~_on_surface(chart, self.points)
        self.dropped |= within  # whether there is a hole or not: nothing is in an object's body
        hidden = ~self.is_object & ~self.is_known
        n_filled = 0
        costs = np.cumsum([0.0] + [_HOLE if chart.hole.any() else _SURFACE for chart in charts])
        begun = (_FOUND + _CHART * len(charts)) / whole_cost
        shares = begun + (1 - begun) * costs / max(costs[-1], 1.0)
        for whole, begin, end in zip(charts, shares, shares[1:], strict=False):
            yield _at(begin)
            chart, shadow = whole, self._shadow(whole, own)
            if not chart.hole.any() or n_filled == self.config.most_surfaces:
                if shadow.is_cast:
                    self.gain = self._lit_by(chart, shadow)
                continue
            local = chart.plane.local(self.points)
            row, column, inside = chart.cells(local)
            low = np.abs(local[:, 2]) < max(chart.step, 4 * chart.plane.thickness)
            largest = _RIM_SPLAT
            if chart.plane.is_layered:
                largest, unseen = _LAYER_SPLAT, np.zeros(chart.shape, np.bool_)
                on_it = hidden & inside & low
                unseen[row[on_it], column[on_it]] = True
                chart = with_rim(chart, shadow.factors, unseen)
            # Seen splats at its rim are made again too, but for large ones: they reach far beyond.
            small = self.gaussians.scales.max(axis=1) < largest * chart.plane.spacing
            under = inside & low & chart.hole[row, column]
            # What is on the surface, and so not in the object's body, is made again with the hole.
            on_hole = hidden & _on_surface(chart, self.points) & chart.hole[row, column]
            # Nor does what hides over the place of an object that stands there: it was its inside.
            over = hidden & self._over_place(chart, own)
            goes = ((hidden | (small & ~self.is_object)) & under) | on_hole | over | within
            filled = self._fill_chart(chart, goes & ~self.locked, shadow)
            n_filled += yield from portion(filled, begin, end, _STAGE)

    def _over_place(self, chart: Chart, own: DoubleArray) -> BoolArray:
        """Splats (N,) over the place of the splats ``own`` (K, 3) that stand there, up to their
        height."""
        if not foot_cells(chart, own).any():
            return np.zeros(len(self.points), np.bool_)
        place, stands = chart.hole.copy(), chart.plane.local(own)
        row, column, inside = chart.cells(stands)
        place[row[inside], column[inside]] = True
        local = chart.plane.local(self.points)
        row, column, inside = chart.cells(local)
        inside &= (local[:, 2] > 0) & (local[:, 2] < np.percentile(stands[:, 2], 99))
        return inside & ndimage.binary_closing(place, iterations=_BETWEEN)[row, column]

    def _fill_chart(self, chart: Chart, goes: BoolArray, shadow: _Shadow) -> Stage[bool]:
        """Fill a chart's hole, without the splats ``goes`` (N,); False when it does harm."""
        plane = chart.plane
        bright = replace(chart, color=chart.color * shadow.factors)
        surface = bright.color, chart.known, chart.hole
        if self.inpainter is None:
            color = continued_color(*surface)
        else:
            color = yield from portion(self.inpainter.painted_stage(*surface), 0, 0, _STAGE)
        color = np.clip(color, 0, 1.5)
        base = smooth_base(chart.height[:, :, None], chart.known, chart.hole, _BASE)[:, :, 0]
        height = np.where(chart.hole, base, chart.height)
        yield _at(_COLORS)
        fresh = new_splats(self.gaussians, bright, color, height, self.rasterizer, self.config.seed)
        # What no photo showed is no surface to compare with.
        left = np.flatnonzero(~self.is_object & ~self.dropped & (self.is_known | ~goes))
        gain = self._lit_by(chart, shadow)
        sh = self.gaussians.sh * gain[:, None].astype(np.float32)
        sh[:, 0] = dc_from_rgb((rgb_from_dc(self.gaussians.sh[:, 0]) * gain).astype(np.float32))
        rest = replace(self.gaussians, sh=sh).take(left)
        check = accepted_stage(rest, fresh, goes[left], chart, self.seen.views, self.rasterizer)
        kept = yield from portion(check, _LAID, 1, _STAGE)
        if not kept.any():
            self.is_refused = True
            if shadow.is_cast:
                self.gain = gain
            return False
        fresh = fresh.take(np.flatnonzero(kept))
        self.dropped |= goes
        self.gain = gain
        self.made.append(fresh)
        self.groups.append(np.full(len(fresh), plane.label, np.int32))
        return True

    def _shadow(self, chart: Chart, own: DoubleArray) -> _Shadow:
        """What takes the shadow of the splats ``own`` (K, 3) off the chart that these stand on."""
        none = _Shadow(np.ones((*chart.shape, 3)), is_cast=False)
        if not self.config.lighten:
            return none
        foot = foot_cells(chart, own)
        if not foot.any():
            return none
        foot = chart.hole if chart.hole.any() else foot
        stands = self.is_thing & ((self.labels != chart.plane.label) | (self.labels == 0))
        taken = taken_cells(chart, self.points[stands], self.size)
        cast = shadow_of(chart, foot, own, taken)
        return _Shadow(gains(chart, foot, taken, cast), is_cast=cast is not None)

    def _lit_by(self, chart: Chart, shadow: _Shadow) -> DoubleArray:
        """Factors (N, 3) of all splats when that shadow is taken off, too."""
        plane = chart.plane
        near = np.ones((len(self.gaussians), 3))
        rgb = rgb_from_dc(self.gaussians.sh[plane.splats, 0]).astype(np.float64)
        local = plane.local(self.points[plane.splats])
        near[plane.splats] = splat_gains(chart, shadow.factors, local, rgb)
        near[self.locked] = 1.0
        return np.maximum(self.gain, near)


def with_rim(chart: Chart, factors: DoubleArray, unseen: BoolArray) -> Chart:
    """The chart whose hole has the cells next to it that cannot stay as they are.

    What touched the object is nearly black: made brighter by ``factors`` (H, W, 3), it shows noise
    in the object's color. And where splats lie on top that no photo showed, ``unseen`` (H, W), the
    known ones are a layer under the surface.
    """
    near = ndimage.binary_dilation(chart.hole, iterations=_DEEP_CELLS)
    deep = near & (factors @ LUMA > _DEEP)
    layered = ndimage.binary_closing(unseen | chart.hole, iterations=_BETWEEN) & chart.known
    layered = ndimage.binary_dilation(chart.hole, iterations=-1, mask=layered | chart.hole)
    rim = ndimage.binary_dilation((deep | layered) & chart.known, mask=chart.known)
    return replace(chart, hole=chart.hole | rim, known=chart.known & ~rim, again=chart.again | rim)


def _sizes(points: DoubleArray, labels: IntArray) -> DoubleArray:
    """Extent (N,) of the group of each splat."""
    result = np.zeros(len(labels))
    for label in np.unique(labels):
        own = labels == label
        low, high = np.percentile(points[own], (2, 98), axis=0)
        result[own] = np.linalg.norm(high - low)
    return result


def _on_surface(chart: Chart, points: DoubleArray) -> BoolArray:
    """Which of ``points`` (N, 3) lie on the chart's surface, whether photos showed it or not."""
    local = chart.plane.local(points)
    row, column, inside = chart.cells(local)
    surface = ndimage.binary_fill_holes(chart.known | chart.hole)
    near = np.abs(local[:, 2] - chart.height[row, column]) < tolerance_of(chart)
    return inside & near & surface[row, column]


def _inside(own: DoubleArray, points: DoubleArray, thick: float) -> BoolArray:
    """Points (N,) in the convex hull of the object's splats ``own`` (K, 3), which are ``thick``."""
    lo, hi = np.percentile(own, 1, axis=0), np.percentile(own, 99, axis=0)
    within: BoolArray = np.all((points > lo - thick) & (points < hi + thick), axis=1)
    own = own[((own >= lo) & (own <= hi)).all(axis=1)]
    result = np.zeros(len(points), np.bool_)
    if len(own) < 5 or not within.any():
        return result
    try:
        planes = ConvexHull(own[:: max(1, len(own) // 3000)]).equations
    except QhullError:  # flat: nothing is inside
        return result
    near = np.flatnonzero(within)
    for plane in planes:  # normals look outwards
        near = near[points[near] @ plane[:3] + plane[3] <= thick]
    result[near] = True
    return result


# --- The stage.


_VISIBLE = 1.02  # factor of a color from which on it is changed


@dataclass(frozen=True, eq=False)
class Filling:
    """Changes of a fill; nothing is changed yet."""

    removed: LongArray  # (R,) rows of the object
    unseen: LongArray  # (U,) rows that no view ever saw and that the object hid
    splats: Gaussians  # (F,) new, world
    labels: IntArray  # (F,) their groups: those of the surfaces that they continue
    stained: LongArray  # (S,) rows to be lightened
    gains: FloatArray  # (S, 3) by these factors
    lighten: bool  # whether stains were looked for
    is_refused: bool  # a hole was found and left open: its filling hardly shows, or does harm
    model: str = ""  # name of the inpainting model's file; "" = colors continue the surroundings
    was_put: bool = False  # all of the object was put there by a person, so that it hid nothing

    def __bool__(self) -> bool:
        return len(self.splats) > 0 or len(self.stained) > 0 or len(self.unseen) > 0


def fillable(scene: Scene) -> LongArray:
    """Splats (K,) whose place can be filled: the selected ones, else all that were deleted.

    Raises ``GagaError`` when there are none.
    """
    chosen = np.flatnonzero(scene.has(State.SELECTED))
    chosen = chosen if len(chosen) else np.flatnonzero(scene.has(State.DELETED))
    if len(chosen) == 0:
        raise GagaError("Nothing is selected, and nothing was deleted. Select an object first.")
    return chosen


def fill_title(scene: Scene, indices: AnyArray) -> str:
    """Title of the edit in the history."""
    if scene.has(State.DELETED)[indices].all():
        return "Fill what was deleted"
    groups = np.unique(scene.labels[indices])
    if len(groups) == 1 and groups[0]:
        return f"Delete and fill {group_name(scene, int(groups[0]))}"
    return "Delete and fill"


def usual_seconds(scene: Scene, n_cameras: int, config: FillConfig) -> float:
    """Seconds that `fill_stage` usually takes on two cores, from so many cameras."""
    n_views = min(n_cameras, config.most_views) or AROUND
    return _USUAL * n_views * int(scene.visible.sum())


def fill_stage(
    scene: Scene,
    indices: AnyArray,
    cameras: Sequence[Camera],
    rasterizer: Rasterizer,
    config: FillConfig | None = None,
) -> Stage[Filling]:
    """Find what the splats ``indices`` (K,) hide from ``cameras``, and what would fill it.

    Deleted splats may be among them: what they left is filled. Locked ones that they hid stay.
    Without cameras that show the object, views from all around it are taken. Raises ``GagaError``
    when an inpainting model is asked for that cannot be used.
    """
    settings = FillConfig() if config is None else config
    model = Inpainter(Path(settings.model), settings.model_sha256) if settings.model else None
    with model or nullcontext():
        if model is not None:
            yield from model.loaded_stage()
        return (yield from _filled(scene, indices, (cameras, rasterizer, settings), model))


def _filled(
    scene: Scene,
    indices: AnyArray,
    how: tuple[Sequence[Camera], Rasterizer, FillConfig],
    inpainter: Inpainter | None,
) -> Stage[Filling]:
    """`fill_stage`; ``inpainter`` colors what is filled, None: the surroundings do."""
    cameras, rasterizer, settings = how
    chosen = np.zeros(len(scene), np.bool_)
    chosen[sorted_indices(indices, len(scene))] = True
    # What has no place in space is never drawn: it hides nothing.
    is_there = np.isfinite(scene.gaussians.means).all(axis=1)
    rows = np.flatnonzero((scene.visible | chosen) & is_there)
    apart = _hides_nothing(scene, rows, chosen[rows])
    rows = rows[~apart]
    labels = scene.labels[rows]
    gaussians = yield from portion(bake_stage(scene, indices=rows), 0, 0, _STAGE)
    is_object = chosen[rows]
    splats = gaussians.take(np.zeros(0, np.int64))
    if not is_object.any():  # the removal alone
        none, gains = np.zeros(0, np.int64), np.zeros((0, 3), np.float32)
        found = splats, np.zeros(0, np.int32), none, gains, settings.lighten
        was_put = bool(apart.any())
        return Filling(np.flatnonzero(chosen), none, *found, is_refused=False, was_put=was_put)
    placed, made = _put_there(scene, rows)
    known = (placed | made) & ~is_object
    looks = seen_stage(gaussians, is_object, cameras, rasterizer, settings, known)
    seen = yield from portion(looks, 0, _LOOKS, _STAGE)
    work = Work(gaussians, labels, is_object, seen, rasterizer, settings)
    work.inpainter = inpainter
    work.locked |= placed | ((scene.state[rows] & np.uint8(State.LOCKED)) != 0)
    parts = _apart(gaussians.means.astype(np.float64), is_object, labels, settings.reach)
    for i, part in enumerate(parts):
        begin, end = (_LOOKS + (1 - _LOOKS) * k / len(parts) for k in (i, i + 1))
        yield from portion(work.fill(part), begin, end, _STAGE)
    stained = np.flatnonzero((work.gain > _VISIBLE).any(axis=1) & ~work.dropped)
    for piece in work.made:
        splats = joined(splats, piece)
    return Filling(
        removed=np.flatnonzero(chosen),
        unseen=rows[work.dropped],
        splats=splats,
        labels=np.concatenate([np.zeros(0, np.int32), *work.groups]),
        stained=rows[stained],
        gains=work.gain[stained].astype(np.float32),
        lighten=settings.lighten,
        is_refused=work.is_refused,
        model=inpainter.name if inpainter is not None and len(splats) else "",
    )


_MOVED = 1e-6  # relative: less is rounding of composed motions
_AWAY = 0.5  # of the diagonal of an object: what was moved farther left the place that it hid


def _hides_nothing(scene: Scene, rows: LongArray, is_object: BoolArray) -> BoolArray:
    """Which splats ``rows`` (K,) of the object were put where they are by a person: copies, what
    was added, and what was moved away. Photos show what is behind them."""
    result = is_object & (rows >= scene.n_opened)
    left = np.flatnonzero(is_object & ~result)
    own = rows[left].astype(np.int32)
    now, world = world_means(scene, own).astype(np.float64), scene.frame.world
    home = turned(scene.gaussians.means[own].astype(np.float64), world[:3, :3]) + world[:3, 3]
    for placement in np.unique(scene.placement[own]):
        part = scene.placement[own] == placement
        way = np.linalg.norm(now[part].mean(axis=0) - home[part].mean(axis=0))
        result[left[part]] = way > _AWAY * np.linalg.norm(np.ptp(now[part], axis=0))
    return result


def _put_there(scene: Scene, rows: LongArray) -> tuple[BoolArray, BoolArray]:
    """Which splats ``rows`` (K,) a person put where they are, copies and what was moved or added,
    and which ones an edit made. That no photo showed them there tells nothing."""
    made, source = np.zeros(len(rows), np.bool_), scene.source[rows]
    for item in scene.added:
        if item.is_made:
            made |= (source >= item.first) & (source < item.first + item.n)
    world = scene.frame.world[:3]
    off = np.abs(scene.placements.matrix - world).max(axis=(1, 2))
    moved = off > _MOVED * np.abs(world).max()
    return ((rows >= scene.n_opened) | moved[scene.placement[rows]]) & ~made, made


def _apart(
    points: DoubleArray, is_object: BoolArray, labels: IntArray, reach: float
) -> list[BoolArray]:
    """The object's splats (N,) in parts that do not touch one another's surroundings."""
    boxes: list[tuple[DoubleArray, DoubleArray, BoolArray]] = []
    for label in np.unique(labels[is_object]):
        part = is_object & (labels == label)
        lo, hi = points[part].min(axis=0), points[part].max(axis=0)
        margin = reach * float((hi - lo).max())
        lo, hi = lo - margin, hi + margin
        while True:
            near = [k for k, box in enumerate(boxes) if ((box[0] < hi) & (lo < box[1])).all()]
            if not near:
                break
            for k in reversed(near):
                other = boxes.pop(k)
                lo, hi = np.minimum(lo, other[0]), np.maximum(hi, other[1])
                part = part | other[2]
        boxes.append((lo, hi, part))
    return [part for _, _, part in boxes]


# --- The edit that removes an object and fills what it hid.


# Levels of lightening, at most: each takes one row of the table of placements. 16 of brightness
# alone gave dark red splats the factors of grey ones.
_LEVELS = 128
_STEP = 0.1  # log of a factor of a channel between two levels, 10 %; larger where there were more


def filled_edit(scene: Scene, found: Filling, title: str) -> Edit | None:
    """Delete the object with what it hid, lighten its shadow, and add the new splats.

    ``scene``: as it was when ``found`` was computed.
    """
    if found.model:
        title = f"{title}, colors by {found.model}"
    scratch = replace(scene, revision=Revision())
    parts: list[Edit] = []

    def add(edit: Edit | None) -> None:
        if edit is not None:
            edit.apply(scratch)
            parts.append(edit)

    add(delete(scratch, np.concatenate([found.removed, found.unseen]), title))
    if len(found.stained):  # splats that are lightened alike
        log, step, n = np.log(np.nan_to_num(found.gains.astype(np.float64), nan=1.0)), _STEP, 0
        while not 0 < n <= _LEVELS:
            steps, level = np.unique(np.rint(log / step), axis=0, return_inverse=True)
            n, step, level = len(steps), 2 * step, level.ravel()
        for k in range(n):
            factors = np.diag(np.exp(log[level == k].mean(axis=0)))
            affine = np.column_stack([factors, np.zeros(3)])
            add(recolor(scratch, found.stained[level == k], affine, title="Lighten the shadow"))
    add(append_made(scratch, found.splats, found.labels, title, State(0)))
    return together(title, parts)
