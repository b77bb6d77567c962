"""A surface as a picture in its own plane, and colors continued into its holes."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, LongArray
from gaga_core.camera import Camera
from gaga_core.color import LUMA, rgb_from_dc
from gaga_core.fill.surfaces import FillConfig, Plane, SeenView
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Rasterizer

# --- Continue values smoothly into cells where they are not known.


_WEAK = 1e-6  # pull to the mean: decides where nothing known is next to the cells


def continued(values: DoubleArray, known: BoolArray, wanted: BoolArray) -> DoubleArray:
    """``values`` (H, W, C) with the ``wanted`` cells (H, W) between ``known`` ones.

    The harmonic (membrane) interpolation: each wanted cell is the mean of its neighbours that are
    known or wanted; others do not count, so no value comes from outside.
    """
    result = values.copy()
    n = int(wanted.sum())
    if n == 0 or not known.any():
        return result
    index = np.full(wanted.shape, -1)
    index[wanted] = np.arange(n)
    diagonal = np.full(n, _WEAK)
    right = np.tile(_WEAK * values[known].mean(axis=0), (n, 1))
    pairs = []
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        to, inside = _shifted(index, axis, step), _shifted(np.ones_like(wanted), axis, step)
        fixed = wanted & inside.astype(bool) & _shifted(known & ~wanted, axis, step).astype(bool)
        linked = wanted & inside.astype(bool) & (to >= 0)
        diagonal[index[fixed]] += 1
        neighbour = np.stack(
            [_shifted(values[:, :, c], axis, step) for c in range(values.shape[2])], 2
        )
        right[index[fixed]] += neighbour[fixed]
        diagonal[index[linked]] += 1
        pairs.append((index[linked], to[linked]))
    i = np.concatenate([a for a, _ in pairs])
    j = np.concatenate([b for _, b in pairs])
    both = np.arange(n)
    matrix = coo_matrix(
        (np.append(-np.ones(len(i)), diagonal), (np.append(i, both), np.append(j, both))),
        shape=(n, n),
    ).tocsc()
    result[wanted] = splu(matrix).solve(right)
    return result


def _shifted(values: AnyArray, axis: int, step: int) -> AnyArray:
    """The values of each cell's neighbour; at the border False or -1 (what a zero or index is)."""
    moved = np.roll(values, -step, axis)
    edge = [slice(None)] * values.ndim
    edge[axis] = slice(-1, None) if step > 0 else slice(0, 1)
    moved[tuple(edge)] = -1 if values.dtype.kind == "i" else 0
    return moved


def blurred(values: DoubleArray, weights: DoubleArray, sigma: float) -> DoubleArray:
    """Mean of ``values`` (H, W, C) around each cell, weighted by ``weights`` (H, W)."""
    below = np.maximum(ndimage.gaussian_filter(weights, sigma), 1e-9)
    channels = (values[:, :, c] * weights for c in range(values.shape[2]))
    return np.stack([ndimage.gaussian_filter(c, sigma) / below for c in channels], axis=2)


def smooth_base(color: DoubleArray, known: BoolArray, hole: BoolArray, sigma: float) -> DoubleArray:
    """What the color (H, W, C) is without its texture, in known cells and in the hole.

    A linear trend fitted around the hole (light falls off over a surface), and the membrane of
    what is left of it.
    """
    rows, columns = np.indices(known.shape)
    distance = ndimage.distance_transform_edt(~hole) if hole.any() else np.ones(known.shape)
    reach = 2 + np.sqrt(hole.sum())
    weight = known * np.exp(-((distance / reach) ** 2))
    slopes = ((places - places.mean()) / places.max() for places in (rows, columns))
    terms = np.stack([np.ones(known.shape), *slopes], axis=2)
    root = np.sqrt(weight[known])[:, None]
    trend_weights = np.linalg.lstsq(root * terms[known], root * color[known], rcond=None)[0]
    trend = terms @ trend_weights
    left = np.where(known[:, :, None], color - trend, 0)
    low = blurred(left, known.astype(float), sigma)
    return trend + continued(low, known, hole)


# --- A surface as a picture in its own plane: which cells are known, and which are a hole.


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
        return np.stack(found, axis=1).reshape(len(local), *values.shape[2:])


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
    return asked & (own < (1 - _GAP) * usual)[:, :, 0]


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
    return result | (gaps & ndimage.binary_dilation(result, iterations=_RIM))


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


# --- Continue a texture into a hole by copies of small pieces of what is around it.
# Exemplar-based inpainting (Criminisi, Perez & Toyama 2004): pieces on the rim of the hole are
# filled first where most around them is known, each with the piece of the known part that fits
# best there.


_TRIAL = 0.28  # sizes of the hole: radius of one that is cut to compare styles
_N_TRIALS = 3
_USUAL = 0.9  # factor of the error of the first style: the other one must be clearly better
_MOST_PIECES = 6000  # known pieces that are compared


@dataclass(frozen=True)
class Style:
    """How a surface is continued: what is coarser than ``base`` smoothly, the rest by pieces."""

    base: float  # cells; 0: all by pieces
    half: int  # cells from the middle of a piece to its side


