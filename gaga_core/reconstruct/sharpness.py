"""How sharp a picture is: the strength of its finest detail."""

import numpy as np
from PIL import Image

from gaga_core.arrays import FloatArray, UInt8Array

LOOK_SIDE = 640  # pixels: pictures are compared at this size


def sharpness(picture: UInt8Array) -> float:
    """Variance of the Laplacian of the brightness of a picture (H, W, 3): larger is sharper.

    Divided by the variance of the brightness itself, so that a dark photo is not a blurred one.
    """
    gray: FloatArray = picture.mean(axis=2, dtype=np.float32)
    inner = gray[1:-1, 1:-1] * 4
    laplacian = inner - gray[:-2, 1:-1] - gray[2:, 1:-1] - gray[1:-1, :-2] - gray[1:-1, 2:]
    return float(laplacian.var() / max(float(gray.var()), 1.0))


def shrunk(picture: UInt8Array, longest_side: int) -> UInt8Array:
    """``picture`` (H, W, 3) with no side longer than ``longest_side`` pixels."""
    height, width = picture.shape[:2]
    times = longest_side / max(width, height)
    if times >= 1:
        return picture
    size = (max(round(width * times), 1), max(round(height * times), 1))
    image = Image.fromarray(picture).resize(size, Image.Resampling.BOX, reducing_gap=2.0)
    return np.asarray(image)
