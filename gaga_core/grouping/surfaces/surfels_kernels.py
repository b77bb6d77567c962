"""Kernels of surface samples: normals from depth maps, thinning, seeds."""

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
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
def sum_of_trees(
    features: DoubleArray,  # (R, F)
    roots: IntArray,  # (T,)
    feature: IntArray,  # (n,)
    threshold: DoubleArray,  # (n,)
    right: IntArray,  # (n,) 0 = a leaf
    value: DoubleArray,  # (n,)
    out: DoubleArray,  # (R,) written
) -> None:
    """The sum of what each tree says of each row."""
    for r in range(len(features)):
        total = 0.0
        for root in roots:
            node = root
            while right[node] > 0:
                is_next = features[r, feature[node]] <= threshold[node]
                node = node + 1 if is_next else right[node]
            total += value[node]
        out[r] = total


@exact_kernel
def smooth_once(
    values: DoubleArray,  # (S, 3)
    around: LongArray,  # (S, k)
    cluster: LongArray,  # (S,)
    out: DoubleArray,  # (S, 3) written
    count: DoubleArray,  # (S,) written
) -> None:
    """Sums of each sample and its neighbours in the same cluster, and how many they are."""
    for s in range(len(values)):
        x, y, z, n = values[s, 0], values[s, 1], values[s, 2], 1.0
        for k in range(around.shape[1]):
            t = around[s, k]
            if cluster[t] == cluster[s]:
                x += values[t, 0]
                y += values[t, 1]
                z += values[t, 2]
                n += 1.0
        out[s, 0], out[s, 1], out[s, 2], count[s] = x, y, z, n


@exact_kernel
def products_of_rows(
    start: IntArray,  # (n + 1,) of the rows of a sparse table
    column: IntArray,  # ascending in each row
    value: DoubleArray,
    one: LongArray,  # (B,) rows
    other: LongArray,  # (B,)
    out: DoubleArray,  # (B,) written
) -> None:
    """Scalar products of rows of a sparse table."""
    for k in range(len(one)):
        i, j, total = start[one[k]], start[other[k]], 0.0
        while i < start[one[k] + 1] and j < start[other[k] + 1]:
            if column[i] == column[j]:
                total += value[i] * value[j]
                i += 1
                j += 1
            elif column[i] < column[j]:
                i += 1
            else:
                j += 1
        out[k] = total
