"""Kernels of the depth gate and of the memory bank's counts.

Exact arithmetic (no fast math) in float64: the gate is a strict comparison, so the same Gaussian
must fall on the same side on every machine and in the plain reference of the tests.
"""

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.kernels import exact_kernel


@exact_kernel
def masks_of_centres(
    means: FloatArray,  # (N, 3) world
    pose: DoubleArray,  # (3, 4) cam_from_world
    lens: DoubleArray,  # (4,) fx fy cx cy
    labels: IntArray,  # (H, W) dense mask ids 1..M, 0 = none
    bounds: DoubleArray,  # (M + 1, 2) open interval of accepted depths; row 0 empty
    near: float,
    start: int,
    stop: int,
    mask_of: IntArray,  # (N,) written in [start, stop): mask id or 0
) -> None:
    """Project each centre, read the mask there, keep the id if the depth is inside its interval."""
    height, width = labels.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for i in range(start, stop):
        mask_of[i] = 0
        x = np.float64(means[i, 0])
        y = np.float64(means[i, 1])
        z = np.float64(means[i, 2])
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if not depth > near:  # also leaves out NaN
            continue
        u = fx * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / depth + cx
        v = fy * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / depth + cy
        # Compared as floats: a far-off centre would overflow an int. u >= 0, so int() is floor.
        if not (u >= 0.0 and v >= 0.0 and u < width and v < height):
            continue
        mask = labels[int(v), int(u)]
        # A product, not a branch: whether a centre passes is anybody's guess, also the processor's.
        inside = (depth > bounds[mask, 0]) & (depth < bounds[mask, 1])
        mask_of[i] = mask * np.int32(inside)


@exact_kernel
def greatest_overlaps(
    mask_of: IntArray,  # (N,) 0 = none
    group: IntArray,  # (N,) -1 = free
    sizes: IntArray,  # (M + 1,) out: #G(m); those of no mask at 0
    tally: IntArray,  # (G + 1,) zeros, and again afterwards
    best: IntArray,  # (M + 1, 2) out: groups of the greatest and the second greatest overlap
    counts: IntArray,  # (M + 1, 2) out: #(G(m) and G_g) of these
) -> None:
    """The two groups that own most of each G(m), the lower one on a tie, 0 = none.

    Gaussians are sorted by mask and counted mask by mask: linear in N + M + G, without a table of
    all masks and groups.
    """
    n_masks = len(sizes)
    sizes[:] = 0
    for i in range(len(mask_of)):
        sizes[mask_of[i]] += 1
    end = np.empty(n_masks, np.int64)
    end[0] = 0
    for m in range(1, n_masks):
        end[m] = end[m - 1] + (sizes[m - 1] if m > 1 else 0)
    owner = np.empty(len(mask_of) - sizes[0], np.int32)
    for i in range(len(mask_of)):
        m = mask_of[i]
        if m > 0:
            owner[end[m]] = group[i]
            end[m] += 1
    best[:] = 0
    counts[:] = 0
    for m in range(1, n_masks):
        first = end[m] - sizes[m]
        for k in range(first, end[m]):
            if owner[k] > 0:
                tally[owner[k]] += 1
        for k in range(first, end[m]):
            g = owner[k]
            if g <= 0 or tally[g] == 0:
                continue
            n = tally[g]
            tally[g] = 0
            if n > counts[m, 0] or (n == counts[m, 0] and g < best[m, 0]):
                best[m, 1], counts[m, 1] = best[m, 0], counts[m, 0]
                best[m, 0], counts[m, 0] = g, n
            elif n > counts[m, 1] or (n == counts[m, 1] and g < best[m, 1]):
                best[m, 1], counts[m, 1] = g, n


@exact_kernel
def take_free(
    mask_of: IntArray,  # (N,) 0 = none
    group_of_mask: IntArray,  # (M + 1,) 0 = none, as is entry 0
    group: IntArray,  # (N,) -1 = free; changed in place
) -> None:
    """Give every free Gaussian of a mask to the mask's group: ownership is exclusive."""
    for i in range(len(mask_of)):
        owner = group_of_mask[mask_of[i]]
        take = (group[i] < 0) & (owner > 0)
        group[i] = owner if take else group[i]
