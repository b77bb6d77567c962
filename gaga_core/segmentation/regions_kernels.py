"""Kernels of the weights-free regions: smoothing, superpixels, the depth's creases."""

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.kernels import kernel


@kernel
def smooth(
    image: FloatArray,  # (H, W, 3)
    radius: int,
    space: float,  # 1 / (2 sigma^2) in pixels
    value: float,  # 1 / (2 sigma^2) in units of the image
    out: FloatArray,  # (H, W, 3)
) -> None:
    """Bilateral filter: flattens grain and keeps contours."""
    height, width, _ = image.shape
    for y in range(height):
        for x in range(width):
            l0, a0, b0 = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            total, l1, a1, b1 = 0.0, 0.0, 0.0, 0.0
            for v in range(max(0, y - radius), min(height, y + radius + 1)):
                for u in range(max(0, x - radius), min(width, x + radius + 1)):
                    dl, da, db = image[v, u, 0] - l0, image[v, u, 1] - a0, image[v, u, 2] - b0
                    near = ((v - y) * (v - y) + (u - x) * (u - x)) * space
                    w = np.exp(-near - (dl * dl + da * da + db * db) * value)
                    total += w
                    l1 += w * image[v, u, 0]
                    a1 += w * image[v, u, 1]
                    b1 += w * image[v, u, 2]
            out[y, x, 0] = l1 / total
            out[y, x, 1] = a1 / total
            out[y, x, 2] = b1 / total


