"""Take the shadow of a removed object off the surface that it stood on.

How much light a place lacks is the factor by which its colors, made brighter, are those that the
rest of the surface has: a maximum-likelihood estimate over factors, with the colors of the
surroundings as distribution. So a dark square of a chessboard is no shadow, and a shadow over
several squares is one.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, LongArray
from gaga_core.color import LUMA
from gaga_core.fill.chart import Chart, blurred, tolerance_of

# --- The shadow that an object casts on the surface on which it stands. Its outline is known but
# for the light: it is that of the object's own splats, moved along the surface by so much for each
# unit of height. The light whose shadow explains the brightness of the surface best is taken
# (between-class variance over all variance, Otsu 1979), and it is none when that explains little:
# dark wood, stripes and the shadows of other objects have other outlines.


_TURNS = 24  # of the light around the object
_TURN = 2 * np.pi / _TURNS
_LENGTHS = (0.25, 0.4, 0.6, 0.9, 1.3, 1.9)  # of a shadow, in heights of what casts it
_MOST_POINTS = 1500  # of the object
_CLOSE = 3  # cells between its splats
_MARGIN = _CLOSE + 1  # cells
_RING, _LEAST_RING = 0.15, 4  # around a shadow: in sizes of the hole, and cells
_LEAST_CELLS, _LEAST_SHARE = 20, 0.05  # of a shadow: cells, and areas of the hole
_NEXT, _EVERYWHERE = 0.3, 0.17  # share of variance that a shadow explains: next to it, and of all
# Of its outline, chosen on the demo's teapot (0.76 of it is darker inside; on other surfaces of
# that scene at most 0.12): cells from it, log of a step, share that must be seen and be dark.
_ACROSS, _STEP, _CROSSED, _DARK_INSIDE, _FREE = 3.0, 0.08, 0.2, 0.65, 0.99
_ONE_SIDED = 0.75  # of its depth: a shadow is not so dark on the other side, a stripe is


@dataclass(frozen=True, eq=False)
class Cast:
    """A shadow."""

    mask: BoolArray  # (H, W) where it falls
    depth: float  # log by which it is darker than what is next to it
    share: float  # of the variance next to it that it explains


def cast_shadow(
    chart: Chart, dark: DoubleArray, foot: BoolArray, own: DoubleArray, taken: BoolArray
) -> Cast | None:
    """The shadow of the splats at ``own`` (K, 3), plane coordinates; None where there is none.

    ``dark``: (H, W) log of the light that is missing, up to a constant; ``foot``: (H, W) where the
    object stands; ``taken``: (H, W) where other objects do.
    """
    free = chart.known & ~ndimage.binary_dilation(taken, iterations=2) & ~foot
    ring = round(max(_LEAST_RING, _RING * np.sqrt(foot.sum())))
    least = max(_LEAST_CELLS, _LEAST_SHARE * foot.sum())
    points = own[own[:, 2] > 0]
    points = points[:: max(1, len(points) // _MOST_POINTS)]

    def shadow(turn: float, length: float) -> Cast:
        mask = _outline(chart, points, turn, length)
        near = ndimage.binary_dilation(mask | foot, iterations=ring) & ~mask & free
        if (mask & free).sum() < least or near.sum() < _LEAST_CELLS:
            return Cast(mask, 0.0, 0.0)
        return Cast(mask, *_explained(dark[mask & free], dark[near]))

    lights = [(turn, length) for turn in np.arange(_TURNS) * _TURN for length in _LENGTHS]
    tried = [shadow(*light) for light in lights]
    turn, length = lights[int(np.argmax([one.share for one in tried]))]
    finer = [
        (turn + k * _TURN, length * f) for k in (-0.5, 0, 0.5) for f in (0.8, 0.9, 1, 1.1, 1.25)
    ]
    turn, length = max(finer, key=lambda light: shadow(*light).share)
    found, opposite = shadow(turn, length), shadow(turn + np.pi, length)
    if found.share < _NEXT or opposite.depth > _ONE_SIDED * found.depth:
        return None
    everywhere = _explained(dark[found.mask & free], dark[free & ~found.mask])[1]
    return found if everywhere > _EVERYWHERE else None


def outlined_shadow(
    chart: Chart, foot: BoolArray, own: DoubleArray, taken: BoolArray
) -> Cast | None:
    """The shadow whose outline is dark inside wherever it is crossed; None where there is none.

    Where a cloth lies on a table, these two explain most of the variance of the brightness, but at
    each place of a shadow's outline there is the same stuff on both sides. Arguments as in
    `cast_shadow`.
    """
    free = chart.known & ~ndimage.binary_dilation(taken | foot, iterations=2)
    bright = np.log(np.maximum(chart.color, _DARK)) @ LUMA
    points = own[own[:, 2] > 0]
    points = points[:: max(1, len(points) // _MOST_POINTS)]
    best: tuple[float, Cast] | None = None
    for turn in np.arange(_TURNS) * _TURN:
        for length in _LENGTHS:
            mask = _outline(chart, points, turn, length)
            steps, seen = _steps(mask | foot, bright, free)
            if seen < _CROSSED or (mask & free).sum() < _LEAST_CELLS:
                continue
            share, depth = float((steps > _STEP).mean()), float(np.median(steps))
            if share > _DARK_INSIDE and depth > _CAST[0] and (best is None or share > best[0]):
                best = share, Cast(mask, depth, share)
    return None if best is None else best[1]


def _steps(mask: BoolArray, bright: DoubleArray, free: BoolArray) -> tuple[DoubleArray, float]:
    """By how much it is darker inside of the outline of ``mask`` (K,), and the share it is of it.

    Only where both sides are ``free`` (H, W).
    """
    away = ndimage.distance_transform_edt(~mask)
    down, right = np.gradient(
        ndimage.gaussian_filter(away - ndimage.distance_transform_edt(mask), 1.0)
    )
    row, column = np.nonzero((away > 0) & (away < 2))
    length = np.hypot(down, right)[row, column] + 1e-9
    way = _ACROSS * np.stack([down[row, column], right[row, column]]) / length

    def at(values: DoubleArray, side: int) -> DoubleArray:
        places = np.stack([row, column]) + side * way
        return ndimage.map_coordinates(values, places, order=1, mode="nearest")

    both = (at(free.astype(float), 1) > _FREE) & (at(free.astype(float), -1) > _FREE)
    share = both.sum() / max(len(row), 1) if both.sum() >= _LEAST_CELLS else 0.0
    return (at(bright, 1) - at(bright, -1))[both], float(share)


def _outline(chart: Chart, points: DoubleArray, turn: float, length: float) -> BoolArray:
    """Where the shadow (H, W) of ``points`` (K, 3), plane coordinates, falls."""
    moved = points[:, :2] + length * points[:, 2:] * [np.cos(turn), np.sin(turn)]
    row, column, inside = chart.cells(moved)
    mask = _marked(chart, row[inside], column[inside])
    return _closed(mask)[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN] | mask


def _marked(chart: Chart, row: LongArray, column: LongArray) -> BoolArray:
    """Cells (H, W) of these rows and columns."""
    mask = np.zeros(chart.shape, np.bool_)
    mask[row, column] = True
    return mask


def _closed(mask: BoolArray) -> BoolArray:
    """``mask`` without gaps of some cells, `_MARGIN` cells larger on each side."""
    return ndimage.binary_closing(np.pad(mask, _MARGIN), iterations=_CLOSE)


def _explained(dark: DoubleArray, bright: DoubleArray) -> tuple[float, float]:
    """By how much the first are darker, and the share of the variance that this explains."""
    if len(dark) == 0 or len(bright) == 0:
        return 0.0, 0.0
    both = np.concatenate([dark, bright])
    depth = float(dark.mean() - bright.mean())
    between = len(dark) * len(bright) / len(both) ** 2 * max(depth, 0.0) ** 2
    return depth, between / max(float(both.var()), 1e-9)


# --- The share of light that each place lacks.


_DARK = 0.02  # color that counts as black
_BRIGHTEST = 1.3  # color at the upper end of the distribution
_BINS = 48  # of it, a channel
_UNLIKELY = 2e-6  # share of a color that the surroundings do not have
_MOST_LIGHT = 5.0  # factor: nothing is made brighter by more
_N_LEVELS = 25  # factors that are tried
_PRICE = 0.5  # log likelihood that a factor e costs: without evidence nothing is made brighter
_SPREAD = 0.2  # log by which a shadow's depth varies
_BLUR = 2.0  # cells over which the factor is the same
_TILTS = (0.0, 0.15, 0.3, 0.45, -0.15)  # how much more red a shadow lacks than blue, in its log
_STAIN_LOGS = (0.03, 0.15)  # of a factor that is a stain: at the hole, and from its size on
_FAR = 0.5  # sizes of the hole: what is farther away is its surroundings
_RIM = 0.25  # sizes of the hole, where its shadow begins
_AT_FOOT = 3.0  # cells from the hole
_ONE_PIECE = 0.6  # share of the outline that lacks light without a break
_LEAST_FOOT = 20  # cells on which an object stands
_BELOW = 0.03  # share of an object's splats that are under its support
_PENUMBRA = 0.1  # sizes of the foot over which a shadow's edge is soft
_NEAR = 0.12  # sizes of the hole: so near to it a shadow is darkest
_SHADOW = 0.05  # mean log factor there under which nothing is a shadow
_EVIDENCE = 2.2  # times that of the surroundings: so much a shadow is at least
_CAST = (0.15, 0.2)  # least depth (log) of a cast shadow: in brightness, in light that lacks
_DARKER = 0.1  # log by which a rim is darker that is a shadow whatever the pattern
_DARKEST = 85  # percentile of the surroundings: so dark it is at least
_LARGEST = 4.0  # areas of the hole that its shadow covers; larger ones are another's
_NARROWINGS = 5
_WIDE = (1.2, 2.2)  # sizes of the hole: a shadow fades out from here to there
_FITS, _EVEN = 6, 0.03  # rounds of the fit of light that falls off; log that is no deviation
_EXPLAINED = 0.75  # of the deviations are left after such a fit
_NEARLY_NONE = 1e-3  # cells of a color, under which it is not led on
_FEW = 30  # cells of surroundings with which nothing can be said
_SOFT = 1.0  # cells over which a factor fades at its edge
_BRIGHT = 98  # percentile of the splats of the surroundings: none is made brighter than that
_CELLS_AROUND = 64  # cells of hues looked at: more than a circle of two cells holds
_CLEAN = 1.02  # factor under which a splat is no stain
_PULL = 2.5  # bins: colors so near are taken for the same
_PULLS = 4  # steps towards them


@dataclass(frozen=True, eq=False)
class _Place:
    """Area of a possible shadow, and the area to compare it with."""

    log: DoubleArray  # (H, W, 3) colors, without the fall-off of light
    may: BoolArray  # (H, W)
    around: BoolArray  # (H, W) the surroundings
    least: DoubleArray  # (H, W) log of a factor that is a stain there
    fade: DoubleArray  # (H, W) how much of it is taken off
    sure: DoubleArray  # (H, W) how far it is known that a shadow of ``depth`` (log) falls there
    depth: float


def gains(
    chart: Chart,
    foot: BoolArray,
    taken: BoolArray | None = None,
    cast: Cast | None = None,
) -> DoubleArray:
    """Factors (H, W, 3) by which known cells are too dark next to the object's place; 1 elsewhere.

    ``foot``: (H, W) where it stands; ``taken``: (H, W) where other objects do: what is nearer to
    them is their shadow. ``cast``: the shadow that it casts. Without one there is no stain unless
    the rim of the foot is clearly darker than other places of the surface.
    """
    ones = np.ones((*chart.shape, 3))
    if foot.sum() < _LEAST_FOOT or not (chart.known & ~foot).any():
        return ones
    taken = np.zeros(chart.shape, np.bool_) if taken is None else taken
    place = _next_to(chart, foot, taken) if cast is None else _in_shadow(chart, foot, taken, cast)
    if place is None or place.around.sum() < _FEW:
        return ones
    size = np.sqrt(foot.sum())
    distance = ndimage.distance_transform_edt(~foot)
    log, least = place.log, place.least
    found = _levels(log, chart.known, place, 0.0)
    stained = _touching(place.may & (found.lacking > least), foot)
    tried = [_levels(log, chart.known, place, tilt) for tilt in _TILTS]
    found = max(tried, key=lambda one: float(one.likelihood[stained].sum()))
    for _ in range(_NARROWINGS):
        stained = _touching(place.may & (found.lacking > least), foot)
        if cast is not None or stained.sum() <= _LARGEST * foot.sum():
            break
        least = 1.5 * least
    else:  # no outline: only what is next to the foot
        stained &= distance <= _RIM * size + 2
    lacking = _falling_off(found.lacking, chart.known & (distance <= _NEAR * size + 2))
    stained = _touching(stained & (lacking > least), foot)
    shift = _pulled(log, lacking[:, :, None] * found.channels, stained, place.around)
    soft = ndimage.gaussian_filter(shift * (place.fade * stained)[:, :, None], (_SOFT, _SOFT, 0))
    return np.clip(np.exp(soft), 1.0, _MOST_LIGHT)


def shadow_of(chart: Chart, foot: BoolArray, own: DoubleArray, taken: BoolArray) -> Cast | None:
    """The shadow that the splats at ``own`` (K, 3), world, cast; None where there is none.

    It is looked for in the brightness, and in the light that colors lack: in that a pattern is
    even, but not where the shadow covers most of the surroundings. Arguments as in `gains`.
    """
    log = np.log(np.maximum(chart.color, _DARK))
    missing = [-log @ LUMA]
    far = chart.known & (ndimage.distance_transform_edt(~foot) > _FAR * np.sqrt(foot.sum()))
    if far.sum() >= _FEW:
        missing.append(_levels(log, chart.known, _anywhere(log, far), 0.0).lacking)
    local = chart.plane.local(own)
    found = [cast_shadow(chart, dark, foot, local, taken) for dark in missing]
    clear = [c for c, least in zip(found, _CAST, strict=False) if c is not None and c.depth > least]
    best = max(clear, key=lambda c: c.share, default=None)
    if best is None and chart.plane.is_layered:
        return outlined_shadow(chart, foot, local, taken)
    return best


def _anywhere(log: DoubleArray, around: BoolArray) -> _Place:
    """A stain may be anywhere and of any depth."""
    none = np.zeros(around.shape)
    return _Place(log, ~none.astype(bool), around, none, none, sure=none, depth=0.0)


def _in_shadow(chart: Chart, foot: BoolArray, taken: BoolArray, cast: Cast) -> _Place:
    """In a shadow, with what lies in half light at its edge."""
    width = _PENUMBRA * np.sqrt(foot.sum()) + 2
    may = ndimage.binary_dilation(cast.mask | foot, iterations=round(width))
    may &= ~ndimage.binary_dilation(taken, iterations=2)
    around = chart.known & ~may & ~taken
    return _Place(
        log=_even(chart, around),
        may=may,
        around=around,
        least=np.full(chart.shape, _STAIN_LOGS[0]),
        fade=np.ones(chart.shape),
        sure=ndimage.gaussian_filter(cast.mask.astype(float), width / 2),
        depth=cast.depth,
    )


def _next_to(chart: Chart, foot: BoolArray, taken: BoolArray) -> _Place | None:
    """Next to the object; None where that is hardly darker than elsewhere."""
    size = np.sqrt(foot.sum())
    distance = ndimage.distance_transform_edt(~foot)
    far = chart.known & (distance > _FAR * size)
    rim = chart.known & (distance <= _RIM * size + 2)
    if far.sum() < _FEW or not rim.any():
        return None
    own = np.ones(chart.shape, np.bool_)
    if taken.any():
        own = distance < ndimage.distance_transform_edt(~taken)
    log = _even(chart, far)
    place = _anywhere(log, far)
    found = _levels(log, chart.known, place, 0.0)
    free = far & own if (far & own).any() else far
    # The rim lacks clearly more light (log) than other places do, or is clearly darker.
    least_lacking = max(_SHADOW, _EVIDENCE * float(found.lacking[free].mean()))
    lacks_light = found.lacking[rim].mean() >= least_lacking
    if not lacks_light and not _is_dark(log, chart.known, rim, far):
        return None
    if not _is_one_piece(found.lacking, chart.known & (distance <= _AT_FOOT)):
        return None
    least = np.interp(distance / size, (_RIM, 1.0), _STAIN_LOGS)
    # What the shadow itself covers is no surroundings.
    around = far & ~_touching(own & (found.lacking > least), foot)
    fade = np.interp(distance / size, _WIDE, (1.0, 0.0))
    return replace(place, may=own, around=around, least=least, fade=fade)


def _even(chart: Chart, far: BoolArray) -> DoubleArray:
    """Log colors (H, W, 3) without the fall-off of light over the cells ``far`` (H, W)."""
    log = np.log(np.maximum(chart.color, _DARK))
    return log - _falloff(log @ LUMA, far)[:, :, None]


def _falloff(log: DoubleArray, far: BoolArray) -> DoubleArray:
    """How light falls off linearly over the surface (H, W), zero on average of ``far`` (H, W).

    By least absolute values of ``log`` (H, W), which a shadow hardly moves. Zero everywhere where
    that explains little: a pattern of light and dark is no fall-off.
    """
    rows, columns = np.indices(far.shape) / max(far.shape)
    terms = np.stack([np.ones(far.shape), rows, columns], axis=2)
    a, b = terms[far], log[far]
    weights = np.ones(len(b))
    for _ in range(_FITS):
        root = np.sqrt(weights)
        fit = np.linalg.lstsq(root[:, None] * a, root * b, rcond=None)[0]
        weights = 1 / (np.abs(b - a @ fit) + _EVEN)
    if np.abs(b - a @ fit).mean() > _EXPLAINED * np.abs(b - np.median(b)).mean():
        return np.zeros(far.shape)
    trend = terms @ fit
    return trend - trend[far].mean()


def splat_gains(
    chart: Chart, factors: DoubleArray, local: DoubleArray, rgb: DoubleArray
) -> DoubleArray:
    """Factors (N, 3) of splats of colors ``rgb`` (N, 3) at ``local`` (N, 3) on the plane.

    None becomes brighter than the splats of its hue that are not stained: a dark red flower on
    pale paper is no shadow over one of a brighter red than there is.
    """
    result = chart.at(factors, local)
    clean = result.max(axis=1) < _CLEAN
    if not clean.any():
        return result
    top = np.percentile(rgb[clean], _BRIGHT, axis=0)
    result = np.clip(np.minimum(result, top / np.maximum(rgb, _DARK)), 1.0, None)
    lit = result.max(axis=1) > 1
    log, more = np.log(np.maximum(rgb, _DARK)), np.log(result[lit])
    way = np.maximum(more.mean(axis=1), 1e-9)
    most = _brightest(log[clean], log[lit] + more) - log[lit].mean(axis=1)
    result[lit] = np.exp(more * np.clip(most / way, 0.0, 1.0)[:, None])
    return result


def _brightest(log: DoubleArray, wanted: DoubleArray) -> DoubleArray:
    """Brightness (K,), a log, of the brightest of log colors ``log`` (N, 3) of the hue of each of
    ``wanted`` (K, 3); minus infinity where none has its hue."""
    near = _PULL * _box()[1]
    cell = near / 2
    hues, which = np.unique(np.rint(_hue(log) / cell), axis=0, return_inverse=True)
    top = np.full(len(hues) + 1, -np.inf)  # the last one: of no hue
    np.maximum.at(top, which.ravel(), log.mean(axis=1))
    some = np.arange(1, min(_CELLS_AROUND, len(hues)) + 1)
    _, found = cKDTree(hues * cell).query(_hue(wanted), some, distance_upper_bound=near)
    most: DoubleArray = top[found].max(axis=1)
    return most


def _hue(log: DoubleArray) -> DoubleArray:
    """What of log colors (N, 3) light does not change (N, 3)."""
    return log - log.mean(axis=1, keepdims=True)


def taken_cells(chart: Chart, points: DoubleArray, height: float) -> BoolArray:
    """Cells (H, W) over which up to ``height`` some of ``points`` (N, 3), world, lie."""
    local = chart.plane.local(points)
    row, column, inside = chart.cells(local)
    over = inside & (local[:, 2] > tolerance_of(chart)) & (local[:, 2] < height)
    found = _marked(chart, row[over], column[over])
    return ndimage.binary_opening(ndimage.binary_closing(found), iterations=2)


def foot_cells(chart: Chart, own: DoubleArray) -> BoolArray:
    """Cells (H, W) on which an object with splats at ``own`` (K, 3), world, stands, if it does."""
    local = chart.plane.local(own)
    row, column, inside = chart.cells(local)
    if (local[:, 2] < -tolerance_of(chart)).mean() > _BELOW:  # the plane goes through it
        return np.zeros(chart.shape, np.bool_)
    low = inside & (np.abs(local[:, 2] - chart.height[row, column]) < tolerance_of(chart))
    padded = ndimage.binary_fill_holes(_closed(_marked(chart, row[low], column[low])))
    return padded[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]


def _is_one_piece(lacking: DoubleArray, foot: BoolArray) -> bool:
    """Whether a long piece of the hole's outline ``foot`` (H, W) lacks light without a break.

    A shadow begins where the object stands; dark parts of a pattern touch the outline here and
    there.
    """
    parts, n = ndimage.label(foot & (lacking > _STAIN_LOGS[0]), structure=np.ones((3, 3)))
    largest = int(np.bincount(parts[foot], minlength=n + 1)[1:].max(initial=0))
    return bool(largest >= _ONE_PIECE * foot.sum())


def _is_dark(log: DoubleArray, known: BoolArray, rim: BoolArray, far: BoolArray) -> bool:
    """Whether the rim is darker all around than nearly all of a surface of one color."""
    low = blurred((log @ LUMA)[:, :, None], known.astype(float), _BLUR)[:, :, 0]
    dark = np.median(low[far]) - low
    spread = 1.4826 * float(np.median(np.abs(dark[far])))
    least = max(_DARKER, 3 * spread, float(np.percentile(dark[far], _DARKEST)))
    return bool(np.median(dark[rim]) >= least)


@dataclass(frozen=True, eq=False)
class _Levels:
    lacking: DoubleArray  # (H, W) log of the factor
    likelihood: DoubleArray  # (H, W) log, of the best factor
    channels: DoubleArray  # (3,) by which the log is multiplied in each channel


def _levels(log: DoubleArray, known: BoolArray, place: _Place, tilt: float) -> _Levels:
    """The likeliest factor at each cell of log colors ``log`` (H, W, 3)."""
    around = place.around
    channels = 1 + tilt * np.array([1.0, 0.0, -1.0])
    channels = channels / float(LUMA @ channels)
    box, width = _box()
    histogram = np.histogramdd(log[around], _BINS, box)[0]
    share = ndimage.gaussian_filter(histogram / around.sum(), 1.0, mode="nearest")
    table = np.log(share + _UNLIKELY)
    below = np.maximum(ndimage.gaussian_filter(known.astype(float), _BLUR), 1e-6)
    best, lacking = np.full(known.shape, -np.inf), np.zeros(known.shape)
    for level in np.linspace(0, np.log(_MOST_LIGHT), _N_LEVELS):
        at = ((log + level * channels - box[0][0]) / width - 0.5).transpose(2, 0, 1)
        likelihood = ndimage.map_coordinates(table, at, order=1, mode="nearest")
        mean = ndimage.gaussian_filter(np.where(known, likelihood, 0.0), _BLUR) / below
        mean -= (1 - place.sure) * _PRICE * level
        mean -= place.sure * ((level - place.depth) / _SPREAD) ** 2 / 2
        better = mean > best
        best[better], lacking[better] = mean[better], level
    return _Levels(np.where(known, lacking, 0.0), np.where(known, best, 0.0), channels)


def _pulled(
    log: DoubleArray, shift: DoubleArray, stained: BoolArray, around: BoolArray
) -> DoubleArray:
    """``shift`` (H, W, 3) of log colors ``log``, led on to the colors that are usual around.

    Mean shift (Comaniciu & Meer 2002), the same for neighbouring cells.
    """
    box, width = _box()
    rows = log[around]
    share, *sums = [
        ndimage.gaussian_filter(
            np.histogramdd(rows, _BINS, box, weights=weights)[0], _PULL, mode="nearest"
        )
        for weights in (None, *rows.T)
    ]
    below = np.maximum(ndimage.gaussian_filter(stained.astype(float), _BLUR), 1e-6)[:, :, None]
    for _ in range(_PULLS):
        now = log + shift
        at = ((now - box[0][0]) / width - 0.5).transpose(2, 0, 1)
        n, *totals = [
            ndimage.map_coordinates(table, at, order=1, mode="nearest") for table in (share, *sums)
        ]
        known = (stained & (n > _NEARLY_NONE))[:, :, None]
        mean = np.stack(totals, axis=2) / np.maximum(n, _NEARLY_NONE)[:, :, None]
        step = np.where(known, mean - now, 0.0)
        shift = shift + ndimage.gaussian_filter(step, (_BLUR, _BLUR, 0)) / below
    return shift


def _box() -> tuple[list[tuple[float, float]], float]:
    """Limits of log colors in each channel, and the width of a bin."""
    low, high = float(np.log(_DARK)), float(np.log(_BRIGHTEST))
    return [(low, high)] * 3, (high - low) / _BINS


def _falling_off(lacking: DoubleArray, foot: BoolArray) -> DoubleArray:
    """``lacking`` (H, W), nowhere more than on the way there from the ``foot`` (H, W).

    A shadow is darkest where the object stands; what is darker farther away is another's, or a
    dark part of a pattern. Of all ways the one counts whose least value is largest (morphological
    reconstruction by dilation, Vincent 1993).
    """
    result = np.where(foot, lacking, 0.0)
    while True:
        spread = np.minimum(ndimage.grey_dilation(result, size=(3, 3)), lacking)
        if np.array_equal(spread, result):
            return result
        result = spread


def _touching(stained: BoolArray, hole: BoolArray) -> BoolArray:
    """What of ``stained`` (H, W) hangs together with the hole."""
    parts, _ = ndimage.label(stained | hole)
    return stained & np.isin(parts, np.unique(parts[hole]))
