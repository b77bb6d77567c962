"""A surface as a picture in its own plane: which cells are known, and which are a hole."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, LongArray
from gaga_core.camera import Camera
from gaga_core.color import LUMA, rgb_from_dc
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.fill.config import FillConfig
from gaga_core.scene.fill.smooth import blurred, continued
from gaga_core.scene.fill.surfaces import Plane
from gaga_core.scene.fill.views import SeenView

_FAR = 60.0  # sides of the chart: how far away its camera stands, so that it sees all from above
_COVERED = 0.5  # alpha from which on a cell is surface
OPAQUE = 0.9  # alpha from which on nothing is missing
_DOUBT = 0.2  # of the views that show the object there: so few may err at its outline
_OPENED = 0.5  # of these: so many must see deeper when it is gone
_RIM = 2  # cells at the edge of a hole that the splats around it half cover
_SELDOM = 0.25  # of the views in which the object hides a cell: seen by fewer, it is made again
_GAP = 0.1  # share of light that a gap under the object lacks
_WIDE, _NARROW = 3.0, 1.0  # cells over which the light around a gap and in it is averaged
_CLOSE = 6  # cells between parts of one hole
_FLAT = 0.12  # sine of the angle to the surface under which a view says nothing
_LEAST_CELLS = 6  # of a hole
_ENCLOSED = 0.5  # share of a hole's rim that is known surface
_CELLS_A_SPLAT = 2.0  # across


@dataclass(frozen=True, eq=False)
class Chart:
    """Cells (H, W) over a plane; row 0 is at the largest v, column 0 at the smallest u."""

    plane: Plane
    corner: DoubleArray  # (2,) u and v of the outer corner of cell (0, 0)
    step: float  # side of a cell, scene units
    color: DoubleArray  # (H, W, 3) where known
    height: DoubleArray  # (H, W) of the surface over the plane, where known
    known: BoolArray  # (H, W) seen surface
    hole: BoolArray  # (H, W) surface that the object hid from all views
    again: BoolArray  # (H, W) cells of the hole that photos showed

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.known.shape
        return rows, columns

    def uv(self) -> DoubleArray:
        """Centres of all cells (H, W, 2), plane coordinates."""
        rows, columns = self.shape
        u = self.corner[0] + self.step * (np.arange(columns) + 0.5)
        v = self.corner[1] - self.step * (np.arange(rows) + 0.5)
        return np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=2)

    def cells(self, local: DoubleArray) -> tuple[LongArray, LongArray, BoolArray]:
        """Row and column of plane coordinates (N, 2 or 3), clipped, and whether inside."""
        column = np.floor((local[:, 0] - self.corner[0]) / self.step).astype(np.int64)
        row = np.floor((self.corner[1] - local[:, 1]) / self.step).astype(np.int64)
        rows, columns = self.shape
        inside: BoolArray = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1), inside

    def at(self, values: DoubleArray, local: DoubleArray) -> DoubleArray:
        """``values`` (H, W) or (H, W, C) between cells at plane coordinates (N, 2 or 3)."""
        column = (local[:, 0] - self.corner[0]) / self.step - 0.5
        row = (self.corner[1] - local[:, 1]) / self.step - 0.5
        planes = values.reshape(*self.shape, -1)
        found = [
            ndimage.map_coordinates(planes[:, :, c], [row, column], order=1, mode="nearest")
            for c in range(planes.shape[2])
        ]
        result: DoubleArray = np.stack(found, axis=1).reshape(len(local), *values.shape[2:])
        return result


def chart_of(
    gaussians: Gaussians,
    plane: Plane,
    object_points: DoubleArray,
    views: tuple[SeenView, ...],
    rasterizer: Rasterizer,
    config: FillConfig,
) -> Chart:
    """The surface around and under an object whose splats are at ``object_points`` (K, 3)."""
    local = plane.local(object_points)[:, :2]
    lo, hi = np.percentile(local, 1, axis=0), np.percentile(local, 99, axis=0)
    margin = max(config.reach * float((hi - lo).max()), 10 * plane.spacing)
    lo, hi = lo - margin, hi + margin
    side = float((hi - lo).max())
    step = max(plane.spacing / _CELLS_A_SPLAT, side / config.most_cells)
    columns, rows = (int(n) for n in np.ceil((hi - lo) / step))
    corner = np.array([lo[0], hi[1]])
    color, height, alpha = drawn(
        gaussians.take(plane.splats), plane, corner, step, (rows, columns), rasterizer
    )
    known = alpha > _COVERED
    empty = np.zeros((rows, columns), np.bool_)
    chart = Chart(plane, corner, step, color, np.where(known, height, 0), known, empty, empty)
    return _with_hole(chart, alpha, views)


def drawn(
    gaussians: Gaussians,
    plane: Plane,
    corner: DoubleArray,
    step: float,
    shape: tuple[int, int],
    rasterizer: Rasterizer,
) -> tuple[DoubleArray, DoubleArray, DoubleArray]:
    """Color (H, W, 3), height (H, W) and alpha (H, W) of splats seen from straight above.

    Colors are those of degree 0, divided by alpha.
    """
    rows, columns = shape
    distance = _FAR * step * max(shape)
    K = np.array([[distance / step, 0, columns / 2], [0, distance / step, rows / 2], [0, 0, 1.0]])
    u, v, normal = plane.axes.T
    middle = np.array([corner[0] + step * columns / 2, corner[1] - step * rows / 2, distance])
    eye = plane.world(middle[None])[0]
    pose = np.eye(4)
    pose[:3, :3] = np.stack([u, -v, -normal])
    pose[:3, 3] = -pose[:3, :3] @ eye
    camera = Camera(K, pose, columns, rows)
    rgb = np.ascontiguousarray(rgb_from_dc(gaussians.sh[:, 0]))
    frame = rasterizer.render(gaussians, camera, channels=rgb)
    alpha = frame.alpha.astype(np.float64)
    safe = np.maximum(alpha, 1e-6)[:, :, None]
    height = np.where(alpha > 0, distance - frame.expected_depth, 0.0)
    return frame.image / safe, height, alpha


def tolerance_of(chart: Chart) -> float:
    """Heights over the surface up to which something lies on it, scene units."""
    return max(1.5 * chart.step, 4 * chart.plane.thickness)


def _with_hole(chart: Chart, alpha: DoubleArray, views: tuple[SeenView, ...]) -> Chart:
    """Find the hole: cells behind the object that no view saw or looked through.

    ``alpha``: (H, W) of the surface's splats from straight above.
    """
    plane, known = chart.plane, chart.known
    reached = ndimage.gaussian_filter(known.astype(float), 4.0)
    guess = ndimage.gaussian_filter(np.where(known, chart.height, 0), 4.0) / np.maximum(
        reached, 1e-3
    )
    height = np.where(known, chart.height, guess)
    points = plane.world(np.dstack([chart.uv(), height]).reshape(-1, 3))
    tolerance = tolerance_of(chart)
    behind = np.zeros(len(points), np.int32)
    through, seen, gone, full = (np.zeros_like(behind) for _ in range(4))
    for view in views:
        at, inside = _pixels_of(view, points, plane)
        above = above_surface(view.camera, view.depth[at], points, plane)
        on_it = inside & (above > tolerance) & view.is_object[at]
        behind += on_it
        through += inside & (above < -tolerance)
        seen += inside & (np.abs(above) <= tolerance) & ~view.is_object[at]
        left = above_surface(view.camera, view.after[at], points, plane)
        gone += on_it & (left < -tolerance)
        full += on_it & (np.abs(left) <= tolerance) & (view.after_alpha[at] >= OPAQUE)
    # What a view looked through is no surface; what it saw and is not known here is another one,
    # but for the rim: splats half under the object are not known.
    other = (seen > _DOUBT * behind).reshape(chart.shape)
    other &= ~ndimage.binary_dilation(known, iterations=_RIM + 1)
    free = (through > np.maximum(seen, _DOUBT * behind)).reshape(chart.shape)
    free = (free | other) & ~known
    # A hole is where most views that the object hid it from see deeper without the object.
    opened = (gone > _OPENED * behind).reshape(chart.shape) & (behind > 0).reshape(chart.shape)
    hidden = (behind > 0).reshape(chart.shape) & ~known & ~free
    wanted = ndimage.binary_dilation(opened & hidden, iterations=_RIM, mask=hidden)
    surface = continued(known.astype(float)[:, :, None], known | free, wanted)[:, :, 0] > 0.5
    # Where what is left is opaque, from above or in those views, new splats would lie over it.
    covered = known & (alpha >= OPAQUE)
    covered |= ((full > _OPENED * behind) & (behind > 0)).reshape(chart.shape)
    surely = known | covered
    hole = _enclosed(wanted & surface & ~covered, surely)
    # What is next to it was seen by few views, and stood in the object's shadow: it is made again.
    rim = (behind > 0).reshape(chart.shape) & known & ~covered
    hole |= ndimage.binary_dilation(hole, iterations=_RIM, mask=rim | hole)
    seldom = (seen < _SELDOM * behind).reshape(chart.shape)
    hole = _whole(hole, known, darker(chart.color, known, known & (seldom | hole)))
    return replace(chart, hole=hole, known=known & ~hole, again=known & hole)


def darker(color: DoubleArray, known: BoolArray, asked: BoolArray) -> BoolArray:
    """Which of the cells ``asked`` (H, W) are darker than the other ``known`` ones (H, W) there.

    What photos showed well stays as it is.
    """
    sure = known & ~asked
    if not sure.any():
        return asked
    luma = (color @ LUMA)[:, :, None]
    usual = continued(blurred(luma, sure.astype(float), _WIDE), sure, asked)
    own = blurred(luma, known.astype(float), _NARROW)
    result: BoolArray = asked & (own < (1 - _GAP) * usual)[:, :, 0]
    return result


def _whole(hole: BoolArray, known: BoolArray, gap: BoolArray) -> BoolArray:
    """The hole (H, W) with the places in it that show the dark of a gap.

    ``gap``: (H, W) known cells that few of the views that look there saw, and saw dark.
    """
    if not hole.any():
        return hole
    inside = ndimage.binary_closing(np.pad(hole, _CLOSE), iterations=_CLOSE)
    inside = ndimage.binary_fill_holes(inside)[_CLOSE:-_CLOSE, _CLOSE:-_CLOSE]
    result = hole | (inside & gap)
    result = ndimage.binary_dilation(result, iterations=_CLOSE, mask=result | gap)
    # Cells between it and the known surface, of which no view could tell.
    gaps = ndimage.binary_closing(np.pad(result | known, _RIM), iterations=_RIM)
    gaps = gaps[_RIM:-_RIM, _RIM:-_RIM] & ~known
    whole: BoolArray = result | (gaps & ndimage.binary_dilation(result, iterations=_RIM))
    return whole


def _enclosed(hole: BoolArray, known: BoolArray) -> BoolArray:
    """The parts of ``hole`` (H, W) that are no specks and are mostly surrounded by ``known``."""
    parts, n = ndimage.label(hole, structure=np.ones((3, 3)))
    kept = np.zeros(n + 1, np.bool_)
    for i in range(1, n + 1):
        part = parts == i
        rim = ndimage.binary_dilation(part) & ~part
        kept[i] = part.sum() >= _LEAST_CELLS and known[rim].mean() > _ENCLOSED
    return kept[parts]


def _pixels_of(
    view: SeenView, points: DoubleArray, plane: Plane
) -> tuple[tuple[LongArray, LongArray], BoolArray]:
    """Rows and columns of the pixels at ``points`` (N, 3), and whether these say anything (N,)."""
    camera = view.camera
    pixels, depth = camera.project(points)
    column, row = np.floor(pixels[:, 0]), np.floor(pixels[:, 1])
    inside = (depth > 0) & (column >= 0) & (row >= 0)
    inside &= (column < camera.width) & (row < camera.height)
    # Views from below the surface say nothing of its upper side, and flat ones cannot tell heights.
    eyes = camera.position - points
    inside &= eyes @ plane.axes[:, 2] > _FLAT * np.linalg.norm(eyes, axis=1)
    at = np.where(inside, row, 0).astype(np.int64), np.where(inside, column, 0).astype(np.int64)
    return at, inside


def above_surface(
    camera: Camera, seen: FloatArray, points: DoubleArray, plane: Plane
) -> DoubleArray:
    """How far (N,) the surface of depth ``seen`` (N,) at each of ``points`` (N, 3) lies above it.

    Along the plane's normal; -inf where there is no surface.
    """
    depth = points @ camera.cam_from_world[2, :3] + camera.cam_from_world[2, 3]
    share = seen.astype(np.float64) / np.where(depth > 0, depth, 1.0)  # 1: it is at the point
    rise = (camera.position - points) @ plane.axes[:, 2]
    return np.where(seen > 0, (1 - share) * rise, -np.inf)
