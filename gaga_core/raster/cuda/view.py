"""The view of a camera on the device: projected splats and the list of each tile."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gaga_core.arrays import AnyArray, FloatArray, LongArray
from gaga_core.camera import NEAR, Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import ALPHA_MIN, BLUR

# --- EWA projection in plain torch and float64, on whatever device the picture is blended.


@dataclass(frozen=True, eq=False)
class Projected:
    """Splats in a picture: float64, but the radii."""

    index: Tensor  # (n,) int64 Gaussian, ascending
    centres: Tensor  # (n, 2) pixels
    conics: Tensor  # (n, 3) upper triangle of the inverse covariance
    opacities: Tensor  # (n,)
    depths: Tensor  # (n,) camera depth
    radii: Tensor  # (n, 2) int32 half size of the box outside which alpha is under 1/255


def project_rows(
    gaussians: Gaussians, rows: slice, camera: Camera, device: torch.device
) -> Projected:
    """EWA projection of some Gaussians, as in `raster.reference.project`: those in the picture."""
    names = ("means", "quats", "log_scales", "logit_opacities")
    means, quats, log_scales, logits = (
        torch.tensor(np.asarray(getattr(gaussians, name))[rows], device=device).double()
        for name in names
    )
    pose = torch.tensor(np.asarray(camera.cam_from_world[:3]), device=device).double()
    K = torch.tensor(np.asarray(camera.K), device=device).double()
    focal = torch.stack([K[0, 0], K[1, 1]])
    size = torch.tensor([camera.width, camera.height], device=device).double()
    p_cam = means @ pose[:, :3].T + pose[:, 3]
    depths = p_cam[:, 2]
    slope = p_cam[:, :2] / depths[:, None]
    limit = 1.3 * 0.5 * size / focal
    clamped = slope.clamp(-limit, limit)
    axes = _rotations(quats) * log_scales.exp()[:, None, :]
    # J W R S: a row of J is (focal, 0, -focal * slope) / depth.
    turned = torch.einsum("ij,njk->nik", pose[:, :3], axes)
    M = (turned[:, :2] - clamped[..., None] * turned[:, 2:]) * (focal / depths[:, None])[..., None]
    xx, yy = (M * M).sum(dim=2).unbind(dim=1)
    xy = (M[:, 0] * M[:, 1]).sum(dim=1)
    plain = xx * yy - xy * xy
    xx, yy = xx + BLUR, yy + BLUR
    det = xx * yy - xy * xy
    opacities = torch.sigmoid(logits)
    if gaussians.is_antialiased:
        opacities = opacities * torch.sqrt(plain.clamp_min(0.0) / det)
    centres = slope * focal + torch.stack([K[0, 2], K[1, 2]])
    cut = 2 * torch.log((opacities / ALPHA_MIN).clamp_min(1.0))
    half = torch.sqrt(cut[:, None] * torch.stack([xx, yy], dim=1))
    keep = (depths >= NEAR) & (depths < 1e30) & (opacities >= ALPHA_MIN)
    # Not "outside" but "inside": anything that is no number fails these.
    keep &= (det > 0) & (xx + yy < 1e30)
    keep &= ((centres + half >= 0.5) & (centres - half <= size - 0.5)).all(dim=1)
    index = torch.nonzero(keep)[:, 0]
    conics = (torch.stack([yy, -xy, xx], dim=1) / det[:, None])[index]
    radii = half[index].ceil().clamp(1, 1e6).int()
    return Projected(
        index + (rows.start or 0), centres[index], conics, opacities[index], depths[index], radii
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


TILE = 16
CHANNELS = 32  # blended at once: 32 fit small cards
_ROWS = 1 << 20  # Gaussians projected at once: float64 temporaries stay under 300 MB
# Channel counts that every gsplat has kernels for. Version 1.5 pads others itself, 1.6 refuses.
_COUNTS = (1, 2, 3, 4, 8, 16, CHANNELS)


@dataclass(frozen=True, eq=False)
class View:
    """n splats in the order of the Gaussians, and which of them each tile lists."""

    index: Tensor  # (n,) int64 Gaussian
    means2d: Tensor  # (1, n, 2) float32 pixels
    conics: Tensor  # (1, n, 3) float32 upper triangle of the inverse covariance
    opacities: Tensor  # (1, n) float32
    depths: Tensor  # (1, n) float32
    offsets: Tensor  # (1, tile rows, tile columns) int32 where each tile's list begins
    ids: Tensor  # (M,) int32 rows, front to back inside a tile
    width: int
    height: int

    @property
    def is_empty(self) -> bool:
        """Whether no tile lists a splat."""
        return len(self.ids) == 0


@contextmanager
def memory_in_words() -> Iterator[None]:
    """A full graphics card becomes a sentence."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise GagaError(
            "The graphics card has not enough free memory for this scene. Choose the backend cpu."
        ) from error


