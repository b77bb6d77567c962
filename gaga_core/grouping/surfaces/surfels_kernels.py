"""Kernels of surface samples: normals from depth maps, thinning, seeds."""

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, LongArray
from gaga_core.kernels import exact_kernel, kernel


@exact_kernel
def normals_at(
    depth: FloatArray,  # (H, W) 0 = nothing there
    rows: LongArray,  # (P,)
    columns: LongArray,  # (P,)
    lens: DoubleArray,  # (4,) fx, fy, cx, cy
    radius: int,  # pixels of the window on each side
    step: int,  # every so many pixels of it
    shares: DoubleArray,  # (R,) of 1 / depth by which pixels may miss the plane, round by round
    out: DoubleArray,  # (P, 3) written: unit normals in the camera's frame, 0 = unknown
) -> None:
    """Normals towards the camera of planes fitted to 1 / depth, which is linear over a plane's
    picture; each round leaves out the pixels that the last plane misses."""
    height, width = depth.shape
    fx, fy, cx, cy = lens
    for k in range(len(rows)):
        y0, x0 = rows[k], columns[k]
        out[k, :] = 0
        if depth[y0, x0] <= 0:
            continue
        a, b, c = 0.0, 0.0, 1.0 / depth[y0, x0]
        fits = False
        for share in shares:
            most = share / depth[y0, x0]
            uu, uv, u1, vv, v1, n = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            uq, vq, q1 = 0.0, 0.0, 0.0
            for dy in range(-radius, radius + 1, step):
                for dx in range(-radius, radius + 1, step):
                    y, x = y0 + dy, x0 + dx
                    if y < 0 or x < 0 or y >= height or x >= width or depth[y, x] <= 0:
                        continue
                    u, v, q = dx / fx, dy / fy, 1.0 / depth[y, x]
                    if abs(q - (a * u + b * v + c)) > most:
                        continue
                    uu += u * u
                    uv += u * v
                    u1 += u
                    vv += v * v
                    v1 += v
                    n += 1.0
                    uq += u * q
                    vq += v * q
                    q1 += q
            minor_a, minor_b, minor_c = vv * n - v1 * v1, uv * n - v1 * u1, uv * v1 - vv * u1
            det = uu * minor_a - uv * minor_b + u1 * minor_c
            fits = n >= 12 and abs(det) > 1e-30
            if not fits:
                break
            a = (uq * minor_a - uv * (vq * n - v1 * q1) + u1 * (vq * v1 - vv * q1)) / det
            b = (uu * (vq * n - q1 * v1) - uq * minor_b + u1 * (uv * q1 - vq * u1)) / det
            c = (uu * (vv * q1 - v1 * vq) - uv * (uv * q1 - u1 * vq) + uq * minor_c) / det
        if fits:
            z = c - a * (x0 + 0.5 - cx) / fx - b * (y0 + 0.5 - cy) / fy
            length = np.sqrt(a * a + b * b + z * z)
            out[k, 0], out[k, 1], out[k, 2] = -a / length, -b / length, -z / length


@kernel
def keep_apart(
    order: LongArray,  # (S,) points, those that come first are kept first
    nearest: LongArray,  # (S, k)
    distance: DoubleArray,  # (S, k)
    reach: DoubleArray,  # (S,)
    kept: BoolArray,  # (S,) written
) -> None:
    """Keep points that no kept one has within its reach, or that have none within theirs."""
    gone = np.zeros(len(order), np.bool_)
    kept[:] = False
    for i in order:
        if gone[i]:
            continue
        kept[i] = True
        for k in range(nearest.shape[1]):
            j = nearest[i, k]
            if (distance[i, k] < reach[i] or distance[i, k] < reach[j]) and not kept[j]:
                gone[j] = True


@kernel
def choose_seeds(
    order: LongArray,  # (S,)
    nearest: LongArray,  # (S, k)
    seeds: BoolArray,  # (S,) written
) -> None:
    """Seeds none of which is among the nearest of an earlier one."""
    taken = np.zeros(len(order), np.bool_)
    seeds[:] = False
    for i in order:
        if taken[i]:
            continue
        seeds[i], taken[i] = True, True
        for k in range(nearest.shape[1]):
            taken[nearest[i, k]] = True


@exact_kernel
def count_on_planes(
    points: DoubleArray,  # (S, 3)
    normals: DoubleArray,  # (S, 3)
    away: DoubleArray,  # (S,) distance up to which a sample is on a plane
    cosine: float,  # between the normals from which on it is
    probe: LongArray,  # (P,) samples that count
    tried: LongArray,  # (T,) samples whose tangent planes are tried
    count: LongArray,  # (T,) written
) -> None:
    """Count the samples on the tangent planes of others."""
    for t, i in enumerate(tried):
        x, y, z = points[i]
        a, b, c = normals[i]
        count[t] = 0
        for j in probe:
            height = (points[j, 0] - x) * a + (points[j, 1] - y) * b + (points[j, 2] - z) * c
            alike = normals[j, 0] * a + normals[j, 1] * b + normals[j, 2] * c
            count[t] += abs(height) < away[j] and alike > cosine
