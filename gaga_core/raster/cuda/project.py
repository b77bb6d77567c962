"""EWA projection in plain torch, on whatever device the picture is blended."""

import numpy as np
import torch
from torch import Tensor

from gaga_core.arrays import FloatArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import ALPHA_MIN, BLUR, NEAR


def project(
    gaussians: Gaussians, rows: slice, camera: Camera, device: torch.device
) -> tuple[Tensor, ...]:
    """EWA projection of some Gaussians in float64, as in `raster.reference.project`.

    Returns, of those in the picture: index, centre (n, 2), conic (n, 3), opacity, depth, and the
    half size (n, 2) int32 of the box outside which alpha is under 1/255.
    """

    def send(array: FloatArray) -> Tensor:
        return torch.tensor(np.asarray(array[rows]), device=device).double()

    pose = torch.tensor(np.asarray(camera.cam_from_world[:3]), device=device).double()
    K = torch.tensor(np.asarray(camera.K), device=device).double()
    focal = torch.stack([K[0, 0], K[1, 1]])
    size = torch.tensor([camera.width, camera.height], device=device).double()
    p_cam = send(gaussians.means) @ pose[:, :3].T + pose[:, 3]
    depth = p_cam[:, 2]
    slope = p_cam[:, :2] / depth[:, None]
    limit = 1.3 * 0.5 * size / focal
    clamped = slope.clamp(-limit, limit)
    axes = _rotations(send(gaussians.quats)) * send(gaussians.log_scales).exp()[:, None, :]
    # J W R S: a row of J is (focal, 0, -focal * slope) / depth.
    turned = torch.einsum("ij,njk->nik", pose[:, :3], axes)
    M = (turned[:, :2] - clamped[..., None] * turned[:, 2:]) * (focal / depth[:, None])[..., None]
    xx, yy = (M * M).sum(dim=2).unbind(dim=1)
    xx, yy, xy = xx + BLUR, yy + BLUR, (M[:, 0] * M[:, 1]).sum(dim=1)
    det = xx * yy - xy * xy
    opacity = torch.sigmoid(send(gaussians.logit_opacities))
    centre = slope * focal + torch.stack([K[0, 2], K[1, 2]])
    cut = 2 * torch.log((opacity / ALPHA_MIN).clamp_min(1.0))
    half = torch.sqrt(cut[:, None] * torch.stack([xx, yy], dim=1))
    keep = (depth >= NEAR) & (depth < 1e30) & (opacity >= ALPHA_MIN)
    # Not "outside" but "inside": anything that is no number fails these.
    keep &= (det > 0) & (xx + yy < 1e30)
    keep &= ((centre + half >= 0.5) & (centre - half <= size - 0.5)).all(dim=1)
    index = torch.nonzero(keep)[:, 0]
    conic = torch.stack([yy, -xy, xx], dim=1)[index] / det[index, None]
    radii = half[index].ceil().clamp(1, 1e6).int()
    return (
        index + rows.start,
        centre[index].float(),
        conic.float(),
        opacity[index].float(),
        depth[index].float(),
        radii,
    )


def _rotations(quats: Tensor) -> Tensor:
    """Rotation matrices (n, 3, 3) of quaternions (n, 4) wxyz of any length; NaN where it is 0."""
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(dim=1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
