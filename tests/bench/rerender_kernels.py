"""What training costs without cached rows: the backward pass of a 16-channel render."""

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray
from gaga_core.kernels import kernel
from gaga_core.raster.cpu.blend_kernels import _exp, _is_done, _open_tile
from gaga_core.raster.cpu.project_kernels import OPACITY, TILE, Y0, Y1, H, R, S, U, V

_F = np.float32
_ZERO, _HALF = _F(0), _F(0.5)
_ALPHA_MIN, _ALPHA_MAX, _T_MIN = _F(1 / 255), _F(0.99), _F(1e-4)
_LOWEST = _F(-5.7)
_WIDE = 16


@kernel
def blend_wide_backward(
    splats: FloatArray,
    offsets: LongArray,
    ids: IntArray,
    slopes: FloatArray,  # (tiles, TILE, 16, TILE) gradient of the picture, by tile
    size: LongArray,  # (2,) width, height
    out: FloatArray,  # (n, 16) gradient of the features, added to
) -> None:
    """The mirror of `blend_wide`: out[k] += sum over pixels of w_k times the pixel's gradient."""
    n_tiles_x = (size[0] + TILE - 1) // TILE
    T = np.empty((TILE, TILE), np.float32)
    weights = np.empty(TILE, np.float32)
    for tile in range(offsets.shape[0] - 1):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        _open_tile(T, min(TILE, size[1] - top), min(TILE, size[0] - left))
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            for y in range(max(0, int(splats[k, Y0]) - top), min(TILE, int(splats[k, Y1]) - top)):
                dy = _F(y) - v
                shift = -s * (u + r * dy)
                rest = -h * dy * dy
                for x in range(TILE):
                    e = s * _F(x) + shift
                    a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, rest - e * e)))
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = T[y, x]
                    after = before - before * a
                    goes_on = after >= _T_MIN
                    weights[x] = a * before if goes_on else _ZERO
                    T[y, x] = after if goes_on else -abs(before)
                for c in range(_WIDE):
                    total = _ZERO
                    for x in range(TILE):
                        total += weights[x] * slopes[tile, y, c, x]
                    out[k, c] += total
            if (j & 15) == 15 and _is_done(T):
                break
