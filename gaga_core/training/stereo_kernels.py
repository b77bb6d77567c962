"""Kernels of `stereo`: PatchMatch over planes, and the check of depth maps against one another.

A hypothesis of a pixel is a plane, written as its inverse depth there and the change of that by one
pixel to the right and one down: over a plane, inverse depth is affine in pixels. With M = K_s R
K^-1 and t = K_s T (R, T: source from view), pixel x of inverse depth w is seen at M x + w t: moving
by a pixel adds a constant vector, so a sample of a window costs three additions.

Pixels are array indices here: centres at +0, and M and t are made for these.
"""

import math

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.kernels import kernel

REACH, STEP = 4, 2  # half a window and the distance of its samples, pixels
SAMPLES = (2 * REACH // STEP + 1) ** 2
_FEWEST = 15  # samples that a source must see
_F = np.float32
_LIKE = -1.0 / (2 * 0.12**2)  # samples of another grey count less: they lie on another surface
_FLAT = 2e-5  # variance under which a window has no texture
_WORST = -1.0
_FROM_NEIGHBOURS, _TURNS = 2, 5  # hypotheses of a pixel in a sweep
_STATE = np.uint64(88172645463325252)


@kernel
def match_view(
    grey: FloatArray,  # (H, W)
    pixels: FloatArray,  # all pictures, one behind the other
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
    values, weights = np.empty(SAMPLES, np.float32), np.empty(SAMPLES, np.float32)
    random = np.array([_STATE + np.uint64(7919 * seed)], np.uint64)
    trial = np.empty(3, np.float64)
    for y in range(height):
        for x in range(width):
            _window(grey, y, x, values, weights)
            scores[y, x] = _score(values, weights, y, x, planes[y, x], pixels, sources, M, t)
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
                        _extend(planes, other_y, other_x, y, x, trial)
                    else:
                        _vary(planes[y, x], turn, reach, most - least, steepest, random, trial)
                    limit = steepest * trial[0]
                    if not (least <= trial[0] <= most):
                        continue
                    if not (abs(trial[1]) <= limit and abs(trial[2]) <= limit):
                        continue
                    score = _score(values, weights, y, x, trial, pixels, sources, M, t)
                    if score > best:
                        best = score
                        planes[y, x] = trial
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
    """Samples of the window around a pixel, and what each counts."""
    height, width = grey.shape
    middle = grey[y, x]
    k = 0
    for dy in range(-REACH, REACH + 1, STEP):
        for dx in range(-REACH, REACH + 1, STEP):
            value = grey[min(height - 1, max(0, y + dy)), min(width - 1, max(0, x + dx))]
            values[k] = value
            weights[k] = _F(math.exp((value - middle) * (value - middle) * _LIKE))
            k += 1


@kernel
def _extend(
    planes: DoubleArray, from_y: int, from_x: int, y: int, x: int, trial: DoubleArray
) -> None:
    """The plane of another pixel, at this one."""
    trial[1], trial[2] = planes[from_y, from_x, 1], planes[from_y, from_x, 2]
    trial[0] = planes[from_y, from_x, 0] + (x - from_x) * trial[1] + (y - from_y) * trial[2]


@kernel
def _vary(
    plane: DoubleArray,
    turn: int,
    reach: float,
    span: float,
    steepest: float,
    random: AnyArray,  # (1,) uint64, changed
    trial: DoubleArray,
) -> None:
    """A plane near ``plane``: far and tilted, at another depth, and close by but tilted."""
    r0, r1, r2 = _random(random), _random(random), _random(random)
    trial[0], trial[1], trial[2] = plane[0], plane[1], plane[2]
    tilt = reach * steepest * plane[0]
    if turn == _FROM_NEIGHBOURS:
        trial[0] += 0.5 * reach * span * r0
    elif turn == _FROM_NEIGHBOURS + 1:
        trial[0] += 0.125 * reach * span * r0
        return
    else:
        trial[0] *= 1.0 + 0.2 * reach * r0
        tilt *= 0.25
    trial[1] += tilt * r1
    trial[2] += tilt * r2


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
    y: int,
    x: int,
    plane: DoubleArray,
    pixels: FloatArray,
    sources: LongArray,
    M: DoubleArray,
    t: DoubleArray,
) -> float:
    """Mean similarity of the two sources that agree best: from others it may be hidden."""
    first, second = _WORST, _WORST
    for s in range(len(sources)):
        found = _similarity(values, weights, y, x, plane, pixels, sources[s], M[s], t[s])
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
    y: int,
    x: int,
    plane: DoubleArray,
    pixels: FloatArray,
    source: LongArray,  # (3,)
    M: DoubleArray,  # (3, 3)
    t: DoubleArray,  # (3,)
) -> float:
    """Weighted normalised cross-correlation of a window and its place in a source; -1 = unseen."""
    offset, width, height = source[0], source[1], source[2]
    w, wx, wy = plane[0], plane[1], plane[2]
    ax, ay, az = M[0, 0] + wx * t[0], M[1, 0] + wx * t[1], M[2, 0] + wx * t[2]
    bx, by, bz = M[0, 1] + wy * t[0], M[1, 1] + wy * t[1], M[2, 1] + wy * t[2]
    px = M[0, 0] * x + M[0, 1] * y + M[0, 2] + w * t[0]
    py = M[1, 0] * x + M[1, 1] * y + M[1, 2] + w * t[1]
    pz = M[2, 0] * x + M[2, 1] * y + M[2, 2] + w * t[2]
    if not pz > 1e-9:
        return _WORST
    total, sa, sb, saa, sbb, sab = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    n, k = 0, 0
    for dy in range(-REACH, REACH + 1, STEP):
        for dx in range(-REACH, REACH + 1, STEP):
            qz = pz + dx * az + dy * bz
            u = (px + dx * ax + dy * bx) / qz
            v = (py + dx * ay + dy * by) / qz
            if qz > 1e-9 and u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1:
                column, row = int(u), int(v)
                fu, fv = u - column, v - row
                at = offset + row * width + column
                top = pixels[at] + fu * (pixels[at + 1] - pixels[at])
                low = pixels[at + width] + fu * (pixels[at + width + 1] - pixels[at + width])
                b = top + fv * (low - top)
                a, weight = values[k], weights[k]
                total += weight
                sa += weight * a
                sb += weight * b
                saa += weight * a * a
                sbb += weight * b * b
                sab += weight * a * b
                n += 1
            k += 1
    if n < _FEWEST:
        return _WORST
    ma, mb = sa / total, sb / total
    va, vb = saa / total - ma * ma, sbb / total - mb * mb
    if va < _FLAT or vb < _FLAT:
        return _WORST
    return (sab / total - ma * mb) / math.sqrt(va * vb)
