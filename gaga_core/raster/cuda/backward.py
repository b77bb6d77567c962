"""Training on the graphics card: draw a view so that autograd can take its gradients back.

gsplat differentiates the blending and the spherical harmonics; our own projection in float64
(`project`) is differentiated by torch.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Gradients
from gaga_core.raster.cuda.project import Parameters, Projected, long_radii, project_again
from gaga_core.raster.cuda.view import blend, fetch, find_splats, list_tiles, send


@dataclass(frozen=True, eq=False)
class CudaForward:
    """A drawn view and what its way back needs."""

    index: Tensor  # (n,) int64 Gaussian, ascending
    parameters: Parameters  # of these: leaves of the graph
    sh: Tensor  # (n, S, 3) float32, a leaf too
    splats: Projected | None  # None when no tile lists a splat
    image: Tensor  # (H, W, 3) background included
    alpha: Tensor  # (H, W)


def forward(
    gsplat: Any, gaussians: Gaussians, camera: Camera, background: Tensor, device: torch.device
) -> CudaForward:
    """Draw SH color over ``background`` (3,), keeping the graph of every parameter in view."""
    index = find_splats(gaussians, camera, device).index
    rows = index.cpu().numpy()
    parameters, sh = Parameters.of(gaussians, rows, device), send(gaussians.sh[rows], device)
    for leaf in (*_columns(parameters), sh):
        leaf.requires_grad_()
    with torch.enable_grad():
        splats = project_again(parameters, index, camera)
        view = list_tiles(gsplat, splats, camera)
        if view.is_empty:
            size = (camera.height, camera.width)
            alpha = torch.zeros(size, device=device)
            return CudaForward(index, parameters, sh, None, background.expand(*size, 3), alpha)
        eye = torch.tensor(camera.position, device=device).double()
        colors = sh_colors(gsplat, gaussians.sh_degree, parameters.means - eye, sh)
        image, alpha = blend(gsplat, view, colors)
        image = image + (1 - alpha)[..., None] * background
    return CudaForward(index, parameters, sh, splats, image, alpha)


def sh_colors(gsplat: Any, degree: int, directions: Tensor, sh: Tensor) -> Tensor:
    """Color (n, 3) of splats seen along ``directions`` (n, 3); 0 where it is no number."""
    finite = torch.isfinite(sh)
    # Not only in the result: 0 times NaN would come back as the gradient of the direction.
    color = gsplat.spherical_harmonics(degree, directions.float(), torch.where(finite, sh, 0.0))
    color = color + 0.5
    return torch.where((color > 0) & (color < 1e30) & finite.all(dim=1), color, 0.0)


def backward(
    drawn: CudaForward, camera: Camera, by_image: Tensor, by_alpha: Tensor | None = None
) -> Gradients:
    """Gradients from those by the image (H, W, 3) and by alpha (H, W; None = 0)."""
    leaves = (*_columns(drawn.parameters), drawn.sh)
    n = len(drawn.index)
    if drawn.splats is None:
        found = [torch.zeros_like(leaf) for leaf in leaves]
        by_centre, radii = leaves[0].new_zeros((n, 2)), leaves[0].new_zeros(n)
    else:
        outputs, slopes = [drawn.image], [by_image]
        if by_alpha is not None:
            outputs, slopes = [*outputs, drawn.alpha], [*slopes, by_alpha]
        asked = (*leaves, drawn.splats.centres)
        *found, by_centre = torch.autograd.grad(outputs, asked, slopes)
        radii = long_radii(drawn.splats)
    half_picture = by_centre.new_tensor([camera.width / 2, camera.height / 2])
    means, quats, log_scales, logit_opacities, sh = (fetch(column) for column in found)
    return Gradients(
        indices=drawn.index.int().cpu().numpy(),
        means=means,
        quats=quats,
        log_scales=log_scales,
        logit_opacities=logit_opacities,
        sh=sh,
        screen=fetch((by_centre * half_picture).norm(dim=1)),
        radii=fetch(radii),
    )


def _columns(parameters: Parameters) -> tuple[Tensor, ...]:
    return (
        parameters.means,
        parameters.quats,
        parameters.log_scales,
        parameters.logit_opacities,
    )
