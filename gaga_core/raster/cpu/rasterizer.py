"""The numba backend of `raster.base.Rasterizer`."""

from dataclasses import replace

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.kernels import run_chunks
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
)
from gaga_core.raster.chunks import SpatialChunks
from gaga_core.raster.cpu import blend_kernels as kernels
from gaga_core.raster.cpu.backward import Forward, backward, forward
from gaga_core.raster.cpu.label_kernels import label_tiles
from gaga_core.raster.cpu.prepare import TILES_AT_ONCE, TiledView, for_kernel, prepare
from gaga_core.raster.cpu.sample import sampled_weights
from gaga_core.raster.cpu.sh_kernels import sh_colors
from gaga_core.raster.cpu.vote import add_votes
from gaga_core.raster.vote_slots import VoteSlots


class CpuRasterizer:
    """Tile rasterizer on all CPU threads (16 x 16 tiles, one depth sort a view).

    The pictures do not depend on the number of threads, and several threads may render at once.
    See `raster.base` for the operators and the image model. With ``chunks`` the scene that they
    were made of is projected as far as a view may show it, and the last view is kept for the next
    operator; the results are the same bits.
    """

    name = "cpu"

    def __init__(self, chunks: SpatialChunks | None = None) -> None:
        self._chunks = chunks
        self._last: tuple[Camera, TiledView] | None = None

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
        view = self._view(gaussians, camera)
        behind = np.zeros(max(3, n_channels), np.float32)
        behind[:n_channels] = 0 if background is None else background
        if channels is None:
            return _blend(view, camera, _colors(gaussians, camera, view), behind, 3)
        colors = _gather(channels[:, :3], view.order, 3)
        frame = _blend(view, camera, colors, behind, n_channels)
        for c in range(3, n_channels, kernels.WIDE):
            features = _gather(channels[:, c : c + kernels.WIDE], view.order, kernels.WIDE)
            _blend_wide(view, features, behind, frame.image, c)
        return frame

    def weights(
        self,
        gaussians: Gaussians,
        camera: Camera,
        pixels: LongArray,
        *,
        w_min: float = 0.0,
    ) -> PixelWeights:
        """Blending weights above ``w_min`` of ``pixels`` (P,), flat indices v * width + u."""
        check_pixels(camera, pixels)
        return sampled_weights(self._view(gaussians, camera), camera.width, pixels, w_min)

    def vote(
        self,
        gaussians: Gaussians,
        camera: Camera,
        labels: IntArray,
        histogram: FloatArray | VoteSlots,
    ) -> None:
        """histogram[i, k] += sum of w_i over pixels with label k; negative labels are ignored."""
        check_vote(gaussians, camera, labels, histogram)
        add_votes(self._view(gaussians, camera), for_kernel(labels, np.int32), histogram)

    def label_splat(self, gaussians: Gaussians, camera: Camera, labels: IntArray) -> LabelFrame:
        """Exact argmax over ``labels`` (N,) of summed weights; the smaller label when equal."""
        check_shape("labels", labels, (len(gaussians),), np.int32)
        if labels.min(initial=0) < 0:
            raise ValueError("labels: must not be negative (0 = none)")
        view = self._view(gaussians, camera)
        values, dense = _dense(labels[view.order])
        out = np.zeros((camera.height, camera.width), np.int32)
        confidence = np.zeros((camera.height, camera.width), np.float32)

        def work(start: int, stop: int) -> None:
            label_tiles(
                view.splats,
                dense,
                view.offsets,
                view.ids,
                len(values),
                out,
                confidence,
                start,
                stop,
            )

        run_chunks(work, view.n_tiles, TILES_AT_ONCE)
        return LabelFrame(values[out], confidence)

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
        drawn = _forward(gaussians, camera, background)
        return backward(gaussians, camera, drawn, image_gradient, alpha_gradient)

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
        """Render, compare with ``target`` (H, W, 3) by ``loss``, and differentiate.

        With a ``sink`` the gradients go there in pieces, while they are in the caches.
        """
        check_shape("target", target, (camera.height, camera.width, 3), np.float32)
        drawn = _forward(gaussians, camera, background)
        value, image_gradient = loss(drawn.image, target)
        gradients = backward(gaussians, camera, drawn, image_gradient, sink=sink)
        return TrainStep(value, drawn.image, gradients)

    def _view(self, gaussians: Gaussians, camera: Camera) -> TiledView:
        """What the camera sees, with the Gaussians' own indices."""
        chunks = self._chunks
        if chunks is None or chunks.gaussians is not gaussians:
            return prepare(gaussians, camera)
        last = self._last  # read once: another thread may write
        if last is None or last[0] is not camera:
            last = camera, _view_of_few(gaussians, camera, chunks.in_view(camera))
            self._last = last
        return last[1]


