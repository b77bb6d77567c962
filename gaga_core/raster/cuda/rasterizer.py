"""The gsplat backend of `raster.base.Rasterizer`."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Frame, LabelFrame, PixelWeights
from gaga_core.raster.cuda.project import project

_TILE = 16
_CHANNELS = 32  # blended at once; gsplat has kernels for powers of two, and 32 fit small cards
_ROWS = 1 << 20  # Gaussians projected at once: float64 temporaries stay under 300 MB
_ENTRIES = 1 << 25  # (tile entries x tile pixels) of one band: bounds what listing may allocate
_EVERYTHING = 1 << 30


@dataclass(frozen=True, eq=False)
class _View:
    """What a camera sees, on the device: n splats in the order of the Gaussians, tiles listed."""

    index: Tensor  # (n,) int64 Gaussian
    means2d: Tensor  # (1, n, 2) float32 pixels
    conics: Tensor  # (1, n, 3) float32 upper triangle of the inverse covariance
    opacities: Tensor  # (1, n) float32
    depths: Tensor  # (1, n) float32
    offsets: Tensor  # (1, tile rows, tile columns) int32 where each tile's list begins
    ids: Tensor  # (M,) int32 rows, front to back inside a tile
    width: int
    height: int

    @property
    def is_empty(self) -> bool:
        return len(self.ids) == 0


@dataclass(frozen=True, eq=False)
class _Entries:
    """Contributions of a band of pixels: pixels rising, in each front to back."""

    pixels: Tensor  # (m,) int64 flat index in the whole picture
    splats: Tensor  # (m,) int64 row of the view
    weights: Tensor  # (m,) float64 alpha T
    after: Tensor  # (m,) float64 transmittance behind the splat


@contextmanager
def _memory_in_words() -> Iterator[None]:
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise GagaError(
            "The graphics card has not enough free memory for this scene. Choose the backend cpu."
        ) from error


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
            self._alpha_max = self._measure_alpha_max()

    @_memory_in_words()
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
        n_channels = 3
        if channels is not None:
            check_shape("channels", channels, (len(gaussians), "C"), np.float32)
            n_channels = channels.shape[1]
        if background is not None:
            check_shape("background", background, (n_channels,))
        behind = self._send(np.zeros(n_channels) if background is None else background)
        view = self._prepare(gaussians, camera)
        shape = (camera.height, camera.width)
        if view.is_empty:
            image = behind.expand(*shape, n_channels)
            return Frame(_fetch(image), *(np.zeros(shape, np.float32) for _ in range(3)))
        if channels is None:
            colors = self._sh_colors(gaussians, camera, view)
        else:
            colors = self._send(channels[_indices(view)])
        colors = torch.cat([colors, view.depths[0, :, None]], dim=1)
        image, alpha = self._blend(view, colors)
        depth = torch.where(alpha > 0, image[..., -1] / alpha.clamp_min(1e-12), 0.0)
        image = image[..., :-1] + (1 - alpha)[..., None] * behind
        return Frame(_fetch(image), _fetch(alpha), _fetch(depth), _fetch(self._median(view)))

    @_memory_in_words()
    @torch.no_grad()
    def weights(
        self, gaussians: Gaussians, camera: Camera, pixels: LongArray, *, w_min: float = 0.0
    ) -> PixelWeights:
        """Blending weights above ``w_min`` of ``pixels`` (P,), flat indices v * width + u."""
        check_shape("pixels", pixels, ("P",))
        n_pixels = camera.width * camera.height
        if len(pixels) and (pixels.min() < 0 or pixels.max() >= n_pixels):
            raise ValueError(f"pixels: flat indices must be in 0..{n_pixels - 1}")
        view = self._prepare(gaussians, camera)
        wanted = torch.zeros(n_pixels, dtype=torch.bool, device=self._device)
        wanted[torch.tensor(pixels, dtype=torch.int64, device=self._device)] = True
        owners, indices, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [_NOTHING]
        for entries in self._entries(view):
            weights = entries.weights.float()
            keep = wanted[entries.pixels] & (weights > w_min)
            owners.append(entries.pixels[keep].cpu().numpy())
            indices.append(view.index[entries.splats[keep]].cpu().numpy())
            values.append(_fetch(weights[keep]))
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

    @_memory_in_words()
    def vote(
        self, gaussians: Gaussians, camera: Camera, labels: IntArray, histogram: FloatArray
    ) -> None:
        """histogram[i, k] += sum of w_i over pixels with label k; negative labels are ignored.

        A picture is W c for channels c; so the gradient of sum(picture * mask of k) by c is the
        column k of the votes, and gsplat's backward pass gives 32 of them at once.
        """
        check_shape("labels", labels, (camera.height, camera.width), np.int32)
        check_shape("histogram", histogram, (len(gaussians), "K"), np.float32)
        if int(labels.max()) >= histogram.shape[1]:
            raise ValueError(f"labels: {labels.max()} has no column of {histogram.shape[1]}")
        if not (histogram.flags.c_contiguous and histogram.flags.writeable):
            raise ValueError("histogram: expected a writable C-contiguous array")
        view = self._prepare(gaussians, camera)
        if view.is_empty:
            return
        present = np.unique(labels[labels >= 0])
        picture = torch.tensor(labels, device=self._device)
        votes = []
        for start in range(0, len(present), _CHANNELS):
            chunk = torch.tensor(present[start : start + _CHANNELS], device=self._device)
            one_hot = (picture[..., None] == chunk).float()
            zeros = torch.zeros(
                (len(view.index), len(chunk)), device=self._device, requires_grad=True
            )
            image, _ = self._blend(view, zeros)
            votes.append(_fetch(torch.autograd.grad(image, zeros, one_hot)[0]))
        # Only now: a card that is full half way leaves the histogram as it was.
        rows = _indices(view)
        for start, columns in zip(range(0, len(present), _CHANNELS), votes, strict=True):
            histogram[np.ix_(rows, present[start : start + _CHANNELS])] += columns

    @_memory_in_words()
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
            return LabelFrame(winner.cpu().numpy(), _fetch(best))
        mine = torch.tensor(labels[_indices(view)], device=self._device)
        values = torch.unique(mine)
        for start in range(0, len(values), _CHANNELS):
            chunk = values[start : start + _CHANNELS]
            image, _ = self._blend(view, (mine[:, None] == chunk).float())
            weight = image.amax(dim=2)
            # The first of equal ones: argmax does not promise which it takes.
            place = torch.arange(len(chunk), device=self._device)
            tied = torch.where(image == weight[..., None], place, len(chunk))
            better = weight > best
            winner = torch.where(better, chunk[tied.amin(dim=2)], winner)
            best = torch.where(better, weight, best)
        return LabelFrame(winner.cpu().numpy(), _fetch(best))

    def _send(self, array: AnyArray) -> Tensor:
        return torch.tensor(np.asarray(array, np.float32), device=self._device)

    def _prepare(self, gaussians: Gaussians, camera: Camera) -> _View:
        """Project, then list the splats of each tile by depth (ties by index)."""
        pieces = [
            project(gaussians, slice(start, start + _ROWS), camera, self._device)
            for start in range(0, max(len(gaussians), 1), _ROWS)
        ]
        index, means2d, conics, opacities, depths, radii = (
            torch.cat(columns) for columns in zip(*pieces, strict=True)
        )
        tiles_x, tiles_y = -(-camera.width // _TILE), -(-camera.height // _TILE)
        offsets = torch.zeros((1, tiles_y, tiles_x), dtype=torch.int32, device=self._device)
        ids = torch.zeros(0, dtype=torch.int32, device=self._device)
        if len(index):
            _, keys, ids = self._gsplat.isect_tiles(
                means2d[None], radii[None], depths[None], _TILE, tiles_x, tiles_y, n_images=1
            )
            if len(ids):
                offsets = self._gsplat.isect_offset_encode(keys, 1, tiles_x, tiles_y)
        return _View(
            index,
            means2d[None],
            conics[None],
            opacities[None],
            depths[None],
            offsets.reshape(1, tiles_y, tiles_x),
            ids,
            camera.width,
            camera.height,
        )

    def _sh_colors(self, gaussians: Gaussians, camera: Camera, view: _View) -> Tensor:
        """SH color (n, 3) of the splats in view, seen from the camera's position."""
        rows = _indices(view)
        directions = self._send(gaussians.means[rows].astype(np.float64) - camera.position)
        sh = self._send(gaussians.sh[rows])
        color = self._gsplat.spherical_harmonics(gaussians.sh_degree, directions, sh) + 0.5
        return torch.where((color > 0) & (color < 1e30), color, 0.0)

    def _blend(self, view: _View, features: Tensor) -> tuple[Tensor, Tensor]:
        """Picture (H, W, C) of ``features`` (n, C) over black, and alpha (H, W)."""
        images = []
        for start in range(0, features.shape[1], _CHANNELS):
            chunk = features[:, start : start + _CHANNELS]
            image, alpha = self._gsplat.rasterize_to_pixels(
                view.means2d,
                view.conics,
                chunk[None].contiguous(),
                view.opacities,
                view.width,
                view.height,
                _TILE,
                view.offsets,
                view.ids,
            )
            images.append(image[0])
        return torch.cat(images, dim=2), alpha[0, ..., 0]

    def _median(self, view: _View) -> Tensor:
        """Depth (H, W) at which T falls to 1/2, 0 if never."""
        depth = torch.zeros(view.height * view.width, device=self._device)
        for entries in self._entries(view):
            crosses = (entries.after <= 0.5) & (entries.after + entries.weights > 0.5)
            depth[entries.pixels[crosses]] = view.depths[0, entries.splats[crosses]]
        return depth.reshape(view.height, view.width)

    def _entries(self, view: _View) -> Iterator[_Entries]:
        """All contributions, band by band of tile rows.

        Bands, not depth ranges: a pixel that is done in one range would go on in the next.
        """
        if view.is_empty:
            return
        starts = [*view.offsets[0, :, 0].tolist(), len(view.ids)]
        top = 0
        for row in range(1, len(starts)):
            is_last = row == len(starts) - 1
            if is_last or (starts[row + 1] - starts[top]) * _TILE * _TILE > _ENTRIES:
                if starts[row] > starts[top]:
                    yield self._band(view, top, row, starts[row])
                top = row

    def _band(self, view: _View, top: int, bottom: int, end: int) -> _Entries:
        """Contributions in tile rows ``top`` to ``bottom``, whose lists stop at ``end``."""
        first = top * _TILE
        height = min(bottom * _TILE, view.height) - first
        down = torch.tensor([0.0, first], device=self._device)
        means2d = view.means2d - down
        offsets = view.offsets[:, top:bottom].contiguous()
        ids = view.ids[:end].contiguous()
        size = (view.width, height, _TILE)
        splat = (means2d, view.conics, view.opacities)
        if hasattr(self._gsplat, "rasterize_contributing_gaussian_ids"):  # gsplat 1.6
            n_each, _ = self._gsplat.rasterize_num_contributing_gaussians(
                *splat, offsets, ids, *size
            )
            table, weights = self._gsplat.rasterize_contributing_gaussian_ids(
                *splat, offsets, ids, *size, n_each
            )
            filled = table.reshape(height * view.width, -1) >= 0
            pixels = torch.nonzero(filled)[:, 0]
            splats = table.reshape(filled.shape)[filled].long()
            w = weights.reshape(filled.shape)[filled].double()
        else:
            clear = torch.ones((1, height, view.width), device=self._device)
            splats, pixels, _ = self._gsplat.rasterize_to_indices_in_range(
                0, _EVERYTHING, clear, *splat, *size, offsets, ids
            )
            w = self._weights_of(means2d[0], view, splats, pixels)
        after = 1 - _running_sum(w, pixels)
        return _Entries(pixels + first * view.width, splats, w, after)

    def _weights_of(self, means2d: Tensor, view: _View, splats: Tensor, pixels: Tensor) -> Tensor:
        """alpha T (m,) of listed contributions: gsplat 1.5 lists them without their weights."""
        u, v = pixels % view.width + 0.5, pixels // view.width + 0.5
        dx, dy = means2d[splats, 0] - u, means2d[splats, 1] - v
        a, b, c = view.conics[0, splats].unbind(dim=1)
        sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
        alpha = (view.opacities[0, splats] * torch.exp(-sigma)).clamp_max(self._alpha_max)
        logs = torch.log1p(-alpha.double())
        return alpha * torch.exp(_running_sum(logs, pixels) - logs)

    def _measure_alpha_max(self) -> float:
        """gsplat's upper limit of alpha, which differs between versions: one opaque splat."""
        one = torch.ones((1, 1), device=self._device)
        centre = torch.full((1, 1, 2), 0.5, device=self._device)
        conic = torch.tensor([[[1.0, 0.0, 1.0]]], device=self._device)
        tile = torch.zeros((1, 1, 1), dtype=torch.int32, device=self._device)
        ids = torch.zeros(1, dtype=torch.int32, device=self._device)
        _, alpha = self._gsplat.rasterize_to_pixels(
            centre, conic, one[..., None], one, _TILE, _TILE, _TILE, tile, ids
        )
        return float(alpha[0, 0, 0, 0])


_NOTHING: FloatArray = np.zeros(0, np.float32)


def _fetch(tensor: Tensor) -> FloatArray:
    result: FloatArray = tensor.contiguous().cpu().numpy()
    return result if result.flags.owndata else result.copy()


def _indices(view: _View) -> LongArray:
    result: LongArray = view.index.cpu().numpy()
    return result


def _running_sum(values: Tensor, pixels: Tensor) -> Tensor:
    """Sums (m,) of ``values`` (m,) float64 up to each entry, begun anew at every pixel."""
    total = torch.cumsum(values, dim=0)
    _, lengths = torch.unique_consecutive(pixels, return_counts=True)
    last = torch.cumsum(lengths, dim=0) - 1
    before = torch.cat([total.new_zeros(1), total[last[:-1]]]) if len(last) else total
    return total - torch.repeat_interleave(before, lengths)
