"""Which Gaussians a camera can see, found by boxes around those that lie near each other.

A view of a large scene shows a small part of it. Boxes outside the view are left out as a whole,
so its cost is that of what it sees. Nothing is lost: the test of a box is the test that projection
makes of each Gaussian (`raster.cpu.project_kernels.project`), written as half-spaces of the box.
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import BLUR, NEAR

_SIZE = 512  # most Gaussians of a chunk
_LARGE = 0.98  # quantile of the sizes above which Gaussians have chunks of their own
_MOST = 0.3  # share of all Gaussians above which to copy them costs more than to project all
_SIGMAS = 3.34  # standard deviations that `project` draws at most
_SLACK = 1e-6  # of the terms of a test, for rounding


@dataclass(frozen=True, eq=False)
class SpatialChunks:
    """Boxes around the centres of Gaussians that lie near each other: C chunks.

    Gaussians with a centre that is not finite are in none: they are never drawn. Valid as long as
    the Gaussians do not change.
    """

    gaussians: Gaussians
    rows: IntArray  # (K,) the Gaussians of one chunk after the other
    offsets: LongArray  # (C + 1,) where each chunk begins in `rows`
    centers: DoubleArray  # (C, 3) of the boxes, world
    halves: DoubleArray  # (C, 3) half their edges
    longest: DoubleArray  # (C,) greatest standard deviation of a Gaussian, scene units

    @staticmethod
    def of(gaussians: Gaussians) -> "SpatialChunks | None":
        """The chunks of a scene; None for one that is too small to be divided."""
        finite = np.flatnonzero(np.isfinite(gaussians.means).all(axis=1)).astype(np.int32)
        if len(finite) <= 2 * _SIZE:
            return None
        with np.errstate(over="ignore"):
            sizes = np.exp(np.nan_to_num(gaussians.log_scales.max(axis=1), nan=-np.inf))
        # One large Gaussian would widen the reach of all in its chunk.
        is_large = sizes[finite] > np.quantile(sizes[finite], _LARGE)
        chunks = [
            chunk
            for part in (finite[~is_large], finite[is_large])
            for chunk in _divided(gaussians.means, part)
        ]
        low = np.stack([gaussians.means[chunk].min(axis=0) for chunk in chunks]).astype(np.float64)
        high = np.stack([gaussians.means[chunk].max(axis=0) for chunk in chunks]).astype(np.float64)
        return SpatialChunks(
            gaussians,
            rows=np.concatenate(chunks),
            offsets=np.cumsum([0, *(len(chunk) for chunk in chunks)]).astype(np.int64),
            centers=(low + high) / 2,
            halves=(high - low) / 2,
            longest=np.array([sizes[chunk].max() for chunk in chunks], np.float64),
        )

    def in_view(self, camera: Camera) -> IntArray | None:
        """Gaussians (K,), ascending, of the chunks that ``camera`` may see: all that it draws or
        whose centres it shows, and some others. None where these are so many that a choice does not
        pay."""
        seen = np.flatnonzero(self._may_be_seen(camera))
        lengths = np.diff(self.offsets)
        if int(lengths[seen].sum()) > _MOST * len(self.gaussians):
            return None
        parts = [self.rows[self.offsets[c] : self.offsets[c + 1]] for c in seen]
        return np.sort(np.concatenate([np.zeros(0, np.int32), *parts]))

    def _may_be_seen(self, camera: Camera) -> BoolArray:
        """Which chunks (C,) hold a Gaussian that `project` may keep.

        It keeps one at (x, y, z) of the camera's frame with the standard deviation s where
        z >= near, and |f x / z + c - w / 2| < w / 2 + bound with
        bound = 3.34 sqrt((stretch s / z)^2 + blur) <= 3.34 (stretch s / z + sqrt(blur)), and the
        same in y. Times z these are linear in the centre and in s.
        """
        focal, middle = np.diag(camera.K)[:2], camera.K[:2, 2]
        size = np.array([camera.width, camera.height], np.float64)
        slope = 1.3 * 0.5 * size / focal
        stretch = float((focal * np.sqrt(1 + slope**2)).max())
        margin = _SIGMAS * np.sqrt(BLUR)
        # Rows a and reach r: kept only if a . (x, y, z, 1) + r s > 0.
        planes = np.zeros((5, 4))
        planes[0] = 0, 0, 1, -NEAR
        for axis in (0, 1):
            planes[1 + axis, axis], planes[1 + axis, 2] = focal[axis], middle[axis] + margin
            planes[3 + axis, axis] = -focal[axis]
            planes[3 + axis, 2] = size[axis] - middle[axis] + margin
        reach = np.array([0.0, *[_SIGMAS * stretch] * 4])
        world = planes @ camera.cam_from_world  # (5, 4)
        terms = np.abs(self.centers) @ np.abs(world[:, :3]).T + np.abs(world[:, 3])
        value = self.centers @ world[:, :3].T + world[:, 3]
        value += self.halves @ np.abs(world[:, :3]).T
        with np.errstate(invalid="ignore"):  # a size that is infinite, at the near plane: 0 * inf
            value += np.nan_to_num(self.longest[:, None] * reach, nan=0.0, posinf=np.inf)
        seen: BoolArray = np.all(value + _SLACK * terms >= 0, axis=1)
        return seen


def _divided(means: FloatArray, rows: IntArray) -> list[IntArray]:
    """``rows`` (K,) in halves along the widest axis, again and again, until all are small."""
    waiting, chunks = [rows], []
    while waiting:
        part = waiting.pop()
        if len(part) <= _SIZE:
            chunks += [part] if len(part) > 0 else []
            continue
        centres = means[part]
        axis = int(np.argmax(centres.max(axis=0) - centres.min(axis=0)))
        middle = len(part) // 2
        order = np.argpartition(centres[:, axis], middle)
        waiting += [part[order[:middle]], part[order[middle:]]]
    return chunks
