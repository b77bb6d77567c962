"""A training step next to a peer's on the same splats: OpenSplat's CPU rasterizer, built here.

The peer is left out unless ``GAGA_OPENSPLAT`` names a checkout of
https://github.com/pierotofy/OpenSplat (AGPL-3.0; nothing of it is part of this project) and a C++
compiler and ninja are there. Only its CPU kernels are built, in a minute or two, against the
installed torch; around them stands what its ``Model`` does in torch: activations, SSIM by
convolutions, one Adam for each kind of parameter.
"""

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Gradients
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.training.losses import photometric
from gaga_core.training.optimizer import Rates, Splats, adam_step
from gaga_core.training.settings import RateConfig
from tests.bench.bench_raster import surfaces
from tests.bench.figures import Figure, median_ms, one_thread
from tests.scenes import orbit_cameras

_BINDING = """
#include "bindings.h"
std::tuple<torch::Tensor, torch::Tensor, int64_t> draw(
    int width, int height, torch::Tensor xys, torch::Tensor conics, torch::Tensor colors,
    torch::Tensor opacities, torch::Tensor background, torch::Tensor cov2d, torch::Tensor depths) {
  auto r = rasterize_forward_tensor_cpu(
      width, height, xys, conics, colors, opacities, background, cov2d, depths);
  return {std::get<0>(r), std::get<1>(r), reinterpret_cast<int64_t>(std::get<2>(r))};
}
std::tuple<torch::Tensor, torch::Tensor, torch::Tensor, torch::Tensor> back(
    int width, int height, torch::Tensor xys, torch::Tensor conics, torch::Tensor colors,
    torch::Tensor opacities, torch::Tensor background, torch::Tensor cov2d, torch::Tensor depths,
    torch::Tensor rest, int64_t lists, torch::Tensor by_image, torch::Tensor by_alpha) {
  auto *px2gid = reinterpret_cast<std::vector<int32_t> *>(lists);
  auto r = rasterize_backward_tensor_cpu(height, width, xys, conics, colors, opacities,
      background, cov2d, depths, rest, px2gid, by_image, by_alpha);
  delete[] px2gid;
  return r;
}
PYBIND11_MODULE(TORCH_EXTENSION_NAME, m) {
  m.def("project", &project_gaussians_forward_tensor_cpu);
  m.def("shade", &compute_sh_forward_tensor_cpu);
  m.def("draw", &draw);
  m.def("back", &back);
}
"""


def figures() -> list[Figure]:
    """CPU milliseconds of a step of both, one thread each; ours alone where the peer is missing."""
    gaussians = _colored(surfaces(60_000), 3)
    camera = orbit_cameras(1, width=320, height=240, radius=2.0)[0]
    target = np.ascontiguousarray(CpuRasterizer().render(gaussians, camera).image[::-1])
    with one_thread():
        ours = median_ms(_our_step(gaussians, camera, target), 7, warm_up=2)
    title = "train: a step with Adam, 60k, 320x240, degree 3"
    found = [Figure(title, ours, "CPU-ms")]
    reason = _why_missing()
    if reason:
        print(f"peer: OpenSplat is left out: {reason}")  # noqa: T201  a benchmark says what it skips
        return found
    n_threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        peer = _Peer(Path(os.environ["GAGA_OPENSPLAT"]), gaussians, camera, target)
        mine = torch.tensor(CpuRasterizer().render(gaussians, camera).image)
        apart = (peer.draw().detach() - mine).abs().mean().item()
        theirs = median_ms(peer.step, 3)
    finally:
        torch.set_num_threads(n_threads)
    return [
        *found,
        Figure("peer: OpenSplat on the CPU, the same step", theirs, "CPU-ms"),
        Figure("peer: OpenSplat's step to ours", theirs / ours, "x", ">= 3"),
        Figure("peer: mean difference of the pictures", apart, "", "<= 0.01"),
    ]


def _why_missing() -> str:
    folder = os.environ.get("GAGA_OPENSPLAT", "")
    if not folder:
        return "GAGA_OPENSPLAT names no checkout of it"
    if not (Path(folder) / "rasterizer" / "gsplat-cpu" / "gsplat_cpu.cpp").is_file():
        return f"{folder} holds no CPU rasterizer of it"
    missing = [tool for tool in ("c++", "ninja") if shutil.which(tool) is None]
    return f"{missing[0]} is not installed" if missing else ""


def _colored(gaussians: Gaussians, degree: int) -> Gaussians:
    n_rest = (degree + 1) ** 2 - 1
    rest = np.random.default_rng(0).normal(0, 0.05, (len(gaussians), n_rest, 3))
    return replace(gaussians, sh=np.concatenate([gaussians.sh, rest.astype(np.float32)], axis=1))


def _our_step(gaussians: Gaussians, camera: Camera, target: Any) -> Callable[[], object]:
    trained, rates = Splats.of(gaussians), Rates.at(RateConfig(), 0.5, 1.0)

    def sink(piece: Gradients) -> None:
        adam_step(trained, piece, rates, 100)

    return lambda: CpuRasterizer().train_step(
        trained.values, camera, target, photometric, sink=sink
    )