def prepare(gsplat: Any, gaussians: Gaussians, camera: Camera, device: torch.device) -> View:
    """Project the Gaussians that a camera sees, and list those of each tile."""
    return list_tiles(gsplat, find_splats(gaussians, camera, device), camera)


def find_splats(gaussians: Gaussians, camera: Camera, device: torch.device) -> Projected:
    """The splats in the picture, piece by piece."""
    starts = range(0, max(len(gaussians), 1), _ROWS)
    with torch.no_grad():
        pieces = [
            project_rows(gaussians, slice(start, start + _ROWS), camera, device) for start in starts
        ]
    index = torch.cat([piece.index for piece in pieces])
    names = ("centres", "conics", "opacities", "depths", "radii")
    columns = (torch.cat([getattr(piece, name) for piece in pieces]) for name in names)
    return Projected(index, *columns)


def list_tiles(gsplat: Any, splats: Projected, camera: Camera) -> View:
    """List the splats of each tile by depth (ties by index)."""
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    device = splats.index.device
    offsets = torch.zeros((1, rows, columns), dtype=torch.int32, device=device)
    ids = torch.zeros(0, dtype=torch.int32, device=device)
    means2d, depths = splats.centres.float()[None], splats.depths.float()[None]
    if len(splats.index):
        where = (means2d, splats.radii[None], depths)
        _, keys, ids = gsplat.isect_tiles(*where, TILE, columns, rows, n_images=1)
        if len(ids):
            offsets = gsplat.isect_offset_encode(keys, 1, columns, rows)
    return View(
        splats.index,
        means2d,
        splats.conics.float()[None],
        splats.opacities.float()[None],
        depths,
        offsets.reshape(1, rows, columns),
        ids,
        camera.width,
        camera.height,
    )


def blend(gsplat: Any, view: View, features: Tensor) -> tuple[Tensor, Tensor]:
    """Picture (H, W, C) of ``features`` (n, C) over black, and alpha (H, W)."""
    images = []
    for start in range(0, features.shape[1], CHANNELS):
        chunk = features[:, start : start + CHANNELS]
        count = chunk.shape[1]
        padding = next(n for n in _COUNTS if n >= count) - count
        image, alpha = gsplat.rasterize_to_pixels(
            view.means2d,
            view.conics,
            torch.nn.functional.pad(chunk, (0, padding))[None].contiguous(),
            view.opacities,
            view.width,
            view.height,
            TILE,
            view.offsets,
            view.ids,
        )
        images.append(image[0, ..., :count])
    return torch.cat(images, dim=2), alpha[0, ..., 0]


def send(array: AnyArray, device: torch.device) -> Tensor:
    """``array`` as float32 on the device."""
    return torch.tensor(np.asarray(array, np.float32), device=device)


def fetch(tensor: Tensor) -> FloatArray:
    """``tensor`` as float32, in memory of its own."""
    result: FloatArray = tensor.detach().float().contiguous().cpu().numpy()
    return result if result.flags.owndata else result.copy()


def indices(view: View) -> LongArray:
    """Gaussians (n,) of the rows of a view."""
    return view.index.cpu().numpy()
