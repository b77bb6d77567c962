"""The training loop that the engines of the CPU and of CUDA share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Gradients
from gaga_core.training.checkpoint import TrainState
from gaga_core.training.distributed import Team
from gaga_core.training.optimizer import Rates
from gaga_core.training.settings import TrainConfig
from gaga_core.training.views import TrainView

_EXPOSURE_END_RATE = 0.01  # share of the exposures' learning rate at the end
_ORDER, _BEHIND = 0, 9  # what random numbers are drawn for; engines use other numbers


class Engine(Protocol):
    """Does iterations of a training; it may keep the splats elsewhere until asked."""

    @property
    def n_splats(self) -> int:
        """Current number of splats."""
        ...

    def advance(self, state: TrainState) -> None:
        """Do the next iteration: number, loss and exposures of ``state`` are right after it."""
        ...

    def copied(self, state: TrainState) -> Gaussians:
        """The splats as they are now, in arrays that stay as they are."""
        ...

    def fetch(self, state: TrainState) -> None:
        """Make all of ``state`` right."""
        ...


@dataclass(frozen=True, eq=False)
class Setting:
    """All that stays the same from one iteration to the next."""

    views: Sequence[TrainView]
    smaller: Mapping[float, Sequence[TrainView]]  # the same views at shares of their size
    config: TrainConfig
    extent: float  # of the cameras, scene units
    team: Team

    @cached_property
    def background(self) -> FloatArray:
        """Color (3,) behind all splats."""
        return np.array(self.config.background, np.float32)

    def behind(self, view: TrainView, iteration: int) -> FloatArray:
        """Color (3,) behind all splats in one iteration: where a background is left out another
        each time, so that only what is transparent there fits."""
        if view.alpha is None:
            return self.background
        return self.random(_BEHIND, iteration).random(3, np.float32)

    def view(self, index: int, moment: float) -> TrainView:
        """A view at the current size."""
        return self.smaller.get(self.config.size_at(moment), self.views)[index]

    def rates(self, moment: float) -> Rates:
        """Learning rates; those of a team grow with the root of its size, as its gradients are
        surer (Zhao 2024, Grendel)."""
        n = self.team.size
        return Rates.at(self.config.rates, moment, self.extent).scaled(float(np.sqrt(n)))

    def random(self, use: int, number: int) -> np.random.Generator:
        """Random numbers of one use at one moment, the same for all workers."""
        return np.random.default_rng((self.config.seed, use, number))


@dataclass(frozen=True)
class Turn:
    """One worker's turn: its view, and how often that was drawn before."""

    view: int
    n_before: int


def turns_of(n_steps: int, setting: Setting) -> list[Turn]:
    """The turns of all workers after ``n_steps``.

    All views in a random order, then all in another; the workers of a team take the next ones.
    """
    found, n = [], len(setting.views)
    for worker in range(setting.team.size):
        turn, place = divmod(n_steps * setting.team.size + worker, n)
        found.append(Turn(int(setting.random(_ORDER, turn).permutation(n)[place]), turn))
    return found


def step_exposures(
    state: TrainState, setting: Setting, turns: Sequence[Turn], by_exposure: DoubleArray
) -> None:
    """Move the exposures of all workers' views alike in every worker, in place.

    ``by_exposure`` (2, 3) is this worker's gradient by the exposure of its own view.
    """
    team = setting.team
    rows = np.zeros((team.size, 2, 3))
    rows[team.rank] = by_exposure
    rows = team.mean_values(rows) * team.size
    config = setting.config
    rate = config.exposure_rate * _EXPOSURE_END_RATE ** (state.iteration / config.iterations)
    for turn, row in zip(turns, rows, strict=True):
        state.exposures.step(turn.view, row, rate, turn.n_before)


def is_due_for_control(iteration: int, config: TrainConfig) -> bool:
    """Whether the density is controlled after this iteration."""
    density = config.density
    moment = iteration / config.iterations
    return iteration % density.every == 0 and density.start <= moment <= density.stop


def is_due_for_reset(iteration: int, config: TrainConfig) -> bool:
    """Whether opacities are cut before this iteration: what was measured after the last saw none
    of it."""
    density = config.density
    if density.strategy != "gradient" or density.reset_every <= 0:
        return False
    every = max(1, config.at(density.reset_every))
    done = iteration - 1
    return done > 0 and done % every == 0 and done < config.at(density.stop)


# --- Dropout: splats left out at random in each step, against those that only suit single photos.
# Where few photos see a place, a splat in front of it can repair the picture of one of them and is
# in the way of every other view. Left out now and then, it is no longer needed for that, and those
# behind it learn to draw the place themselves (Park 2025, DropGaussian).


_OUT_LOGIT = -20.0  # logit of a splat that is not drawn
HIGHEST_OPACITY = 0.995  # opacity after compensation


@dataclass(frozen=True, eq=False)
class Thinned:
    """Splats with some left out and the opacity of the others raised, and the way back."""

    gaussians: Gaussians
    slopes: DoubleArray | None  # (N,) of the raised logit by the stored one; None = all 1

    def walk_back(self, gradients: Gradients) -> None:
        """Make the gradients by logits those by the logits that are stored, in place."""
        if self.slopes is not None:
            gradients.logit_opacities[:] *= self.slopes[gradients.indices].astype(np.float32)


def thinned(gaussians: Gaussians, share: float, rng: np.random.Generator) -> Thinned:
    """Leave out a ``share`` 0..1 of the splats; the others get opacity o / (1 - ``share``).

    So each covers on average as much as it does when all are drawn. Opacities end at 0.995 and pass
    no gradient there. A share of 0 changes nothing.
    """
    if share == 0:
        return Thinned(gaussians, None)
    is_out: BoolArray = rng.random(len(gaussians)) < share
    opacities = gaussians.opacities.astype(np.float64)
    wanted = opacities / (1 - share)
    raised = np.minimum(wanted, np.maximum(HIGHEST_OPACITY, opacities))
    is_free = wanted == raised
    logits = np.where(is_out, _OUT_LOGIT, _logit(raised))
    slopes = np.where(is_free & ~is_out, (1 - opacities) / np.maximum(1 - raised, 1e-9), 0.0)
    return Thinned(replace(gaussians, logit_opacities=logits.astype(np.float32)), slopes)


def _logit(opacities: DoubleArray) -> DoubleArray:
    inside = np.clip(opacities, 1e-9, 1 - 1e-9)
    return np.log(inside / (1 - inside))
