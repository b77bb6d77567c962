"""The gsplat backend of `raster.base.Rasterizer`."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.camera import NEAR, Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import (
    ALPHA_MIN,
    BLUR,
    Frame,
    LabelFrame,
    PixelWeights,
    check_pixels,
    check_render,
    check_vote,
)
from gaga_core.raster.vote_slots import VoteSlots

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


# --- Lists of the contributions to pixels: which splat, with what weight, front to back.


_ENTRIES = 1 << 25  # (tile entries x tile pixels) of one band: bounds what listing may allocate
_EVERYTHING = 1 << 30


@dataclass(frozen=True, eq=False)
class Entries:
    """Contributions of a band of pixels: pixels ascending, in each front to back."""

    pixels: Tensor  # (m,) int64 flat index in the whole picture
    splats: Tensor  # (m,) int64 row of the view
    weights: Tensor  # (m,) float64 alpha T
    after: Tensor  # (m,) float64 transmittance behind the splat


def list_entries(gsplat: Any, view: View, alpha_max: float) -> Iterator[Entries]:
    """All contributions, band by band of tile rows.

    Bands, not depth ranges: a pixel that is done in one range would go on in the next.
    """
    if view.is_empty:
        return
    starts = [*view.offsets[0, :, 0].tolist(), len(view.ids)]
    top = 0
    for row in range(1, len(starts)):
        is_last = row == len(starts) - 1
        if is_last or (starts[row + 1] - starts[top]) * TILE * TILE > _ENTRIES:
            if starts[row] > starts[top]:
                yield _band(gsplat, view, alpha_max, top, row)
            top = row


def measure_alpha_max(gsplat: Any, device: torch.device) -> float:
    """gsplat's upper limit of alpha, which differs between versions: one opaque splat."""
    one = torch.ones((1, 1), device=device)
    centre = torch.full((1, 1, 2), 0.5, device=device)
    conic = torch.tensor([[[1.0, 0.0, 1.0]]], device=device)
    tile = torch.zeros((1, 1, 1), dtype=torch.int32, device=device)
    ids = torch.zeros(1, dtype=torch.int32, device=device)
    _, alpha = gsplat.rasterize_to_pixels(
        centre, conic, one[..., None], one, TILE, TILE, TILE, tile, ids
    )
    return float(alpha[0, 0, 0, 0])


def _band(gsplat: Any, view: View, alpha_max: float, top: int, bottom: int) -> Entries:
    """Contributions in tile rows ``top`` to ``bottom``."""
    is_last = bottom == view.offsets.shape[1]
    end = len(view.ids) if is_last else int(view.offsets[0, bottom, 0])
    first = top * TILE
    height = min(bottom * TILE, view.height) - first
    means2d = view.means2d - torch.tensor([0.0, first], device=view.means2d.device)
    offsets = view.offsets[:, top:bottom].contiguous()
    ids = view.ids[:end].contiguous()
    size = (view.width, height, TILE)
    splat = (means2d, view.conics, view.opacities)
    if hasattr(gsplat, "rasterize_contributing_gaussian_ids"):  # gsplat 1.6
        n_each, _ = gsplat.rasterize_num_contributing_gaussians(*splat, offsets, ids, *size)
        table, weights = gsplat.rasterize_contributing_gaussian_ids(
            *splat, offsets, ids, *size, n_each
        )
        filled = table.reshape(height * view.width, -1) >= 0
        pixels = torch.nonzero(filled)[:, 0]
        splats = table.reshape(filled.shape)[filled].long()
        w = weights.reshape(filled.shape)[filled].double()
    else:
        clear = torch.ones((1, height, view.width), device=means2d.device)
        splats, pixels, _ = gsplat.rasterize_to_indices_in_range(
            0, _EVERYTHING, clear, *splat, *size, offsets, ids
        )
        w = _weights_of(means2d[0], view, alpha_max, splats, pixels)
    after = 1 - _running_sum(w, pixels)
    return Entries(pixels + first * view.width, splats, w, after)


def _weights_of(
    means2d: Tensor, view: View, alpha_max: float, splats: Tensor, pixels: Tensor
) -> Tensor:
    """alpha T (m,) of listed contributions: gsplat 1.5 lists them without their weights."""
    u, v = pixels % view.width + 0.5, pixels // view.width + 0.5
    dx, dy = means2d[splats, 0] - u, means2d[splats, 1] - v
    a, b, c = view.conics[0, splats].unbind(dim=1)
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alpha = (view.opacities[0, splats] * torch.exp(-sigma)).clamp_max(alpha_max)
    logs = torch.log1p(-alpha.double())
    return alpha * torch.exp(_running_sum(logs, pixels) - logs)


