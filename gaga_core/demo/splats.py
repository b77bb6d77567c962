"""Discs with baked light become Gaussians."""

import numpy as np

from gaga_core.arrays import FloatArray
from gaga_core.demo.surface import Surface
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats

SPREAD = 0.66  # standard deviation of a splat, in steps to the next disc
_ROOM_SPREAD = 0.85  # walls are plain: rather smooth than crisp
_THICKNESS = 0.12  # of the smaller one in the plane


def gaussians_of(surface: Surface, sh: FloatArray, rng: np.random.Generator) -> Gaussians:
    """Flat splats in the surface's plane, nearly opaque."""
    n = len(surface)
    across = np.cross(surface.normals, surface.tangents)
    axes = np.stack([surface.tangents, across, surface.normals], axis=2)
    in_plane = np.clip(surface.sizes, 0.0012, None)
    in_plane *= np.where(surface.labels == 0, _ROOM_SPREAD, SPREAD)[:, None]
    # No splat is much longer than wide by accident of a patch's corner.
    in_plane = np.minimum(in_plane, 3.5 * in_plane.min(axis=1, keepdims=True))
    thick = np.maximum(_THICKNESS * in_plane.min(axis=1), 2e-4)
    opacity = rng.uniform(0.970, 0.992, n)
    return Gaussians(
        means=surface.points.astype(np.float32),
        quats=matrices_to_quats(axes).astype(np.float32),
        log_scales=np.log(np.column_stack([in_plane, thick])).astype(np.float32),
        logit_opacities=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh=np.ascontiguousarray(sh, np.float32),
    )
