"""What training calls of gsplat 1.5.3, in plain torch, for machines without it.

Written from gsplat's documented arguments: same shapes, same order of calls, brute force pictures.
The strategies do the least of what gsplat's do: duplicate and remove, in the optimisers too.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from gaga_core.camera import Camera
from gaga_core.color import SH_C0
from tests import torch_reference

Params = dict[str, torch.nn.Parameter]
Optimizers = dict[str, torch.optim.Adam]


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make ``import gsplat`` and ``gsplat.strategy.ops`` find the stand-in."""
    module, strategy, ops = (
        ModuleType(f"gsplat{rest}") for rest in ("", ".strategy", ".strategy.ops")
    )
    vars(module).update(
        rasterization=rasterization, DefaultStrategy=DefaultStrategy, MCMCStrategy=MCMCStrategy
    )
    vars(ops).update(reset_opa=reset_opa)
    for name, part in (("", module), (".strategy", strategy), (".strategy.ops", ops)):
        monkeypatch.setitem(sys.modules, f"gsplat{name}", part)


def rasterization(
    *,
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    sh_degree: int | None,
    packed: bool,
    rasterize_mode: str = "classic",
    backgrounds: Tensor | None = None,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    n = len(means)
    assert not packed
    assert (means.shape, quats.shape, scales.shape) == ((n, 3), (n, 4), (n, 3))
    assert opacities.shape == (n,)
    assert (viewmats.shape, Ks.shape) == ((1, 4, 4), (1, 3, 3))
    if sh_degree is None:  # what is drawn, in any number of channels
        assert colors.shape == (n, 1)
        sh = ((colors - 0.5) / SH_C0)[..., None].expand(n, 1, 3)
    else:
        sh = colors[:, : (sh_degree + 1) ** 2]
        assert sh.shape == (n, (sh_degree + 1) ** 2, 3)
    behind = torch.zeros(1, 3) if backgrounds is None else backgrounds
    assert behind.shape == (1, 3)
    camera = Camera(Ks[0].double().numpy(), viewmats[0].double().numpy(), width, height)
    centres = torch.zeros(1, n, 2, requires_grad=True)
    shown = {
        "means": means.double(),
        "quats": quats.double(),
        "log_scales": torch.log(scales.double()),
        "logit_opacities": torch.logit(opacities.double()),
        "sh": sh.double(),
        "shift": centres[0].double(),
    }
    assert rasterize_mode in ("classic", "antialiased")
    image, alpha = torch_reference.render(
        shown,
        camera,
        behind[0].double().numpy(),
        antialiased=rasterize_mode == "antialiased",
    )
    info = {"means2d": centres, "radii": torch.ones(1, n, 2, dtype=torch.int32)}
    info |= {"width": width, "height": height, "n_cameras": 1}  # type: ignore[dict-item]
    if sh_degree is None:
        image = image[..., :1]
    return image.float()[None], alpha.float()[None, ..., None], info


@dataclass
class DefaultStrategy:
    """Duplicates above the threshold, removes the faint."""

    prune_opa: float
    grow_grad2d: float
    grow_scale3d: float
    prune_scale3d: float
    refine_start_iter: int
    refine_stop_iter: int
    reset_every: int
    refine_every: int
    revised_opacity: bool

    def initialize_state(self, scene_scale: float) -> dict[str, Any]:
        return {"grad2d": None, "count": None, "scene_scale": scene_scale}

    def step_pre_backward(
        self, params: Params, optimizers: Optimizers, state: dict[str, Any], step: int, info: Any
    ) -> None:
        info["means2d"].retain_grad()

    @torch.no_grad()
    def step_post_backward(
        self, params: Params, optimizers: Optimizers, state: dict[str, Any], step: int, info: Any
    ) -> None:
        if step >= self.refine_stop_iter:
            return
        shown = (info["radii"] > 0).all(dim=-1)[0]
        size = torch.tensor([info["width"] / 2, info["height"] / 2])
        length = (info["means2d"].grad[0] * size).norm(dim=-1).float()
        state["grad2d"] += torch.where(shown, length, 0.0)
        state["count"] += shown.float()
        if step > self.refine_start_iter and step % self.refine_every == 0:
            mean = state["grad2d"] / state["count"].clamp_min(1)
            rows = torch.arange(len(mean))
            more = rows[mean > self.grow_grad2d]
            kept = torch.cat([rows[torch.sigmoid(params["opacities"]) >= self.prune_opa], more])
            is_new = torch.arange(len(kept)) >= len(kept) - len(more)
            _update(params, optimizers, lambda p: p[kept], lambda v: _fresh(v[kept], is_new))
            state["grad2d"], state["count"] = torch.zeros(len(kept)), torch.zeros(len(kept))


@dataclass
class MCMCStrategy:
    """Adds 5 % copies of opaque splats."""

    cap_max: int
    noise_lr: float
    refine_start_iter: int
    refine_stop_iter: int
    refine_every: int
    min_opacity: float
    rates: list[float] = field(default_factory=list)

    def initialize_state(self) -> dict[str, Any]:
        return {"binoms": torch.zeros(51, 51)}

    @torch.no_grad()
    def step_post_backward(
        self,
        params: Params,
        optimizers: Optimizers,
        state: dict[str, Any],
        step: int,
        info: Any,
        lr: float,
    ) -> None:
        self.rates.append(lr)
        n = len(params["means"])
        n_new = min(self.cap_max, int(1.05 * n)) - n
        due = self.refine_start_iter < step < self.refine_stop_iter
        if n_new > 0 and due and step % self.refine_every == 0:
            more = torch.multinomial(torch.sigmoid(params["opacities"]), n_new)
            kept = torch.cat([torch.arange(n), more])
            is_new = torch.arange(n + n_new) >= n
            _update(params, optimizers, lambda p: p[kept], lambda v: _fresh(v[kept], is_new))


def reset_opa(
    *, params: Params, optimizers: Optimizers, state: dict[str, Any], value: float
) -> None:
    with torch.no_grad():
        params["opacities"].clamp_(max=float(np.log(value / (1 - value))))


def _fresh(values: Tensor, is_new: Tensor) -> Tensor:
    values[is_new] = 0
    return values


def _update(
    params: Params,
    optimizers: Optimizers,
    of_param: Callable[[Tensor], Tensor],
    of_state: Callable[[Tensor], Tensor],
) -> None:
    """New parameters take the old ones' place, in the optimisers too, as gsplat does it."""
    for name, optimizer in optimizers.items():
        old = params[name]
        new = torch.nn.Parameter(of_param(old.detach()).clone())
        state = optimizer.state.pop(old)
        for key in ("exp_avg", "exp_avg_sq"):
            state[key] = of_state(state[key])
        optimizer.param_groups[0]["params"] = [new]
        optimizer.state[new] = state
        params[name] = new
