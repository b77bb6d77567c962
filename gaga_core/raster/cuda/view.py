"""What a camera sees, on the device: projected splats and the list of each tile."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gaga_core.arrays import AnyArray, FloatArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.raster.cuda.project import Projected, project_rows

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
        where = (means2d.detach(), splats.radii[None], depths.detach())
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
    result: LongArray = view.index.cpu().numpy()
    return result
