"""Kernels of `stereo`: PatchMatch over planes, and the check of depth maps against one another.

A hypothesis of a pixel is a plane, written as its inverse depth there and the change of that by one
pixel to the right and one down: over a plane, inverse depth is affine in pixels. With M = K_s R
K^-1 and t = K_s T (R, T: source from view), pixel x of inverse depth w is seen at M x + w t: moving
by a pixel adds a constant vector, so a sample of a window costs three additions.

Pixels are array indices here: centres at +0, and M and t are made for these.
"""

import math

import numpy as np

from gaga_core.arrays import (
    AnyArray,
    BoolArray,
    DoubleArray,
    FloatArray,
    IntArray,
    LongArray,
    UInt32Array,
)
from gaga_core.kernels import exp_below_zero, kernel

REACH, STEP = 4, 2  # half a window and the distance of its samples, pixels
SAMPLES = (2 * REACH // STEP + 1) ** 2
_LANES = -(-SAMPLES // 16) * 16  # whole vectors; those behind the samples have no weight
_FEWEST = 15  # samples that a source must see
_F = np.float32
_LIKE = _F(-1.0 / (2 * 0.12**2))  # samples of another grey count less: they lie on another surface
_FLAT = 2e-5  # variance under which a window has no texture
_WORST = -1.0
_INSIDE = 1e-3  # pixels from the border of a picture to a whole window: more than it rounds by
_FROM_NEIGHBOURS, _TURNS = 2, 5  # hypotheses of a pixel in a sweep
_STATE = np.uint64(88172645463325252)


def _offsets() -> tuple[FloatArray, FloatArray]:
    """Pixels right and down from the middle of a window to each of its samples."""
    steps = np.arange(-REACH, REACH + 1, STEP, dtype=np.float32)
    down, right = np.meshgrid(steps, steps, indexing="ij")
    behind = (0, _LANES - SAMPLES)
    return np.pad(right.ravel(), behind), np.pad(down.ravel(), behind)


_RIGHT, _DOWN = _offsets()
_BYTE, _8, _16, _24 = np.uint32(255), np.uint32(8), np.uint32(16), np.uint32(24)


def packed(grey: FloatArray) -> UInt32Array:
    """Pixels (H W,) of a picture (H, W) in 0..1, each with the next to the right and below in 8
    bits: one load brings what lies around a place between them."""
    levels = np.pad(np.round(grey * 255).astype(np.uint32), (0, 1), mode="edge")
    right, below = levels[:-1, 1:], levels[1:, :-1]
    four = levels[:-1, :-1] | right << _8 | below << _16 | levels[1:, 1:] << _24
    result: UInt32Array = four.astype(np.uint32).ravel()
    return result


@kernel
def match_view(
    grey: FloatArray,  # (H, W)
    pixels: UInt32Array,  # of all pictures, one behind the other: `packed`
    sources: LongArray,  # (S, 3) offset in ``pixels``, width, height
    M: DoubleArray,  # (S, 3, 3)
    t: DoubleArray,  # (S, 3)
    least: float,  # of inverse depth
    most: float,
    steepest: float,  # change of inverse depth by a pixel, x inverse depth
    n_sweeps: int,
    seed: int,
    planes: DoubleArray,  # (H, W, 3) changed
    scores: FloatArray,  # (H, W) written
) -> None:
    """PatchMatch: neighbours hand their planes on, chance improves them.

    Even sweeps go right and down, odd ones left and up. Chance searches the whole range of depths
    at first, and half as far each sweep.
    """
    height, width = grey.shape
    values, weights = np.zeros(_LANES, np.float32), np.zeros(_LANES, np.float32)
    random = np.array([_STATE + np.uint64(7919 * seed)], np.uint64)
    for y in range(height):
        for x in range(width):
            _window(grey, y, x, values, weights)
            w, wx, wy = planes[y, x, 0], planes[y, x, 1], planes[y, x, 2]
            scores[y, x] = _score(
                values, weights, grey[y, x], y, x, w, wx, wy, pixels, sources, M, t
            )
    for sweep in range(n_sweeps):
        reach = 0.5**sweep
        step = 1 if sweep % 2 == 0 else -1
        for j in range(height):
            y = j if step == 1 else height - 1 - j
            for i in range(width):
                x = i if step == 1 else width - 1 - i
                _window(grey, y, x, values, weights)
                best = float(scores[y, x])
                for turn in range(_TURNS):
                    if turn < _FROM_NEIGHBOURS:
                        other_x, other_y = x - step * (turn == 0), y - step * (turn == 1)
                        if not (0 <= other_x < width and 0 <= other_y < height):
                            continue
                        w, wx, wy = _extended(planes, other_y, other_x, y, x)
                    else:
                        w, wx, wy = _varied(
                            planes, y, x, turn, reach, most - least, steepest, random
                        )
                    limit = steepest * w
                    if not (least <= w <= most and abs(wx) <= limit and abs(wy) <= limit):
                        continue
                    score = _score(
                        values, weights, grey[y, x], y, x, w, wx, wy, pixels, sources, M, t
                    )
                    if score > best:
                        best = score
                        planes[y, x, 0], planes[y, x, 1], planes[y, x, 2] = w, wx, wy
                scores[y, x] = best


@kernel
def count_agreeing(
    inverse_depths: FloatArray,  # (H, W) 0 = none
    maps: FloatArray,  # those of all views, one behind the other
    sources: LongArray,  # (S, 3)
    M: DoubleArray,
    t: DoubleArray,
    is_before: BoolArray,  # (S,)
    tolerance: float,  # relative
    counts: IntArray,  # (H, W) added to: sources that see the same surface
    is_new: BoolArray,  # (H, W) cleared where a source does that is before this view
) -> None:
    """How many other depth maps agree with each pixel of one."""
    height, width = inverse_depths.shape
    for y in range(height):
        for x in range(width):
            w = np.float64(inverse_depths[y, x])
            if not w > 0.0:
                continue
            for s in range(len(sources)):
                qz = M[s, 2, 0] * x + M[s, 2, 1] * y + M[s, 2, 2] + w * t[s, 2]
                if not qz > 1e-9:
                    continue
                u = (M[s, 0, 0] * x + M[s, 0, 1] * y + M[s, 0, 2] + w * t[s, 0]) / qz
                v = (M[s, 1, 0] * x + M[s, 1, 1] * y + M[s, 1, 2] + w * t[s, 1]) / qz
                if not (-0.5 <= u < sources[s, 1] - 0.5 and -0.5 <= v < sources[s, 2] - 0.5):
                    continue
                at = math.floor(v + 0.5) * sources[s, 1] + math.floor(u + 0.5)
                theirs = maps[sources[s, 0] + at]
                ours = w / qz  # the third number of M x + w t is the depth there times w
                if theirs > 0.0 and abs(theirs - ours) < tolerance * ours:
                    counts[y, x] += 1
                    if is_before[s]:
                        is_new[y, x] = False


@kernel
def _window(grey: FloatArray, y: int, x: int, values: FloatArray, weights: FloatArray) -> None:
    """Samples of the window around a pixel, less its middle, and what each counts: one in all."""
    height, width = grey.shape
    middle = grey[y, x]
    k = 0
    for dy in range(-REACH, REACH + 1, STEP):
        row = min(height - 1, max(0, y + dy))
        for dx in range(-REACH, REACH + 1, STEP):
            values[k] = grey[row, min(width - 1, max(0, x + dx))] - middle
            k += 1
    total = _F(0)
    for k in range(SAMPLES):
        weights[k] = exp_below_zero(values[k] * values[k] * _LIKE)  # of -35 at least
        total += weights[k]
    for k in range(SAMPLES):
        weights[k] /= total


@kernel
def _extended(
    planes: DoubleArray, from_y: int, from_x: int, y: int, x: int
) -> tuple[float, float, float]:
    """The plane of another pixel, at this one."""
    wx, wy = planes[from_y, from_x, 1], planes[from_y, from_x, 2]
    return planes[from_y, from_x, 0] + (x - from_x) * wx + (y - from_y) * wy, wx, wy


@kernel
def _varied(
    planes: DoubleArray,
    y: int,
    x: int,
    turn: int,
    reach: float,
    span: float,
    steepest: float,
    random: AnyArray,  # (1,) uint64, changed
) -> tuple[float, float, float]:
    """A plane near that of a pixel: far and tilted, at another depth, and close by but tilted."""
    r0, r1, r2 = _random(random), _random(random), _random(random)
    w, wx, wy = planes[y, x, 0], planes[y, x, 1], planes[y, x, 2]
    tilt = reach * steepest * w
    if turn == _FROM_NEIGHBOURS:
        return w + 0.5 * reach * span * r0, wx + tilt * r1, wy + tilt * r2
    if turn == _FROM_NEIGHBOURS + 1:
        return w + 0.125 * reach * span * r0, wx, wy
    tilt *= 0.25
    return w * (1.0 + 0.2 * reach * r0), wx + tilt * r1, wy + tilt * r2


@kernel
def _random(state: AnyArray) -> float:
    """A number in -1..1 (xorshift, Marsaglia 2003); ``state`` (1,) uint64 is changed."""
    x = state[0]
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    x ^= x << np.uint64(17)
    state[0] = x
    return np.float64(x >> np.uint64(11)) / 4503599627370496.0 - 1.0


@kernel
def _score(
    values: FloatArray,
    weights: FloatArray,
    middle: np.float32,
    y: int,
    x: int,
    w: float,
    wx: float,
    wy: float,
    pixels: UInt32Array,
    sources: LongArray,
    M: DoubleArray,
    t: DoubleArray,
) -> float:
    """Mean similarity of the two sources that agree best: from others it may be hidden."""
    first, second = _WORST, _WORST
    for s in range(len(sources)):
        found = _similarity(values, weights, middle, y, x, w, wx, wy, pixels, sources, M, t, s)
        if found > first:
            second = first
            first = found
        elif found > second:
            second = found
    return 0.5 * (first + second) if len(sources) > 1 else first


@kernel
def _similarity(
    values: FloatArray,
    weights: FloatArray,
    middle: np.float32,
    y: int,
    x: int,
    w: float,
    wx: float,
    wy: float,
    pixels: UInt32Array,
    sources: LongArray,
    M: DoubleArray,
    t: DoubleArray,
    s: int,
) -> float:
    """Weighted normalised cross-correlation of a window and its place in a source; -1 = unseen."""
    offset, width, height = sources[s, 0], sources[s, 1], sources[s, 2]
    # Of the middle of the window, and what a pixel to the right and one down adds.
    at = (
        M[s, 0, 0] * x + M[s, 0, 1] * y + M[s, 0, 2] + w * t[s, 0],
        M[s, 1, 0] * x + M[s, 1, 1] * y + M[s, 1, 2] + w * t[s, 1],
        M[s, 2, 0] * x + M[s, 2, 1] * y + M[s, 2, 2] + w * t[s, 2],
    )
    right = M[s, 0, 0] + wx * t[s, 0], M[s, 1, 0] + wx * t[s, 1], M[s, 2, 0] + wx * t[s, 2]
    down = M[s, 0, 1] + wy * t[s, 0], M[s, 1, 1] + wy * t[s, 1], M[s, 2, 1] + wy * t[s, 2]
    # Distances from the borders of the picture, times the depth: they are linear in the window, so
    # its corners have the least and the largest.
    from_left = _room(at, right, down, 1.0, 0.0, -_INSIDE)
    from_right = _room(at, right, down, -1.0, 0.0, width - 1 - _INSIDE)
    from_top = _room(at, right, down, 0.0, 1.0, -_INSIDE)
    from_bottom = _room(at, right, down, 0.0, -1.0, height - 1 - _INSIDE)
    front = _room(at, right, down, 0.0, 0.0, 1.0)
    if not min(from_left[1], from_right[1], from_top[1], from_bottom[1], front[1]) > 0.0:
        return _WORST
    # Where depths of the window are alike, 32 bits round by less than `_INSIDE`.
    is_whole = min(from_left[0], from_right[0], from_top[0], from_bottom[0]) > 1e-9
    if not (is_whole and front[0] > 0.5 * front[1]):
        return _part_similarity(
            values, weights, middle, at, right, down, pixels, offset, width, height
        )
    px, py, pz = _F(at[0]), _F(at[1]), _F(at[2])
    ax, ay, az = _F(right[0]), _F(right[1]), _F(right[2])
    bx, by, bz = _F(down[0]), _F(down[1]), _F(down[2])
    sa, sb, saa, sbb, sab = _F(0), _F(0), _F(0), _F(0), _F(0)
    for k in range(_LANES):
        depth = _F(1) / (pz + _RIGHT[k] * az + _DOWN[k] * bz)
        u = (px + _RIGHT[k] * ax + _DOWN[k] * bx) * depth
        v = (py + _RIGHT[k] * ay + _DOWN[k] * by) * depth
        column, row = np.int32(u), np.int32(v)
        fu, fv = u - _F(column), v - _F(row)
        four = pixels[np.uint32(offset) + np.uint32(row) * np.uint32(width) + np.uint32(column)]
        b = _between(four, fu, fv) - middle
        wa, wb = weights[k] * values[k], weights[k] * b
        sa += wa
        sb += wb
        saa += wa * values[k]
        sbb += wb * b
        sab += wa * b
    return _correlation(1.0, float(sa), float(sb), float(saa), float(sbb), float(sab))


@kernel
def _room(
    at: tuple[float, float, float],
    right: tuple[float, float, float],
    down: tuple[float, float, float],
    a: float,
    b: float,
    c: float,
) -> tuple[float, float]:
    """Least and largest a u' + b v' + c w' of a window whose samples are (u', v', w')."""
    here = a * at[0] + b * at[1] + c * at[2]
    reach = REACH * (
        abs(a * right[0] + b * right[1] + c * right[2])
        + abs(a * down[0] + b * down[1] + c * down[2])
    )
    return here - reach, here + reach


@kernel
def _part_similarity(
    values: FloatArray,
    weights: FloatArray,
    middle: np.float32,
    at: tuple[float, float, float],
    right: tuple[float, float, float],
    down: tuple[float, float, float],
    pixels: UInt32Array,
    offset: int,
    width: int,
    height: int,
) -> float:
    """`_similarity` of those samples that the source sees."""
    total, sa, sb, saa, sbb, sab = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    n = 0
    for k in range(SAMPLES):
        dx, dy = _RIGHT[k], _DOWN[k]
        qz = at[2] + dx * right[2] + dy * down[2]
        u = (at[0] + dx * right[0] + dy * down[0]) / qz
        v = (at[1] + dx * right[1] + dy * down[1]) / qz
        if qz > 1e-9 and u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1:
            column, row = int(u), int(v)
            fu, fv = u - column, v - row
            four = pixels[offset + row * width + column]
            b = _between(four, _F(fu), _F(fv)) - middle
            a, weight = values[k], weights[k]
            total += weight
            sa += weight * a
            sb += weight * b
            saa += weight * a * a
            sbb += weight * b * b
            sab += weight * a * b
            n += 1
    if n < _FEWEST:
        return _WORST
    return _correlation(total, sa, sb, saa, sbb, sab)


@kernel
def _between(four: np.uint32, fu: np.float32, fv: np.float32) -> np.float32:
    """Grey in 0..1 between a pixel and the next to the right and below."""
    top_left, top_right = _F(four & _BYTE), _F((four >> _8) & _BYTE)
    low_left, low_right = _F((four >> _16) & _BYTE), _F(four >> _24)
    top = top_left + fu * (top_right - top_left)
    low = low_left + fu * (low_right - low_left)
    return (top + fv * (low - top)) * _F(1 / 255)


@kernel
def _correlation(
    total: float,
    sa: float,
    sb: float,
    saa: float,
    sbb: float,
    sab: float,
) -> float:
    """Of two weighted samples from their sums; -1 where one has no texture."""
    ma, mb = sa / total, sb / total
    va, vb = saa / total - ma * ma, sbb / total - mb * mb
    if va < _FLAT or vb < _FLAT:
        return _WORST
    return (sab / total - ma * mb) / math.sqrt(va * vb)
