"""Colors of splats as seen from outside their group: what a person calls the group's color.

The white inside of a blue cup, and the sheen that spherical harmonics show in a few directions,
say nothing of the color by which somebody asks. Each group is drawn alone, orthographically, as a
small picture of depths from a few directions; a splat counts as often as it lies at the front,
with the color that it has in those directions.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.color import SH_C0, sh_basis
from gaga_core.scene.scene import Scene

_CELLS, _FEW_CELLS = 24, 6  # along each side of a view of a group
_PER_CELL = 6  # splats of the group, so that what is behind cannot be seen between them
_MANY_GROUPS = 8192  # from here on all views have few cells
_N_VIEWS = 6  # at most
_DEGREE = 2  # of the spherical harmonics that count
_ELEVATION = 0.6  # of the views without cameras, radians over the ground


@dataclass(frozen=True, eq=False)
class Spread:
    """Where splats (N) stand in the upright frame, and the robust boxes of their groups (G)."""

    points: FloatArray  # (N, 3)
    area: FloatArray  # (N,) negative = does not count
    lo: FloatArray  # (G, 3)
    hi: FloatArray  # (G, 3)


def view_axes(frame: DoubleArray, cameras: Sequence[Camera]) -> DoubleArray:
    """Axes (V, 3, 3), rows right, down, forward, in the upright frame ``frame`` (3, 3), of a few
    views: those of ``cameras`` that differ most, else from around and a little above."""
    if cameras:
        turned = np.stack([camera.cam_from_world[:3, :3] for camera in cameras]) @ frame.T
        forward = turned[:, 2]
        chosen = [0]
        while len(chosen) < min(_N_VIEWS, len(cameras)):
            chosen.append(int((forward @ forward[chosen].T).max(axis=1).argmin()))
        return np.ascontiguousarray(turned[chosen])
    around = np.arange(_N_VIEWS - 1) * 2 * np.pi / (_N_VIEWS - 1)
    level = np.cos(_ELEVATION)
    forward = np.stack(
        [
            -level * np.cos(around),
            -level * np.sin(around),
            np.full(len(around), -np.sin(_ELEVATION)),
        ],
        axis=1,
    )
    right = np.stack([-np.sin(around), np.cos(around), np.zeros(len(around))], axis=1)
    axes: DoubleArray = np.stack([right, np.cross(forward, right), forward], axis=1)
    return axes


def seen_colors(
    scene: Scene, rows: IntArray, spread: Spread, matrix: DoubleArray, views: DoubleArray
) -> FloatArray:
    """Color in 0..1 of each splat as seen in ``views`` (V, 3, 3), and the share of them in which
    nothing of its own group hides it: (N, 4). What is hidden in all has its mean color.

    ``rows`` (N,) are groups; ``matrix`` (P, 3, 4) brings placements into the frame of the views.
    """
    from gaga_core.query.group_facts_kernels import add_seen, nearest_depths
    from gaga_core.raster.cpu.prepare import for_kernel

    sh = for_kernel(scene.gaussians.sh, np.float32)
    n_groups = len(spread.lo)
    cells = _CELLS if n_groups < _MANY_GROUPS else _FEW_CELLS
    counts = np.bincount(rows, minlength=n_groups)
    own = np.clip(np.sqrt(counts / _PER_CELL), _FEW_CELLS, cells)  # groups use the middle of a view
    centre = (spread.lo.astype(np.float64) + spread.hi) / 2
    diagonal = np.linalg.norm(spread.hi.astype(np.float64) - spread.lo, axis=1)
    per_unit = own / np.maximum(diagonal, 1e-12)
    placement = for_kernel(scene.placement, np.int32)
    degree = min(_DEGREE, scene.gaussians.sh_degree)
    seen = np.zeros((len(scene), 4), np.float32)
    depths = np.empty((n_groups, cells, cells), np.float32)
    for axes in views:
        depths[:] = np.inf
        forward = axes[2] @ matrix[:, :, :3]  # (P, 3) in the placements' frames
        forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
        basis = np.ascontiguousarray(sh_basis(forward, degree))
        shared = rows, spread.points, spread.area
        nearest_depths(*shared, axes, centre, per_unit, depths)
        add_seen(
            rows,
            placement,
            spread.points,
            spread.area,
            axes,
            centre,
            per_unit,
            depths,
            sh,
            basis,
            seen,
        )
    times = seen[:, 3:]
    plain = 0.5 + np.float32(SH_C0) * sh[:, 0]
    seen[:, :3] = np.where(times > 0, seen[:, :3] / np.maximum(times, 1), plain)
    seen[:, 3] /= len(views)
    return seen
