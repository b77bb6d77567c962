"""The gsplat backend of `raster.base.Rasterizer`."""

import importlib
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
    Gradients,
    GradientSink,
    ImageLoss,
    LabelFrame,
    PixelWeights,
    TrainStep,
    check_pixels,
    check_render,
    check_vote,
    empty_gradients,
)
from gaga_core.raster.cuda.backward import CudaForward, backward, forward, sh_colors
from gaga_core.raster.cuda.listing import list_entries, measure_alpha_max
from gaga_core.raster.cuda.view import (
    CHANNELS,
    View,
    blend,
    fetch,
    indices,
    memory_in_words,
    prepare,
    send,
)
from gaga_core.raster.vote_slots import VoteSlots


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

    @memory_in_words()
    def backward(
        self,
        gaussians: Gaussians,
        camera: Camera,
        image_gradient: FloatArray,
        *,
        alpha_gradient: FloatArray | None = None,
        background: DoubleArray | FloatArray | None = None,
    ) -> Gradients:
        """Gradients by the parameters, from those by the image (H, W, 3) and alpha (H, W)."""
        shape = (camera.height, camera.width)
        check_shape("image_gradient", image_gradient, (*shape, 3), np.float32)
        if alpha_gradient is not None:
            check_shape("alpha_gradient", alpha_gradient, shape, np.float32)
        drawn = self._forward(gaussians, camera, background)
        by_alpha = None if alpha_gradient is None else send(alpha_gradient, self._device)
        return backward(drawn, camera, send(image_gradient, self._device), by_alpha)

    @memory_in_words()
    def train_step(
        self,
        gaussians: Gaussians,
        camera: Camera,
        target: FloatArray,
        loss: ImageLoss,
        *,
        background: DoubleArray | FloatArray | None = None,
        sink: GradientSink | None = None,
    ) -> TrainStep:
        """Render, compare with ``target`` (H, W, 3) by ``loss`` on the CPU, and differentiate."""
        check_shape("target", target, (camera.height, camera.width, 3), np.float32)
        drawn = self._forward(gaussians, camera, background)
        image = fetch(drawn.image)
        value, image_gradient = loss(image, target)
        gradients = backward(drawn, camera, send(image_gradient, self._device))
        if sink is not None:
            sink(gradients)
            gradients = empty_gradients(np.zeros(0, np.int32), gradients.sh.shape[1])
        return TrainStep(value, image, gradients)

    def _forward(
        self, gaussians: Gaussians, camera: Camera, background: DoubleArray | FloatArray | None
    ) -> CudaForward:
        if background is not None:
            check_shape("background", background, (3,))
        behind = send(np.zeros(3) if background is None else background, self._device)
        return forward(self._gsplat, gaussians, camera, behind, self._device)

    def _prepare(self, gaussians: Gaussians, camera: Camera) -> View:
        return prepare(self._gsplat, gaussians, camera, self._device)

    def _sh_colors(self, gaussians: Gaussians, camera: Camera, view: View) -> Tensor:
        """SH color (n, 3) of the splats in view, seen from the camera's position."""
        rows = indices(view)
        directions = gaussians.means[rows].astype(np.float64) - camera.position
        sh = send(gaussians.sh[rows], self._device)
        return sh_colors(self._gsplat, gaussians.sh_degree, send(directions, self._device), sh)

    def _median(self, view: View) -> Tensor:
        """Depth (H, W) at which T falls to 1/2, 0 if never."""
        depth = torch.zeros(view.height * view.width, device=self._device)
        for entries in list_entries(self._gsplat, view, self._alpha_max):
            crosses = (entries.after <= 0.5) & (entries.after + entries.weights > 0.5)
            depth[entries.pixels[crosses]] = view.depths[0, entries.splats[crosses]]
        return depth.reshape(view.height, view.width)


_NOTHING: FloatArray = np.zeros(0, np.float32)