def _view_of_few(gaussians: Gaussians, camera: Camera, rows: IntArray | None) -> TiledView:
    """What the camera sees where it may see only ``rows`` (K,), ascending; None: all."""
    if rows is None:
        return prepare(gaussians, camera)
    some = Gaussians(
        gaussians.means.take(rows, axis=0),
        gaussians.quats.take(rows, axis=0),
        gaussians.log_scales.take(rows, axis=0),
        gaussians.logit_opacities.take(rows),
        np.zeros((len(rows), 1, 3), np.float32),  # colors are looked up in the whole
    )
    view = prepare(some, camera, antialiased=gaussians.is_antialiased)
    return replace(view, order=rows[view.order])


def _forward(
    gaussians: Gaussians, camera: Camera, background: DoubleArray | FloatArray | None
) -> Forward:
    behind = np.zeros(3, np.float32)
    if background is not None:
        check_shape("background", background, (3,))
        behind[:] = background
    view = prepare(gaussians, camera)
    return forward(view, camera, _colors(gaussians, camera, view), behind)


def _dense(labels: IntArray) -> tuple[IntArray, IntArray]:
    """Labels as positions in a ascending table that begins with 0: huge ids cost no memory."""
    if labels.max(initial=0) < 65536:
        return np.arange(labels.max(initial=0) + 1, dtype=np.int32), labels
    values = np.unique(np.append(labels, np.int32(0)))
    return values, np.searchsorted(values, labels).astype(np.int32)


def _colors(gaussians: Gaussians, camera: Camera, view: TiledView) -> FloatArray:
    """SH color (n, 3) of the splats in view, seen from the camera's position."""
    sh = for_kernel(gaussians.sh, np.float32)
    means = for_kernel(gaussians.means, np.float32)
    eye = np.array(camera.position, np.float64)
    colors = np.empty((len(view.order), 3), np.float32)

    def work(start: int, stop: int) -> None:
        sh_colors(sh, means, view.order, view.rows, eye, colors, start, stop)

    run_chunks(work, len(colors), 16384)
    return colors


def _gather(channels: FloatArray, order: IntArray, n_columns: int) -> FloatArray:
    """Rows of the splats in view, padded with zeros to ``n_columns``."""
    result = np.zeros((len(order), n_columns), np.float32)
    result[:, : channels.shape[1]] = channels[order]
    return result


def _blend(
    view: TiledView, camera: Camera, colors: FloatArray, background: FloatArray, n_channels: int
) -> Frame:
    shape = (camera.height, camera.width)
    image = np.zeros((*shape, n_channels), np.float32)
    alpha, expected, median = (np.empty(shape, np.float32) for _ in range(3))

    def work(start: int, stop: int) -> None:
        kernels.blend(
            view.splats,
            view.depths,
            colors,
            view.offsets,
            view.ids,
            background,
            image,
            alpha,
            expected,
            median,
            start,
            stop,
        )

    run_chunks(work, view.n_tiles, TILES_AT_ONCE)
    return Frame(image, alpha, expected, median)


def _blend_wide(
    view: TiledView, features: FloatArray, background: FloatArray, image: FloatArray, first: int
) -> None:
    def work(start: int, stop: int) -> None:
        kernels.blend_wide(
            view.splats, features, view.offsets, view.ids, background, image, first, start, stop
        )

    run_chunks(work, view.n_tiles, TILES_AT_ONCE)
