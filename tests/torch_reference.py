"""The image model of `raster.base` in torch and float64: what gradients are tested against."""

from typing import Any

import numpy as np
import torch

from gaga_core.arrays import DoubleArray
from gaga_core.camera import NEAR, Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import ALPHA_MAX, ALPHA_MIN, BLUR, T_MIN

NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh")


def parameters(gaussians: Gaussians) -> dict[str, torch.Tensor]:
    """Every column as a float64 leaf that wants a gradient, and ``shift`` (N, 2) of the centres."""
    columns = {name: getattr(gaussians, name).astype(np.float64) for name in NAMES}
    columns["shift"] = np.zeros((len(gaussians), 2))
    return {name: torch.tensor(column, requires_grad=True) for name, column in columns.items()}


def render(
    p: dict[str, torch.Tensor],
    camera: Camera,
    background: DoubleArray,
    *,
    antialiased: bool = False,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Image (H, W, 3) and alpha (H, W) of splats in front of the camera, brute force."""
    pose = torch.tensor(camera.cam_from_world)
    p_cam = p["means"] @ pose[:3, :3].T + pose[:3, 3]
    centres, plain = _project(p, p_cam, camera)
    covariances = plain + BLUR * torch.eye(2, dtype=torch.float64)
    conics = torch.linalg.inv(covariances)
    opacities = torch.sigmoid(p["logit_opacities"])
    if antialiased:
        opacities = opacities * torch.sqrt(torch.det(plain) / torch.det(covariances))
    colors = _colors(p, camera)
    u = torch.arange(camera.width) + 0.5
    v = (torch.arange(camera.height) + 0.5)[:, None]
    image = torch.zeros(camera.height, camera.width, 3, dtype=torch.float64)
    T = torch.ones(camera.height, camera.width, dtype=torch.float64)
    is_open = torch.ones(camera.height, camera.width, dtype=torch.bool)
    depths = p_cam[:, 2].detach().float()
    for k in torch.argsort(depths, stable=True).tolist():
        if depths[k] < NEAR:
            continue
        dx, dy = u - centres[k, 0], v - centres[k, 1]
        a, b, c = conics[k, 0, 0], conics[k, 0, 1], conics[k, 1, 1]
        alpha = opacities[k] * torch.exp(-0.5 * (a * dx**2 + c * dy**2) - b * dx * dy)
        alpha = torch.where(alpha < ALPHA_MIN, 0, alpha.clamp(max=ALPHA_MAX))
        is_open = is_open & (T * (1 - alpha) >= T_MIN)
        alpha = torch.where(is_open, alpha, 0)
        image = image + (alpha * T)[..., None] * colors[k]
        T = T * (1 - alpha)
    return image + T[..., None] * torch.tensor(background), 1 - T


def _project(
    p: dict[str, torch.Tensor], p_cam: torch.Tensor, camera: Camera
) -> tuple[torch.Tensor, torch.Tensor]:
    """Centres (N, 2) and 2D covariances (N, 2, 2) without the blur."""
    w, x, y, z = (p["quats"] / p["quats"].norm(dim=1, keepdim=True)).T
    rotation = torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1),
        ],
        1,
    )
    axes = rotation * torch.exp(p["log_scales"])[:, None, :]
    f = torch.tensor([camera.K[0, 0], camera.K[1, 1]])
    depth = p_cam[:, 2:]
    slope = p_cam[:, :2] / depth
    limit = 1.3 * 0.5 * torch.tensor([camera.width, camera.height]) / f
    clamped = torch.minimum(torch.maximum(slope, -limit), limit)
    zero = torch.zeros_like(depth[:, 0])
    J = torch.stack(
        [
            torch.stack([f[0] / depth[:, 0], zero, -f[0] * clamped[:, 0] / depth[:, 0]], 1),
            torch.stack([zero, f[1] / depth[:, 0], -f[1] * clamped[:, 1] / depth[:, 0]], 1),
        ],
        1,
    )
    M = J @ torch.tensor(camera.cam_from_world[:3, :3]) @ axes
    centres = slope * f + torch.tensor(camera.K[:2, 2]) + p["shift"]
    return centres, M @ M.transpose(1, 2)


def _colors(p: dict[str, torch.Tensor], camera: Camera) -> torch.Tensor:
    directions = p["means"] - torch.tensor(camera.position)
    basis = sh_basis(directions / directions.norm(dim=1, keepdim=True))[:, : p["sh"].shape[1]]
    return (0.5 + torch.einsum("ns,nsc->nc", basis, p["sh"])).clamp(min=0)


def sh_basis(directions: torch.Tensor) -> torch.Tensor:
    """Real spherical harmonics (N, 25) by recurrences in x, y, z: no azimuth, so smooth at poles.

    Y_l^m = N Q_l^|m|(z) times the real or imaginary part of (x + i y)^|m|, sign (-1)^m.
    """
    from math import factorial, pi, sqrt

    x, y, z = directions.T
    real, imaginary = [torch.ones_like(z)], [torch.zeros_like(z)]
    for _ in range(4):
        r, i = real[-1], imaginary[-1]
        real.append(x * r - y * i)
        imaginary.append(x * i + y * r)
    Q: dict[tuple[int, int], Any] = {(0, 0): torch.ones_like(z)}
    for m in range(1, 5):
        Q[m, m] = (2 * m - 1) * Q[m - 1, m - 1]
    for m in range(4):
        Q[m + 1, m] = (2 * m + 1) * z * Q[m, m]
        for k in range(m + 2, 5):
            Q[k, m] = ((2 * k - 1) * z * Q[k - 1, m] - (k + m - 1) * Q[k - 2, m]) / (k - m)
    columns = []
    for degree in range(5):
        for m in range(-degree, degree + 1):
            k = abs(m)
            norm = sqrt((2 * degree + 1) / (4 * pi) * factorial(degree - k) / factorial(degree + k))
            wave = imaginary[k] if m < 0 else real[k]
            sign = (-1) ** k * (sqrt(2) if m else 1)
            columns.append(sign * norm * Q[degree, k] * wave)
    return torch.stack(columns, dim=1)


def gradient(leaf: torch.Tensor) -> DoubleArray:
    """What ``backward`` left in a leaf."""
    assert leaf.grad is not None
    return leaf.grad.numpy()
