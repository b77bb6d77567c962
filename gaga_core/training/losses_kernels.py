"""Kernels of the photometric loss: L1 and structural similarity (SSIM) with their gradient.

A picture is a matrix of H rows of 3 W numbers, its channels interleaved, with a frame of zeros:
REACH rows above and below, PAD numbers on the left, enough on the right to fill whole strips.

The 11 x 11 Gaussian window is two passes of 11 taps: down the rows, then along the line in steps of
3. A strip of OUT columns is walked downwards with the last 11 rows at hand (row y lies in slot
y mod 11; the taps turn instead of the rows), so no blurred copy of a picture is ever written. All
of a strip's lines are rows of one array of fixed size: the compiler then knows that they do not
overlap and vectorises every loop.
"""

import math

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.kernels import kernel
from gaga_core.raster.cpu.simd_kernels import prefetch

REACH = 5
TAPS = 2 * REACH + 1
CHANNELS = 3
PAD = CHANNELS * REACH
OUT = 240  # columns of a strip: whole strips for widths of 80, 160, 320, 640 pixels
IN = OUT + 32  # columns that it reads: OUT + 2 PAD, in whole vectors
_SIGMA = 1.5
_F = np.float32
_ZERO, _ONE, _TWO = _F(0), _F(1), _F(2)
_C1, _C2 = _F(0.01**2), _F(0.03**2)  # Wang 2004, for pictures in 0..1


@kernel
def _window(taps: FloatArray) -> None:
    """The taps twice over: those from 11 - r on are the taps turned by r."""
    total = 0.0
    for k in range(TAPS):
        total += math.exp(-((k - REACH) ** 2) / (2.0 * _SIGMA * _SIGMA))
    for k in range(2 * TAPS):
        taps[k] = math.exp(-((k % TAPS - REACH) ** 2) / (2.0 * _SIGMA * _SIGMA)) / total


