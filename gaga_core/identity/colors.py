"""Identity encodings as colors: what Gaussians the training holds for alike look alike."""

import numpy as np

from gaga_core.arrays import FloatArray, UInt8Array, check_shape
from gaga_core.identity.linear_kernels import D

_TAILS = (1.0, 99.0)  # percentiles that become 0 and 255: few far encodings do not gray the rest
_SAMPLED = 1 << 17  # rows that axes and percentiles are taken from, evenly spaced


def encoding_colors(encodings: FloatArray) -> UInt8Array:
    """RGB (N, 3) of ``encodings`` (N, D): their three principal components, each over its range.

    Deterministic, signs of the axes included. Encodings that are all alike are gray.
    """
    check_shape("encodings", encodings, ("N", D), np.float32)
    sample = encodings[:: max(1, len(encodings) // _SAMPLED)].astype(np.float64)
    sample = sample[np.isfinite(sample).all(axis=1)]
    if len(sample) == 0:
        return np.full((len(encodings), 3), 128, np.uint8)
    mean = sample.mean(axis=0)
    _, axes = np.linalg.eigh((sample - mean).T @ (sample - mean))  # ascending
    axes = axes[:, :-4:-1]
    signs = np.sign(axes[np.abs(axes).argmax(axis=0), range(axes.shape[1])])
    axes = axes * np.where(signs == 0, 1, signs)
    low, high = np.percentile((sample - mean) @ axes, _TAILS, axis=0)
    span = np.where(high - low > 1e-9, high - low, np.inf)
    projected = (np.nan_to_num(encodings) - mean.astype(np.float32)) @ axes.astype(np.float32)
    shares = np.where(np.isinf(span), 0.5, (projected - low) / np.where(np.isinf(span), 1, span))
    colors: UInt8Array = np.rint(np.clip(shares, 0, 1) * 255).astype(np.uint8)
    return colors
