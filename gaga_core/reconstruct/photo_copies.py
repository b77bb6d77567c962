"""Copies of a photo: smaller, compressed again, or with another exposure, as from a chat."""

import numpy as np
from PIL import Image

from gaga_core.arrays import FloatArray, UInt8Array

_SIDE = 128  # pixels: pictures are compared at this size
_COARSE = 16  # ... and first at this one
_ALIKE = 0.998  # correlation from which two pictures may be of one photo, coarse
_SAME = 0.08  # standard deviations: mean difference of two copies at most
_SHAPE = 0.01  # sides may differ by this share


class LooksIndex:
    """The photos that were looked at so far, to find copies among them."""

    def __init__(self) -> None:
        self._coarse: list[FloatArray] = []
        self._fine: list[FloatArray] = []
        self._ratio: list[float] = []

    def has_like(self, picture: UInt8Array) -> bool:
        """Whether ``picture`` (H, W, 3) is a copy of one of them; remembers it if not.

        Two photos from places a step apart differ by far more than copies do.
        """
        height, width = picture.shape[:2]
        coarse, fine, ratio = _looks(picture, _COARSE), _looks(picture, _SIDE), width / height
        for other, detail, shape in zip(self._coarse, self._fine, self._ratio, strict=True):
            if abs(shape / ratio - 1) > _SHAPE or float((coarse * other).mean()) < _ALIKE:
                continue
            if float(np.abs(fine - detail).mean()) < _SAME:
                return True
        self._coarse.append(coarse)
        self._fine.append(fine)
        self._ratio.append(ratio)
        return False


def _looks(picture: UInt8Array, side: int) -> FloatArray:
    """Brightness (side, side) with mean 0 and standard deviation 1."""
    image = Image.fromarray(picture).convert("L").resize((side, side), Image.Resampling.BOX)
    gray = np.asarray(image, np.float32)
    result: FloatArray = (gray - gray.mean()) / max(float(gray.std()), 1.0)
    return result