# Noise and grain; stripes and checks; the edge between two materials.
STYLES = (Style(3.0, 4), Style(12.0, 7), Style(0.0, 8))
# Places where styles are tried are like the surroundings of the hole: in deviations of the
# brightness there, the least deviation and the largest difference, and next to it, in radii of
# the trial. Chosen on the demo's teapot.
_AS_VARIED, _AS_BRIGHT, _AS_NEAR = 0.8, 1.0, 4.0


def continued_color(color: DoubleArray, known: BoolArray, hole: BoolArray) -> DoubleArray:
    """``color`` (H, W, C) with the ``hole`` (H, W) filled, in the style that does best elsewhere.

    Styles are compared on smaller holes that are cut into the known part.
    """
    trials = _trials(color @ LUMA if color.shape[2] == len(LUMA) else color[:, :, 0], known, hole)
    errors = [0.0] * len(STYLES)
    for trial in trials:
        for k, style in enumerate(STYLES):
            wrong = _in_style(style, color, known & ~trial, trial) - color
            errors[k] += float((wrong[trial] ** 2).mean())
    errors[0] *= _USUAL
    return _in_style(STYLES[int(np.argmin(errors))], color, known, hole)


def _in_style(style: Style, color: DoubleArray, known: BoolArray, hole: BoolArray) -> DoubleArray:
    if style.base:
        base = smooth_base(color, known, hole, style.base)
    else:
        base = np.broadcast_to(color[known].mean(axis=0), color.shape)
    detail = synthesized(color - base, known, hole, style.half)
    return np.where(hole[:, :, None], base + detail, color)


def _trials(luma: DoubleArray, known: BoolArray, hole: BoolArray) -> list[BoolArray]:
    """Discs (H, W) of known cells, far from each other, as large as fit, up to the hole's half.

    Where the surface is as bright and as varied as around the hole, if there are such places.
    """
    radius = _TRIAL * np.sqrt(hole.sum())
    room = ndimage.distance_transform_edt(np.pad(known, 1))[1:-1, 1:-1]
    around = known & ndimage.binary_dilation(hole, iterations=max(round(radius), 1))
    if around.any():
        weights = known.astype(float)
        both = np.stack([luma, luma**2], axis=2)
        mean, square = blurred(both, weights, radius).transpose(2, 0, 1)
        spread = luma[around].std()
        alike = np.sqrt(np.maximum(square - mean**2, 0)) >= _AS_VARIED * spread
        alike &= np.abs(mean - luma[around].mean()) <= _AS_BRIGHT * spread
        alike &= ndimage.distance_transform_edt(~hole) <= _AS_NEAR * radius
        if (room[alike] >= min(radius, 3)).any():
            room = np.where(alike, room, 0.0)
    rows, columns = np.indices(known.shape)
    found: list[BoolArray] = []
    for _ in range(_N_TRIALS):
        row, column = np.unravel_index(np.argmax(np.minimum(room, radius)), known.shape)
        away = np.hypot(rows - row, columns - column)
        size = min(radius, 0.8 * float(room[row, column]))
        if size < 3:
            break
        found.append(known & (away < size))
        room = np.where(away < 2 * radius, 0.0, room)
    return found


def synthesized(texture: DoubleArray, known: BoolArray, hole: BoolArray, half: int) -> DoubleArray:
    """``texture`` (H, W, C) with the cells of ``hole`` (H, W) filled; zero where nothing fits.

    ``half``: cells from the middle of a copied piece to its side.
    """
    side = 2 * half + 1
    result, filled, left = texture.copy(), known & ~hole, hole.copy()
    result[~filled] = 0
    if min(known.shape) < side:
        return result
    whole = sliding_window_view(filled, (side, side)).all(axis=(2, 3))
    places = np.argwhere(whole)
    if len(places) == 0:
        return result
    places = places[:: max(1, len(places) // _MOST_PIECES)]
    windows = sliding_window_view(texture, (side, side), axis=(0, 1))  # (h, w, C, side, side)
    pieces = windows[places[:, 0], places[:, 1]].transpose(0, 2, 3, 1).reshape(len(places), -1)
    squares = pieces**2
    share = ndimage.uniform_filter(filled.astype(float), side)
    while left.any():
        rim = left & ndimage.binary_dilation(filled)
        if not rim.any():
            break
        at = np.argmax(np.where(rim, share, -1))
        row, column = np.unravel_index(at, left.shape)
        top = int(np.clip(row - half, 0, left.shape[0] - side))
        start = int(np.clip(column - half, 0, left.shape[1] - side))
        window = (slice(top, top + side), slice(start, start + side))
        mask = filled[window]
        weights = np.repeat(mask.ravel(), texture.shape[2]).astype(float)
        target = result[window].ravel() * weights
        cost = squares @ weights - 2 * (pieces @ target)
        best = pieces[np.argmin(cost)].reshape(side, side, -1)
        fresh = left[window]
        result[window][fresh] = best[fresh]
        filled[window] |= fresh
        left[window] = False
        around = (
            slice(max(0, top - side), top + 2 * side),
            slice(max(0, start - side), start + 2 * side),
        )
        share[around] = ndimage.uniform_filter(filled[around].astype(float), side)
    return result
