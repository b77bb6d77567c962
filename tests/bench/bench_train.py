"""A training step on the CPU: gradients against float64 autograd, CPU time of each part."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Gradients
from gaga_core.raster.cpu.prepare import prepare
from gaga_core.raster.cpu.rasterizer import (
    CpuRasterizer,
    _backward_sum_tiles,
    _blend,
    _colors,
    _walk_back,
    forward,
)
from gaga_core.training.losses import photometric
from gaga_core.training.optimizer import Rates, Splats, adam_step
from gaga_core.training.settings import RateConfig
from tests import torch_reference
from tests.bench.bench_raster import surfaces
from tests.bench.figures import Figure, cpu_median
from tests.scenes import orbit_cameras, random_gaussians


def figures() -> list[Figure]:
    """Every figure of this file; times in CPU milliseconds of all threads together."""
    return [*_accuracy(), *_parts(), *_whole()]


def _accuracy() -> list[Figure]:
    """The worst parameter kind of a scene of every kind of splat, degree 3."""
    gaussians = random_gaussians(400, seed=11, sh_degree=3)
    camera = orbit_cameras(5, width=109, height=83)[1]
    by_image = np.random.default_rng(0).normal(size=(83, 109, 3)).astype(np.float32)
    got = CpuRasterizer().backward(gaussians, camera, by_image)
    leaves = torch_reference.parameters(gaussians)
    image, _ = torch_reference.render(leaves, camera, np.zeros(3))
    (image * torch.tensor(by_image)).sum().backward()  # type: ignore[no-untyped-call]
    errors, cosines = [], []
    for name in torch_reference.NAMES:
        want = torch_reference.gradient(leaves[name])
        ours = np.zeros_like(want)
        ours[got.indices] = getattr(got, name)
        size = np.linalg.norm(want)
        errors.append(np.linalg.norm(ours - want) / size)
        cosines.append((ours * want).sum() / size / np.linalg.norm(ours))
    return [
        Figure("gradients: relative error against float64", float(max(errors)), "", "<= 1e-3"),
        Figure("gradients: cosine with float64", float(min(cosines)), "", ">= 0.9999"),
    ]


def _view(n: int, width: int, height: int) -> tuple[Gaussians, Camera]:
    return surfaces(n), orbit_cameras(1, width=width, height=height, radius=2.0)[0]


def _parts() -> list[Figure]:
    """124k pixels, 50k splats: the size of a small photo scene."""
    gaussians, camera = _view(50_000, 264, 471)
    view = prepare(gaussians, camera)
    colors, black = _colors(gaussians, camera, view), np.zeros(3, np.float32)
    drawn = forward(view, camera, colors, black)
    target = np.ascontiguousarray(drawn.image[::-1])
    by_image = photometric(drawn.image, target)[1]
    by_alpha = np.zeros_like(drawn.transmittance)
    sums = _backward_sum_tiles(drawn, by_image, by_alpha)
    parts: dict[str, Callable[[], object]] = {
        "prepare": lambda: prepare(gaussians, camera),
        "blend": lambda: forward(view, camera, colors, black),
        "blend as the viewer, in loops and with depth": lambda: _blend(
            view, camera, colors, black, 3
        ),
        "loss and its gradient": lambda: photometric(drawn.image, target),
        "back through tiles": lambda: _backward_sum_tiles(drawn, by_image, by_alpha),
        "back through projection": lambda: _walk_back(gaussians, camera, drawn, sums),
    }
    took = {name: cpu_median(work, 9) for name, work in parts.items()}
    in_vectors, in_loops = list(took.values())[1:3]
    return [
        *(Figure(f"train: 50k, 264x471, {name}", ms, "CPU-ms") for name, ms in took.items()),
        Figure("train: blend in vectors to blend in loops", in_vectors / in_loops, "x", "<= 0.75"),
        Figure("train: 50k, 264x471, tile entries", len(view.ids), ""),
    ]


def _whole() -> list[Figure]:
    """A step at 320x240 with 60k splats, colors of degree 0 and 3."""
    gaussians, camera = _view(60_000, 320, 240)
    cpu, found = CpuRasterizer(), []
    target = np.ascontiguousarray(cpu.render(gaussians, camera).image[::-1])
    render = cpu_median(lambda: cpu.render(gaussians, camera), 9)
    rates = Rates.at(RateConfig(), 0.5, 1.0)
    for degree in (0, 3):
        n_rest = (degree + 1) ** 2 - 1
        rest = np.random.default_rng(0).normal(0, 0.05, (len(gaussians), n_rest, 3))
        sh = np.concatenate([gaussians.sh, rest.astype(np.float32)], axis=1)
        splats = replace(gaussians, sh=sh)

        def step(splats: Gaussians = splats) -> object:
            return cpu.train_step(splats, camera, target, photometric)

        took = cpu_median(step, 9)
        found.append(
            Figure(f"train: a step, 60k, 320x240, degree {degree}", took, "CPU-ms", "<= 65")
        )
        found.append(Figure(f"train: that step to a render, degree {degree}", took / render, "x"))
        gradients = cpu.train_step(splats, camera, target, photometric).gradients
        trained = Splats.of(splats)

        def move(trained: Splats = trained, gradients: Gradients = gradients) -> None:
            adam_step(trained, gradients, rates, 100)

        found.append(Figure(f"train: Adam, 60k, degree {degree}", cpu_median(move, 9), "CPU-ms"))
    return found
