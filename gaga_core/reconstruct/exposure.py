"""Differences of exposure and white balance between photos, trained along and then left out."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.raster.base import ImageLoss

_BETA1, _BETA2 = 0.9, 0.99


@dataclass(frozen=True, eq=False)
class Exposures:
    """A gain and an offset for each view and channel: photo = gain x picture + offset.

    Their means over the views are 1 and 0, so that the splats keep the photos' mean look. The
    arrays are changed in place.
    """

    values: DoubleArray  # (V, 2, 3) gain, offset
    first: DoubleArray  # (V, 2, 3) Adam's running mean of the gradient
    second: DoubleArray  # (V, 2, 3) and of its square

    @staticmethod
    def neutral(n_views: int) -> "Exposures":
        """All photos as they are."""
        values = np.zeros((n_views, 2, 3))
        values[:, 0] = 1
        return Exposures(values, np.zeros_like(values), np.zeros_like(values))

    def loss_of(self, view: int, loss: ImageLoss, gradient: DoubleArray) -> ImageLoss:
        """``loss`` behind the exposure of ``view``; its gradient by that is written to
        ``gradient`` (2, 3)."""
        gain, offset = self.values[view].astype(np.float32)

        def compare(image: FloatArray, target: FloatArray) -> tuple[float, FloatArray]:
            value, by_seen = loss(image * gain + offset, target)
            gradient[0] = (by_seen * image).sum(axis=(0, 1), dtype=np.float64)
            gradient[1] = by_seen.sum(axis=(0, 1), dtype=np.float64)
            return value, by_seen * gain

        return compare

    def step(self, view: int, gradient: DoubleArray, rate: float, n_before: int) -> None:
        """Move the exposure of ``view``, after ``n_before`` such steps of it."""
        first, second = self.first[view], self.second[view]
        first += (1 - _BETA1) * (gradient - first)
        second += (1 - _BETA2) * (gradient**2 - second)
        over = 1 - _BETA1 ** (n_before + 1), 1 - _BETA2 ** (n_before + 1)
        self.values[view] -= rate * (first / over[0]) / (np.sqrt(second / over[1]) + 1e-15)
        self.values[:] -= self.values.mean(axis=0) - np.array([[1.0] * 3, [0.0] * 3])
