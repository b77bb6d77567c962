"""Training on CUDA through gsplat and its strategies of density control, behind `engine.Engine`.

Parameters and Adam's running means stay on the device; `fetch` brings them to the state when a
checkpoint, an observer or a measurement asks for them, so that a checkpoint of this engine holds
what one of the CPU holds. Written for gsplat 1.5.
"""

import importlib
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.training.checkpoint import TrainState
from gaga_core.training.densification import ScreenSums, quota, walk_rate
from gaga_core.training.engine import (
    HIGHEST_OPACITY,
    Setting,
    Turn,
    is_due_for_control,
    is_due_for_reset,
    step_exposures,
    turns_of,
)
from gaga_core.training.losses import LEAST_COVERAGE, sampled_depth
from gaga_core.training.optimizer import Rates, Splats, of_columns, with_degree
from gaga_core.training.settings import TrainConfig
from gaga_core.training.views import TrainView

# Our columns under gsplat's names; SH is split into degree 0 and the rest.
_NAMES = {
    "means": "means",
    "quats": "quats",
    "log_scales": "scales",
    "logit_opacities": "opacities",
}
_SH, _REST = "sh0", "shN"
_NEVER = 1 << 40


class CudaEngine:
    """`engine.Engine` over torch and gsplat on one device."""

    def __init__(self, state: TrainState, setting: Setting, device: str = "cuda") -> None:
        self._gsplat: Any = importlib.import_module("gsplat")
        self._ops: Any = importlib.import_module("gsplat.strategy.ops")
        self._setting, self._device = setting, torch.device(device)
        degree = setting.config.sh_degree
        columns = [
            _by_name(with_degree(part, degree))
            for part in (state.splats.values, state.splats.first, state.splats.second)
        ]
        values = {name: torch.nn.Parameter(self._send(c)) for name, c in columns[0].items()}
        self._params = values
        self._optimizers = {
            name: self._optimizer(p, columns[1][name], columns[2][name], state.iteration)
            for name, p in values.items()
        }
        self._strategy = _strategy(self._gsplat, setting.config)
        self._strategy_state: dict[str, Any] = self._initial_state(state.sums)

    @property
    def n_splats(self) -> int:
        """Current number of splats."""
        return len(self._params["means"])

    def copied(self, state: TrainState) -> Gaussians:
        """The splats, brought from the device."""
        return _gaussians(self._params).with_antialiasing(self._setting.config.antialiased)

    def fetch(self, state: TrainState) -> None:
        """Bring the splats and all that is known of them from the device into ``state``."""
        firsts, seconds = (
            {name: o.state[self._params[name]][key] for name, o in self._optimizers.items()}
            for key in ("exp_avg", "exp_avg_sq")
        )
        state.splats = Splats(_gaussians(self._params), _gaussians(firsts), _gaussians(seconds))
        sums = self._strategy_state
        if isinstance(sums.get("grad2d"), Tensor):
            state.sums = ScreenSums(_fetch(sums["grad2d"]), _fetch(sums["count"]).astype(np.int32))
        else:
            state.sums = ScreenSums.empty(len(state.splats))

    def advance(self, state: TrainState) -> None:
        """The next iteration; ``state`` gets its number, loss and exposures, and nothing else."""
        try:
            self._advance(state)
        except torch.OutOfMemoryError as error:
            raise GagaError(
                "The graphics card has not enough free memory for this training. Choose fewer "
                "splats, smaller pictures, or the backend cpu."
            ) from error

    def _advance(self, state: TrainState) -> None:
        setting, config, i = self._setting, self._setting.config, state.iteration + 1
        torch.manual_seed(config.seed * 1_000_003 + i)  # alike in all workers
        turns = turns_of(i - 1, setting)
        turn = turns[setting.team.rank]
        # gsplat 1.5.3 never comes to its own reset: `step % n == 0 & step > 0` is always false.
        if is_due_for_reset(i, config):
            self._ops.reset_opa(
                params=self._params,
                optimizers=self._optimizers,
                state=self._strategy_state,
                value=config.density.reset_opacity,
            )
        view = setting.view(turn.view, i / config.iterations)
        exposure = torch.tensor(
            state.exposures.values[turn.view], dtype=torch.float32, device=self._device
        ).requires_grad_(config.exposure)
        behind = setting.behind(view, i)
        image, info = self._render(view.camera, i / config.iterations, behind)
        target = torch.tensor(view.target(behind), device=self._device)
        loss = _photometric(image * exposure[0] + exposure[1], target, config.dissimilarity)
        uses_gradient = config.density.strategy == "gradient"
        if uses_gradient:
            self._strategy.step_pre_backward(
                self._params, self._optimizers, self._strategy_state, i, info
            )
        more = self._decay(config) + self._depth_error(view, config.depth_at(i / config.iterations))
        (loss + more).backward()  # type: ignore[no-untyped-call]
        setting.team.mean_in_place([p.grad for p in self._params.values() if p.grad is not None])
        self._step_exposures(state, turns, exposure)
        self._step_optimizers(rates_by_name(setting.rates(i / config.iterations)))
        if uses_gradient:
            self._control_by_gradient(i, info)
        else:
            walk = walk_rate(config.rates.means_end ** (i / config.iterations), setting.extent)
            self._strategy.step_post_backward(
                self._params, self._optimizers, self._strategy_state, i, info, lr=walk
            )
        value = setting.team.mean_values(np.array([float(loss.detach())]))[0]
        state.losses[i - 1] = value
        state.iteration = i

    def _render(
        self, camera: Camera, moment: float, behind: FloatArray
    ) -> tuple[Tensor, dict[str, Any]]:
        p, config = self._params, self._setting.config
        share = config.dropout_at(moment, len(self._setting.views))
        images, _, info = self._rasterize(
            camera,
            opacities=thinned_opacities(torch.sigmoid(p["opacities"]), share),
            colors=torch.cat([p[_SH], p[_REST]], dim=1),
            sh_degree=config.degree_at(moment),
            rasterize_mode="antialiased" if config.antialiased else "classic",
            backgrounds=self._send(behind)[None],
        )
        return images[0], info

    def _rasterize(self, camera: Camera, **looks: Any) -> Any:
        """gsplat's pictures (1, H, W, C), alphas (1, H, W, 1) and info of the splats."""
        return self._gsplat.rasterization(
            means=self._params["means"],
            quats=self._params["quats"],
            scales=torch.exp(self._params["scales"]),
            viewmats=self._send(camera.cam_from_world)[None],
            Ks=self._send(camera.K)[None],
            width=camera.width,
            height=camera.height,
            packed=False,
            **looks,
        )

    def _depth_error(self, view: TrainView, weight: float) -> Tensor:
        """``weight`` x the mean relative error of depth in a view, as `cpu_train.depth_gradients`
        has its gradients; 0 where it has no depth."""
        if view.depth is None or weight <= 0 or not (view.depth > 0).any():
            return torch.zeros((), device=self._device)
        camera, measured = sampled_depth(view.camera, view.depth)
        known = measured > 0
        unit = float(np.median(measured[known]))
        by_place = self._send(camera.cam_from_world[2] / unit)
        images, alphas, _ = self._rasterize(
            camera,
            opacities=torch.sigmoid(self._params["opacities"]),
            colors=(self._params["means"] @ by_place[:3] + by_place[3])[:, None],
            sh_degree=None,
        )
        alpha = alphas[0, ..., 0]
        off = images[0, ..., 0] / alpha.clamp_min(LEAST_COVERAGE) - self._send(measured / unit)
        counts = torch.from_numpy(known).to(self._device) & (alpha > LEAST_COVERAGE)
        return weight / int(known.sum()) * torch.where(counts, off.abs(), 0.0).sum()

    def _decay(self, config: TrainConfig) -> Tensor:
        """The regularisers of the loss (MCMC)."""
        total = torch.zeros((), device=self._device)
        if config.opacity_decay > 0:
            total = total + config.opacity_decay * torch.sigmoid(self._params["opacities"]).mean()
        if config.scale_decay > 0:
            weight = config.scale_decay / self._setting.extent
            total = total + weight * torch.exp(self._params["scales"]).mean()
        return total

    def _step_exposures(self, state: TrainState, turns: list[Turn], exposure: Tensor) -> None:
        if self._setting.config.exposure and exposure.grad is not None:
            by_exposure: DoubleArray = exposure.grad.double().cpu().numpy()
            step_exposures(state, self._setting, turns, by_exposure)

    def _step_optimizers(self, rates: dict[str, float]) -> None:
        for name, optimizer in self._optimizers.items():
            optimizer.param_groups[0]["lr"] = rates[name]
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)

    def _control_by_gradient(self, i: int, info: dict[str, Any]) -> None:
        """gsplat's default strategy, under our cap.

        When a control is due this view is not counted: then what is known is the same in all
        workers, and the threshold that admits just as many splats as may come can be told.
        """
        config, density = self._setting.config, self._setting.config.density
        if is_due_for_control(i, config) and self._strategy_state["grad2d"] is not None:
            info["radii"] = torch.zeros_like(info["radii"])
            sums = [self._strategy_state[key] for key in ("grad2d", "count")]
            self._setting.team.sum_in_place(sums)
            moment, step = i / config.iterations, density.every / config.iterations
            n_new = quota(density, self.n_splats, moment, step)
            mean = sums[0] / sums[1].clamp_min(1e-6)
            if n_new < len(mean):
                least = float(torch.topk(mean, n_new + 1).values[-1])
                self._strategy.grow_grad2d = max(density.threshold, least)
        self._strategy.step_post_backward(
            self._params, self._optimizers, self._strategy_state, i, info
        )
        self._strategy.grow_grad2d = density.threshold

    def _optimizer(
        self, param: torch.nn.Parameter, first: FloatArray, second: FloatArray, n_steps: int
    ) -> torch.optim.Adam:
        optimizer = torch.optim.Adam([param], lr=0.0, eps=1e-15)
        optimizer.state[param] = {
            "step": torch.tensor(float(n_steps)),
            "exp_avg": self._send(first),
            "exp_avg_sq": self._send(second),
        }
        return optimizer

    def _initial_state(self, sums: ScreenSums) -> dict[str, Any]:
        if self._setting.config.density.strategy == "mcmc":
            state: dict[str, Any] = self._strategy.initialize_state()
            return state
        state = self._strategy.initialize_state(scene_scale=self._setting.extent)
        state["grad2d"] = self._send(sums.gradient)
        state["count"] = self._send(sums.n_views)
        return state

    def _send(self, array: AnyArray) -> Tensor:
        return torch.from_numpy(np.array(array, np.float32, order="C")).to(self._device)


