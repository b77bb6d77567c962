"""From Gaussians and a camera to depth-sorted splats and the list of each tile."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import NEAR, Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import BLUR
from gaga_core.raster.cpu import project_kernels as kernels
from gaga_core.threads import n_threads, run_kernel

_CHUNK = 16384  # Gaussians of one piece of work
TILES_AT_ONCE = 16  # tiles of one piece of work


@dataclass(frozen=True, eq=False)
class TiledView:
    """The view of a camera, ready to be blended: n splats, front to back."""

    splats: FloatArray  # (n, 8), see project_kernels
    depths: FloatArray  # (n,) camera depth
    order: IntArray  # (n,) index of the Gaussian
    rows: IntArray  # (n,) rows of `splats` by ascending Gaussian: the order of the file
    offsets: LongArray  # (n_tiles + 1,) where each tile's list begins, tiles row by row
    ids: IntArray  # (M,) rows of `splats`, ascending inside a tile

    @property
    def n_tiles(self) -> int:
        """Number of tiles of the picture."""
        return len(self.offsets) - 1

    def run(self, kernel: Callable[..., None], *arguments: object) -> None:
        """Call ``kernel(*arguments, start, stop)`` over the tiles, on all threads."""
        run_kernel(kernel, self.n_tiles, TILES_AT_ONCE, *arguments)


class _Memory:
    """Writable face of a read-only array, for kernels that only read.

    Numba would compile a kernel again, in seconds, for read-only arrays.
    """

    def __init__(self, array: AnyArray) -> None:
        self.array = array  # keeps the memory alive
        self.__array_interface__ = array.__array_interface__ | {
            "data": (array.__array_interface__["data"][0], False)
        }


def for_kernel(array: AnyArray, dtype: type[np.generic]) -> AnyArray:
    """``array`` as kernels take it: C-contiguous, aligned, of ``dtype``, typed as writable.

    No copy when only the write flag is in the way; the kernel must not write then.
    """
    ready = np.require(array, dtype, ["C", "A"])
    if ready.flags.writeable or ready.size == 0:
        return ready if ready.flags.writeable else ready.copy()
    return np.asarray(_Memory(ready))


def prepare(gaussians: Gaussians, camera: Camera, *, antialiased: bool | None = None) -> TiledView:
    """Project, sort by depth (ties by index) and list the splats of each tile.

    ``antialiased``: mip mode; None = as the Gaussians' comments say.
    """
    look = gaussians.is_antialiased if antialiased is None else antialiased
    splats, depths, index, packed = _project(gaussians, camera, look)
    by_depth = kernels.sort_by_depth(depths[packed].view(np.uint32), packed.copy())
    n = len(by_depth)
    sorted_splats = np.empty((n, 8), np.float32)
    sorted_depths, order = np.empty(n, np.float32), np.empty(n, np.int32)
    n_spans, row_of = np.empty(n, np.int64), np.empty(len(splats), np.int32)

    into = (sorted_splats, sorted_depths, order, row_of, n_spans)
    run_kernel(kernels.arrange, n, _CHUNK, by_depth, splats, depths, index, *into)
    offsets, ids = _bin(sorted_splats, n_spans, camera)
    return TiledView(sorted_splats, sorted_depths, order, row_of[packed], offsets, ids)


def pose_and_lens(camera: Camera, antialiased: bool = False) -> tuple[DoubleArray, DoubleArray]:
    """The camera as `project` takes it: pose (3, 4), and lens (9,), in the order below."""
    K = camera.K
    size = (camera.width, camera.height)
    lens = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *size, NEAR, BLUR, antialiased]
    return np.array(camera.cam_from_world[:3], np.float64, order="C"), np.array(lens, np.float64)


def _project(
    gaussians: Gaussians, camera: Camera, antialiased: bool
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Projected columns with gaps, and the rows that are filled, in the order of the Gaussians."""
    n = len(gaussians)
    names = ("means", "quats", "log_scales", "logit_opacities")
    columns = [for_kernel(getattr(gaussians, name), np.float32) for name in names]
    pose, lens = pose_and_lens(camera, antialiased)
    splats = np.empty((n, 8), np.float32)
    depths, index = np.empty(n, np.float32), np.empty(n, np.int32)
    counts = np.zeros((n + _CHUNK - 1) // _CHUNK, np.int64)

    into = (splats, depths, index, counts, _CHUNK)
    run_kernel(kernels.project, n, _CHUNK, *columns, pose, lens, *into)
    pieces = [np.arange(c * _CHUNK, c * _CHUNK + k, dtype=np.int32) for c, k in enumerate(counts)]
    return splats, depths, index, np.concatenate([np.zeros(0, np.int32), *pieces])


def _bin(splats: FloatArray, n_spans: LongArray, camera: Camera) -> tuple[LongArray, IntArray]:
    """Tile lists by a stable counting sort: each piece of splats writes behind the one before."""
    n = len(splats)
    n_tiles_x = -(-camera.width // kernels.TILE)
    n_tiles = n_tiles_x * -(-camera.height // kernels.TILE)
    first_span = np.zeros(n + 1, np.int64)
    np.cumsum(n_spans, out=first_span[1:])
    spans = np.empty((first_span[-1], 2), np.int32)
    chunk = max(_CHUNK, -(-n // (2 * n_threads())))
    histogram = np.zeros((-(-n // chunk), n_tiles), np.int64)

    lists = (splats, first_span, camera.width, n_tiles_x, spans, histogram, chunk)
    run_kernel(kernels.tile_spans, n, chunk, *lists)
    ends = np.cumsum(histogram.T.ravel())  # tile by tile, in it piece by piece
    cursor = np.ascontiguousarray(
        (ends - histogram.T.ravel()).reshape(n_tiles, len(histogram)).T, dtype=np.int64
    )
    offsets = np.zeros(n_tiles + 1, np.int64)
    if n > 0:
        offsets[1:] = ends.reshape(n_tiles, -1)[:, -1]
    ids = np.empty(offsets[-1], np.int32)

    run_kernel(kernels.fill_tiles, n, chunk, first_span, spans, cursor, ids, chunk)
    return offsets, ids
