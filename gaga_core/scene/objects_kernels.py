"""One pass over all splats for the object list."""

import math

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray, UInt8Array
from gaga_core.kernels import kernel


@kernel
def tally_groups(
    labels: IntArray,  # (N,)
    state: UInt8Array,  # (N,)
    placement: IntArray,  # (N,)
    matrix: DoubleArray,  # (P, 3, 4)
    means: FloatArray,  # (N, 3)
    counts: LongArray,  # (G, 16) out: splats by group and state bits
    spread: DoubleArray,  # (G, 10) out: lo xyz, hi xyz, sum xyz, sum of squares; live splats
) -> None:
    """Count splats by group and state, and measure where the live ones stand."""
    for i in range(labels.shape[0]):
        g = labels[i]
        bits = state[i] & 15
        counts[g, bits] += 1
        if bits & 8:
            continue
        x = float(means[i, 0])
        y = float(means[i, 1])
        z = float(means[i, 2])
        r = placement[i]
        if r != 0:
            m = matrix[r]
            a = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
            b = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
            c = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            x, y, z = a, b, c
        if not math.isfinite(x + y + z):
            continue
        s = spread[g]
        s[0] = min(s[0], x)
        s[1] = min(s[1], y)
        s[2] = min(s[2], z)
        s[3] = max(s[3], x)
        s[4] = max(s[4], y)
        s[5] = max(s[5], z)
        s[6] += x
        s[7] += y
        s[8] += z
        s[9] += x * x + y * y + z * z
