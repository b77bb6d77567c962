"""The functions of gsplat 1.5.3 that the CUDA backend calls, in plain torch, for machines without.

Written from gsplat's documented arguments and kernels: same shapes, dtypes, checks and order of
results, same image model (alpha up to 0.999). Tiles one after the other: for small pictures.
``contributors`` adds what gsplat 1.6 offers beside.
"""

import sys
from itertools import pairwise
from types import ModuleType

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.torch_reference import sh_basis

_ALPHA_MAX = 0.999
_CHANNELS = (1, 2, 3, 4, 5, 8, 9, 16, 17, 32)  # 1.5 pads other counts, 1.6 refuses them


def install(monkeypatch: pytest.MonkeyPatch, *, contributors: bool = False) -> ModuleType:
    """Make ``import gsplat`` find the stand-in."""
    module = ModuleType("gsplat")
    functions = [
        isect_tiles,
        isect_offset_encode,
        rasterize_to_pixels,
        rasterize_to_indices_in_range,
        spherical_harmonics,
    ]
    if contributors:
        functions += [rasterize_num_contributing_gaussians, rasterize_contributing_gaussian_ids]
    for function in functions:
        setattr(module, function.__name__, function)
    monkeypatch.setitem(sys.modules, "gsplat", module)
    return module


def spherical_harmonics(degree: int, dirs: Tensor, coeffs: Tensor) -> Tensor:
    assert dirs.shape == (len(coeffs), 3)
    assert coeffs.shape[1:] == ((degree + 1) ** 2, 3)
    directions = dirs.double()
    basis = sh_basis(directions / directions.norm(dim=1, keepdim=True))
    return torch.einsum("ns,nsc->nc", basis[:, : coeffs.shape[1]].float(), coeffs)


@torch.no_grad()
def isect_tiles(
    means2d: Tensor,
    radii: Tensor,
    depths: Tensor,
    tile_size: int,
    tile_width: int,
    tile_height: int,
    *,
    n_images: int,
) -> tuple[Tensor, Tensor, Tensor]:
    n = means2d.shape[1]
    assert not means2d.requires_grad
    assert means2d.shape == radii.shape == (1, n, 2)
    assert depths.shape == (1, n)
    assert n_images == 1
    assert (means2d.dtype, radii.dtype, depths.dtype) == (torch.float, torch.int, torch.float)
    size = torch.tensor([tile_width, tile_height])
    first = torch.floor((means2d[0] - radii[0]) / tile_size).clamp_min(0).minimum(size).int()
    last = torch.ceil((means2d[0] + radii[0]) / tile_size).clamp_min(0).minimum(size).int()
    keys, ids = [], []
    bits = depths[0].numpy().view(np.int32).astype(np.int64)
    for i in range(n):
        for y in range(int(first[i, 1]), int(last[i, 1])):
            for x in range(int(first[i, 0]), int(last[i, 0])):
                keys.append((y * tile_width + x) << 32 | int(bits[i]))
                ids.append(i)
    key = torch.tensor(keys, dtype=torch.int64)
    order = torch.argsort(key, stable=True)
    counts = (last - first).prod(dim=1)[None].int()
    return counts, key[order], torch.tensor(ids, dtype=torch.int32)[order]


def isect_offset_encode(
    isect_ids: Tensor, n_images: int, tile_width: int, tile_height: int
) -> Tensor:
    assert n_images == 1
    tiles = torch.arange(tile_width * tile_height)
    offsets = torch.searchsorted(isect_ids >> 32, tiles)
    return offsets.reshape(1, tile_height, tile_width).int()


def rasterize_to_pixels(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    width: int,
    height: int,
    tile_size: int,
    isect_offsets: Tensor,
    flatten_ids: Tensor,
) -> tuple[Tensor, Tensor]:
    assert colors.shape[:2] == means2d.shape[:2]
    assert colors.is_contiguous()
    assert colors.shape[-1] in _CHANNELS
    image = torch.zeros((height * width, colors.shape[-1]))
    alpha = torch.zeros(height * width)
    for pixels, ids, w in _tiles(
        means2d, conics, opacities, width, height, tile_size, isect_offsets, flatten_ids
    ):
        image = image.index_add(0, pixels, w @ colors[0, ids])
        alpha[pixels] = w.sum(dim=1)
    return image.reshape(1, height, width, -1), alpha.reshape(1, height, width, 1)


