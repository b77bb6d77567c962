"""Differences of a rendered picture from a photo: the training loss, SSIM, PSNR; and what measured
depth is compared at."""

from dataclasses import replace

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, check_shape
from gaga_core.camera import Camera
from gaga_core.threads import run_kernel
from gaga_core.training import losses_kernels as kernels
from gaga_core.training.settings import DISSIMILARITY

LEAST_COVERAGE = 0.05  # of a pixel whose depth is compared
_ROWS = 32  # rows of one piece of work
_DEPTH_SIDE = 128  # pixels of the longest side: phones measure 256, smoothed over several


def photometric(
    image: FloatArray,  # (H, W, 3) float32, colors in 0..1
    target: FloatArray,  # (H, W, 3) float32
    dissimilarity: float = DISSIMILARITY,
) -> tuple[float, FloatArray]:
    """(1 - d) mean |image - target| + d (1 - SSIM), and its gradient (H, W, 3) by ``image``.

    The loss of 3D Gaussian Splatting (Kerbl 2023, equation 7), d = ``dissimilarity``. SSIM as in
    `ssim`. The value does not depend on the number of threads.
    """
    a, b, slopes, sums = _compare(image, target)
    height, width = image.shape[:2]
    gradient = np.empty((height, kernels.CHANNELS * width), np.float32)

    share = float(dissimilarity)
    run_kernel(kernels.gradient_rows, height, _ROWS, a, b, slopes, share, gradient)
    similar, apart = sums.sum(axis=0) / image.size
    value = (1 - dissimilarity) * apart + dissimilarity * (1 - similar)
    return float(value), gradient.reshape(image.shape)


def ssim(image: FloatArray, target: FloatArray) -> float:
    """Mean structural similarity of pictures (H, W, 3) float32 in 0..1 (Wang 2004); 1 = equal.

    Per channel, with an 11 x 11 Gaussian window of sigma 1.5 and zeros beyond the border, averaged
    over all pixels: the variant that papers on Gaussian splatting report.
    """
    return float(_compare(image, target)[3][:, 0].sum() / image.size)


def psnr(image: FloatArray, target: FloatArray) -> float:
    """Peak signal-to-noise ratio in dB of pictures of one shape in 0..1; infinite when equal."""
    check_shape("target", target, image.shape)
    error = float(((image.astype(np.float64) - target) ** 2).mean())
    return float("inf") if error == 0 else -10 * float(np.log10(error))


def _compare(
    image: FloatArray, target: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, DoubleArray]:
    """Framed pictures, gradients of SSIM by its blurred maps, sums (H, 2) of SSIM and |a - b|."""
    check_shape("image", image, ("H", "W", 3), np.float32)
    check_shape("target", target, image.shape, np.float32)
    height, width = len(image), kernels.CHANNELS * image.shape[1]
    a, b = _framed(image), _framed(target)
    slopes = np.zeros((3, *a.shape), np.float32)
    sums = np.zeros((height, 2), np.float64)

    run_kernel(kernels.similarity_rows, height, _ROWS, a, b, slopes, sums, width)
    return a, b, slopes, sums


def _framed(image: FloatArray) -> FloatArray:
    """(H, W, 3) as a matrix with a frame of zeros, as `losses_kernels` reads it."""
    height, width = len(image), kernels.CHANNELS * image.shape[1]
    n_columns = -(-width // kernels.OUT) * kernels.OUT + kernels.IN - kernels.OUT
    framed = np.zeros((height + 2 * kernels.REACH, n_columns), np.float32)
    inside = framed[kernels.REACH : -kernels.REACH, kernels.PAD : kernels.PAD + width]
    inside[:] = image.reshape(height, width)
    return framed


def sampled_depth(camera: Camera, depth: FloatArray) -> tuple[Camera, FloatArray]:
    """Every n-th pixel of a depth map, and the camera whose pixels these are."""
    height, width = depth.shape
    step = -(-max(height, width) // _DEPTH_SIDE)
    first = step // 2
    sampled = np.ascontiguousarray(depth[first::step, first::step])
    whole = camera.resized(width, height)
    to_sampled = np.array([[1, 0, -first - 0.5], [0, 1, -first - 0.5], [0, 0, step]]) / step
    to_sampled[:2, 2] += 0.5
    K = to_sampled @ whole.K
    return replace(whole, K=K, width=sampled.shape[1], height=sampled.shape[0]), sampled
