"""Lists of the contributions to pixels: which splat, with what weight, front to back."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gaga_core.raster.cuda.view import TILE, View

_ENTRIES = 1 << 25  # (tile entries x tile pixels) of one band: bounds what listing may allocate
_EVERYTHING = 1 << 30


@dataclass(frozen=True, eq=False)
class Entries:
    """Contributions of a band of pixels: pixels ascending, in each front to back."""

    pixels: Tensor  # (m,) int64 flat index in the whole picture
    splats: Tensor  # (m,) int64 row of the view
    weights: Tensor  # (m,) float64 alpha T
    after: Tensor  # (m,) float64 transmittance behind the splat


def list_entries(gsplat: Any, view: View, alpha_max: float) -> Iterator[Entries]:
    """All contributions, band by band of tile rows.

    Bands, not depth ranges: a pixel that is done in one range would go on in the next.
    """
    if view.is_empty:
        return
    starts = [*view.offsets[0, :, 0].tolist(), len(view.ids)]
    top = 0
    for row in range(1, len(starts)):
        is_last = row == len(starts) - 1
        if is_last or (starts[row + 1] - starts[top]) * TILE * TILE > _ENTRIES:
            if starts[row] > starts[top]:
                yield _band(gsplat, view, alpha_max, top, row)
            top = row


def measure_alpha_max(gsplat: Any, device: torch.device) -> float:
    """gsplat's upper limit of alpha, which differs between versions: one opaque splat."""
    one = torch.ones((1, 1), device=device)
    centre = torch.full((1, 1, 2), 0.5, device=device)
    conic = torch.tensor([[[1.0, 0.0, 1.0]]], device=device)
    tile = torch.zeros((1, 1, 1), dtype=torch.int32, device=device)
    ids = torch.zeros(1, dtype=torch.int32, device=device)
    _, alpha = gsplat.rasterize_to_pixels(
        centre, conic, one[..., None], one, TILE, TILE, TILE, tile, ids
    )
    return float(alpha[0, 0, 0, 0])


def _band(gsplat: Any, view: View, alpha_max: float, top: int, bottom: int) -> Entries:
    """Contributions in tile rows ``top`` to ``bottom``."""
    is_last = bottom == view.offsets.shape[1]
    end = len(view.ids) if is_last else int(view.offsets[0, bottom, 0])
    first = top * TILE
    height = min(bottom * TILE, view.height) - first
    means2d = view.means2d - torch.tensor([0.0, first], device=view.means2d.device)
    offsets = view.offsets[:, top:bottom].contiguous()
    ids = view.ids[:end].contiguous()
    size = (view.width, height, TILE)
    splat = (means2d, view.conics, view.opacities)
    if hasattr(gsplat, "rasterize_contributing_gaussian_ids"):  # gsplat 1.6
        n_each, _ = gsplat.rasterize_num_contributing_gaussians(*splat, offsets, ids, *size)
        table, weights = gsplat.rasterize_contributing_gaussian_ids(
            *splat, offsets, ids, *size, n_each
        )
        filled = table.reshape(height * view.width, -1) >= 0
        pixels = torch.nonzero(filled)[:, 0]
        splats = table.reshape(filled.shape)[filled].long()
        w = weights.reshape(filled.shape)[filled].double()
    else:
        clear = torch.ones((1, height, view.width), device=means2d.device)
        splats, pixels, _ = gsplat.rasterize_to_indices_in_range(
            0, _EVERYTHING, clear, *splat, *size, offsets, ids
        )
        w = _weights_of(means2d[0], view, alpha_max, splats, pixels)
    after = 1 - _running_sum(w, pixels)
    return Entries(pixels + first * view.width, splats, w, after)


def _weights_of(
    means2d: Tensor, view: View, alpha_max: float, splats: Tensor, pixels: Tensor
) -> Tensor:
    """alpha T (m,) of listed contributions: gsplat 1.5 lists them without their weights."""
    u, v = pixels % view.width + 0.5, pixels // view.width + 0.5
    dx, dy = means2d[splats, 0] - u, means2d[splats, 1] - v
    a, b, c = view.conics[0, splats].unbind(dim=1)
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alpha = (view.opacities[0, splats] * torch.exp(-sigma)).clamp_max(alpha_max)
    logs = torch.log1p(-alpha.double())
    return alpha * torch.exp(_running_sum(logs, pixels) - logs)


def _running_sum(values: Tensor, pixels: Tensor) -> Tensor:
    """Sums (m,) of ``values`` (m,) float64 up to each entry, started again at every pixel."""
    total = torch.cumsum(values, dim=0)
    _, lengths = torch.unique_consecutive(pixels, return_counts=True)
    last = torch.cumsum(lengths, dim=0) - 1
    before = torch.cat([total.new_zeros(1), total[last[:-1]]]) if len(last) else total
    return total - torch.repeat_interleave(before, lengths)