def rasterize_to_indices_in_range(
    range_start: int,
    range_end: int,
    transmittances: Tensor,
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    width: int,
    height: int,
    tile_size: int,
    isect_offsets: Tensor,
    flatten_ids: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    assert (range_start, range_end >= len(flatten_ids)) == (0, True)
    assert transmittances.shape == (1, height, width)
    assert bool((transmittances == 1).all())
    table = _table(means2d, conics, opacities, width, height, tile_size, isect_offsets, flatten_ids)
    pixels = torch.tensor([p for p, row in enumerate(table) for _ in row], dtype=torch.int64)
    splats = torch.tensor([i for row in table for i, _ in row], dtype=torch.int64)
    return splats, pixels, torch.zeros_like(pixels)


def rasterize_num_contributing_gaussians(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    offsets: Tensor,
    ids: Tensor,
    width: int,
    height: int,
    tile_size: int,
) -> tuple[Tensor, Tensor]:
    table = _table(means2d, conics, opacities, width, height, tile_size, offsets, ids)
    counts = torch.tensor([len(row) for row in table], dtype=torch.int32)
    alphas = torch.tensor([sum(w for _, w in row) for row in table])
    return counts.reshape(1, height, width), alphas.reshape(1, height, width)


def rasterize_contributing_gaussian_ids(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    offsets: Tensor,
    ids: Tensor,
    width: int,
    height: int,
    tile_size: int,
    num_contributing_gaussians: Tensor,
) -> tuple[Tensor, Tensor]:
    table = _table(means2d, conics, opacities, width, height, tile_size, offsets, ids)
    longest = int(num_contributing_gaussians.max())
    found = torch.full((len(table), longest), -1, dtype=torch.int32)
    weights = torch.zeros((len(table), longest))
    for p, row in enumerate(table):
        for k, (i, w) in enumerate(row):
            found[p, k], weights[p, k] = i, w
    return (
        found.reshape(1, height, width, longest),
        weights.reshape(1, height, width, longest),
    )


def _table(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    width: int,
    height: int,
    tile_size: int,
    offsets: Tensor,
    flatten_ids: Tensor,
) -> list[list[tuple[int, float]]]:
    """Of each pixel: splats and weights, front to back."""
    table: list[list[tuple[int, float]]] = [[] for _ in range(width * height)]
    for pixels, ids, w in _tiles(
        means2d, conics, opacities, width, height, tile_size, offsets, flatten_ids
    ):
        rows, columns = torch.nonzero(w, as_tuple=True)
        for p, i, x in zip(pixels[rows], ids[columns], w[rows, columns], strict=True):
            table[int(p)].append((int(i), float(x)))
    return table


def _tiles(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    width: int,
    height: int,
    tile_size: int,
    offsets: Tensor,
    flatten_ids: Tensor,
) -> list[tuple[Tensor, Tensor, Tensor]]:
    """Of each tile: pixels (p,), splats (k,) front to back, and weights (p, k)."""
    n = means2d.shape[1]
    assert conics.shape == (1, n, 3)
    assert opacities.shape == (1, n)
    assert offsets.dtype == flatten_ids.dtype == torch.int32
    tile_height, tile_width = offsets.shape[1:]
    assert offsets.shape[0] == 1
    assert tile_height * tile_size >= height
    assert tile_width * tile_size >= width
    ends = [*offsets.flatten().tolist(), len(flatten_ids)]
    result = []
    for tile, (start, end) in enumerate(pairwise(ends)):
        top, left = tile // tile_width * tile_size, tile % tile_width * tile_size
        v = torch.arange(top, min(top + tile_size, height))
        u = torch.arange(left, min(left + tile_size, width))
        vv, uu = (a.flatten() for a in torch.meshgrid(v, u, indexing="ij"))
        ids = flatten_ids[start:end].long()
        dx = means2d[0, ids, 0] - (uu[:, None] + 0.5)
        dy = means2d[0, ids, 1] - (vv[:, None] + 0.5)
        a, b, c = conics[0, ids].unbind(dim=1)
        sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
        alpha = (opacities[0, ids] * torch.exp(-sigma)).clamp_max(_ALPHA_MAX)
        alpha = torch.where((sigma < 0) | (alpha < 1 / 255), 0.0, alpha)
        after = torch.cumprod(1 - alpha, dim=1)
        before = torch.cat([torch.ones(len(vv), 1), after], dim=1)[:, :-1]
        done = torch.cummax(((after <= 1e-4) & (alpha > 0)).int(), dim=1).values if len(ids) else 0
        w = torch.where(torch.as_tensor(done) > 0, 0.0, alpha * before)
        result.append((vv * width + uu, ids, w))
    return result
