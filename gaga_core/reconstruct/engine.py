"""What drives a training: the part that the CPU's and the CUDA engine share."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.gaussians import Gaussians
from gaga_core.reconstruct.checkpoint import TrainState
from gaga_core.reconstruct.optimizer import Rates
from gaga_core.reconstruct.settings import TrainConfig
from gaga_core.reconstruct.team import Team
from gaga_core.reconstruct.views import TrainView

_EXPOSURE_END = 0.01  # share of the exposures' learning rate at the end
_ORDER = 0  # what random numbers are drawn for; engines use other numbers


class Engine(Protocol):
    """Does iterations of a training; it may keep the splats elsewhere until asked."""

    @property
    def n_splats(self) -> int:
        """How many splats there are now."""
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
    half: Sequence[TrainView]  # the same views at half size, or none
    config: TrainConfig
    extent: float  # of the cameras, scene units
    team: Team

    @cached_property
    def background(self) -> FloatArray:
        """Color (3,) behind all splats."""
        return np.array(self.config.background, np.float32)

    def view(self, index: int, moment: float) -> TrainView:
        """A view at the size of the moment."""
        return (self.half if moment <= self.config.half_until else self.views)[index]

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
    rate = config.exposure_rate * _EXPOSURE_END ** (state.iteration / config.iterations)
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
