"""The numba backend of `raster.base.Rasterizer`."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from gaga_core.arrays import (
    AnyArray,
    BoolArray,
    DoubleArray,
    FloatArray,
    IntArray,
    LongArray,
    UInt64Array,
    check_shape,
)
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import (
    Frame,
    Gradients,
    GradientSink,
    ImageLoss,
    LabelFrame,
    PixelWeights,
    SpatialChunks,
    TrainStep,
    check_pixels,
    check_render,
    check_vote,
    empty_gradients,
)
from gaga_core.raster.cpu import blend_kernels as kernels
from gaga_core.raster.cpu.backward_kernels import (
    SUMS,
    add_tiles,
    backward_splats,
    backward_tiles,
    blend_colors,
)
from gaga_core.raster.cpu.prepare import (
    TILES_AT_ONCE,
    TiledView,
    for_kernel,
    pose_and_lens,
    prepare,
)
from gaga_core.raster.cpu.project_kernels import TILE, backward_colors, sh_colors
from gaga_core.raster.vote_slots import VoteSlots
from gaga_core.threads import n_threads, run_chunks, run_kernel


@dataclass(frozen=True, eq=False)
class Outlines:
    """Objects as a view shows them, and as it would if nothing stood before them."""

    labels: IntArray  # (H, W) seen label, 0 = none
    objects: IntArray  # (K,) labels in view, ascending
    # (H, W, ceil(K / 64)), in memory column by column: bit k % 64 of word k // 64 is object k alone
    bits: UInt64Array

    def whole(self, k: int) -> BoolArray:
        """Mask (H, W) of object k, seen or hidden."""
        return (self.bits[:, :, k // 64] >> np.uint64(k % 64) & np.uint64(1)) > 0


@dataclass(frozen=True, eq=False)
class Labelled:
    """A picture with the labels of what it shows."""

    image: FloatArray  # (H, W, 3) background included
    alpha: FloatArray  # (H, W)
    median_depth: FloatArray  # (H, W) camera depth, 0 = none
    outlines: Outlines


# --- Blending weights of sampled pixels as sparse rows (rows of W).


def sampled_weights(view: TiledView, width: int, pixels: LongArray, w_min: float) -> PixelWeights:
    """Rows in the order of ``pixels``, entries above ``w_min``: counted first, then written."""
    n_tiles_x = -(-width // TILE)
    flat = np.ascontiguousarray(pixels, np.int64)
    tile = flat // width // TILE * n_tiles_x + flat % width // TILE
    by_tile = np.lexsort((flat, tile))
    samples = flat[by_tile]
    sample_offsets = np.searchsorted(tile[by_tile], np.arange(view.n_tiles + 1)).astype(np.int64)
    row_ends = np.zeros(len(flat), np.int64)

    def run(indices: IntArray, values: FloatArray, writes: bool) -> None:
        lists = (view.order, view.offsets, view.ids, samples, sample_offsets, n_tiles_x, width)
        view.run(
            kernels.sample_weights, view.splats, *lists, w_min, row_ends, indices, values, writes
        )

    run(np.empty(0, np.int32), np.empty(0, np.float32), False)
    counts = np.empty(len(flat), np.int64)
    counts[by_tile] = row_ends
    indptr = np.append(0, np.cumsum(counts)).astype(np.int64)
    row_ends[:] = indptr[:-1][by_tile]
    indices, values = np.empty(indptr[-1], np.int32), np.empty(indptr[-1], np.float32)
    run(indices, values, True)
    return PixelWeights(indptr, indices, values)


# --- Votes: labels of pixels summed into the Gaussians that show there (W^T of one-hot labels).


_BATCH = 1 << 23  # partial sums held at a time: 32 MiB


def add_votes(view: TiledView, labels: IntArray, histogram: FloatArray | VoteSlots) -> None:
    """histogram[i, k] += sum of w_i over the pixels of ``labels`` (H, W) that are k >= 0.

    Many tiles show one splat. So a batch of tiles is summed in parallel, each tile for itself, and
    then the sums are added tile by tile, in parallel over splats: no atomics, no dependence of the
    result on the number of threads.
    """
    size = np.array([labels.shape[1], labels.shape[0]], np.int64)
    # The label map, numbered again in each tile: position in `found`, -1 = ignore.
    local = np.empty((view.n_tiles, TILE, TILE), np.int32)
    found = np.empty((view.n_tiles, TILE * TILE), np.int32)  # label of each position
    n_found = np.zeros(view.n_tiles, np.int64)
    view.run(kernels.tile_labels, labels, local, found, n_found)
    if isinstance(histogram, VoteSlots):
        add: Callable[..., None] = kernels.add_sums_to_slots
        table: tuple[AnyArray, ...] = (histogram.labels, histogram.weights, histogram.lost)
    else:
        add, table = kernels.add_sums, (histogram,)
    lists, n = (view.offsets, view.ids), len(view.order)
    n_sums = np.cumsum(np.append(0, np.diff(view.offsets) * n_found))
    first = 0
    while first < view.n_tiles:
        last = int(np.searchsorted(n_sums, n_sums[first] + _BATCH, side="right")) - 1
        last = min(view.n_tiles, max(last, first + 1))
        at = n_sums[first : last + 1] - n_sums[first]  # where a tile's sums begin
        sums = np.zeros(at[-1], np.float32)  # of each (splat, label) of the batch
        tiles = (view.splats, *lists, local, n_found, at, first, size, sums)
        run_kernel(kernels.vote_tiles, last - first, TILES_AT_ONCE, *tiles)
        rows = (view.order, *lists, found, n_found, at, first, sums, *table)
        run_kernel(add, n, max(1, -(-n // n_threads())), *rows)
        first = last


# --- Training on the CPU: draw a view, and take a gradient of its picture back to the parameters.


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

    lists = (view.offsets, view.ids, background)
    view.run(blend_colors, view.splats, colors, *lists, image, transmittance, ends)
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
    sums = _backward_sum_tiles(drawn, image_gradient, alpha_gradient)
    return _walk_back(gaussians, camera, drawn, sums, sink)


def _backward_sum_tiles(
    drawn: Forward, image_gradient: FloatArray, alpha_gradient: FloatArray
) -> FloatArray:
    """Sums (n, SUMS) over the pixels of each splat in view, see `backward_kernels`."""
    view = drawn.view
    partials = np.empty((len(view.ids), SUMS), np.float32)
    sums = np.zeros((len(view.order), SUMS), np.float32)
    gradients = (for_kernel(g, np.float32) for g in (image_gradient, alpha_gradient))
    picture = (drawn.image, drawn.transmittance, drawn.ends, *gradients)
    lists = (view.offsets, view.ids)
    view.run(backward_tiles, view.splats, drawn.colors, *lists, *picture, partials)
    piece = max(_CHUNK, -(-len(sums) // n_threads()))
    run_kernel(add_tiles, len(sums), piece, *lists, drawn.ends, partials, sums)
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

    known = (means, quats, log_scales, pose, lens, view.order)

    def work(start: int, stop: int) -> None:
        if sink is None:
            columns = (getattr(result, field.name)[start:stop] for field in fields(Gradients))
            piece = Gradients(*columns)
        else:
            piece = empty_gradients(indices[start:stop], n_sh)
        by_color = np.empty((stop - start, 3), np.float32)
        of_shape = (piece.means, piece.quats, piece.log_scales, piece.logit_opacities)
        found = (*of_shape, by_color, piece.screen, piece.radii)
        backward_splats(*known, view.rows[start:stop], view.splats, drawn.colors, sums, *found)
        backward_colors(sh, means, piece.indices, eye, by_color, piece.sh, piece.means)
        if sink is not None:
            sink(piece)

    run_chunks(work, len(indices), _CHUNK)
    return result


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
            lists = (view.offsets, view.ids, behind)
            view.run(kernels.blend_wide, view.splats, features, *lists, frame.image, c)
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

        lists = (view.offsets, view.ids, len(values))
        view.run(kernels.label_tiles, view.splats, dense, *lists, out, confidence)
        return LabelFrame(values[out], confidence)

    def labelled(
        self,
        gaussians: Gaussians,
        camera: Camera,
        labels: IntArray,  # (N,) >= 0; 0 takes part as "none"
        objects: IntArray,  # (G,) labels, ascending
        void: float,
        background: DoubleArray | FloatArray | None = None,  # (3,); black
    ) -> Labelled:
        """What `render` gives, and in the same pass what is seen of every label, and where
        ``objects`` would be seen alone.

        A pixel whose label of greatest weight weighs less than ``void`` shows none.
        """
        check_shape("labels", labels, (len(gaussians),), np.int32)
        view = self._view(gaussians, camera)
        values, dense = _dense(labels[view.order])
        rows = np.full(len(values), -1, np.int32)
        seen = values[np.bincount(dense, minlength=1) > 0] if len(dense) else values[:0]
        here = np.intersect1d(objects, seen).astype(np.int32)
        rows[np.searchsorted(values, here)] = np.arange(len(here), dtype=np.int32)
        shape = (camera.height, camera.width)
        image, shown = np.empty((*shape, 3), np.float32), np.empty(shape, np.int32)
        alpha, median = np.empty(shape, np.float32), np.empty(shape, np.float32)
        bits = np.zeros((camera.width, camera.height, max(1, -(-len(here) // 64))), np.uint64)
        behind = np.zeros(3, np.float32) if background is None else np.float32(background)
        drawn = (image, alpha, median)
        known = (dense, rows, view.offsets, view.ids, void, behind)
        colors = _colors(gaussians, camera, view)
        view.run(
            kernels.blend_labels, view.splats, view.depths, colors, *known, *drawn, shown, bits
        )
        shown = shown if values[-1] == len(values) - 1 else values[shown]
        return Labelled(image, alpha, median, Outlines(shown, here, bits.transpose(1, 0, 2)))

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

    run_kernel(sh_colors, len(colors), 16384, sh, means, view.order, view.rows, eye, colors)
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

    lists = (view.offsets, view.ids, background)
    planes = (image, alpha, expected, median)
    view.run(kernels.blend, view.splats, view.depths, colors, *lists, *planes)
    return Frame(image, alpha, expected, median)