class _Peer:
    """Its parameters, its optimisers, its step."""

    def __init__(self, source: Path, gaussians: Gaussians, camera: Camera, target: Any) -> None:
        self._camera, self._target = camera, torch.tensor(target)
        self._kernels = _built(source)
        columns = {
            "means": gaussians.means,
            "scales": gaussians.log_scales,
            "quats": gaussians.quats,
            "dc": gaussians.sh[:, :1],
            "rest": gaussians.sh[:, 1:],
            "opacities": gaussians.logit_opacities[:, None],
        }
        self._leaves = {k: torch.tensor(v).requires_grad_() for k, v in columns.items()}
        self._optimizers = [torch.optim.Adam([leaf], lr=1e-4) for leaf in self._leaves.values()]
        self._view = torch.tensor(camera.cam_from_world, dtype=torch.float32)
        self._window = _window()

    def step(self) -> None:
        """Draw, compare, go back, move."""
        for optimizer in self._optimizers:
            optimizer.zero_grad()
        self._loss(self.draw()).backward()  # type: ignore[no-untyped-call]
        for optimizer in self._optimizers:
            optimizer.step()

    def draw(self) -> Tensor:
        """The picture (H, W, 3)."""
        leaves, camera, K = self._leaves, self._camera, self._camera.K
        width, height = camera.width, camera.height
        means, quats = leaves["means"], leaves["quats"]
        xys, _, conics, cov2d, depths = self._kernels.project(
            len(means),
            means,
            leaves["scales"].exp(),
            1.0,
            quats / quats.norm(dim=-1, keepdim=True),
            self._view,
            _projection(camera) @ self._view,
            K[0, 0],
            K[1, 1],
            K[0, 2],
            K[1, 2],
            height,
            width,
            0.01,
        )
        directions = means.detach() - torch.tensor(camera.position, dtype=torch.float32)
        directions = directions / directions.norm(dim=-1, keepdim=True)
        sh = torch.cat([leaves["dc"], leaves["rest"]], dim=1)
        colors = (self._kernels.shade(len(means), 3, 3, directions, sh) + 0.5).clamp_min(0)
        opacities = leaves["opacities"].sigmoid()
        drawn: Tensor = _Rasterize.apply(  # type: ignore[no-untyped-call]
            self._kernels, (width, height), xys, conics, colors, opacities, cov2d, depths
        )
        return drawn.clamp_max(1)

    def _loss(self, image: Tensor) -> Tensor:
        a, b = (t.permute(2, 0, 1)[None] for t in (image, self._target))

        def blurred(maps: Tensor) -> Tensor:
            return torch.nn.functional.conv2d(maps, self._window, padding=5, groups=3)

        ma, mb = blurred(a), blurred(b)
        aa, bb, ab = blurred(a * a) - ma * ma, blurred(b * b) - mb * mb, blurred(a * b) - ma * mb
        over = (ma * ma + mb * mb + 0.01**2) * (aa + bb + 0.03**2)
        similar = ((2 * ma * mb + 0.01**2) * (2 * ab + 0.03**2) / over).mean()
        return 0.8 * (image - self._target).abs().mean() + 0.2 * (1 - similar)


class _Rasterize(torch.autograd.Function):
    """Its rasterizer and the way back through it."""

    @staticmethod
    def forward(ctx: Any, kernels: Any, size: tuple[int, int], *inputs: Tensor) -> Tensor:
        xys, conics, colors, opacities, cov2d, depths = (t.detach().contiguous() for t in inputs)
        given = (*size, xys, conics, colors, opacities, torch.zeros(3), cov2d, depths)
        image, rest, lists = kernels.draw(*given)
        ctx.kept = (kernels, given, rest, lists)
        return image

    @staticmethod
    def backward(ctx: Any, *by_output: Tensor) -> Any:
        kernels, given, rest, lists = ctx.kept
        by_image = by_output[0].contiguous()
        found = kernels.back(*given, rest, lists, by_image, torch.zeros_like(by_image[..., 0]))
        by_xys, by_conics, by_colors, by_opacities = found
        return None, None, by_xys, by_conics, by_colors, by_opacities, None, None


def _built(source: Path) -> Any:
    from torch.utils.cpp_extension import load_inline

    folder = source / "rasterizer" / "gsplat-cpu"
    code = f'#include "{(folder / "gsplat_cpu.cpp").resolve()}"\n{_BINDING}'
    return load_inline(  # type: ignore[no-untyped-call]
        "gaga_bench_opensplat",
        code,
        extra_include_paths=[str(folder.resolve())],
        extra_cflags=["-O3"],
    )


def _projection(camera: Camera) -> Tensor:
    """Its projection matrix: the principal point is in the middle."""
    K, near, far = camera.K, 0.001, 1000.0
    matrix = torch.zeros(4, 4)
    matrix[0, 0], matrix[1, 1] = 2 * K[0, 0] / camera.width, 2 * K[1, 1] / camera.height
    matrix[2, 2], matrix[2, 3], matrix[3, 2] = far / (far - near), -far * near / (far - near), 1
    return matrix


def _window() -> Tensor:
    taps = torch.exp(-((torch.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
    taps = taps / taps.sum()
    return (taps[:, None] * taps)[None, None].repeat(3, 1, 1, 1)
