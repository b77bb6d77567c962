"""Rotations and affine maps: quaternions wxyz, matrices that act on column vectors."""

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, LongArray, check_shape

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
    values, axes = np.empty(moments.shape[:2]), np.empty(moments.shape)
    with np.errstate(all="ignore"):
        for start in range(0, len(moments), _AT_ONCE):
            rows = slice(start, start + _AT_ONCE)
            v, a = _principal(np.array(moments[rows].transpose(1, 2, 0), np.float64, order="C"))
            values[rows], axes[rows] = v.T, a.transpose(2, 0, 1)
    return values, axes


_AT_ONCE = 4096  # matrices: their entries stay in the processor's cache
_SWEEPS = 12  # of Jacobi rotations; 5 to 7 are enough for 3 x 3
_SAME = 1e-6  # of the largest: eigenvalues, and components of an axis, that count as equal


def _principal(c: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """`principal_axes` of ``c`` (3, 3, N), overwritten: values (3, N), axes (3, 3, N)."""
    a = np.zeros_like(c)
    a[0, 0] = a[1, 1] = a[2, 2] = 1
    left = np.arange(c.shape[2])
    for _ in range(_SWEEPS):
        off = abs(c[0, 1, left]) + abs(c[0, 2, left]) + abs(c[1, 2, left])
        trace = abs(c[0, 0, left]) + abs(c[1, 1, left]) + abs(c[2, 2, left])
        left = left[off > 1e-18 * trace]
        if len(left) == 0:
            break
        turned_c, turned_a = c[:, :, left], a[:, :, left]
        for p, q in ((0, 1), (0, 2), (1, 2)):
            _rotate(turned_c, turned_a, p, q)
        c[:, :, left], a[:, :, left] = turned_c, turned_a
    v = np.stack([c[0, 0], c[1, 1], c[2, 2]])
    for i, j in ((0, 1), (1, 2), (0, 1)):
        swaps = np.flatnonzero(v[j] < v[i])
        v[i, swaps], v[j, swaps] = v[j, swaps], v[i, swaps]
        a[:, i, swaps], a[:, j, swaps] = a[:, j, swaps], a[:, i, swaps]
    low, high = v[1] - v[0] <= _SAME * v[2], v[2] - v[1] <= _SAME * v[2]
    a[:, :, low & high] = np.eye(3)[:, :, None]
    for rows, known, first, second in ((low & ~high, 2, 0, 1), (high & ~low, 0, 1, 2)):
        a[:, first, rows], a[:, second, rows] = _across(a[:, known, rows])
    for i in range(3):
        best = _first_of_largest(abs(a[:, i]), 1)
        a[:, i] *= np.where(np.take_along_axis(a[:, i], best[None], 0)[0] < 0, -1.0, 1.0)
    return v, a


def _rotate(c: DoubleArray, a: DoubleArray, p: int, q: int) -> None:
    """Make entry (p, q) of ``c`` (3, 3, N) zero (Jacobi's method), ``a`` (3, 3, N) with it."""
    theta = (c[q, q] - c[p, p]) / (2.0 * c[p, q])
    t = np.where(theta < 0, -1.0, 1.0) / (abs(theta) + np.sqrt(theta * theta + 1.0))
    t = np.where(abs(theta) > 1e150, 0.5 / theta, t)
    t[c[p, q] == 0] = 0
    cosine = 1.0 / np.sqrt(t * t + 1.0)
    sine, h, r = t * cosine, t * c[p, q], 3 - p - q
    c[p, p] -= h
    c[q, q] += h
    c[p, q] = c[q, p] = 0.0
    for rows in (c[r], *a):
        rows[p], rows[q] = cosine * rows[p] - sine * rows[q], sine * rows[p] + cosine * rows[q]
    c[p, r], c[q, r] = c[r, p], c[r, q]


def _across(known: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Two axes (3, N) across a known one: the first towards the coordinate axis that lies most
    across it."""
    least = np.arange(3)[:, None] == _first_of_largest(abs(known), -1)
    along = known[least.argmax(axis=0), np.arange(known.shape[1])]
    first = (least - along * known) / np.sqrt(1.0 - along * along)
    (x, y, z), (u, v, w) = known, first
    return first, np.stack([y * w - z * v, z * u - x * w, x * v - y * u])


def _first_of_largest(sizes: DoubleArray, sign: int) -> LongArray:
    """The first (N,) of the largest of ``sizes`` (3, N); of the least for ``sign`` -1."""
    best = np.zeros(sizes.shape[1], np.int64)
    for r in range(1, 3):
        so_far = np.take_along_axis(sizes, best[None], 0)[0]
        best[sign * (sizes[r] - so_far) > _SAME] = r
    return best


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