@kernel
def nearest_centres(
    features: FloatArray,  # (H, W, C)
    centres: FloatArray,  # (rows * columns, C + 2) features, y, x; moved in place
    rows: int,
    columns: int,
    nearness: float,  # weight of a squared pixel next to a squared unit of the features
    sums: DoubleArray,  # (rows * columns, C + 3) scratch
    labels: IntArray,  # (H, W) written: index of the pixel's centre
) -> None:
    """One round of SLIC (Achanta 2012): each pixel takes the nearest of the 3 x 3 centres whose
    cells surround it, then each centre moves to the mean of its pixels."""
    height, width, n_features = features.shape
    sums[:] = 0
    for y in range(height):
        row = min(rows - 1, y * rows // height)
        for x in range(width):
            column = min(columns - 1, x * columns // width)
            best, chosen = np.float32(np.inf), 0
            for i in range(max(0, row - 1), min(rows, row + 2)):
                for j in range(max(0, column - 1), min(columns, column + 2)):
                    k = i * columns + j
                    dy, dx = y - centres[k, n_features], x - centres[k, n_features + 1]
                    distance = np.float32(nearness) * (dy * dy + dx * dx)
                    for c in range(n_features):
                        d = features[y, x, c] - centres[k, c]
                        distance += d * d
                    if distance < best:
                        best, chosen = distance, k
            labels[y, x] = chosen
            for c in range(n_features):
                sums[chosen, c] += features[y, x, c]
            sums[chosen, n_features] += y
            sums[chosen, n_features + 1] += x
            sums[chosen, n_features + 2] += 1
    for k in range(len(centres)):
        if sums[k, n_features + 2] > 0:
            for c in range(n_features + 2):
                centres[k, c] = sums[k, c] / sums[k, n_features + 2]


@kernel
def connected(
    labels: IntArray,  # (H, W)
    features: FloatArray,  # (H, W, C)
    least: int,  # pixels; smaller pieces join the piece whose border pixel is most like theirs
    queue: IntArray,  # (H * W,) scratch
    out: IntArray,  # (H, W) written: dense ids from 0
) -> int:
    """4-connected pieces of ``labels``, numbered by their first pixel; how many."""
    height, width, n_features = features.shape
    out[:] = -1
    n = 0
    for start in range(height * width):
        if out[start // width, start % width] >= 0:
            continue
        label = labels[start // width, start % width]
        queue[0] = start
        out[start // width, start % width] = n
        head, tail = 0, 1
        nearest, like = np.inf, -1
        while head < tail:
            y, x = queue[head] // width, queue[head] % width
            head += 1
            for k in range(4):
                v = y + (k == 0) - (k == 1)
                u = x + (k == 2) - (k == 3)
                if v < 0 or u < 0 or v >= height or u >= width:
                    continue
                other = out[v, u]
                if other < 0 and labels[v, u] == label:
                    out[v, u] = n
                    queue[tail] = v * width + u
                    tail += 1
                elif other >= 0 and other != n:
                    distance = 0.0
                    for c in range(n_features):
                        d = features[y, x, c] - features[v, u, c]
                        distance += d * d
                    if distance < nearest:
                        nearest, like = distance, other
        if tail < least and like >= 0:
            for i in range(tail):
                out[queue[i] // width, queue[i] % width] = like
        else:
            n += 1
    return n


@kernel
def creases(
    inverse: FloatArray,  # (H, W) 1 / depth, 0 = nothing there
    reach: int,  # pixels
    out: FloatArray,  # (H, W)
) -> None:
    """How far the surface bends towards the camera at each pixel, 0 where it is flat or bulges.

    A plane's inverse depth is linear in the picture, whatever the camera, and projection keeps
    convex what is convex: so the second difference of 1 / depth, over its value, tells contacts and
    steps behind an object (> 0) from the object's own edges (< 0) without a focal length.
    """
    height, width = inverse.shape
    for y in range(height):
        for x in range(width):
            here, bend = inverse[y, x], np.float32(0)
            for k in range(4):
                dy = 0 if k == 0 else reach
                dx = 0 if k == 1 else (-reach if k == 3 else reach)
                if y < dy or y + dy >= height or x < abs(dx) or x + abs(dx) >= width:
                    continue
                second = inverse[y - dy, x - dx] + inverse[y + dy, x + dx] - 2 * here
                if k >= 2:  # the diagonals reach further
                    second *= np.float32(0.7)
                bend = max(bend, second)
            out[y, x] = bend / here if here > 0 else np.float32(0)


@kernel
def folds(
    normals: FloatArray,  # (H, W, 3) unit, camera frame, towards the camera
    reach: int,  # pixels
    out: FloatArray,  # (H, W)
) -> None:
    """How much the normals of both sides lean towards each other at each pixel, 0..2: the same
    creases as `creases` finds, from normals; 0 where the surface is flat or bulges."""
    height, width, _ = normals.shape
    for y in range(height):
        for x in range(width):
            fold = np.float32(0)
            for k in range(4):
                dy = 0 if k == 0 else reach
                dx = 0 if k == 1 else (-reach if k == 3 else reach)
                if y < dy or y + dy >= height or x < abs(dx) or x + abs(dx) >= width:
                    continue
                lean = np.float32(0)
                if dx != 0:
                    change = normals[y - dy, x - dx, 0] - normals[y + dy, x + dx, 0]
                    lean += change if dx > 0 else -change
                if dy != 0:
                    lean += normals[y - dy, x - dx, 1] - normals[y + dy, x + dx, 1]
                if k >= 2:
                    lean *= np.float32(0.7)
                fold = max(fold, lean)
            out[y, x] = fold


# --- Kernels of the weights-free regions: neighbours of superpixels, and merging them.


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


# --- Kernel of the weights-free regions: where the tree of merges is cut.


# Weights of a merge's penalty, in the order of the array that the kernel takes.
START, SMALL, LARGE, FILLED, FILL, RAGGED, INSIDE, TAKEN = range(8)


@kernel
def cut(
    joined: IntArray,  # (M, 2) larger, smaller of each merge; the larger's index goes on
    costs: FloatArray,  # (M,)
    common: FloatArray,  # (M,) pixel pairs along the border that vanished
    area: FloatArray,  # (n,) pixels of the pieces; this and the next three are changed in place
    border: FloatArray,  # (n,) pixel pairs along the borders to other pieces
    edge: FloatArray,  # (n,) pixels along the edge of the picture
    box: IntArray,  # (n, 4) first and last column, first and last row
    weights: DoubleArray,  # (8,) START..TAKEN
    limit: float,  # doubt from which a merge is not made
    parent: IntArray,  # (n,) own indices; written: whom each piece joined
) -> None:
    """Make the merges whose doubt, and that of all merges within them, is under ``limit``.

    The doubt of a merge is the logarithm of its cost less what its shape speaks for it: it grows
    with the merges within, so that a lower limit only ever splits further.
    """
    total = area.sum()
    doubt = np.full(len(area), -np.inf)
    for step in range(len(joined)):
        a, b = joined[step]
        filled = area[b] / ((box[b, 1] - box[b, 0] + 1) * (box[b, 3] - box[b, 2] + 1))
        granted = weights[START]
        granted += weights[SMALL] * np.log(area[b] / total)
        granted += weights[LARGE] * np.log(area[a] / total)
        granted += weights[INSIDE] * common[step] / max(border[b], 1)
        granted += weights[TAKEN] * common[step] / max(border[a], 1)
        area[a] += area[b]
        border[a] += border[b] - 2 * common[step]
        edge[a] += edge[b]
        for k in range(2):
            box[a, 2 * k] = min(box[a, 2 * k], box[b, 2 * k])
            box[a, 2 * k + 1] = max(box[a, 2 * k + 1], box[b, 2 * k + 1])
        fill = area[a] / ((box[a, 1] - box[a, 0] + 1) * (box[a, 3] - box[a, 2] + 1))
        granted += weights[FILL] * fill + weights[FILLED] * (fill - filled)
        granted += weights[RAGGED] * np.log((border[a] + edge[a]) ** 2 / area[a])
        doubt[a] = max(doubt[a], doubt[b], np.log(costs[step] + 1e-6) - granted)
        if doubt[a] < limit:
            parent[b] = a
