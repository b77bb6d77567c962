"""Training on the CPU: draw a view, compare, step, control the density."""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.color import SH_C0, dc_from_rgb
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Gradients, GradientSink, TrainableRasterizer, TrainStep
from gaga_core.training.checkpoint import TrainState
from gaga_core.training.densification import (
    ScreenSums,
    control_density,
    quota,
    relocate_and_grow,
    reset_opacities,
    walk,
)
from gaga_core.training.engine import (
    Setting,
    is_due_for_control,
    is_due_for_reset,
    step_exposures,
    thinned,
    turns_of,
)
from gaga_core.training.losses import LEAST_COVERAGE, photometric, sampled_depth
from gaga_core.training.optimizer import Splats, adam_step
from gaga_core.training.views import TrainView

_SPLIT, _WALK, _DROP = 1, 2, 3  # what random numbers are drawn for


class CpuEngine:
    """`engine.Engine` that trains the state in place.

    Everything random is drawn again from seed and iteration, so that a state is all it takes to go
    on.
    """

    def __init__(
        self, state: TrainState, setting: Setting, rasterizer: TrainableRasterizer
    ) -> None:
        self._state, self._setting, self._rasterizer = state, setting, rasterizer

    @property
    def n_splats(self) -> int:
        """Current number of splats."""
        return len(self._state.splats)

    def copied(self, state: TrainState) -> Gaussians:
        """A copy of the splats."""
        copy = Splats.of(state.splats.values).values
        return copy.with_antialiasing(self._setting.config.antialiased)

    def fetch(self, state: TrainState) -> None:
        """Nothing: ``state`` is right at any time."""

    def advance(self, state: TrainState) -> None:
        """Do the next iteration of ``state``, in place."""
        setting, config, i = self._setting, self._setting.config, state.iteration + 1
        moment = i / config.iterations
        if is_due_for_reset(i, config):
            reset_opacities(state.splats, config.density.reset_opacity)
        degree = config.degree_at(moment)
        if degree > state.splats.values.sh_degree:
            state.splats = state.splats.with_degree(degree)
        turns = turns_of(i - 1, setting)
        index = turns[setting.team.rank].view
        rates = setting.rates(moment)

        def apply(gradients: Gradients) -> None:
            _add_decay(state, gradients, setting)
            adam_step(state.splats, gradients, rates, i)
            state.sums.add(gradients)

        # Alone, a worker moves splats piece by piece; a team's mean needs all gradients first.
        sink = apply if setting.team.size == 1 else None
        step, by_exposure = self._draw(state, setting.view(index, moment), index, sink)
        if sink is None:
            apply(setting.team.mean(step.gradients, len(state.splats)))
        if config.exposure:
            step_exposures(state, setting, turns, by_exposure)
        state.losses[i - 1] = setting.team.mean_values(np.array([step.value]))[0]
        _control(state, setting, i)
        state.iteration = i

    def _draw(
        self, state: TrainState, view: TrainView, index: int, sink: GradientSink | None
    ) -> tuple[TrainStep, DoubleArray]:
        """Draw a view and compare it; also the gradient (2, 3) by its exposure (0 without)."""
        config, i = self._setting.config, state.iteration + 1
        moment, by_exposure = i / config.iterations, np.zeros((2, 3))
        drawn = thinned(
            state.splats.values,
            config.dropout_at(moment, len(self._setting.views)),
            self._setting.random(_DROP, i),
        )

        def loss(image: FloatArray, target: FloatArray) -> tuple[float, FloatArray]:
            return photometric(image, target, config.dissimilarity)

        def walk_back(gradients: Gradients) -> None:
            drawn.walk_back(gradients)
            if by_depth is not None:
                by_depth.add_to(gradients)
            if sink is not None:
                sink(gradients)

        weight = config.depth_at(moment)
        by_depth = depth_gradients(state.splats.values, view, self._rasterizer, weight)
        compare = state.exposures.loss_of(index, loss, by_exposure) if config.exposure else loss
        behind = self._setting.behind(view, i)
        step = self._rasterizer.train_step(
            drawn.gaussians.with_antialiasing(config.antialiased),
            view.camera,
            view.target(behind),
            compare,
            background=behind,
            sink=None if sink is None else walk_back,
        )
        if sink is None:
            walk_back(step.gradients)
        return step, by_exposure


