"""Training by several workers at once: each draws its own view, all take the mean step."""

from dataclasses import dataclass
from typing import Protocol

from gaga_core.arrays import DoubleArray
from gaga_core.raster.base import Gradients


class Team(Protocol):
    """Workers that train the same splats. All hold equal parameters at every moment."""

    @property
    def rank(self) -> int:
        """This worker's number; 0 measures, writes and reports."""
        ...

    @property
    def size(self) -> int:
        """How many workers there are."""
        ...

    def mean(self, gradients: Gradients, n_splats: int) -> Gradients:
        """Mean of all workers' gradients; rows that a worker did not draw count as zero there."""
        ...

    def mean_values(self, values: DoubleArray) -> DoubleArray:
        """Element-wise mean over the workers."""
        ...


@dataclass(frozen=True)
class SingleWorker:
    """A team of one."""

    rank: int = 0
    size: int = 1

    def mean(self, gradients: Gradients, n_splats: int) -> Gradients:
        """The gradients as they are."""
        return gradients

    def mean_values(self, values: DoubleArray) -> DoubleArray:
        """The values as they are."""
        return values


SINGLE_WORKER = SingleWorker()
