"""Passes over all splats that measure groups."""

import math

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.kernels import kernel

BEHIND_CELLS = 1.5  # this far behind the nearest splat, in cells of a view, is still its surface
HIDDEN_SHARE = 0.05  # weight of splats that no view sees, against those that all see


@kernel
def weigh_splats(
    rows: IntArray,  # (N,) row of each splat's group
    state: UInt8Array,  # (N,) State bits
    placement: IntArray,  # (N,)
    matrix: DoubleArray,  # (P, 3, 4) frame_from_file
    growth: DoubleArray,  # (P,) factor of areas
    means: FloatArray,  # (N, 3)
    log_scales: FloatArray,  # (N, 3)
    logit_opacities: FloatArray,  # (N,)
    points: FloatArray,  # (N, 3) out: positions in the frame
    area: FloatArray,  # (N,) out: product of the two largest scales, frame; -1 = does not count
    weight: FloatArray,  # (N,) out: opacity
    sums: DoubleArray,  # (G, 8) out: count, opacity, opacity x area, position xyz, squares, -
) -> None:
    """First pass: where splats stand, how much of each is seen, and sums by group."""
    for i in range(rows.shape[0]):
        area[i] = -1.0
        if state[i] & 8:
            continue
        m = matrix[placement[i]]
        x0 = float(means[i, 0])
        y0 = float(means[i, 1])
        z0 = float(means[i, 2])
        x = m[0, 0] * x0 + m[0, 1] * y0 + m[0, 2] * z0 + m[0, 3]
        y = m[1, 0] * x0 + m[1, 1] * y0 + m[1, 2] * z0 + m[1, 3]
        z = m[2, 0] * x0 + m[2, 1] * y0 + m[2, 2] * z0 + m[2, 3]
        a = log_scales[i, 0]
        b = log_scales[i, 1]
        c = log_scales[i, 2]
        face = growth[placement[i]] * math.exp(min(60.0, a + b + c - min(a, b, c)))
        opacity = 1.0 / (1.0 + math.exp(-max(-60.0, min(60.0, float(logit_opacities[i])))))
        if not math.isfinite(x + y + z + face + opacity):
            continue
        points[i, 0] = x
        points[i, 1] = y
        points[i, 2] = z
        area[i] = face
        weight[i] = opacity
        s = sums[rows[i]]
        s[0] += 1.0
        s[1] += opacity
        s[2] += opacity * face
        s[3] += opacity * x
        s[4] += opacity * y
        s[5] += opacity * z
        s[6] += opacity * (x * x + y * y + z * z)


@kernel
def tally_axes(
    rows: IntArray,  # (N,)
    points: FloatArray,  # (N, 3)
    area: FloatArray,  # (N,) negative = does not count
    weight: FloatArray,  # (N,)
    lo: FloatArray,  # (G, 3) where the bins begin
    per_unit: FloatArray,  # (G, 3) bins by length
    bins: FloatArray,  # (G, 3, B) out: opacity in each bin; what lies outside is in the end bins
) -> None:
    """Histogram of positions by group and axis."""
    last = bins.shape[2] - 1
    for i in range(rows.shape[0]):
        if area[i] < 0:
            continue
        g = rows[i]
        for k in range(3):
            at = (points[i, k] - lo[g, k]) * per_unit[g, k]
            j = int(max(0.0, min(float(last), at)))
            bins[g, k, j] += weight[i]


@kernel
def _seen_along(
    axes: DoubleArray, point: FloatArray, centre: DoubleArray, per_unit: float, n: int
) -> tuple[float, float, float]:
    """Column and row of a point (3,) in a group's picture of ``n`` cells a side, and its depth."""
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    u = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z) * per_unit + 0.5 * n
    v = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z) * per_unit + 0.5 * n
    return u, v, axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z


@kernel
def nearest_depths(
    rows: IntArray,  # (N,)
    points: FloatArray,  # (N, 3)
    area: FloatArray,  # (N,) negative = does not count
    axes: DoubleArray,  # (3, 3) rows: right, down and forward of an orthographic view
    centre: DoubleArray,  # (G, 3) of each group's picture
    per_unit: DoubleArray,  # (G,) cells by length
    depths: FloatArray,  # (G, C, C) out: depth of the nearest splat of the group
) -> None:
    """Draw each group alone as a small picture of depths; what lies outside is left out."""
    n = depths.shape[1]
    for i in range(rows.shape[0]):
        if area[i] < 0:
            continue
        g = rows[i]
        u, v, depth = _seen_along(axes, points[i], centre[g], per_unit[g], n)
        if 0 <= u < n and 0 <= v < n:
            depths[g, int(v), int(u)] = min(depths[g, int(v), int(u)], depth)


