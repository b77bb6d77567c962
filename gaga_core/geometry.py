"""Rotations and affine maps: quaternions wxyz, matrices that act on column vectors."""

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, check_shape

# --- What decisions depend on: BLAS and LAPACK sum in another order on each processor, and a last
# bit may decide. These have one order.


def turned(points: DoubleArray, matrix: DoubleArray) -> DoubleArray:
    """Points (N, 3) after a matrix (3, 3): ``points @ matrix.T``."""
    x, y, z = np.ascontiguousarray(points.T, np.float64)  # rows of three take thrice the time
    result = np.empty((3, len(points)))
    for i, (a, b, c) in enumerate(matrix):
        np.multiply(x, a, out=result[i])
        result[i] += y * b
        result[i] += z * c
    return np.ascontiguousarray(result.T)


def along(points: DoubleArray, axis: DoubleArray) -> DoubleArray:
    """Products (N,) of points (N, 3) and an axis (3,): ``points @ axis``."""
    x, y, z = points.T
    return x * axis[0] + y * axis[1] + z * axis[2]


def principal_axes(moments: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Eigenvalues (N, 3), ascending, and eigenvectors (N, 3, 3), columns, of symmetric ``moments``
    (N, 3, 3).

    The largest component of each vector is positive, the first of equal ones. Where two values are
    equal, the first of their vectors is as near as can be to the coordinate axis that lies most
    across the third one; where all are, the vectors are the coordinate axes.
    """
    from gaga_core.geometry_kernels import principal  # numba: a good part of the launch time

    values, axes = np.empty(moments.shape[:2]), np.empty(moments.shape)
    principal(np.array(moments, np.float64, order="C"), values, axes)
    return values, axes


def axes_of_points(points: DoubleArray) -> DoubleArray:
    """Directions (3, 3), columns, in which points (N, 3) extend, the least first."""
    x, y, z = np.ascontiguousarray((points - points.mean(axis=0)).T, np.float64)
    xy, xz, yz = (x * y).sum(), (x * z).sum(), (y * z).sum()
    moments = [[(x * x).sum(), xy, xz], [xy, (y * y).sum(), yz], [xz, yz, (z * z).sum()]]
    return principal_axes(np.array([moments]))[1][0]


# --- Rotations.


def quats_to_matrices(quats: FloatArray | DoubleArray) -> DoubleArray:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4) wxyz; they need not be of unit length."""
    check_shape("quats", quats, ("N", 4))
    q = np.asarray(quats, np.float64)
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def matrices_to_quats(matrices: FloatArray | DoubleArray) -> DoubleArray:
    """Unit quaternions (N, 4) wxyz, w >= 0, of rotation matrices (N, 3, 3) (Shepperd's method)."""
    check_shape("matrices", matrices, ("N", 3, 3))
    m = np.asarray(matrices, np.float64)
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    # Each row: the quaternion scaled by a different component; take the largest for stability.
    x, y, z = (m[:, k, k] for k in range(3))
    wx, wy, wz = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    rows = [
        [1 + trace, wx, wy, wz],
        [wx, 1 + 2 * x - trace, xy, xz],
        [wy, xy, 1 + 2 * y - trace, yz],
        [wz, xz, yz, 1 + 2 * z - trace],
    ]
    candidates = np.stack([np.stack(row, axis=1) for row in rows], axis=1)  # (N, 4, 4)
    diagonal = candidates[:, np.arange(4), np.arange(4)]
    best = candidates[np.arange(len(m)), diagonal.argmax(axis=1)]
    best /= np.linalg.norm(best, axis=1, keepdims=True)
    return np.where(best[:, :1] < 0, -best, best)


def multiply_quats(a: DoubleArray, b: DoubleArray) -> DoubleArray:
    """Hamilton product of quaternions (..., 4) wxyz: first ``b``, then ``a``."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def look_at(eye: DoubleArray, target: DoubleArray, up: DoubleArray) -> DoubleArray:
    """``cam_from_world`` (4, 4) of a camera at ``eye`` that looks at ``target`` (OpenCV axes).

    ``up`` is the world direction that must point to the top of the picture. It looks along z where
    the two are one point, as a camera around splats at 1e17 is.
    """
    forward = np.asarray(target, np.float64) - eye
    forward = forward / np.linalg.norm(forward) if forward.any() else np.array([0.0, 0.0, 1.0])
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:
        right = np.cross(forward, np.roll(up, 1))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = -rotation @ eye
    return matrix


def compose_affine(a: DoubleArray, b: DoubleArray) -> DoubleArray:
    """Affine map (3, 4) or (..., 3, 4) that applies ``b`` first, then ``a``."""
    linear = a[..., :3] @ b[..., :3]
    offset = (a[..., :3] @ b[..., 3:]) + a[..., 3:]
    return np.concatenate([linear, offset], axis=-1)


def fit_similarity(source: DoubleArray, target: DoubleArray) -> DoubleArray:
    """Scale times rotation, and shift, (..., 3, 4) that take points ``source`` (..., N, 3) to
    ``target`` with least squares (Umeyama 1991)."""
    middle_a, middle_b = source.mean(axis=-2), target.mean(axis=-2)
    a, b = source - middle_a[..., None, :], target - middle_b[..., None, :]
    u, values, vt = np.linalg.svd(np.swapaxes(b, -1, -2) @ a)
    signs = np.ones(values.shape)
    signs[..., 2] = np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)
    spread = np.maximum((a * a).sum(axis=(-1, -2)), 1e-300)
    scale = (values * signs).sum(axis=-1) / spread
    linear = scale[..., None, None] * ((u * signs[..., None, :]) @ vt)
    offset = middle_b[..., None] - linear @ middle_a[..., None]
    return np.concatenate([linear, offset], axis=-1)
