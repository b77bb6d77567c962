"""Adam over the columns of a set of Gaussians: only the splats that a view shows are moved."""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Gradients
from gaga_core.threads import run_kernel
from gaga_core.training import losses_kernels as kernels
from gaga_core.training.settings import RateConfig

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
_CHUNK = 8192  # rows of one piece of work


@dataclass(frozen=True, eq=False)
class Splats:
    """State of the training: raw parameters, and Adam's two running means of each, row for row.

    The arrays are changed in place by `adam_step`; operations on rows return new ones.
    """

    values: Gaussians
    first: Gaussians  # running mean of the gradient
    second: Gaussians  # running mean of its square

    @staticmethod
    def of(values: Gaussians) -> "Splats":
        """``values`` at the start of a training: copied, without extra columns, nothing known."""
        copied = of_columns([np.array(getattr(values, name), order="C") for name in COLUMNS])
        return Splats(copied, _zeros_like(copied), _zeros_like(copied))

    def __len__(self) -> int:
        return len(self.values)

    def take(self, rows: IntArray | LongArray | BoolArray) -> "Splats":
        """These rows with their running means."""
        return Splats(self.values.take(rows), self.first.take(rows), self.second.take(rows))

    def grown(self, more: Gaussians) -> "Splats":
        """With ``more`` at the end, of which nothing is known yet."""
        nothing = _zeros_like(more)
        return Splats(
            concatenate(self.values, more),
            concatenate(self.first, nothing),
            concatenate(self.second, nothing),
        )

    def with_degree(self, degree: int) -> "Splats":
        """With SH coefficients up to ``degree``: new ones are zero."""
        return Splats(*(with_degree(g, degree) for g in (self.values, self.first, self.second)))


@dataclass(frozen=True)
class Rates:
    """Learning rates of one step."""

    means: float
    quats: float
    log_scales: float
    logit_opacities: float
    sh: float
    sh_rest: float

    @staticmethod
    def at(config: RateConfig, moment: float, extent: float) -> "Rates":
        """The rates at a ``moment`` 0..1 of a training whose cameras span ``extent``."""
        past = max(0.0, moment - config.end_from) / max(1e-9, 1 - config.end_from)
        fall = config.end**past
        return Rates(
            means=config.means * extent * config.means_end**moment,
            quats=config.quats * fall,
            log_scales=config.log_scales * fall,
            logit_opacities=config.logit_opacities * fall,
            sh=config.sh * fall,
            sh_rest=config.sh * config.sh_rest * fall,
        )

    def scaled(self, times: float) -> "Rates":
        """All rates ``times`` as large."""
        return Rates(*(times * rate for rate in astuple(self)))


def adam_step(splats: Splats, gradients: Gradients, rates: Rates, step: int) -> None:
    """Move the splats that ``gradients`` lists, in place. ``step`` counts from 1."""
    over, correction = 1 / (1 - 0.9**step), 1 / (1 - 0.999**step)
    for name in COLUMNS:
        gradient = as_rows(getattr(gradients, name))
        values, first, second = (
            as_rows(getattr(part, name)) for part in (splats.values, splats.first, splats.second)
        )
        lengths = np.full(values.shape[1], getattr(rates, name) * over, np.float32)
        if name == "sh":
            lengths[3:] = rates.sh_rest * over
        columns = (gradients.indices, gradient, values, first, second, lengths, correction)
        run_kernel(kernels.adam_rows, len(gradient), _CHUNK, *columns)


def concatenate(a: Gaussians, b: Gaussians) -> Gaussians:
    """The rows of ``a``, then those of ``b``; extra columns are left out."""
    return of_columns([np.concatenate([getattr(a, n), getattr(b, n)]) for n in COLUMNS])


def of_columns(columns: Sequence[FloatArray]) -> Gaussians:
    """Gaussians of arrays in the order of `COLUMNS`."""
    means, quats, log_scales, logit_opacities, sh = columns
    return Gaussians(means, quats, log_scales, logit_opacities, sh)


def camera_extent(positions: DoubleArray) -> float:
    """Size of the scene in scene units: 1.1 x the distance from the middle of the cameras (V, 3)
    to the farthest (Kerbl 2023)."""
    middle = positions.mean(axis=0)
    return max(1.1 * float(np.linalg.norm(positions - middle, axis=1).max()), 1e-6)


def as_rows(column: FloatArray) -> FloatArray:
    """A column (N, ...) as a matrix (N, C); also of no rows, where numpy cannot tell C."""
    return column.reshape(len(column), math.prod(column.shape[1:]))


def _zeros_like(gaussians: Gaussians) -> Gaussians:
    return of_columns([np.zeros_like(getattr(gaussians, name)) for name in COLUMNS])


def with_degree(gaussians: Gaussians, degree: int) -> Gaussians:
    """With SH coefficients up to ``degree``: those beyond are dropped, new ones are zero."""
    sh = np.zeros((len(gaussians), (degree + 1) ** 2, 3), np.float32)
    n = min(sh.shape[1], gaussians.sh.shape[1])
    sh[:, :n] = gaussians.sh[:, :n]
    return replace(gaussians, sh=sh)