def thinned_opacities(opacities: Tensor, share: float) -> Tensor:
    """`dropout.thinned`: a share of them 0, the others raised as much."""
    if share == 0:
        return opacities
    is_out = torch.rand_like(opacities) < share
    raised = torch.minimum(opacities / (1 - share), opacities.detach().clamp(min=HIGHEST_OPACITY))
    return torch.where(is_out, 0.0, raised)


def rates_by_name(rates: Rates) -> dict[str, float]:
    """Learning rates under gsplat's names of the parameters."""
    found = {theirs: float(getattr(rates, ours)) for ours, theirs in _NAMES.items()}
    return found | {_SH: float(rates.sh), _REST: float(rates.sh_rest)}


def _strategy(gsplat: Any, config: TrainConfig) -> Any:
    density = config.density
    if density.strategy == "mcmc":
        return gsplat.MCMCStrategy(
            cap_max=density.max_splats,
            noise_lr=density.noise,
            refine_start_iter=config.at(density.start),
            refine_stop_iter=config.at(density.stop),
            refine_every=density.every,
            min_opacity=density.least_opacity,
        )
    return gsplat.DefaultStrategy(
        prune_opa=density.least_opacity,
        grow_grad2d=density.threshold,
        grow_scale3d=density.split_size,
        prune_scale3d=density.largest_size or float("inf"),
        refine_start_iter=config.at(density.start),
        refine_stop_iter=config.at(density.stop),
        reset_every=config.at(density.reset_every) or _NEVER,
        refine_every=density.every,
        revised_opacity=False,
    )


