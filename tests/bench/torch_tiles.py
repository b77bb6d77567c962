"""The fair slow way to blend a view: a loop over tiles, each in a few vectorised torch operations.

Same projected splats, same lists of tiles and same image model as the CPU rasterizer. A tile's list
is blended in pieces, front to back, and left when all of its pixels are done.
"""

import torch
from torch import Tensor

from gaga_core.arrays import FloatArray
from gaga_core.camera import Camera
from gaga_core.raster.base import ALPHA_MAX, ALPHA_MIN, T_MIN
from gaga_core.raster.cpu.prepare import TiledView
from gaga_core.raster.cpu.project_kernels import OPACITY, TILE, H, R, S, U, V


def torch_tile_loop(view: TiledView, camera: Camera, colors: FloatArray, piece: int) -> FloatArray:
    """Picture (H, W, 3) over black of the splats in ``view``, ``piece`` splats at a time."""
    with torch.inference_mode():
        return _blend_tiles(view, camera, torch.from_numpy(colors), piece).numpy()


def _blend_tiles(view: TiledView, camera: Camera, colors: Tensor, piece: int) -> Tensor:
    splats, lists = torch.from_numpy(view.splats), torch.from_numpy(view.ids)
    image = torch.zeros((camera.height, camera.width, 3))
    n_tiles_x = -(-camera.width // TILE)
    offsets = view.offsets.tolist()
    for tile in range(view.n_tiles):
        left, top = tile % n_tiles_x * TILE, tile // n_tiles_x * TILE
        right, bottom = min(left + TILE, camera.width), min(top + TILE, camera.height)
        u = torch.arange(left, right) + 0.5
        v = torch.arange(top, bottom) + 0.5
        color = torch.zeros(((bottom - top) * (right - left), 3))
        T = torch.ones(len(color))
        for start in range(offsets[tile], offsets[tile + 1], piece):
            ids = lists[start : min(start + piece, offsets[tile + 1])].long()
            alpha = _alphas(splats[ids], u, v)
            through = torch.cumprod(1 - alpha, dim=0) * T  # behind each splat
            before = torch.cat([T[None], through[:-1]])
            color += (torch.where(through >= T_MIN, alpha * before, 0)).T @ colors[ids]
            T = through[-1]
            if bool((T < T_MIN).all()):
                break
        image[top:bottom, left:right] = color.reshape(bottom - top, right - left, 3)
    return image


def _alphas(s: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """alpha (k, pixels) of splats (k, columns) on the pixels of a tile, row by row."""
    dx = u[None, None] - s[:, U, None, None]
    dy = v[None, :, None] - s[:, V, None, None]
    along = s[:, S, None, None] * (dx - s[:, R, None, None] * dy)
    power = along.square() + s[:, H, None, None] * dy.square()
    alpha = (s[:, OPACITY, None, None] * torch.exp(-power)).clamp_max(ALPHA_MAX)
    return torch.where(alpha < ALPHA_MIN, 0.0, alpha).reshape(len(s), -1)
