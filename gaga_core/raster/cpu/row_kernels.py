"""From the splats of a tile to rows of 16 pixels: what both ways of training walk over.

`list_rows` goes ahead of the pixels with a few splats: it reads their columns, scattered in memory,
and lists the rows of the tile that each of them reaches. What follows has no branch but the ends of
short loops whose lengths are known long before, and waits for no memory.

Lengths are divided by the root of 8, so that exponents come as an eighth: `exp8` wants them so.
"""

import math
from typing import Any

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray
from gaga_core.kernels import kernel
from gaga_core.raster.cpu.project_kernels import OPACITY, TILE, Y0, Y1, H, R, S, U, V
from gaga_core.simd_kernels import (
    fill,
    lane_numbers,
    larger,
    load,
    log2_above,
    run_at_least,
    store,
)

AT_ONCE = 32  # splats of a tile that are listed at once
ROWS = AT_ONCE * TILE + TILE  # room for their rows
# Columns of a listed splat. SMALL_S is S over the root of 8; U and V count from the middle of the
# tile's first pixel.
SMALL_S, ALPHA, RED, GREEN, BLUE, AT_U, AT_V, PLAIN_S, PLAIN_R, N_COLUMNS = range(10)
# Rows of the list of rows: number in the tile, shift and rest such that at column x the exponent is
# 8 (rest - (SMALL_S x + shift)^2).
ROW, SHIFT, REST, N_LISTS = range(4)
_F = np.float32
_ZERO, _HALF, _ONE = _F(0), _F(0.5), _F(1)
_EIGHTH, _ROOT = _F(1 / 8), _F(math.sqrt(1 / 8))
# Of log2 of 255 alpha the eighth of the logarithm; what float32 may be wrong by lies in the 0.09
# of `log2_above`, of which at least 0.003 is left.
_LN2_8, _LOG255 = _F(math.log(2) / 8), _F(math.log2(255))
_LAST = _F(TILE - 1)


@kernel
def exp8(y: Any) -> Any:
    """exp(8 y) of a vector in [-0.7125, 0], as `blend_kernels._exp` computes exp."""
    p = y * _F(0.0058484054) + _F(0.039789192)
    p = y * p + _F(0.16599582)
    p = y * p + _F(0.4998927)
    p = y * p + _F(0.9999943)
    p = y * p + _ONE
    p = p * p
    p = p * p
    return p * p


@kernel
def open_rows(planes: FloatArray, n_rows: int, n_columns: int) -> None:
    """Clear ``planes`` (TILE, C, TILE) of a tile, and set the transmittances, its first plane."""
    planes[:] = _ZERO
    for y in range(TILE):
        for x in range(TILE):
            planes[y, 0, x] = _ONE if y < n_rows and x < n_columns else -_ONE


@kernel
def is_done(planes: FloatArray) -> bool:
    """Whether no pixel of the tile lets anything through."""
    most = load(planes, 0)
    for y in range(1, TILE):
        most = larger(most, load(planes, y * planes.shape[1] * TILE))
    end: int = run_at_least(most, fill(_ZERO))[1]
    return end == 0


@kernel
def list_rows(
    splats: FloatArray,
    colors: FloatArray,  # (n, 3)
    ids: IntArray,
    start: int,
    stop: int,  # entries of ``ids`` that are listed, AT_ONCE at most
    left: int,
    top: int,  # first pixel of the tile
    listed: FloatArray,  # (AT_ONCE, N_COLUMNS)
    rows: FloatArray,  # (N_LISTS, ROWS)
    spans: LongArray,  # (AT_ONCE, 2) first of its rows, and the one behind the last
) -> None:
    """List splats, and the rows of the tile in which their ellipse {alpha >= 1/255} has a pixel.

    A few rows more, at most, and none that has a gap between them: an ellipse is convex.
    """
    x = lane_numbers()
    n = 0
    for q in range(stop - start):
        k = ids[start + q]
        u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
        s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
        small = s * _ROOT
        listed[q, SMALL_S] = small
        listed[q, ALPHA] = opacity
        for c in range(3):
            listed[q, RED + c] = colors[k, c]
        listed[q, AT_U] = u
        listed[q, AT_V] = v
        listed[q, PLAIN_S] = s
        listed[q, PLAIN_R] = r
        y0 = max(_ZERO, splats[k, Y0] - _F(top))
        y1 = min(_F(TILE), splats[k, Y1] - _F(top))
        dy = x + (y0 - v)
        shift = dy * (-small * r) + (-small * u)
        rest = dy * dy * (-h * _EIGHTH)
        store(rows, ROW * ROWS + n, x + y0)
        store(rows, SHIFT * ROWS + n, shift)
        store(rows, REST * ROWS + n, rest)
        # The least distance along the row: 0 if the ellipse's axis crosses it.
        apart = larger(fill(_ZERO), larger(shift, (shift + small * _LAST) * -_ONE))
        least = -(log2_above(opacity) + _LOG255) * _LN2_8
        first, end = run_at_least(rest - apart * apart, fill(least))
        end = min(end, int(y1 - y0))
        spans[q, 0] = n + first
        spans[q, 1] = n + end
        n += max(0, end)
