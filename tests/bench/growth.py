"""How a cost grows: the best line through it, and what one step more costs at its end."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Line:
    """The line at the start + by_step * steps that is best by shares: few steps weigh as much as
    many."""

    start: float
    by_step: float
    largest_miss: float  # share by which a value misses the line at most
    end_to_begin: float  # a step between the last two values, to one between the first two

    @staticmethod
    def through(steps: Sequence[int], values: Sequence[float]) -> "Line":
        """Of at least two values; ``steps`` ascend."""
        x, y = np.array(steps, np.float64), np.array(values)
        a, b = np.linalg.lstsq(np.stack([1 / y, x / y], axis=1), np.ones(len(x)), rcond=None)[0]
        slopes = np.diff(y) / np.diff(x)
        miss = float(np.abs((a + b * x) / y - 1).max())
        return Line(float(a), float(b), miss, float(slopes[-1] / slopes[0]))
