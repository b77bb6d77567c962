"""Which way is up in a scene, by its cameras or by its splats, and what the cameras look at."""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices

_SNAP = np.cos(np.radians(3.0))  # an up this near to a world axis is that axis
_NEARLY = np.cos(np.radians(30.0))  # ups nearer than this are meant to be the same
_FLATTEST = 0.15  # the cameras' right axes must spread over a plane this much better than along up
_COLMAP_UP = np.array([0.0, -1.0, 0.0])  # of models without cameras: OpenCV axes, y down

_SAMPLE = 50_000  # splats that are looked at
_SEEN = 0.3  # opacity from which on a splat shows a surface
_THIN = 0.4  # of a splat's middle side: it lies along a surface
_ALONG = 0.9  # cosine between the normal of a surface and an axis across which it lies
_MORE = 2.0  # times the surface across either other axis: so much lies across the vertical
_GROUND, _TOP = 0.5, 0.2  # of that surface: at least so much at the foot, at most at the top
_END = 0.15  # of the extent along the axis
_TALL = 1.4  # times either other side: what is so long stands


def estimate_up(cameras: Sequence[Camera]) -> DoubleArray:
    """The scene's up direction (3,), unit, world.

    People hold cameras level: up is what the pictures' right axes have least of, on the side to
    which their tops point. When all look the same way that is no direction, and the mean of the
    pictures' tops is taken. Without cameras: -y, as in the world of most single models.
    """
    if not cameras:
        return _COLMAP_UP.copy()
    tops = np.mean([-c.cam_from_world[1, :3] for c in cameras], axis=0)
    rights = np.stack([c.cam_from_world[0, :3] for c in cameras])
    values, vectors = np.linalg.eigh(rights.T @ rights / len(rights))
    up: DoubleArray = np.array(tops, np.float64)
    if values[0] < _FLATTEST * values[1]:
        up = vectors[:, 0] * (1.0 if vectors[:, 0] @ tops >= 0 else -1.0)
    length = float(np.linalg.norm(up))
    if length < 1e-6:
        return _COLMAP_UP.copy()
    up /= length
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > _SNAP:
        up = np.eye(3)[axis] * np.sign(up[axis])
    return up


def up_of_moved(opened: Sequence[Camera], placed: Sequence[Camera]) -> DoubleArray:
    """The up direction (3,), unit, world, of a scene that was moved as a whole.

    ``opened`` are its cameras as they were, ``placed`` as they stand now. A scene that was laid
    level was laid level along the up of the cameras as they were: where both ups nearly agree it is
    that one, else the one of the cameras as they stand now.
    """
    was, now = estimate_up(opened), estimate_up(placed)
    return was if float(was @ now) > _NEARLY else now


def guess_up(gaussians: Gaussians) -> DoubleArray:
    """The up direction (3,) of splats without cameras: one of the axes of their world.

    Where much more surface lies across one axis than across the others, and most of it at one end,
    that end is the ground. What is much longer along y or z stands. Else, and for the sign then, y
    points down, as in the world of most single models, and z up.
    """
    found = _from_ground(gaussians)
    if found is not None:
        return found
    means = gaussians.means[np.isfinite(gaussians.means).all(axis=1)]
    if len(means) == 0:
        return _COLMAP_UP.copy()
    sides = np.ptp(np.percentile(means[:: len(means) // _SAMPLE + 1], [2, 98], axis=0), axis=0)
    stands = sides[2] > _TALL * max(sides[0], sides[1])
    return np.array([0.0, 0.0, 1.0]) if stands else _COLMAP_UP.copy()


def _from_ground(gaussians: Gaussians) -> DoubleArray | None:
    """The axis (3,) that points away from the ground; None where no ground is seen."""
    rows = np.flatnonzero((gaussians.opacities > _SEEN) & np.isfinite(gaussians.means).all(axis=1))
    rows = rows[:: len(rows) // _SAMPLE + 1]
    if len(rows) == 0:
        return None
    means, sides = gaussians.means[rows].astype(np.float64), np.exp(gaussians.log_scales[rows])
    turned = quats_to_matrices(gaussians.quats[rows])
    normals = np.abs(turned[np.arange(len(rows)), :, sides.argmin(axis=1)])
    thin, middle, long = np.sort(sides, axis=1).T
    low, high = np.percentile(means, [2, 98], axis=0)
    at = (means - low) / np.maximum(high - low, 1e-12)
    area = np.minimum(middle * long, np.percentile(middle * long, 95))
    area = area * (thin < _THIN * middle) * ((at >= 0) & (at <= 1)).all(axis=1)
    across = area[:, None] * (normals > _ALONG)  # (K, 3)
    total = across.sum(axis=0)
    axis = int(total.argmax())
    if total[axis] <= _MORE * np.delete(total, axis).max():
        return None
    foot, top = (float(across[end, axis].sum() / total[axis]) for end in _ends(at[:, axis]))
    if max(foot, top) < _GROUND or min(foot, top) > _TOP:
        return None
    up = np.zeros(3)
    up[axis] = 1.0 if foot > top else -1.0
    return up


def _ends(at: DoubleArray) -> tuple[BoolArray, BoolArray]:
    """Which of the places (K,) in 0..1 lie at either end."""
    return at < _END, at > 1 - _END


def upright_basis(up: DoubleArray) -> DoubleArray:
    """Rotation (3, 3) from world to a frame whose z axis is ``up``; the identity for +z."""
    z = up / np.linalg.norm(up)
    helper = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = helper - (helper @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def common_target(cameras: Sequence[Camera]) -> DoubleArray | None:
    """The point (3,) nearest to all optical axes; None when they do not meet before the cameras."""
    if len(cameras) < 2:
        return None
    matrix, right_side = np.zeros((3, 3)), np.zeros(3)
    for camera in cameras:
        across = np.eye(3) - np.outer(camera.forward, camera.forward)
        matrix += across
        right_side += across @ camera.position
    if np.linalg.eigvalsh(matrix)[0] < 0.01 * len(cameras):
        return None
    point = np.asarray(np.linalg.solve(matrix, right_side), np.float64)
    n_before = sum(float((point - c.position) @ c.forward) > 0 for c in cameras)
    return point if n_before > len(cameras) / 2 else None