@kernel
def similarity_rows(
    picture: FloatArray,  # framed
    target: FloatArray,  # framed
    slopes: FloatArray,  # (3, as picture) by blurred a, blurred a^2, blurred ab; frame comes zeroed
    sums: DoubleArray,  # (H, 2), comes zeroed: sum of SSIM and of |a - b| of each row
    width: int,  # 3 W
    start: int,
    stop: int,
) -> None:
    """SSIM at each pixel of rows start..stop, and its gradient by the blurred maps."""
    taps = np.empty(2 * TAPS, np.float32)
    _window(taps)
    w0, w1, w2, w3, w4, w5 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5]
    B, MA, MB, SQ, AB, S, D, E, F = TAPS, 22, 23, 24, 25, 26, 27, 28, 29
    lines = np.zeros((30, IN), np.float32)
    for left in range(0, width, OUT):
        n = min(OUT, width - left)
        for y in range(start, start + TAPS - 1):
            for x in range(IN):
                lines[y % TAPS, x] = picture[y, left + x]
                lines[B + y % TAPS, x] = target[y, left + x]
        for y in range(start, stop):
            slot = (y + TAPS - 1) % TAPS
            for x in range(IN):
                lines[slot, x] = picture[y + TAPS - 1, left + x]
                lines[B + slot, x] = target[y + TAPS - 1, left + x]
            turn = TAPS - y % TAPS
            for x in range(IN):
                ma, mb, squares, ab = _ZERO, _ZERO, _ZERO, _ZERO
                for k in range(TAPS):
                    a, b = lines[k, x], lines[B + k, x]
                    wa, wb = taps[turn + k] * a, taps[turn + k] * b
                    ma += wa
                    mb += wb
                    squares += wa * a + wb * b
                    ab += wa * b
                lines[MA, x] = ma
                lines[MB, x] = mb
                lines[SQ, x] = squares
                lines[AB, x] = ab
            for x in range(OUT):
                ma = (
                    w0 * (lines[MA, x] + lines[MA, x + 30])
                    + w1 * (lines[MA, x + 3] + lines[MA, x + 27])
                    + w2 * (lines[MA, x + 6] + lines[MA, x + 24])
                    + w3 * (lines[MA, x + 9] + lines[MA, x + 21])
                    + w4 * (lines[MA, x + 12] + lines[MA, x + 18])
                    + w5 * lines[MA, x + 15]
                )
                mb = (
                    w0 * (lines[MB, x] + lines[MB, x + 30])
                    + w1 * (lines[MB, x + 3] + lines[MB, x + 27])
                    + w2 * (lines[MB, x + 6] + lines[MB, x + 24])
                    + w3 * (lines[MB, x + 9] + lines[MB, x + 21])
                    + w4 * (lines[MB, x + 12] + lines[MB, x + 18])
                    + w5 * lines[MB, x + 15]
                )
                # The two variances are needed as a sum only.
                both = (
                    w0 * (lines[SQ, x] + lines[SQ, x + 30])
                    + w1 * (lines[SQ, x + 3] + lines[SQ, x + 27])
                    + w2 * (lines[SQ, x + 6] + lines[SQ, x + 24])
                    + w3 * (lines[SQ, x + 9] + lines[SQ, x + 21])
                    + w4 * (lines[SQ, x + 12] + lines[SQ, x + 18])
                    + w5 * lines[SQ, x + 15]
                ) - (ma * ma + mb * mb)
                ab = (
                    w0 * (lines[AB, x] + lines[AB, x + 30])
                    + w1 * (lines[AB, x + 3] + lines[AB, x + 27])
                    + w2 * (lines[AB, x + 6] + lines[AB, x + 24])
                    + w3 * (lines[AB, x + 9] + lines[AB, x + 21])
                    + w4 * (lines[AB, x + 12] + lines[AB, x + 18])
                    + w5 * lines[AB, x + 15]
                ) - ma * mb
                n1, n2 = _TWO * ma * mb + _C1, _TWO * ab + _C2
                # np.divide: the operator would check for zero, and a branch ends vectors.
                i1 = np.divide(_ONE, ma * ma + mb * mb + _C1)
                i2 = np.divide(_ONE, both + _C2)
                s = n1 * n2 * i1 * i2
                by_ab = _TWO * n1 * i1 * i2
                by_ma = _TWO * (mb * n2 * i1 * i2 - s * ma * i1)
                lines[S, x] = s
                lines[D, x] = by_ma - by_ab * mb + _TWO * s * i2 * ma
                lines[E, x] = -s * i2
                lines[F, x] = by_ab
            similar, apart = 0.0, 0.0
            for x in range(n):
                slopes[0, y + REACH, left + PAD + x] = lines[D, x]
                slopes[1, y + REACH, left + PAD + x] = lines[E, x]
                slopes[2, y + REACH, left + PAD + x] = lines[F, x]
            for x in range(n):
                similar += lines[S, x]
                apart += abs(picture[y + REACH, left + PAD + x] - target[y + REACH, left + PAD + x])
            sums[y, 0] += similar
            sums[y, 1] += apart


