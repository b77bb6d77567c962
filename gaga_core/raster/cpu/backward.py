"""Training on the CPU: draw a view, and take a gradient of its picture back to the parameters."""

from dataclasses import dataclass, fields

import numpy as np

from gaga_core.arrays import FloatArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.kernels import n_threads, run_chunks
from gaga_core.raster.base import Gradients, GradientSink, empty_gradients
from gaga_core.raster.cpu import backward_kernels as kernels
from gaga_core.raster.cpu.prepare import TILES_AT_ONCE, TiledView, for_kernel, pose_and_lens
from gaga_core.raster.cpu.sh_kernels import backward_colors
from gaga_core.raster.cpu.splat_gradient_kernels import backward_splats

_CHUNK = 4096  # splats of one piece of work


@dataclass(frozen=True, eq=False)
class Forward:
    """A drawn view and what its way back needs."""

    view: TiledView
    colors: FloatArray  # (n, 3) of the splats in view
    image: FloatArray  # (H, W, 3) background included
    transmittance: FloatArray  # (H, W)
    ends: LongArray  # (n_tiles,) end of the part of each tile's list that was drawn


def forward(view: TiledView, camera: Camera, colors: FloatArray, background: FloatArray) -> Forward:
    """Blend ``colors`` (n, 3) of the splats in view over ``background`` (3,)."""
    shape = (camera.height, camera.width)
    image, transmittance = np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
    ends = np.empty(view.n_tiles, np.int64)

    def work(start: int, stop: int) -> None:
        kernels.blend_colors(
            view.splats,
            colors,
            view.offsets,
            view.ids,
            background,
            image,
            transmittance,
            ends,
            start,
            stop,
        )

    run_chunks(work, view.n_tiles, TILES_AT_ONCE)
    return Forward(view, colors, image, transmittance, ends)


def backward(
    gaussians: Gaussians,
    camera: Camera,
    drawn: Forward,
    image_gradient: FloatArray,
    alpha_gradient: FloatArray | None = None,
    sink: GradientSink | None = None,
) -> Gradients:
    """Gradients from those by the image (H, W, 3) and by alpha (H, W; None = 0).

    With a ``sink`` they go there in pieces, and the result has no rows.
    """
    if alpha_gradient is None:
        alpha_gradient = np.zeros_like(drawn.transmittance)
    sums = _sum_tiles(drawn, image_gradient, alpha_gradient)
    return _walk_back(gaussians, camera, drawn, sums, sink)


def _sum_tiles(
    drawn: Forward, image_gradient: FloatArray, alpha_gradient: FloatArray
) -> FloatArray:
    """Sums (n, SUMS) over the pixels of each splat in view, see `backward_kernels`."""
    view = drawn.view
    partials = np.empty((len(view.ids), kernels.SUMS), np.float32)
    sums = np.zeros((len(view.order), kernels.SUMS), np.float32)
    by_image = for_kernel(image_gradient, np.float32)
    by_alpha = for_kernel(alpha_gradient, np.float32)
    transmittance = drawn.transmittance

    def work(start: int, stop: int) -> None:
        kernels.backward_tiles(
            view.splats,
            drawn.colors,
            view.offsets,
            view.ids,
            drawn.image,
            transmittance,
            drawn.ends,
            by_image,
            by_alpha,
            partials,
            start,
            stop,
        )

    def add(start: int, stop: int) -> None:
        kernels.add_tiles(view.offsets, view.ids, drawn.ends, partials, sums, start, stop)

    run_chunks(work, view.n_tiles, TILES_AT_ONCE)
    run_chunks(add, len(sums), max(_CHUNK, -(-len(sums) // n_threads())))
    return sums


def _walk_back(
    gaussians: Gaussians,
    camera: Camera,
    drawn: Forward,
    sums: FloatArray,
    sink: GradientSink | None = None,
) -> Gradients:
    """Go back through projection and color to its parameters.

    A piece of splats goes all the way, into the ``sink`` too, before the next one begins.
    """
    view = drawn.view
    means = for_kernel(gaussians.means, np.float32)
    quats = for_kernel(gaussians.quats, np.float32)
    log_scales = for_kernel(gaussians.log_scales, np.float32)
    sh = for_kernel(gaussians.sh, np.float32)
    pose, lens = pose_and_lens(camera, gaussians.is_antialiased)
    eye = np.array(camera.position, np.float64)
    indices, n_sh = view.order[view.rows], sh.shape[1]
    result = empty_gradients(indices if sink is None else indices[:0], n_sh)

    def work(start: int, stop: int) -> None:
        if sink is None:
            piece = _rows(result, start, stop)
        else:
            piece = empty_gradients(indices[start:stop], n_sh)
        by_color = np.empty((stop - start, 3), np.float32)
        backward_splats(
            means,
            quats,
            log_scales,
            pose,
            lens,
            view.order,
            view.rows[start:stop],
            view.splats,
            drawn.colors,
            sums,
            piece.means,
            piece.quats,
            piece.log_scales,
            piece.logit_opacities,
            by_color,
            piece.screen,
            piece.radii,
        )
        backward_colors(sh, means, piece.indices, eye, by_color, piece.sh, piece.means)
        if sink is not None:
            sink(piece)

    run_chunks(work, len(indices), _CHUNK)
    return result


def _rows(gradients: Gradients, start: int, stop: int) -> Gradients:
    """Views of the rows ``start`` to ``stop``."""
    columns = (getattr(gradients, field.name)[start:stop] for field in fields(Gradients))
    return Gradients(*columns)
