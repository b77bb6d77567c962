"""The first Gaussians of a training: one for each point that structure from motion found."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, FloatArray, UInt8Array, check_shape
from gaga_core.camera import Camera
from gaga_core.color import dc_from_rgb
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians

_NEIGHBOURS = 3
_FEWEST = 4  # points, for each to have its neighbours


def initial_gaussians(
    points: DoubleArray,  # (P, 3) world
    colors: UInt8Array,  # (P, 3)
    *,
    opacity: float = 0.1,
    scale: float = 1.0,
) -> Gaussians:
    """A round splat at each point: as large as its three nearest points are far (Kerbl 2023).

    Points that are not finite are left out. Raises ``GagaError`` when fewer than 4 are left.
    """
    check_shape("points", points, ("P", 3))
    check_shape("colors", colors, (len(points), 3), np.uint8)
    finite = np.isfinite(points).all(axis=1)
    points, colors = points[finite], colors[finite]
    if len(points) < _FEWEST:
        raise GagaError(
            f"The model has {len(points)} points, too few to start from. Take more photos that "
            "overlap, and reconstruct again."
        )
    size = scale * np.maximum(neighbour_distance(points), 1e-7)
    return round_gaussians(points, size, colors * np.float32(1 / 255), opacity)


def neighbour_distance(points: DoubleArray) -> DoubleArray:
    """Root mean square distance (P,) of each point to its three nearest."""
    distances: DoubleArray = np.asarray(cKDTree(points).query(points, _NEIGHBOURS + 1)[0])
    result: DoubleArray = np.sqrt((distances[:, 1:] ** 2).mean(axis=1))
    return result


def round_gaussians(
    means: DoubleArray, size: DoubleArray, rgb: FloatArray, opacity: float
) -> Gaussians:
    """Splats of equal axes ``size`` (N,), colors ``rgb`` (N, 3) in 0..1, and one opacity."""
    n = len(means)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    return Gaussians(
        means=np.ascontiguousarray(means, np.float32),
        quats=quats,
        log_scales=np.repeat(np.log(size)[:, None], 3, axis=1).astype(np.float32),
        logit_opacities=np.full(n, np.log(opacity / (1 - opacity)), np.float32),
        sh=dc_from_rgb(rgb)[:, None],
    )


def random_points(cameras: Sequence[Camera], n: int, seed: int) -> DoubleArray:
    """Points (n, 3) world for cameras that come without any: uniform in a box three times the
    extent of the cameras (Kerbl et al. 2023, section 7.4)."""
    positions = np.array([camera.position for camera in cameras])
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
    half = 1.5 * max(float(np.ptp(positions, axis=0).max()), 1e-6)
    points: DoubleArray = middle + np.random.default_rng(seed).uniform(-half, half, (n, 3))
    return points