def _add_decay(state: TrainState, gradients: Gradients, setting: Setting) -> None:
    """Gradients of the regularisers: mean opacity and mean standard deviation (MCMC)."""
    config = setting.config
    rows, values = gradients.indices, state.splats.values
    if config.opacity_decay > 0:
        o = 1 / (1 + np.exp(-values.logit_opacities[rows]))
        gradients.logit_opacities[:] += np.float32(config.opacity_decay / len(values)) * o * (1 - o)
    if config.scale_decay > 0:
        weight = np.float32(config.scale_decay / (3 * len(values) * setting.extent))
        gradients.log_scales[:] += weight * np.exp(values.log_scales[rows])


def _control(state: TrainState, setting: Setting, i: int) -> None:
    """Density control when it is due."""
    config, density = setting.config, setting.config.density
    moment = i / config.iterations
    if density.strategy == "mcmc" and density.noise > 0:
        decay = config.rates.means_end**moment
        walk(state.splats, density, decay, setting.extent, setting.random(_WALK, i))
    if is_due_for_control(i, config):
        _change_density(state, setting, i)


def _change_density(state: TrainState, setting: Setting, i: int) -> None:
    config, density, moment = setting.config, setting.config.density, i / setting.config.iterations
    rng = setting.random(_SPLIT, i)
    n_new = quota(density, len(state.splats), moment, density.every / config.iterations)
    if density.strategy == "mcmc":
        state.splats = relocate_and_grow(state.splats, density, n_new, rng)
    else:
        if moment <= density.reset_every:
            density = replace(density, largest_size=0.0)  # large ones are still needed (Kerbl)
        state.splats = control_density(
            state.splats, state.sums, density, setting.extent, n_new, rng
        )
    state.sums = ScreenSums.empty(len(state.splats))


# --- Loss of measured depth: the depth that splats draw against what a phone measured. It is drawn
# as a color, with the coverage as another, so that the gradients are those of the rasterizer. It is
# compared where both are known, relative to the median of the view, so that units do not matter (as
# Deng 2022 and Kerbl 2024 have it, from other sources of depth).


_COLUMNS = ("means", "quats", "log_scales", "logit_opacities")


@dataclass(frozen=True, eq=False)
class DepthGradients:
    """Gradients of the loss by the raw parameters of all N splats; 0 where a view shows none."""

    means: FloatArray  # (N, 3)
    quats: FloatArray  # (N, 4)
    log_scales: FloatArray  # (N, 3)
    logit_opacities: FloatArray  # (N,)

    def add_to(self, gradients: Gradients) -> None:
        """Add them to the rows of ``gradients``, in place."""
        for name in _COLUMNS:
            getattr(gradients, name)[:] += getattr(self, name)[gradients.indices]


def depth_gradients(
    splats: Gaussians, view: TrainView, rasterizer: TrainableRasterizer, weight: float
) -> DepthGradients | None:
    """Gradients of ``weight`` x the mean relative error of depth in a view; None where it has no
    depth."""
    if view.depth is None or weight <= 0 or not (view.depth > 0).any():
        return None
    camera, measured = sampled_depth(view.camera, view.depth)
    known = measured > 0
    unit, forward = float(np.median(measured[known])), camera.cam_from_world[2]
    by_place = (forward / unit).astype(np.float32)
    far = splats.means @ by_place[:3] + by_place[3]
    colors = np.stack([far, np.ones_like(far), np.zeros_like(far)], axis=1)
    shown = replace(splats, sh=dc_from_rgb(colors)[:, None])
    share = np.float32(weight / known.sum())

    def loss(image: FloatArray, target: FloatArray) -> tuple[float, FloatArray]:
        covered = np.maximum(image[..., 1], LEAST_COVERAGE)
        off = image[..., 0] / covered - target[..., 0]
        side = np.sign(off) * (known & (image[..., 1] > LEAST_COVERAGE)) * share
        gradient = np.zeros_like(image)
        gradient[..., 0] = side / covered
        gradient[..., 1] = -side * image[..., 0] / covered**2
        return float(np.abs(off * side).sum()), gradient

    wanted = np.repeat((measured / np.float32(unit))[..., None], 3, axis=2)
    step = rasterizer.train_step(shown, camera, wanted, loss, background=np.zeros(3, np.float32))
    found, rows = step.gradients, step.gradients.indices
    # By the color: a splat that is farther has a larger one.
    found.means[:] += found.sh[:, :1, 0] * np.float32(1 / SH_C0) * by_place[:3]
    columns = {name: np.zeros_like(getattr(splats, name)) for name in _COLUMNS}
    for name, column in columns.items():
        column[rows] = getattr(found, name)
    return DepthGradients(**columns)
