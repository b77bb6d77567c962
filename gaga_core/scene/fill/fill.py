"""Find what a removed object hid, and make the splats and colors that fill it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.color import dc_from_rgb, rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.edits.append_values import joined
from gaga_core.scene.fill.chart import Chart, chart_of, tolerance_of
from gaga_core.scene.fill.check import accepted
from gaga_core.scene.fill.config import FillConfig
from gaga_core.scene.fill.inpaint import Inpainter
from gaga_core.scene.fill.smooth import smooth_base
from gaga_core.scene.fill.splats import new_splats
from gaga_core.scene.fill.stains import gains, splat_gains, taken_cells
from gaga_core.scene.fill.surfaces import surfaces_around
from gaga_core.scene.fill.texture import continued_color
from gaga_core.scene.fill.views import Seen, seen_stage
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.objects import group_name
from gaga_core.scene.scene import Scene, State

_STAGE = "Fill the hole"
_RIM_SPLAT = 0.8  # spacings: largest deviation of a seen splat that is made again
_VISIBLE = 1.02  # factor of a color from which on it is changed
_THING = 3.0  # sizes of the object: what is larger is no thing that stands on the surface
_BASE = 3.0  # cells: what is finer is texture


@dataclass(frozen=True, eq=False)
class Filling:
    """What filling changes. Nothing is changed yet."""

    removed: LongArray  # (R,) rows of the object
    unseen: LongArray  # (U,) rows that no view ever saw and that the object hid
    splats: Gaussians  # (F,) new, world
    labels: IntArray  # (F,) their groups: those of the surfaces that they continue
    stained: LongArray  # (S,) rows to be lightened
    gains: FloatArray  # (S, 3) by these factors
    lighten: bool  # whether stains were looked for
    is_refused: bool  # a hole was found and left open: its filling hardly shows, or does harm
    model: str = ""  # name of the inpainting model's file; "" = colors continue the surroundings

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
    """What the edit is called in the history."""
    if scene.has(State.DELETED)[indices].all():
        return "Fill what was deleted"
    groups = np.unique(scene.labels[indices])
    if len(groups) == 1 and groups[0]:
        return f"Delete and fill {group_name(scene, int(groups[0]))}"
    return "Delete and fill"


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
    if not settings.model:
        return (yield from _filled(scene, indices, cameras, rasterizer, settings, None))
    with Inpainter(Path(settings.model), settings.model_sha256) as model:
        yield from model.loaded_stage()
        return (yield from _filled(scene, indices, cameras, rasterizer, settings, model))


def _filled(
    scene: Scene,
    indices: AnyArray,
    cameras: Sequence[Camera],
    rasterizer: Rasterizer,
    settings: FillConfig,
    inpainter: Inpainter | None,
) -> Stage[Filling]:
    """`fill_stage`; ``inpainter`` colors what is filled, None: the surroundings do."""
    chosen = np.zeros(len(scene), np.bool_)
    chosen[sorted_indices(indices, len(scene))] = True
    # What has no place in space is never drawn: it hides nothing.
    is_there = np.isfinite(scene.gaussians.means).all(axis=1)
    rows = np.flatnonzero((scene.visible | chosen) & is_there)
    labels = scene.labels[rows]
    gaussians = yield from bake_stage(scene, indices=rows)
    is_object = chosen[rows]
    if not is_object.any():
        return _nothing(np.flatnonzero(chosen), gaussians, settings)
    made = _made(scene)[rows] & ~is_object
    seen = yield from seen_stage(gaussians, is_object, cameras, rasterizer, settings, made)
    work = _Work(gaussians, labels, is_object, seen, rasterizer, settings)
    work.inpainter = inpainter
    work.locked |= (scene.state[rows] & np.uint8(State.LOCKED)) != 0
    parts = _apart(gaussians.means.astype(np.float64), is_object, labels, settings.reach)
    for i, part in enumerate(parts):
        yield Progress(_STAGE, i, len(parts))
        yield from work.fill(part)
    stained = np.flatnonzero((work.gain > _VISIBLE).any(axis=1) & ~work.dropped)
    splats = gaussians.take(np.zeros(0, np.int64))
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


def _nothing(removed: LongArray, gaussians: Gaussians, config: FillConfig) -> Filling:
    """The removal alone, of rows (R,)."""
    none = np.zeros(0, np.int64)
    splats, labels = gaussians.take(none), np.zeros(0, np.int32)
    gain = np.zeros((0, 3), np.float32)
    return Filling(removed, none, splats, labels, none, gain, config.lighten, is_refused=False)


def _made(scene: Scene) -> BoolArray:
    """Splats (N,) of the scene that an edit made, an earlier filling for example."""
    result = np.zeros(len(scene), np.bool_)
    for item in scene.added:
        if item.is_made:
            result |= (scene.source >= item.first) & (scene.source < item.first + item.n)
    return result


class _Work:
    """What is found, part by part of the object."""

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
        # Other things that the photos showed.
        self.is_thing = ~is_object & self.is_known & (sizes < _THING * self.size)
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
        hidden = ~self.is_object & ~self.is_known
        usable = self.is_known & ~self.is_object
        charts = [
            chart_of(self.gaussians, plane, own, self.seen.views, self.rasterizer, self.config)
            for plane in surfaces_around(self.gaussians, self.labels, part, usable, self.config)
        ]
        within = hidden & ~self.locked & _inside(own, self.points)
        for chart in charts:  # what lies on a surface is not in the object
            within &= ~_on_surface(chart, self.points)
        self.dropped |= within  # whether there is a hole or not: nothing is in an object's body
        n_filled = 0
        for chart in charts:
            if not chart.hole.any():
                continue
            plane = chart.plane
            # Seen splats at its rim are made again too, but for large ones: they reach far beyond.
            small = self.gaussians.scales.max(axis=1) < _RIM_SPLAT * plane.spacing
            goes = (hidden | (small & ~self.is_object)) & _under(chart, self.points)
            goes |= within
            n_filled += yield from self._fill_chart(chart, goes & ~self.locked)
            if n_filled == self.config.most_surfaces:
                return

    def _fill_chart(self, chart: Chart, goes: BoolArray) -> Stage[bool]:
        """Fill a chart's hole, without the splats ``goes`` (N,); False when it does harm."""
        plane = chart.plane
        chart, factors = self._lightened(chart)
        surface = chart.color, chart.known, chart.hole
        if self.inpainter is None:
            color = continued_color(*surface)
        else:
            color = yield from self.inpainter.painted_stage(*surface)
        color = np.clip(color, 0, 1.5)
        height = _continued_height(chart)
        fresh = new_splats(self.gaussians, chart, color, height, self.rasterizer, self.config.seed)
        # What no photo showed is no surface to compare with.
        left = np.flatnonzero(~self.is_object & ~self.dropped & (self.is_known | ~goes))
        near = np.ones((len(self.gaussians), 3))
        rgb = rgb_from_dc(self.gaussians.sh[plane.splats, 0]).astype(np.float64)
        local = plane.local(self.points[plane.splats])
        near[plane.splats] = splat_gains(chart, factors, local, rgb)
        near[self.locked] = 1.0
        gain = np.maximum(self.gain, near)
        rest = _lit(self.gaussians, gain).take(left)
        kept = accepted(rest, fresh, goes[left], chart, self.seen.views, self.rasterizer)
        if not kept.any():
            self.is_refused = True
            return False
        fresh = fresh.take(np.flatnonzero(kept))
        self.dropped |= goes
        self.gain = gain
        self.made.append(fresh)
        self.groups.append(np.full(len(fresh), plane.label, np.int32))
        return True

    def _lightened(self, chart: Chart) -> tuple[Chart, DoubleArray]:
        """The chart without the stain, and the factors (H, W, 3) that take it off."""
        if not self.config.lighten:
            return chart, np.ones((*chart.shape, 3))
        stands = self.is_thing & (self.labels != chart.plane.label)
        factors = gains(chart, taken_cells(chart, self.points[stands], self.size))
        return replace(chart, color=chart.color * factors), factors


