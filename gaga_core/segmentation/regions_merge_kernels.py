"""Kernels of the weights-free regions: neighbours of superpixels, and merging them."""

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.kernels import kernel

# Settings of the cost, in the order of the array that the kernels take.
MEAN, HISTOGRAM, CONTOUR, SIZE, KEEP, CREASE = range(6)


@kernel
def add_borders(
    labels: IntArray,  # (H, W)
    cues: FloatArray,  # (K, H, W) strength of a contour at each pixel
    length: FloatArray,  # (n, n) zeros; pixel pairs along the border of two regions
    strength: FloatArray,  # (K, n, n) zeros; sum over them of the cue's larger value
) -> None:
    """Borders between 4-neighbours, both ways round."""
    n_cues, height, width = cues.shape
    for y in range(height):
        for x in range(width):
            a = labels[y, x]
            for k in range(2):
                v, u = y + k, x + 1 - k
                if v >= height or u >= width or labels[v, u] == a:
                    continue
                b = labels[v, u]
                length[a, b] += 1
                length[b, a] += 1
                for c in range(n_cues):
                    value = max(cues[c, y, x], cues[c, v, u])
                    strength[c, a, b] += value
                    strength[c, b, a] += value


@kernel
def add_histograms(
    labels: IntArray,  # (H, W)
    bins: IntArray,  # (H, W)
    out: FloatArray,  # (n, B) zeros
) -> None:
    """Pixels of each bin in each region."""
    height, width = labels.shape
    for y in range(height):
        for x in range(width):
            out[labels[y, x], bins[y, x]] += 1


@kernel
def cost_of(
    a: int,
    b: int,
    area: FloatArray,  # (n,) pixels
    color: FloatArray,  # (n, 3) sums
    histogram: FloatArray,  # (n, B)
    length: FloatArray,  # (n, n)
    strength: FloatArray,  # (K, n, n)
    weights: DoubleArray,  # (6,) MEAN..CREASE
    total: float,  # pixels of the picture
) -> float:
    """Cost of merging two neighbours; that of a small one is low."""
    squared, common = 0.0, 0.0
    for c in range(color.shape[1]):
        d = color[a, c] / area[a] - color[b, c] / area[b]
        squared += d * d
    for k in range(histogram.shape[1]):
        common += min(histogram[a, k] / area[a], histogram[b, k] / area[b])
    cost = weights[MEAN] * np.sqrt(squared) + weights[HISTOGRAM] * (1 - common)
    cost += weights[CONTOUR] * strength[0, a, b] / length[a, b]
    if len(strength) > 1:
        crease = strength[1, a, b] / length[a, b]
        cost *= weights[KEEP] + (1 - weights[KEEP]) * crease
        cost += weights[CREASE] * crease
    result: float = cost * (min(area[a], area[b]) / total) ** weights[SIZE]
    return result


@kernel
def merge_all(
    area: FloatArray,  # (n,); this and the next four are changed in place
    color: FloatArray,  # (n, 3)
    histogram: FloatArray,  # (n, B)
    length: FloatArray,  # (n, n)
    strength: FloatArray,  # (K, n, n)
    weights: DoubleArray,  # (6,)
    joined: IntArray,  # (n - 1, 2) written: larger, smaller; the larger goes on for both
    costs: FloatArray,  # (n - 1,) written
    common: FloatArray,  # (n - 1,) written: length of the border that vanished
) -> int:
    """Merge the cheapest pair of neighbours until one is left; number of merges."""
    n = len(area)
    total = area.sum()
    cost = np.full((n, n), np.inf, np.float32)
    least = np.full(n, np.inf, np.float32)
    with_whom = np.full(n, -1, np.int32)
    for a in range(n):
        for b in range(n):
            if b != a and length[a, b] > 0:
                cost[a, b] = (
                    cost[b, a]
                    if b < a
                    else cost_of(a, b, area, color, histogram, length, strength, weights, total)
                )
                if cost[a, b] < least[a]:
                    least[a], with_whom[a] = cost[a, b], b
    for step in range(n - 1):
        a = int(least.argmin())
        if not least[a] < np.inf:
            return step
        b = with_whom[a]
        if area[b] > area[a]:
            a, b = b, a
        joined[step, 0], joined[step, 1] = a, b
        costs[step], common[step] = least[a], length[a, b]
        area[a] += area[b]
        color[a] += color[b]
        histogram[a] += histogram[b]
        least[b] = np.inf
        cost[a, b] = cost[b, a] = np.inf
        length[a, b] = length[b, a] = 0
        for t in range(n):
            if length[b, t] > 0:
                length[a, t] += length[b, t]
                length[t, a] = length[a, t]
                for c in range(len(strength)):
                    strength[c, a, t] += strength[c, b, t]
                    strength[c, t, a] = strength[c, a, t]
                length[b, t] = length[t, b] = 0
                cost[b, t] = cost[t, b] = np.inf
        least[a], with_whom[a] = np.inf, -1
        for t in range(n):
            if length[a, t] > 0:
                new = np.float32(
                    cost_of(a, t, area, color, histogram, length, strength, weights, total)
                )
                cost[a, t] = cost[t, a] = new
                if new < least[a]:
                    least[a], with_whom[a] = new, t
                if with_whom[t] == a or with_whom[t] == b:
                    with_whom[t] = int(cost[t].argmin())
                    least[t] = cost[t, with_whom[t]]
                elif new < least[t]:
                    least[t], with_whom[t] = new, a
    return n - 1
