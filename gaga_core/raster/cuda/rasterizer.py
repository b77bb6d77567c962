"""The gsplat backend of `raster.base.Rasterizer`."""

import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import (
    Frame,
    LabelFrame,
    PixelWeights,
    check_pixels,
    check_render,
    check_vote,
)
from gaga_core.raster.cuda.view import (
    CHANNELS,
    TILE,
    View,
    blend,
    fetch,
    indices,
    memory_in_words,
    prepare,
    send,
)
from gaga_core.raster.vote_slots import VoteSlots

# --- Lists of the contributions to pixels: which splat, with what weight, front to back.


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


class CudaRasterizer:
    """gsplat behind the operators of `raster.base`; arrays go in and come out as numpy.

    Ask `gaga_core.raster.choose` for one: it knows from `raster.probe` whether gsplat runs here.
    Raises ``GagaError`` when there is no such device or no gsplat.
    """

    name = "cuda"

    def __init__(self, device: str = "cuda") -> None:
        if torch.device(device).type == "cuda" and not torch.cuda.is_available():
            raise GagaError("No CUDA device answers. Choose the backend cpu.")
        try:
            self._gsplat: Any = importlib.import_module("gsplat")
        except ImportError as error:
            raise GagaError(
                "The package gsplat cannot be loaded. Choose the backend cpu."
            ) from error
        self._device = torch.device(device)
        with torch.no_grad():
            self._alpha_max = measure_alpha_max(self._gsplat, self._device)

    @memory_in_words()
    @torch.no_grad()
    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        *,
        channels: FloatArray | None = None,
        background: DoubleArray | FloatArray | None = None,
    ) -> Frame:
        """Blend SH color, or ``channels`` (N, C), and depth over ``background`` (C,)."""
        n_channels = check_render(gaussians, channels, background)
        behind = send(np.zeros(n_channels) if background is None else background, self._device)
        view = self._prepare(gaussians, camera)
        shape = (camera.height, camera.width)
        if view.is_empty:
            image = behind.expand(*shape, n_channels)
            return Frame(fetch(image), *(np.zeros(shape, np.float32) for _ in range(3)))
        if channels is None:
            colors = self._sh_colors(gaussians, camera, view)
        else:
            colors = send(channels[indices(view)], self._device)
        colors = torch.cat([colors, view.depths[0, :, None]], dim=1)
        image, alpha = blend(self._gsplat, view, colors)
        depth = torch.where(alpha > 0, image[..., -1] / alpha.clamp_min(1e-12), 0.0)
        image = image[..., :-1] + (1 - alpha)[..., None] * behind
        return Frame(fetch(image), fetch(alpha), fetch(depth), fetch(self._median(view)))

    @memory_in_words()
    @torch.no_grad()
    def weights(
        self, gaussians: Gaussians, camera: Camera, pixels: LongArray, *, w_min: float = 0.0
    ) -> PixelWeights:
        """Blending weights above ``w_min`` of ``pixels`` (P,), flat indices v * width + u."""
        check_pixels(camera, pixels)
        n_pixels = camera.width * camera.height
        view = self._prepare(gaussians, camera)
        wanted = torch.zeros(n_pixels, dtype=torch.bool, device=self._device)
        wanted[torch.tensor(pixels, dtype=torch.int64, device=self._device)] = True
        owners, indices, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [_NOTHING]
        for entries in list_entries(self._gsplat, view, self._alpha_max):
            weights = entries.weights.float()
            keep = wanted[entries.pixels] & (weights > w_min)
            owners.append(entries.pixels[keep].cpu().numpy())
            indices.append(view.index[entries.splats[keep]].cpu().numpy())
            values.append(fetch(weights[keep]))
        owner = np.concatenate(owners)
        first = np.searchsorted(owner, pixels)
        counts = np.searchsorted(owner, pixels, side="right") - first
        indptr = np.append(0, np.cumsum(counts)).astype(np.int64)
        rows = np.repeat(first - indptr[:-1], counts) + np.arange(indptr[-1])
        return PixelWeights(
            indptr,
            np.concatenate(indices)[rows].astype(np.int32),
            np.concatenate(values)[rows].astype(np.float32),
        )

    @memory_in_words()
    @torch.enable_grad()
    def vote(
        self,
        gaussians: Gaussians,
        camera: Camera,
        labels: IntArray,
        histogram: FloatArray | VoteSlots,
    ) -> None:
        """histogram[i, k] += sum of w_i over pixels with label k; negative labels are ignored.

        A picture is W c for channels c; so the gradient of sum(picture * mask of k) by c is the
        column k of the votes, and gsplat's backward pass gives 32 of them at once.
        """
        check_vote(gaussians, camera, labels, histogram)
        view = self._prepare(gaussians, camera)
        if view.is_empty:
            return
        present = np.unique(labels[labels >= 0])
        picture = torch.tensor(labels, device=self._device)
        votes = []
        for start in range(0, len(present), CHANNELS):
            chunk = torch.tensor(present[start : start + CHANNELS], device=self._device)
            one_hot = (picture[..., None] == chunk).float()
            zeros = torch.zeros(
                (len(view.index), len(chunk)), device=self._device, requires_grad=True
            )
            image, _ = blend(self._gsplat, view, zeros)
            votes.append(fetch(torch.autograd.grad(image, zeros, one_hot)[0]))
        # Only now: a card that is full half way leaves the histogram as it was.
        rows = indices(view)
        for start, columns in zip(range(0, len(present), CHANNELS), votes, strict=True):
            own = present[start : start + CHANNELS]
            if isinstance(histogram, VoteSlots):
                histogram.add(rows.astype(np.int32), own, columns)
            else:
                histogram[np.ix_(rows, own)] += columns

    @memory_in_words()
    @torch.no_grad()
    def label_splat(self, gaussians: Gaussians, camera: Camera, labels: IntArray) -> LabelFrame:
        """Exact argmax over ``labels`` (N,) of summed weights; the smaller label when equal."""
        check_shape("labels", labels, (len(gaussians),), np.int32)
        if labels.min(initial=0) < 0:
            raise ValueError("labels: must not be negative (0 = none)")
        view = self._prepare(gaussians, camera)
        shape = (camera.height, camera.width)
        best = torch.zeros(shape, device=self._device)
        winner = torch.zeros(shape, dtype=torch.int32, device=self._device)
        if view.is_empty:
            return LabelFrame(winner.cpu().numpy(), fetch(best))
        mine = torch.tensor(labels[indices(view)], device=self._device)
        values = torch.unique(mine)
        for start in range(0, len(values), CHANNELS):
            chunk = values[start : start + CHANNELS]
            image, _ = blend(self._gsplat, view, (mine[:, None] == chunk).float())
            weight = image.amax(dim=2)
            # The first of equal ones: argmax does not promise which it takes.
            place = torch.arange(len(chunk), device=self._device)
            tied = torch.where(image == weight[..., None], place, len(chunk))
            better = weight > best
            winner = torch.where(better, chunk[tied.amin(dim=2)], winner)
            best = torch.where(better, weight, best)
        return LabelFrame(winner.cpu().numpy(), fetch(best))

    def _prepare(self, gaussians: Gaussians, camera: Camera) -> View:
        return prepare(self._gsplat, gaussians, camera, self._device)

    def _sh_colors(self, gaussians: Gaussians, camera: Camera, view: View) -> Tensor:
        """SH color (n, 3) of the splats in view, seen from the camera's position; 0 where it is no
        number."""
        rows = indices(view)
        directions = gaussians.means[rows].astype(np.float64) - camera.position
        sh = send(gaussians.sh[rows], self._device)
        finite = torch.isfinite(sh)
        color = 0.5 + self._gsplat.spherical_harmonics(
            gaussians.sh_degree, send(directions, self._device), torch.where(finite, sh, 0.0)
        )
        return torch.where((color > 0) & (color < 1e30) & finite.all(dim=1), color, 0.0)

    def _median(self, view: View) -> Tensor:
        """Depth (H, W) at which T falls to 1/2, 0 if never."""
        depth = torch.zeros(view.height * view.width, device=self._device)
        for entries in list_entries(self._gsplat, view, self._alpha_max):
            crosses = (entries.after <= 0.5) & (entries.after + entries.weights > 0.5)
            depth[entries.pixels[crosses]] = view.depths[0, entries.splats[crosses]]
        return depth.reshape(view.height, view.width)


_NOTHING: FloatArray = np.zeros(0, np.float32)