@kernel
def gradient_rows(
    picture: FloatArray,
    target: FloatArray,
    slopes: FloatArray,
    dissimilarity: float,
    gradient: FloatArray,  # (H, 3 W)
    start: int,
    stop: int,
) -> None:
    """Gradient of (1 - dissimilarity) mean |a - b| + dissimilarity (1 - mean SSIM)."""
    height, width = gradient.shape
    taps = np.empty(2 * TAPS, np.float32)
    _window(taps)
    w0, w1, w2, w3, w4, w5 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5]
    near = _F((1.0 - dissimilarity) / (height * width))
    alike = _F(dissimilarity / (height * width))
    Q, P, M_LINE, Q_LINE, P_LINE, A, B = TAPS, 2 * TAPS, 33, 34, 35, 36, 37
    lines = np.zeros((38, IN), np.float32)
    for left in range(0, width, OUT):
        n = min(OUT, width - left)
        for y in range(start, start + TAPS - 1):
            for x in range(IN):
                lines[y % TAPS, x] = slopes[0, y, left + x]
                lines[Q + y % TAPS, x] = slopes[1, y, left + x]
                lines[P + y % TAPS, x] = slopes[2, y, left + x]
        for y in range(start, stop):
            slot = (y + TAPS - 1) % TAPS
            for x in range(IN):
                lines[slot, x] = slopes[0, y + TAPS - 1, left + x]
                lines[Q + slot, x] = slopes[1, y + TAPS - 1, left + x]
                lines[P + slot, x] = slopes[2, y + TAPS - 1, left + x]
            for x in range(OUT):
                lines[A, x] = picture[y + REACH, left + PAD + x]
                lines[B, x] = target[y + REACH, left + PAD + x]
            turn = TAPS - y % TAPS
            for x in range(IN):
                m, q, p = _ZERO, _ZERO, _ZERO
                for k in range(TAPS):
                    w = taps[turn + k]
                    m += w * lines[k, x]
                    q += w * lines[Q + k, x]
                    p += w * lines[P + k, x]
                lines[M_LINE, x] = m
                lines[Q_LINE, x] = q
                lines[P_LINE, x] = p
            for x in range(OUT):
                m = (
                    w0 * (lines[M_LINE, x] + lines[M_LINE, x + 30])
                    + w1 * (lines[M_LINE, x + 3] + lines[M_LINE, x + 27])
                    + w2 * (lines[M_LINE, x + 6] + lines[M_LINE, x + 24])
                    + w3 * (lines[M_LINE, x + 9] + lines[M_LINE, x + 21])
                    + w4 * (lines[M_LINE, x + 12] + lines[M_LINE, x + 18])
                    + w5 * lines[M_LINE, x + 15]
                )
                q = (
                    w0 * (lines[Q_LINE, x] + lines[Q_LINE, x + 30])
                    + w1 * (lines[Q_LINE, x + 3] + lines[Q_LINE, x + 27])
                    + w2 * (lines[Q_LINE, x + 6] + lines[Q_LINE, x + 24])
                    + w3 * (lines[Q_LINE, x + 9] + lines[Q_LINE, x + 21])
                    + w4 * (lines[Q_LINE, x + 12] + lines[Q_LINE, x + 18])
                    + w5 * lines[Q_LINE, x + 15]
                )
                p = (
                    w0 * (lines[P_LINE, x] + lines[P_LINE, x + 30])
                    + w1 * (lines[P_LINE, x + 3] + lines[P_LINE, x + 27])
                    + w2 * (lines[P_LINE, x + 6] + lines[P_LINE, x + 24])
                    + w3 * (lines[P_LINE, x + 9] + lines[P_LINE, x + 21])
                    + w4 * (lines[P_LINE, x + 12] + lines[P_LINE, x + 18])
                    + w5 * lines[P_LINE, x + 15]
                )
                a, b = lines[A, x], lines[B, x]
                sign = _ONE if a > b else _ZERO
                sign = -_ONE if a < b else sign
                lines[A, x] = near * sign - alike * (m + _TWO * a * q + b * p)
            for x in range(n):
                gradient[y, left + x] = lines[A, x]


# --- Kernels of the optimiser, and of what density control sums up along with it.


_BETA1, _BETA2, _EPSILON = _F(0.9), _F(0.999), _F(1e-15)
_REST1, _REST2 = _F(1.0 - 0.9), _F(1.0 - 0.999)
_AHEAD = 12  # rows whose memory is asked for before they are needed
_LINE = 16  # numbers of a cache line


@kernel
def adam_rows(
    rows: IntArray,  # (n,) rows to change
    gradient: FloatArray,  # (n, C)
    values: FloatArray,  # (N, C) changed
    first: FloatArray,  # (N, C) changed: running mean of the gradient
    second: FloatArray,  # (N, C) changed: running mean of its square
    rates: FloatArray,  # (C,) learning rate over the first bias correction
    correction: float,  # 1 / the second bias correction
    start: int,
    stop: int,
) -> None:
    """One step of Adam (Kingma 2015) for rows[start:stop]; all other rows rest."""
    n_columns = values.shape[1]
    unbias = _F(correction)
    for k in range(start, stop):
        ahead = n_columns * rows[min(k + _AHEAD, stop - 1)]
        for c in range(ahead, ahead + n_columns, _LINE):
            prefetch(values, c)
            prefetch(first, c)
            prefetch(second, c)
        i = rows[k]
        for c in range(n_columns):
            g = gradient[k, c]
            m = _BETA1 * first[i, c] + _REST1 * g
            v = _BETA2 * second[i, c] + _REST2 * (g * g)
            first[i, c] = m
            second[i, c] = v
            values[i, c] -= rates[c] * np.divide(m, _F(math.sqrt(v * unbias)) + _EPSILON)


@kernel
def add_view(
    rows: IntArray,  # (n,) splats that a view draws, each once
    screen: FloatArray,  # (n,)
    gradient: FloatArray,  # (N,) changed: ``screen`` is added
    n_views: IntArray,  # (N,) changed: 1 is added
) -> None:
    """Count a view of the splats ``rows``."""
    for k in range(len(rows)):
        gradient[rows[k]] += screen[k]
        n_views[rows[k]] += 1
