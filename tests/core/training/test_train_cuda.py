"""Training through gsplat: on CUDA where there is a device, and with a stand-in in torch."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from gaga_core.gaussians import Gaussians
from gaga_core.progress import run_stage
from gaga_core.raster import base, probe
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.training import cuda_train
from gaga_core.training.checkpoint import TrainState
from gaga_core.training.cpu_train import CpuEngine
from gaga_core.training.distributed import SINGLE_WORKER
from gaga_core.training.engine import Engine, Setting, thinned
from gaga_core.training.losses import photometric
from gaga_core.training.optimizer import COLUMNS
from gaga_core.training.settings import TrainConfig
from gaga_core.training.train import Trained, train_stage
from gaga_core.training.views import TrainView, TrainViews
from tests.core.training.train_scenes import followed, stop_at
from tests.scenes import orbit_cameras, random_gaussians

CPU = CpuRasterizer()


class _SaysCuda(CpuRasterizer):
    """Draws on the CPU for measuring; the training that it asks for is that of gsplat."""

    name = "cuda"


@pytest.fixture(params=["stand-in", pytest.param("gsplat", marks=pytest.mark.cuda)])
def cuda(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> base.Rasterizer:
    if request.param == "stand-in":
        from tests.core.training import train_gsplat

        train_gsplat.install(monkeypatch)
        engine: Callable[..., object] = partial(cuda_train.CudaEngine, device="cpu")
        monkeypatch.setattr(cuda_train, "CudaEngine", engine)
    else:
        found = probe.verdict(may_compile=True)
        if not found.usable:
            pytest.skip(f"CUDA cannot draw here: {found.reason}")
    return _SaysCuda()


@pytest.fixture(scope="module")
def scene() -> tuple[Gaussians, TrainViews]:
    """Pictures of a few splats, and the splats spoiled."""
    truth = random_gaussians(21, seed=3)
    truth.log_scales[:] += 1.2
    views = []
    for camera in orbit_cameras(4, width=20, height=15):
        image = np.clip(CPU.render(truth, camera).image, 0, 1)
        views.append(TrainView(camera, (image * 255 + 0.5).astype(np.uint8)))
    rng = np.random.default_rng(0)
    spoiled = replace(
        truth,
        means=truth.means + rng.normal(0, 0.1, truth.means.shape).astype(np.float32),
        sh=np.zeros_like(truth.sh),
    )
    return spoiled, TrainViews(tuple(views), tuple(views[:2]))  # one chooses, the other tells


def tiny(strategy: str, iterations: int = 20, **changes: object) -> TrainConfig:
    config = TrainConfig.of("draft")
    density = replace(
        config.density,
        strategy=strategy,  # type: ignore[arg-type]
        max_splats=26,
        every=3,
        threshold=1e-7,
        reset_every=0.0,
    )
    rates = replace(config.rates, sh=0.05)
    changed = replace(config, iterations=iterations, sh_degree=1, density=density, rates=rates)
    changed = replace(changed, smaller=(), dropout=0.0)  # so few splats must all be drawn
    return replace(changed, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("strategy", ["gradient", "mcmc"])
def test_it_learns_under_the_cap_and_with_exposure(
    cuda: base.Rasterizer, scene: tuple[Gaussians, TrainViews], strategy: str
) -> None:
    config = tiny(strategy, exposure=True)
    trained = run_stage(train_stage(*scene, config, cuda))
    assert trained.losses[-4:].mean() < 0.8 * trained.losses[:4].mean()
    assert 21 < len(trained.gaussians) <= 26
    assert trained.gaussians.sh_degree == 1
    assert trained.quality is not None
    assert all(np.isfinite(getattr(trained.gaussians, name)).all() for name in COLUMNS)


@pytest.mark.parametrize("strategy", ["gradient", "mcmc"])
def test_a_stopped_training_goes_on(
    cuda: base.Rasterizer, scene: tuple[Gaussians, TrainViews], strategy: str, tmp_path: Path
) -> None:
    """A checkpoint holds parameters, running means, sums of density control, and exposures."""
    config = tiny(strategy, 8, exposure=True)
    whole = run_stage(train_stage(*scene, config, cuda))
    stop_at(6, *scene, config, tmp_path / "c.npz", cuda)
    resumed: Trained = run_stage(train_stage(*scene, config, cuda, checkpoint=tmp_path / "c.npz"))
    np.testing.assert_allclose(whole.losses, resumed.losses, rtol=1e-4)
    for name in COLUMNS:
        a, b = getattr(whole.gaussians, name), getattr(resumed.gaussians, name)
        np.testing.assert_allclose(a, b, atol=1e-3, err_msg=name)


def test_opacities_are_reset(cuda: base.Rasterizer, scene: tuple[Gaussians, TrainViews]) -> None:
    """gsplat 1.5.3 itself never gets to it."""
    config = tiny("gradient", 5, snapshot_seconds=0.0)
    config = replace(config, density=replace(config.density, reset_every=0.4))
    updates, _ = followed(train_stage(*scene, config, cuda))
    highest = {u.iteration: u.gaussians.opacities.max() for u in updates if u.gaussians}
    assert min(highest[1], highest[2]) > 0.5
    assert highest[3] < 1.1 * config.density.reset_opacity  # and one step


def test_its_loss_is_ours() -> None:
    rng = np.random.default_rng(0)
    image, target = rng.uniform(0, 1, (2, 20, 27, 3)).astype(np.float32)
    leaf = torch.tensor(image, requires_grad=True)
    value = cuda_train._photometric(leaf, torch.tensor(target), 0.2)
    value.backward()  # type: ignore[no-untyped-call]
    want, gradient = photometric(image, target, 0.2)
    assert float(value.detach()) == pytest.approx(want, abs=1e-5)
    assert leaf.grad is not None
    np.testing.assert_allclose(leaf.grad.numpy(), gradient, atol=1e-6)


def test_a_rasterizer_without_gradients_is_refused(scene: tuple[Gaussians, TrainViews]) -> None:
    from gaga_core.raster import choose

    with pytest.raises(ValueError, match="does not train"):
        run_stage(train_stage(*scene, tiny("gradient"), choose("reference")))


def test_splats_are_left_out_as_on_the_cpu() -> None:
    """The same opacities for those that stay, with the same gradient by the stored logits."""
    gaussians = random_gaussians(300, seed=3)
    logits = torch.tensor(np.linspace(-4, 7, 300), dtype=torch.float64, requires_grad=True)
    torch.manual_seed(0)
    found = cuda_train.thinned_opacities(torch.sigmoid(logits), 0.25)
    found.log().nan_to_num(neginf=0.0).sum().backward()  # type: ignore[no-untyped-call]
    there = found.detach().numpy()
    is_out = there == 0
    assert 0.15 < is_out.mean() < 0.35
    some = replace(gaussians, logit_opacities=logits.detach().numpy().astype(np.float32))
    way = thinned(some, 0.25, np.random.default_rng(0))
    ours, slopes = way.gaussians.opacities, way.slopes
    assert slopes is not None
    both = ~is_out & (ours > 1e-6)
    np.testing.assert_allclose(there[both], ours[both], rtol=1e-4)
    assert logits.grad is not None
    by_logit = (1 - ours) * slopes  # of the logarithm of an opacity
    np.testing.assert_allclose(logits.grad.numpy()[both], by_logit[both], rtol=1e-2, atol=1e-4)
    assert cuda_train.thinned_opacities(found, 0.0) is found


def test_measured_depth_pulls_as_on_the_cpu(cuda: base.Rasterizer) -> None:
    """After a step with a depth map both engines have the same running means of gradients."""
    splats = random_gaussians(21, seed=3)
    splats.log_scales[:] += 1.2
    camera = orbit_cameras(1, width=20, height=15)[0]
    drawn = CPU.render(splats, camera)
    measured = np.where(drawn.alpha > 0.3, 0.8 * drawn.expected_depth, 0).astype(np.float32)
    view = TrainView(camera, np.full((15, 20, 3), 120, np.uint8), depth=measured)
    setting = Setting([view], {}, tiny("gradient", depth=40.0), 1.0, SINGLE_WORKER)
    found = []
    for make in (cuda_train.CudaEngine, partial(CpuEngine, rasterizer=CPU)):
        state = TrainState.first(splats, 1, 20)
        engine: Engine = make(state, setting)
        engine.advance(state)
        engine.fetch(state)
        found.append(state.splats.first)
    for name in COLUMNS[:4]:
        theirs, ours = (getattr(means, name) for means in found)
        np.testing.assert_allclose(theirs, ours, atol=0.01 * np.abs(ours).max(), err_msg=name)
