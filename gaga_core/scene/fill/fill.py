"""Find what a removed object hid, and make the splats and colors that fill it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
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
from gaga_core.scene.fill.chart import Chart, chart_of
from gaga_core.scene.fill.check import accepted
from gaga_core.scene.fill.config import FillConfig
from gaga_core.scene.fill.smooth import smooth_base
from gaga_core.scene.fill.splats import new_splats
from gaga_core.scene.fill.stains import gains
from gaga_core.scene.fill.surfaces import surfaces_around
from gaga_core.scene.fill.texture import synthesized
from gaga_core.scene.fill.views import Seen, seen_stage
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.objects import group_name
from gaga_core.scene.scene import Scene, State

_STAGE = "Fill the hole"
_RIM_SPLAT = 0.8  # spacings: largest deviation of a seen splat that is made again
_VISIBLE = 1.02  # factor of a color from which on it is changed
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

    def __bool__(self) -> bool:
        return len(self.splats) > 0 or len(self.stained) > 0


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
    Without cameras that show the object, views from all around it are taken.
    """
    settings = FillConfig() if config is None else config
    chosen = np.zeros(len(scene), np.bool_)
    chosen[sorted_indices(indices, len(scene))] = True
    rows = np.flatnonzero(scene.visible | chosen)
    labels = scene.labels[rows]
    gaussians = yield from bake_stage(scene, indices=rows)
    is_object = chosen[rows]
    seen = yield from seen_stage(gaussians, is_object, cameras, rasterizer, settings)
    work = _Work(gaussians, labels, is_object, seen, rasterizer, settings)
    parts = _apart(gaussians.means.astype(np.float64), is_object, labels, settings.reach)
    for i, part in enumerate(parts):
        yield Progress(_STAGE, i, len(parts))
        work.fill(part)
    work.dropped &= (scene.state[rows] & np.uint8(State.LOCKED)) == 0
    stained = np.flatnonzero((work.gain > _VISIBLE).any(axis=1) & ~work.dropped)
    splats = gaussians.take(np.zeros(0, np.int64))
    for piece in work.made:
        splats = joined(splats, piece)
    return Filling(
        removed=rows[is_object],
        unseen=rows[work.dropped],
        splats=splats,
        labels=np.concatenate([np.zeros(0, np.int32), *work.groups]),
        stained=rows[stained],
        gains=work.gain[stained].astype(np.float32),
        lighten=settings.lighten,
    )


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
        self.is_known = seen.weight > config.seen
        self.points = gaussians.means.astype(np.float64)
        self.made: list[Gaussians] = []
        self.groups: list[IntArray] = []
        self.gain = np.ones((len(gaussians), 3))
        self.dropped = np.zeros(len(gaussians), np.bool_)

    def fill(self, part: BoolArray) -> None:
        """Fill behind the splats ``part`` (N,) of the object, surface by surface."""
        own = self.points[part]
        hidden = ~self.is_object & ~self.is_known
        usable = self.is_known & ~self.is_object
        n_filled = 0
        for plane in surfaces_around(self.gaussians, self.labels, part, usable, self.config):
            chart = chart_of(
                self.gaussians, plane, own, self.seen.views, self.rasterizer, self.config
            )
            if not chart.hole.any():
                continue
            # Seen splats at its rim are made again too, but for large ones: they reach far beyond.
            small = self.gaussians.scales.max(axis=1) < _RIM_SPLAT * plane.spacing
            goes = (hidden | (small & ~self.is_object)) & _under(chart, self.points)
            goes |= hidden & _inside(own, self.points)
            n_filled += self._fill_chart(chart, goes)
            if n_filled == self.config.most_surfaces:
                return

    def _fill_chart(self, chart: Chart, goes: BoolArray) -> bool:
        """Fill a chart's hole, without the splats ``goes`` (N,); False when it does harm."""
        plane = chart.plane
        chart, factors = _lightened(chart, self.config)
        color, height = _continued(chart)
        fresh = new_splats(self.gaussians, chart, color, height, self.rasterizer, self.config.seed)
        # What no photo showed is no surface to compare with.
        left = np.flatnonzero(~self.is_object & ~self.dropped & (self.is_known | ~goes))
        near = np.ones((len(self.gaussians), 3))
        near[plane.splats] = chart.at(factors, plane.local(self.points[plane.splats]))
        gain = np.maximum(self.gain, near)
        rest = _lit(self.gaussians, gain).take(left)
        kept = accepted(rest, fresh, goes[left], chart, self.seen.views, self.rasterizer)
        if not kept.any():
            return False
        fresh = fresh.take(np.flatnonzero(kept))
        self.dropped |= goes
        self.gain = gain
        self.made.append(fresh)
        self.groups.append(np.full(len(fresh), plane.label, np.int32))
        return True


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


def _lightened(chart: Chart, config: FillConfig) -> tuple[Chart, DoubleArray]:
    """The chart without the stain, and the factors (H, W, 3) that take it off."""
    if not config.lighten:
        return chart, np.ones((*chart.shape, 3))
    factors = gains(chart)
    return replace(chart, color=chart.color * factors), factors


def _lit(gaussians: Gaussians, gain: DoubleArray) -> Gaussians:
    """The splats with their colors times ``gain`` (N, 3)."""
    sh = gaussians.sh * gain[:, None].astype(np.float32)
    sh[:, 0] = dc_from_rgb((rgb_from_dc(gaussians.sh[:, 0]) * gain).astype(np.float32))
    return replace(gaussians, sh=sh)


def _continued(chart: Chart) -> tuple[DoubleArray, DoubleArray]:
    """Color (H, W, 3) and height (H, W) with the hole filled."""
    base = smooth_base(chart.color, chart.known, chart.hole, _BASE)
    detail = synthesized(chart.color - base, chart.known, chart.hole)
    color = np.where(chart.hole[:, :, None], base + detail, chart.color)
    height = smooth_base(chart.height[:, :, None], chart.known, chart.hole, _BASE)[:, :, 0]
    return np.clip(color, 0, 1.5), np.where(chart.hole, height, chart.height)


def _under(chart: Chart, points: DoubleArray) -> BoolArray:
    """Splats at ``points`` (N, 3) that lie in the hole's place (N,)."""
    local = chart.plane.local(points)
    row, column, inside = chart.cells(local)
    near = np.abs(local[:, 2]) < max(chart.step, 4 * chart.plane.thickness)
    result: BoolArray = inside & near & chart.hole[row, column]
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