def _running_sum(values: Tensor, pixels: Tensor) -> Tensor:
    """Sums (m,) of ``values`` (m,) float64 up to each entry, started again at every pixel."""
    total = torch.cumsum(values, dim=0)
    _, lengths = torch.unique_consecutive(pixels, return_counts=True)
    last = torch.cumsum(lengths, dim=0) - 1
    before = torch.cat([total.new_zeros(1), total[last[:-1]]]) if len(last) else total
    return total - torch.repeat_interleave(before, lengths)


class CudaRasterizer:
    """gsplat behind the operators of `raster.base`; arrays go in and come out as numpy.

    Ask `gaga_core.raster.choose` for one: it knows from `raster.probe` whether gsplat runs here.
    Raises ``GagaError`` when there is no such device or no gsplat.
    """

    name = "cuda"

    def __init__(self, device: str = "cuda") -> None:
        if torch.device(device).type == "cuda" and not torch.cuda.is_available():
            raise GagaError("No CUDA device answers. Choose the backend cpu.")
        try:
            self._gsplat: Any = importlib.import_module("gsplat")
        except ImportError as error:
            raise GagaError(
                "The package gsplat cannot be loaded. Choose the backend cpu."
            ) from error
        self._device = torch.device(device)
        with torch.no_grad():
            self._alpha_max = measure_alpha_max(self._gsplat, self._device)

    @memory_in_words()
    @torch.no_grad()
    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        *,
        channels: FloatArray | None = None,
        background: DoubleArray | FloatArray | None = None,
    ) -> Frame:
        """Blend SH color, or ``channels`` (N, C), and depth over ``background`` (C,)."""
        n_channels = check_render(gaussians, channels, background)
        behind = send(np.zeros(n_channels) if background is None else background, self._device)
        view = self._prepare(gaussians, camera)
        shape = (camera.height, camera.width)
        if view.is_empty:
            image = behind.expand(*shape, n_channels)
            return Frame(fetch(image), *(np.zeros(shape, np.float32) for _ in range(3)))
        if channels is None:
            colors = self._sh_colors(gaussians, camera, view)
        else:
            colors = send(channels[indices(view)], self._device)
        colors = torch.cat([colors, view.depths[0, :, None]], dim=1)
        image, alpha = blend(self._gsplat, view, colors)
        depth = torch.where(alpha > 0, image[..., -1] / alpha.clamp_min(1e-12), 0.0)
        image = image[..., :-1] + (1 - alpha)[..., None] * behind
        return Frame(fetch(image), fetch(alpha), fetch(depth), fetch(self._median(view)))

    @memory_in_words()
    @torch.no_grad()
    def weights(
        self, gaussians: Gaussians, camera: Camera, pixels: LongArray, *, w_min: float = 0.0
    ) -> PixelWeights:
        """Blending weights above ``w_min`` of ``pixels`` (P,), flat indices v * width + u."""
        check_pixels(camera, pixels)
        n_pixels = camera.width * camera.height
        view = self._prepare(gaussians, camera)
        wanted = torch.zeros(n_pixels, dtype=torch.bool, device=self._device)
        wanted[torch.tensor(pixels, dtype=torch.int64, device=self._device)] = True
        owners, indices, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [_NOTHING]
        for entries in list_entries(self._gsplat, view, self._alpha_max):
            weights = entries.weights.float()
            keep = wanted[entries.pixels] & (weights > w_min)
            owners.append(entries.pixels[keep].cpu().numpy())
            indices.append(view.index[entries.splats[keep]].cpu().numpy())
            values.append(fetch(weights[keep]))
        owner = np.concatenate(owners)
        first = np.searchsorted(owner, pixels)
        counts = np.searchsorted(owner, pixels, side="right") - first
        indptr = np.append(0, np.cumsum(counts)).astype(np.int64)
        rows = np.repeat(first - indptr[:-1], counts) + np.arange(indptr[-1])
        return PixelWeights(
            indptr,
            np.concatenate(indices)[rows].astype(np.int32),
            np.concatenate(values)[rows].astype(np.float32),
        )

    @memory_in_words()
    @torch.enable_grad()
    def vote(
        self,
        gaussians: Gaussians,
        camera: Camera,
        labels: IntArray,
        histogram: FloatArray | VoteSlots,
    ) -> None:
        """histogram[i, k] += sum of w_i over pixels with label k; negative labels are ignored.

        A picture is W c for channels c; so the gradient of sum(picture * mask of k) by c is the
        column k of the votes, and gsplat's backward pass gives 32 of them at once.
        """
        check_vote(gaussians, camera, labels, histogram)
        view = self._prepare(gaussians, camera)
        if view.is_empty:
            return
        present = np.unique(labels[labels >= 0])
        picture = torch.tensor(labels, device=self._device)
        votes = []
        for start in range(0, len(present), CHANNELS):
            chunk = torch.tensor(present[start : start + CHANNELS], device=self._device)
            one_hot = (picture[..., None] == chunk).float()
            zeros = torch.zeros(
                (len(view.index), len(chunk)), device=self._device, requires_grad=True
            )
            image, _ = blend(self._gsplat, view, zeros)
            votes.append(fetch(torch.autograd.grad(image, zeros, one_hot)[0]))
        # Only now: a card that is full half way leaves the histogram as it was.
        rows = indices(view)
        for start, columns in zip(range(0, len(present), CHANNELS), votes, strict=True):
            own = present[start : start + CHANNELS]
            if isinstance(histogram, VoteSlots):
                histogram.add(rows.astype(np.int32), own, columns)
            else:
                histogram[np.ix_(rows, own)] += columns

    @memory_in_words()
    @torch.no_grad()
    def label_splat(self, gaussians: Gaussians, camera: Camera, labels: IntArray) -> LabelFrame:
        """Exact argmax over ``labels`` (N,) of summed weights; the smaller label when equal."""
        check_shape("labels", labels, (len(gaussians),), np.int32)
        if labels.min(initial=0) < 0:
            raise ValueError("labels: must not be negative (0 = none)")
        view = self._prepare(gaussians, camera)
        shape = (camera.height, camera.width)
        best = torch.zeros(shape, device=self._device)
        winner = torch.zeros(shape, dtype=torch.int32, device=self._device)
        if view.is_empty:
            return LabelFrame(winner.cpu().numpy(), fetch(best))
        mine = torch.tensor(labels[indices(view)], device=self._device)
        values = torch.unique(mine)
        for start in range(0, len(values), CHANNELS):
            chunk = values[start : start + CHANNELS]
            image, _ = blend(self._gsplat, view, (mine[:, None] == chunk).float())
            weight = image.amax(dim=2)
            # The first of equal ones: argmax does not promise which it takes.
            place = torch.arange(len(chunk), device=self._device)
            tied = torch.where(image == weight[..., None], place, len(chunk))
            better = weight > best
            winner = torch.where(better, chunk[tied.amin(dim=2)], winner)
            best = torch.where(better, weight, best)
        return LabelFrame(winner.cpu().numpy(), fetch(best))

    def _prepare(self, gaussians: Gaussians, camera: Camera) -> View:
        return prepare(self._gsplat, gaussians, camera, self._device)

    def _sh_colors(self, gaussians: Gaussians, camera: Camera, view: View) -> Tensor:
        """SH color (n, 3) of the splats in view, seen from the camera's position; 0 where it is no
        number."""
        rows = indices(view)
        directions = gaussians.means[rows].astype(np.float64) - camera.position
        sh = send(gaussians.sh[rows], self._device)
        finite = torch.isfinite(sh)
        color = 0.5 + self._gsplat.spherical_harmonics(
            gaussians.sh_degree, send(directions, self._device), torch.where(finite, sh, 0.0)
        )
        return torch.where((color > 0) & (color < 1e30) & finite.all(dim=1), color, 0.0)

    def _median(self, view: View) -> Tensor:
        """Depth (H, W) at which T falls to 1/2, 0 if never."""
        depth = torch.zeros(view.height * view.width, device=self._device)
        for entries in list_entries(self._gsplat, view, self._alpha_max):
            crosses = (entries.after <= 0.5) & (entries.after + entries.weights > 0.5)
            depth[entries.pixels[crosses]] = view.depths[0, entries.splats[crosses]]
        return depth.reshape(view.height, view.width)


_NOTHING: FloatArray = np.zeros(0, np.float32)