def _photometric(image: Tensor, target: Tensor, dissimilarity: float) -> Tensor:
    """`losses.photometric` in torch: (1 - d) L1 + d (1 - SSIM) of (H, W, 3)."""
    taps = torch.exp(-((torch.arange(11, device=image.device) - 5.0) ** 2) / (2 * 1.5**2))
    taps = taps / taps.sum()
    a, b = image.permute(2, 0, 1), target.permute(2, 0, 1)
    planes = torch.cat([a, b, a * a, b * b, a * b])[:, None]
    planes = torch.nn.functional.conv2d(planes, taps.view(1, 1, 11, 1), padding=(5, 0))
    planes = torch.nn.functional.conv2d(planes, taps.view(1, 1, 1, 11), padding=(0, 5))
    ma, mb, aa, bb, ab = torch.chunk(planes[:, 0], 5)
    aa, bb, ab = aa - ma * ma, bb - mb * mb, ab - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    similar = (2 * ma * mb + c1) * (2 * ab + c2) / ((ma**2 + mb**2 + c1) * (aa + bb + c2))
    apart = (image - target).abs().mean()
    return (1 - dissimilarity) * apart + dissimilarity * (1 - similar.mean())


def _by_name(gaussians: Gaussians) -> dict[str, FloatArray]:
    columns = {theirs: getattr(gaussians, ours) for ours, theirs in _NAMES.items()}
    return columns | {_SH: gaussians.sh[:, :1], _REST: gaussians.sh[:, 1:]}


def _gaussians(tensors: dict[str, Any]) -> Gaussians:
    columns = [_fetch(tensors[theirs]) for theirs in _NAMES.values()]
    sh = np.concatenate([_fetch(tensors[_SH]), _fetch(tensors[_REST])], axis=1)
    return of_columns([*columns, sh])


def _fetch(tensor: Tensor) -> FloatArray:
    return np.array(tensor.detach().cpu().numpy(), np.float32)