def _sizes(points: DoubleArray, labels: IntArray) -> DoubleArray:
    """Extent (N,) of the group of each splat."""
    result = np.zeros(len(labels))
    for label in np.unique(labels):
        own = labels == label
        low, high = np.percentile(points[own], (2, 98), axis=0)
        result[own] = np.linalg.norm(high - low)
    return result


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


def _lit(gaussians: Gaussians, gain: DoubleArray) -> Gaussians:
    """The splats with their colors times ``gain`` (N, 3)."""
    sh = gaussians.sh * gain[:, None].astype(np.float32)
    sh[:, 0] = dc_from_rgb((rgb_from_dc(gaussians.sh[:, 0]) * gain).astype(np.float32))
    return replace(gaussians, sh=sh)


def _continued_height(chart: Chart) -> DoubleArray:
    """Height (H, W) with the hole filled."""
    height = smooth_base(chart.height[:, :, None], chart.known, chart.hole, _BASE)[:, :, 0]
    result: DoubleArray = np.where(chart.hole, height, chart.height)
    return result


def _under(chart: Chart, points: DoubleArray) -> BoolArray:
    """Splats at ``points`` (N, 3) that lie in the hole's place (N,)."""
    local = chart.plane.local(points)
    row, column, inside = chart.cells(local)
    near = np.abs(local[:, 2]) < max(chart.step, 4 * chart.plane.thickness)
    result: BoolArray = inside & near & chart.hole[row, column]
    return result


def _on_surface(chart: Chart, points: DoubleArray) -> BoolArray:
    """Which of ``points`` (N, 3) lie on the chart's surface, whether photos showed it or not."""
    local = chart.plane.local(points)
    row, column, inside = chart.cells(local)
    surface = ndimage.binary_fill_holes(chart.known | chart.hole)
    near = np.abs(local[:, 2] - chart.height[row, column]) < tolerance_of(chart)
    result: BoolArray = inside & near & surface[row, column]
    return result


def _inside(own: DoubleArray, points: DoubleArray) -> BoolArray:
    """Points (N,) in the convex hull of the object's splats ``own`` (K, 3)."""
    lo, hi = np.percentile(own, 1, axis=0), np.percentile(own, 99, axis=0)
    result: BoolArray = np.all((points > lo) & (points < hi), axis=1)
    own = own[((own >= lo) & (own <= hi)).all(axis=1)]
    if len(own) < 5 or not result.any():
        return np.zeros(len(points), np.bool_)
    try:
        planes = ConvexHull(own[:: max(1, len(own) // 3000)]).equations
    except QhullError:  # flat: nothing is inside
        return np.zeros(len(points), np.bool_)
    near, slack = np.flatnonzero(result), 1e-9 * float((hi - lo).max())
    for plane in planes:  # normals look outwards
        near = near[points[near] @ plane[:3] + plane[3] <= slack]
    result[:] = False
    result[near] = True
    return result
