"""How splats are packed for the graphics card: 43 bytes each without view-dependent color.

A splat of degree 3 takes 91 bytes in data textures; depth order and projected splats (`splats`) add
28. The files of most trainers hold 248.
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, UInt8Array, UInt16Array, UInt32Array
from gaga_core.gaussians import Gaussians
from gaga_core.scene.scene import Placements

WIDTH = 2048  # texels of a line of every data texture
_COMPARED = 1 << 16  # rows at a time, from both ends: what changed is mostly found in the first


def sh_layers(n_sh: int) -> int:
    """Layers of eight bytes that hold ``n_sh`` - 1 coefficients of three colors."""
    return -(-3 * (n_sh - 1) // 8)


def pieces(rows: AnyArray, start: int) -> list[tuple[int, int, int, AnyArray]]:
    """Rectangles of texels that ``rows`` from ``start`` on fill: (first, width, height, rows)."""
    stop = start + len(rows)
    found = []
    at = start
    while at < stop:
        column = at % WIDTH
        if column == 0 and stop - at >= WIDTH:
            width, height = WIDTH, (stop - at) // WIDTH
        else:
            width, height = min(WIDTH - column, stop - at), 1
        n = width * height
        found.append((at, width, height, rows[at - start : at - start + n]))
        at += n
    return found


def log_scale_range(log_scales: FloatArray) -> tuple[float, float]:
    """Low end and range of the finite log scales (N, 3); at most 40 wide (a factor of 10^17)."""
    finite = log_scales
    if not np.isfinite(log_scales.sum(dtype=np.float64)):
        finite = log_scales[np.isfinite(log_scales)]
    high = float(finite.max(initial=-40.0))
    low = max(float(finite.min(initial=high)), high - 40.0)
    return low, max(high - low, 1e-3)


def pack_shape(
    gaussians: Gaussians, start: int, stop: int, scale_range: tuple[float, float]
) -> AnyArray:
    """Unit quaternion, log scales and opacity of rows start..stop as 8 x 16 bits: (K, 4) uint32.

    Fixed point is finer than halfs here: 3e-5 in a quaternion, 1e-4 in a scale that spans e^7.
    Rows with anything that is not finite, or a quaternion of no length, get opacity 0.
    """
    rows = slice(start, stop)
    quats, logs = gaussians.quats[rows], gaussians.log_scales[rows]
    means, logits = gaussians.means[rows], gaussians.logit_opacities[rows]
    words: UInt16Array = np.empty((len(quats), 8), np.uint16)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        norm = np.sqrt(np.einsum("ij,ij->i", quats, quats))
        sound = np.isfinite(norm) & (norm > 0) & np.isfinite(logs.sum(axis=1) + means.sum(axis=1))
        sound &= ~np.isnan(logits)
        scale = np.where(sound, 32767.5 / np.where(sound, norm, 1), 0).astype(np.float32)
        unit = np.where(sound[:, None], quats, 0) * scale[:, None]
        words[:, :4] = np.clip(unit + np.float32(32768.0), 0, 65535)
        low, span = scale_range
        fixed = (np.where(sound[:, None], logs, low) - np.float32(low)) * np.float32(65535 / span)
        words[:, 4:7] = np.clip(fixed + np.float32(0.5), 0, 65535)
        opacity = np.float32(65535) / (np.float32(1) + np.exp(-np.where(sound, logits, -100)))
        words[:, 7] = opacity + np.float32(0.5)
    return words.view(np.uint32)


def pack_sh(gaussians: Gaussians, start: int, stop: int) -> tuple[AnyArray, AnyArray]:
    """Color of rows start..stop: (K, 4) halfs, and (L, K) uint64 of eight bytes, layer by layer.

    The halfs are the DC coefficients and the scale of the rest: the largest of its numbers, of
    which every coefficient is a share in 127 steps. Where one is not finite, neither is the scale.
    """
    n, n_sh = stop - start, gaussians.sh.shape[1]
    flat = gaussians.sh[start:stop].reshape(n, -1)
    halfs = np.zeros((n, 4), np.float16)
    packed = np.zeros((n, 8 * sh_layers(n_sh)), np.int8)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        halfs[:, :3] = flat[:, :3]
        if n_sh > 1:
            rest = flat[:, 3:]
            halfs[:, 3] = np.maximum(rest.max(axis=1), -rest.min(axis=1))
            scale = halfs[:, 3].astype(np.float32)
            steps = np.where((scale > 0) & np.isfinite(scale), 127 / scale, 0)
            shares = rest * steps[:, None].astype(np.float32)
            np.rint(shares, out=shares)
            np.clip(shares, -127, 127, out=shares)
            packed[:, : shares.shape[1]] = shares
    return halfs, np.ascontiguousarray(packed.view(np.uint64).T)


@dataclass(frozen=True, eq=False)
class PackedSplats:
    """Rows as the textures hold them."""

    means: FloatArray  # (K, 3)
    shape: AnyArray  # (K, 4) uint32, of `pack_shape`
    color: AnyArray  # (K, 4) halfs
    sh: AnyArray  # (L, K) uint64, of `pack_sh`

    def __len__(self) -> int:
        return len(self.means)


def pack_splats(
    gaussians: Gaussians, start: int, stop: int, scale_range: tuple[float, float]
) -> PackedSplats:
    """Pack the rows start..stop."""
    shape = pack_shape(gaussians, start, stop, scale_range)
    return PackedSplats(gaussians.means[start:stop], shape, *pack_sh(gaussians, start, stop))


def words_of_colors(colors: UInt8Array) -> UInt32Array:
    """Colors (K, 3 or 4) of a byte a channel as a texel each (K,)."""
    words = np.zeros((len(colors), 4), np.uint8)
    words[:, : colors.shape[1]] = colors
    found: UInt32Array = words.view("<u4")[:, 0]
    return found


def placement_texels(placements: Placements) -> AnyArray:
    """Texels (P, 16, 4) float32: matrix 3, color 3, rotation back of directions 3, opacity 1.

    Directions are turned by the rotation nearest to the linear part (polar decomposition).
    """
    texels = np.zeros((len(placements), 16, 4), np.float32)
    texels[:, 0:3] = placements.matrix
    texels[:, 3:6] = placements.color
    u, _, vt = np.linalg.svd(np.asarray(placements.matrix, np.float64)[:, :, :3])
    texels[:, 6:9, :3] = np.swapaxes(u @ vt, 1, 2)
    texels[:, 9, 0] = placements.opacity
    return texels


def changed_range(before: AnyArray, after: AnyArray) -> tuple[int, int]:
    """The shortest range of rows outside of which two columns agree; rows added are changed.

    Rows that were cut off are not: the range lies in ``after`` (0, 0 when nothing is to be sent).
    """
    n = min(len(before), len(after))
    start = n
    for at in range(0, n, _COMPARED):
        differs = before[at : min(at + _COMPARED, n)] != after[at : min(at + _COMPARED, n)]
        if differs.any():
            start = at + int(differs.argmax())
            break
    if len(after) > n:
        return start, len(after)
    for stop in range(n, start, -_COMPARED):
        first = max(stop - _COMPARED, start)
        differs = before[first:stop] != after[first:stop]
        if differs.any():
            return start, first + int(np.flatnonzero(differs)[-1]) + 1
    return 0, 0
