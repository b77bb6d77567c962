"""The interface of rasterizers: the operators that the method is made of.

All backends share one image model (3D Gaussian Splatting, Kerbl 2023): EWA projection with the
Jacobian clamped at 1.3 times the half field of view and 0.3 added to the diagonal of the 2D
covariance; alpha = min(0.99, opacity * exp(-q / 2)); contributions under 1/255 are dropped; a pixel
is done when its transmittance would fall under 1e-4; front to back by camera depth of the centres.

Gaussians whose comments say so are drawn in the antialiased (mip) mode: a splat's opacity is
multiplied by sqrt(det of its covariance without the 0.3 / det with it), so that what is smaller
than a pixel does not grow brighter (Yu 2024, Mip-Splatting; as gsplat and SuperSplat do it).
Gradients are those of the mode that is drawn.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.camera import NEAR, Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.vote_slots import VoteSlots

BLUR = 0.3  # pixels^2 added to the 2D covariance
ALPHA_MIN = 1.0 / 255.0
ALPHA_MAX = 0.99
T_MIN = 1e-4


@dataclass(frozen=True, eq=False)
class Frame:
    """A rendered view."""

    image: FloatArray  # (H, W, C) color in 0..1 (not clipped) or any channels
    alpha: FloatArray  # (H, W) 1 - transmittance
    expected_depth: FloatArray  # (H, W) sum w z / sum w, camera depth; 0 where alpha is 0
    median_depth: FloatArray  # (H, W) depth where T falls to 1/2; 0 if never


@dataclass(frozen=True, eq=False)
class LabelFrame:
    """A rendered label map: at each pixel the label of greatest summed blending weight."""

    labels: IntArray  # (H, W) 0 = none
    confidence: FloatArray  # (H, W) weight of that label, 0..1


@dataclass(frozen=True, eq=False)
class PixelWeights:
    """Blending weights w = alpha T of sampled pixels as sparse rows, front to back in each row."""

    indptr: LongArray  # (P + 1,)
    indices: IntArray  # (nnz,) Gaussian
    weights: FloatArray  # (nnz,)


@dataclass(frozen=True, eq=False)
class Gradients:
    """Gradient of a loss by the raw parameters of the n splats that a view draws.

    Row r belongs to Gaussian ``indices[r]``; those not listed have gradient 0. A listed splat that
    is hidden behind others has gradient 0 too.
    """

    indices: IntArray  # (n,) Gaussian, ascending
    means: FloatArray  # (n, 3)
    quats: FloatArray  # (n, 4) by the quaternion as stored: at right angles to it
    log_scales: FloatArray  # (n, 3)
    logit_opacities: FloatArray  # (n,)
    sh: FloatArray  # (n, S, 3)
    # Length of the gradient by the projected centre in units of half the picture: what density
    # control compares with its threshold (Kerbl 2023, section 5.2).
    screen: FloatArray  # (n,)
    radii: FloatArray  # (n,) pixels, 3 standard deviations of the drawn ellipse's long axis


def empty_gradients(indices: IntArray, n_sh: int) -> Gradients:
    """Gradients of the Gaussians ``indices`` (n,), to be filled in; ``n_sh`` coefficients each."""
    n = len(indices)
    return Gradients(
        indices,
        np.empty((n, 3), np.float32),
        np.empty((n, 4), np.float32),
        np.empty((n, 3), np.float32),
        np.empty(n, np.float32),
        np.empty((n, n_sh, 3), np.float32),
        np.empty(n, np.float32),
        np.empty(n, np.float32),
    )


@dataclass(frozen=True, eq=False)
class TrainStep:
    """One evaluation of a loss on a rendered view."""

    value: float
    image: FloatArray  # (H, W, 3) the picture before the step
    gradients: Gradients  # no rows when a sink took them


# picture (H, W, 3) and target -> value and its gradient by the picture (H, W, 3), both float32
ImageLoss = Callable[[FloatArray, FloatArray], tuple[float, FloatArray]]
# Takes some rows of the gradients, in any order of pieces and from several threads at once; the
# arrays are good during the call only. It may change the Gaussians of these rows, and no others.
GradientSink = Callable[[Gradients], None]


def check_render(
    gaussians: Gaussians,
    channels: FloatArray | None,
    background: DoubleArray | FloatArray | None,
) -> int:
    """Check what `Rasterizer.render` is given; the number of channels of its picture."""
    n_channels = 3
    if channels is not None:
        check_shape("channels", channels, (len(gaussians), "C"), np.float32)
        n_channels = channels.shape[1]
    if background is not None:
        check_shape("background", background, (n_channels,))
    return n_channels


def check_pixels(camera: Camera, pixels: LongArray) -> None:
    """Check the flat pixel indices (P,) of `Rasterizer.weights`."""
    check_shape("pixels", pixels, ("P",))
    n_pixels = camera.width * camera.height
    if len(pixels) and (pixels.min() < 0 or pixels.max() >= n_pixels):
        raise ValueError(f"pixels: flat indices must be in 0..{n_pixels - 1}")


def check_vote(
    gaussians: Gaussians, camera: Camera, labels: IntArray, histogram: FloatArray | VoteSlots
) -> None:
    """Check what `Rasterizer.vote` is given."""
    check_shape("labels", labels, (camera.height, camera.width), np.int32)
    if isinstance(histogram, VoteSlots):
        check_shape("histogram", histogram.labels, (len(gaussians), "K"), np.int32)
        return
    check_shape("histogram", histogram, (len(gaussians), "K"), np.float32)
    if int(labels.max()) >= histogram.shape[1]:
        raise ValueError(f"labels: {labels.max()} has no column of {histogram.shape[1]}")
    if not (histogram.flags.c_contiguous and histogram.flags.writeable):
        raise ValueError("histogram: expected a writable C-contiguous array")


class Rasterizer(Protocol):
    """Operators of one backend. ``gaussians`` are in world frame; nothing is changed but what is
    said to be. Every method may be called from several threads at once."""

    name: str

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        *,
        channels: FloatArray | None = None,  # (N, C) blended instead of SH color
        background: DoubleArray | FloatArray | None = None,  # (C,); black
    ) -> Frame:
        """Blend SH color (degree of the file), or ``channels`` when given, and depth."""
        ...

    def weights(
        self,
        gaussians: Gaussians,
        camera: Camera,
        pixels: LongArray,  # (P,) flat indices v * width + u
        *,
        w_min: float = 0.0,
    ) -> PixelWeights:
        """Blending weights of these pixels; entries not above ``w_min`` are left out."""
        ...

    def vote(
        self,
        gaussians: Gaussians,
        camera: Camera,
        labels: IntArray,  # (H, W) at camera size; negative = ignore
        histogram: FloatArray | VoteSlots,  # (N, K), or slots for any labels; added to in place
    ) -> None:
        """histogram[i, k] += sum of w_i over pixels with label k."""
        ...

    def label_splat(
        self,
        gaussians: Gaussians,
        camera: Camera,
        labels: IntArray,  # (N,) >= 0; 0 takes part as "none"
    ) -> LabelFrame:
        """Exact argmax over labels of summed weights, without a K-channel image."""
        ...


class TrainableRasterizer(Rasterizer, Protocol):
    """A rasterizer that also differentiates its pictures.

    The image model is differentiated as it stands: no gradient passes a splat's alpha at its upper
    limit, a color at 0, or a clamped slope of the projection's Jacobian; thresholds do not move.
    """

    def backward(
        self,
        gaussians: Gaussians,
        camera: Camera,
        image_gradient: FloatArray,  # (H, W, 3) of the loss by `render`'s image
        *,
        alpha_gradient: FloatArray | None = None,  # (H, W) of the loss by `render`'s alpha
        background: DoubleArray | FloatArray | None = None,  # (3,); black
    ) -> Gradients:
        """Gradient of any loss on color and alpha, given its gradient by the picture."""
        ...

    def train_step(
        self,
        gaussians: Gaussians,
        camera: Camera,
        target: FloatArray,  # (H, W, 3)
        loss: ImageLoss,
        *,
        background: DoubleArray | FloatArray | None = None,  # (3,); black
        sink: GradientSink | None = None,
    ) -> TrainStep:
        """Render, compare with ``target``, and differentiate: one pass forward and one back.

        With a ``sink`` the gradients go there piece by piece, while they are in the processor's
        caches, instead of into the result.
        """
        ...


# --- Which Gaussians a camera can see, found by boxes around those that lie near each other.
# A view of a large scene shows a small part of it. Boxes outside the view are left out as a whole,
# so its cost is that of what it sees. Nothing is lost: the test of a box is the test that
# projection makes of each Gaussian (`raster.cpu.project_kernels.project`), written as half-spaces
# of the box.


_CHUNK_SPLATS = 512  # most Gaussians of a chunk
_LARGE_QUANTILE = 0.98  # quantile of the sizes above which Gaussians have chunks of their own
_MOST_SHARE = 0.3  # share of all Gaussians above which to copy them costs more than to project all
_SIGMAS = 3.34  # standard deviations that `project` draws at most
_ROUNDING = 1e-6  # of the terms of a test, for rounding


@dataclass(frozen=True, eq=False)
class SpatialChunks:
    """Boxes around the centres of Gaussians that lie near each other: C chunks.

    Gaussians with a centre that is not finite are in none: they are never drawn. Valid as long as
    the Gaussians do not change.
    """

    gaussians: Gaussians
    rows: IntArray  # (K,) the Gaussians of one chunk after the other
    offsets: LongArray  # (C + 1,) where each chunk begins in `rows`
    centers: DoubleArray  # (C, 3) of the boxes, world
    halves: DoubleArray  # (C, 3) half their edges
    longest: DoubleArray  # (C,) greatest standard deviation of a Gaussian, scene units

    @staticmethod
    def of(gaussians: Gaussians) -> "SpatialChunks | None":
        """The chunks of a scene; None for one that is too small to be divided."""
        finite = np.flatnonzero(np.isfinite(gaussians.means).all(axis=1)).astype(np.int32)
        if len(finite) <= 2 * _CHUNK_SPLATS:
            return None
        with np.errstate(over="ignore"):
            sizes = np.exp(np.nan_to_num(gaussians.log_scales.max(axis=1), nan=-np.inf))
        # One large Gaussian would widen the reach of all in its chunk.
        is_large = sizes[finite] > np.quantile(sizes[finite], _LARGE_QUANTILE)
        chunks = [
            chunk
            for part in (finite[~is_large], finite[is_large])
            for chunk in _divided(gaussians.means, part)
        ]
        low = np.stack([gaussians.means[chunk].min(axis=0) for chunk in chunks]).astype(np.float64)
        high = np.stack([gaussians.means[chunk].max(axis=0) for chunk in chunks]).astype(np.float64)
        return SpatialChunks(
            gaussians,
            rows=np.concatenate(chunks),
            offsets=np.cumsum([0, *(len(chunk) for chunk in chunks)]).astype(np.int64),
            centers=(low + high) / 2,
            halves=(high - low) / 2,
            longest=np.array([sizes[chunk].max() for chunk in chunks], np.float64),
        )

    def in_view(self, camera: Camera) -> IntArray | None:
        """Gaussians (K,), ascending, of the chunks that ``camera`` may see: all that it draws or
        whose centres it shows, and some others. None where these are so many that a choice does not
        pay."""
        seen = np.flatnonzero(self._may_be_seen(camera))
        lengths = np.diff(self.offsets)
        if int(lengths[seen].sum()) > _MOST_SHARE * len(self.gaussians):
            return None
        parts = [self.rows[self.offsets[c] : self.offsets[c + 1]] for c in seen]
        return np.sort(np.concatenate([np.zeros(0, np.int32), *parts]))

    def _may_be_seen(self, camera: Camera) -> BoolArray:
        """Which chunks (C,) hold a Gaussian that `project` may keep.

        It keeps one at (x, y, z) of the camera's frame with the standard deviation s where
        z >= near, and |f x / z + c - w / 2| < w / 2 + bound with
        bound = 3.34 sqrt((stretch s / z)^2 + blur) <= 3.34 (stretch s / z + sqrt(blur)), and the
        same in y. Times z these are linear in the centre and in s.
        """
        focal, middle = np.diag(camera.K)[:2], camera.K[:2, 2]
        size = np.array([camera.width, camera.height], np.float64)
        slope = 1.3 * 0.5 * size / focal
        stretch = float((focal * np.sqrt(1 + slope**2)).max())
        margin = _SIGMAS * np.sqrt(BLUR)
        # Rows a and reach r: kept only if a . (x, y, z, 1) + r s > 0.
        planes = np.zeros((5, 4))
        planes[0] = 0, 0, 1, -NEAR
        for axis in (0, 1):
            planes[1 + axis, axis], planes[1 + axis, 2] = focal[axis], middle[axis] + margin
            planes[3 + axis, axis] = -focal[axis]
            planes[3 + axis, 2] = size[axis] - middle[axis] + margin
        reach = np.array([0.0, *[_SIGMAS * stretch] * 4])
        world = planes @ camera.cam_from_world  # (5, 4)
        terms = np.abs(self.centers) @ np.abs(world[:, :3]).T + np.abs(world[:, 3])
        value = self.centers @ world[:, :3].T + world[:, 3]
        value += self.halves @ np.abs(world[:, :3]).T
        with np.errstate(invalid="ignore"):  # a size that is infinite, at the near plane: 0 * inf
            value += np.nan_to_num(self.longest[:, None] * reach, nan=0.0, posinf=np.inf)
        return np.all(value + _ROUNDING * terms >= 0, axis=1)


def _divided(means: FloatArray, rows: IntArray) -> list[IntArray]:
    """``rows`` (K,) in halves along the widest axis, again and again, until all are small."""
    waiting, chunks = [rows], []
    while waiting:
        part = waiting.pop()
        if len(part) <= _CHUNK_SPLATS:
            chunks += [part] if len(part) > 0 else []
            continue
        centres = means[part]
        axis = int(np.argmax(centres.max(axis=0) - centres.min(axis=0)))
        middle = len(part) // 2
        order = np.argpartition(centres[:, axis], middle)
        waiting += [part[order[:middle]], part[order[middle:]]]
    return chunks