@kernel
def add_seen(
    rows: IntArray,  # (N,)
    placement: IntArray,  # (N,)
    points: FloatArray,  # (N, 3)
    area: FloatArray,  # (N,)
    axes: DoubleArray,  # (3, 3) as in `nearest_depths`
    centre: DoubleArray,  # (G, 3)
    per_unit: DoubleArray,  # (G,)
    depths: FloatArray,  # (G, C, C)
    sh: FloatArray,  # (N, S, 3)
    basis: DoubleArray,  # (P, B) of the view's direction in each placement's frame, B <= S
    seen: FloatArray,  # (N, 4) in and out: sum of colors, and number of views
) -> None:
    """Add the color of each splat that nothing of its own group hides in one view."""
    n = depths.shape[1]
    for i in range(rows.shape[0]):
        if area[i] < 0:
            continue
        g = rows[i]
        u, v, depth = _seen_along(axes, points[i], centre[g], per_unit[g], n)
        if not (0 <= u < n and 0 <= v < n):
            continue
        if depth > depths[g, int(v), int(u)] + BEHIND_CELLS / per_unit[g]:
            continue
        b = basis[placement[i]]
        for c in range(3):
            value = 0.5
            for k in range(b.shape[0]):
                value += b[k] * sh[i, k, c]
            seen[i, c] += max(0.0, min(1.0, value))
        seen[i, 3] += 1.0


@kernel
def tally_looks(
    rows: IntArray,  # (N,)
    placement: IntArray,  # (N,)
    recolor: DoubleArray,  # (P, 3, 4) affine in RGB
    seen: FloatArray,  # (N, 4) color as seen from outside, and the share of directions that see it
    points: FloatArray,  # (N, 3)
    area: FloatArray,  # (N,)
    weight: FloatArray,  # (N,)
    lo: FloatArray,  # (G, 3) robust box
    hi: FloatArray,  # (G, 3)
    area_max: FloatArray,  # (G,) larger splats count as this large
    table: FloatArray,  # (L^3, C) of colors
    levels: int,
    looks: DoubleArray,  # (G, C + 4) out: table's columns, then r g b, and the weight
    moments: DoubleArray,  # (G, 10) out: weight, xyz, xx xy xz yy yz zz inside the box
) -> None:
    """Last pass: colors by what is seen of them, and the shape of what lies inside the box."""
    n_columns = table.shape[1]
    for i in range(rows.shape[0]):
        if area[i] < 0:
            continue
        g = rows[i]
        w = weight[i] * min(area[i], area_max[g])
        m = recolor[placement[i]]
        r0 = seen[i, 0]
        g0 = seen[i, 1]
        b0 = seen[i, 2]
        red = max(0.0, min(1.0, m[0, 0] * r0 + m[0, 1] * g0 + m[0, 2] * b0 + m[0, 3]))
        green = max(0.0, min(1.0, m[1, 0] * r0 + m[1, 1] * g0 + m[1, 2] * b0 + m[1, 3]))
        blue = max(0.0, min(1.0, m[2, 0] * r0 + m[2, 1] * g0 + m[2, 2] * b0 + m[2, 3]))
        ir = min(levels - 1, int(red * levels))
        ig = min(levels - 1, int(green * levels))
        ib = min(levels - 1, int(blue * levels))
        # What lies in shade says less of an object's color than its lit side.
        w *= (0.1 + max(red, green, blue)) * (HIDDEN_SHARE + seen[i, 3])
        entry = table[(ir * levels + ig) * levels + ib]
        s = looks[g]
        for c in range(n_columns):
            s[c] += w * entry[c]
        s[n_columns] += w * red
        s[n_columns + 1] += w * green
        s[n_columns + 2] += w * blue
        s[n_columns + 3] += w
        x = float(points[i, 0])
        y = float(points[i, 1])
        z = float(points[i, 2])
        inside = lo[g, 0] <= x <= hi[g, 0] and lo[g, 1] <= y <= hi[g, 1]
        if not inside or z < lo[g, 2] or z > hi[g, 2]:
            continue
        q = moments[g]
        o = float(weight[i])
        x -= lo[g, 0]
        y -= lo[g, 1]
        z -= lo[g, 2]
        q[0] += o
        q[1] += o * x
        q[2] += o * y
        q[3] += o * z
        q[4] += o * x * x
        q[5] += o * x * y
        q[6] += o * x * z
        q[7] += o * y * y
        q[8] += o * y * z
        q[9] += o * z * z
