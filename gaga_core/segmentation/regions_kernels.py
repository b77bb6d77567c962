"""Kernels of the weights-free regions: smoothing, superpixels, the depth's creases."""

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.kernels import exp_below_zero, kernel

_F = np.float32


@kernel
def lab_planes(
    image: UInt8Array,  # (H, W, 3) sRGB
    linear: FloatArray,  # (256,) light of each value, 0..1
    to_xyz: FloatArray,  # (3, 3) from linear light, white at 1
    out: FloatArray,  # (3, H, W) written
) -> None:
    """CIE Lab, as `color.lab_from_rgb`, to single precision."""
    height, width, _ = image.shape
    light = np.empty((3, width), np.float32)
    for y in range(height):
        for x in range(width):
            for c in range(3):
                light[c, x] = linear[image[y, x, c]]
        for c in range(3):
            root = out[c, y]
            for x in range(width):
                t = to_xyz[c, 0] * light[0, x] + to_xyz[c, 1] * light[1, x]
                t += to_xyz[c, 2] * light[2, x]
                # Cube root: a third of the exponent, then Newton; a line under (6 / 29)^3.
                bits = np.int32(np.float32(max(t, _F(0.008))).view(np.int32) * _F(1 / 3))
                r = np.int32(bits + np.int32(0x2A5137A0)).view(np.float32)
                for _ in range(3):
                    r = r - (r - t / (r * r)) * _F(1 / 3)
                root[x] = r if t > _F(216 / 24389) else t * _F(841 / 108) + _F(4 / 29)
        for x in range(width):
            fx, fy, fz = out[0, y, x], out[1, y, x], out[2, y, x]
            out[0, y, x] = _F(116) * fy - _F(16)
            out[1, y, x] = _F(500) * (fx - fy)
            out[2, y, x] = _F(200) * (fy - fz)


@kernel
def color_bins(
    lab: FloatArray,  # (3, H, W)
    n_light: int,  # bins of lightness
    n_hue: int,  # of a, and of b
    out: IntArray,  # (H, W) written
) -> None:
    """Bin of each pixel, of n_light * n_hue * n_hue."""
    _, height, width = lab.shape
    for y in range(height):
        for x in range(width):
            light = min(max(lab[0, y, x] / _F(100) * n_light, _F(0)), _F(n_light - 1))
            a = min(max((lab[1, y, x] + _F(60)) / _F(120) * n_hue, _F(0)), _F(n_hue - 1))
            b = min(max((lab[2, y, x] + _F(60)) / _F(120) * n_hue, _F(0)), _F(n_hue - 1))
            out[y, x] = (int(light) * n_hue + int(a)) * n_hue + int(b)


@kernel
def smooth(
    image: FloatArray,  # (3, H, W)
    radius: int,
    space: float,  # 1 / (2 sigma^2) in pixels
    value: float,  # 1 / (2 sigma^2) in units of the image
    out: FloatArray,  # (3, H, W) written
) -> None:
    """Bilateral filter: flattens grain and keeps contours."""
    _, height, width = image.shape
    # Sums of weights and of colors, in one array: the compiler knows that it does not overlap.
    sums, by = np.empty(4 * width, np.float32), _F(value)
    for y in range(height):
        sums[:] = 0
        for v in range(max(0, y - radius), min(height, y + radius + 1)):
            for dx in range(-radius, radius + 1):
                near = _F(((v - y) * (v - y) + dx * dx) * space)
                first, last = max(0, -dx), min(width, width - dx)
                l0, a0, b0 = (
                    image[0, y, first:last],
                    image[1, y, first:last],
                    image[2, y, first:last],
                )
                l1, a1 = image[0, v, first + dx : last + dx], image[1, v, first + dx : last + dx]
                b1 = image[2, v, first + dx : last + dx]
                for x in range(last - first):
                    dl, da, db = l0[x] - l1[x], a0[x] - a1[x], b0[x] - b1[x]
                    w = exp_below_zero(max(_F(-87), -near - (dl * dl + da * da + db * db) * by))
                    at = first + x
                    sums[at] += w
                    sums[width + at] += w * l1[x]
                    sums[2 * width + at] += w * a1[x]
                    sums[3 * width + at] += w * b1[x]
        for c in range(3):
            for x in range(width):
                out[c, y, x] = sums[(c + 1) * width + x] / sums[x]


@kernel
def filtered(
    image: FloatArray,  # (H, W)
    down: FloatArray,  # (2 R + 1,) weights along a column
    along: FloatArray,  # (2 R + 1,) along a row
    out: FloatArray,  # (H, W) written
) -> None:
    """Separable filter; beyond its edge the picture is mirrored."""
    height, width = image.shape
    reach, side = len(down) // 2, len(along) // 2
    row, total = np.empty(width + 2 * side, np.float32), np.empty(width, np.float32)
    middle = row[side : side + width]
    for y in range(height):
        middle[:] = 0
        for k in range(-reach, reach + 1):
            v = (y + k) % (2 * height)
            source, w = image[min(v, 2 * height - 1 - v)], down[reach + k]
            for x in range(width):
                middle[x] += w * source[x]
        for k in range(side):
            u = k % (2 * width)
            u = min(u, 2 * width - 1 - u)
            row[side - 1 - k], row[side + width + k] = middle[u], middle[width - 1 - u]
        total[:] = 0
        for k in range(2 * side + 1):
            source, w = row[k : k + width], along[k]
            for x in range(width):
                total[x] += w * source[x]
        for x in range(width):  # no row at once: checking its length would compile half of str
            out[y, x] = total[x]


@kernel
def nearest_centres(
    features: FloatArray,  # (C, H, W)
    centres: FloatArray,  # (rows * columns, C + 2) features, y, x; moved in place
    rows: int,
    columns: int,
    nearness: float,  # weight of a squared pixel next to a squared unit of the features
    sums: DoubleArray,  # (rows * columns, C + 3) scratch
    labels: IntArray,  # (H, W) written: index of the pixel's centre
) -> None:
    """One round of SLIC (Achanta 2012): each pixel takes the nearest of the 3 x 3 centres whose
    cells surround it, then each centre moves to the mean of its pixels."""
    n_features, height, width = features.shape
    weight = _F(nearness)
    sums[:] = 0
    # The centres that a row of cells asks, spread out over the columns: loops along a row are
    # vectors then.
    spread = np.empty((9, n_features + 2, width), np.float32)
    best, distance = np.empty(width, np.float32), np.empty(width, np.float32)
    chosen, cell = np.empty(width, np.int32), np.empty(width, np.int32)
    for x in range(width):
        cell[x] = min(columns - 1, x * columns // width)
    last_row = -1
    for y in range(height):
        row = min(rows - 1, y * rows // height)
        if row != last_row:
            for n in range(9):
                i, dj = row + n // 3 - 1, n % 3 - 1
                for x in range(width):
                    j = cell[x] + dj
                    is_there = 0 <= i < rows and 0 <= j < columns
                    for c in range(n_features + 2):
                        spread[n, c, x] = centres[i * columns + j, c] if is_there else _F(1e18)
            last_row = row
        best[:], chosen[:] = np.inf, 0
        for n in range(9):
            step = np.int32((row + n // 3 - 1) * columns + n % 3 - 1)
            ys, xs = spread[n, n_features], spread[n, n_features + 1]
            for x in range(width):
                dy, dx = _F(y) - ys[x], _F(np.int32(x)) - xs[x]
                distance[x] = weight * (dy * dy + dx * dx)
            for c in range(n_features):
                own, other = features[c, y], spread[n, c]
                for x in range(width):
                    d = own[x] - other[x]
                    distance[x] += d * d
            for x in range(width):
                is_nearer = distance[x] < best[x]
                chosen[x] = step + cell[x] if is_nearer else chosen[x]
                best[x] = distance[x] if is_nearer else best[x]
        labels[y] = chosen
        for x in range(width):
            of = sums[labels[y, x]]
            for c in range(n_features):
                of[c] += features[c, y, x]
            of[n_features] += y
            of[n_features + 1] += x
            of[n_features + 2] += 1
    for k in range(len(centres)):
        if sums[k, n_features + 2] > 0:
            for c in range(n_features + 2):
                centres[k, c] = sums[k, c] / sums[k, n_features + 2]


@kernel
def connected(
    labels: IntArray,  # (H, W)
    features: FloatArray,  # (C, H, W)
    least: int,  # pixels; smaller pieces join the piece whose border pixel is most like theirs
    queue: IntArray,  # (H * W,) scratch
    out: IntArray,  # (H, W) written: dense ids from 0
) -> int:
    """4-connected pieces of ``labels``, numbered by their first pixel; how many."""
    n_features, height, width = features.shape
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
                        d = features[c, y, x] - features[c, v, u]
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
    labels: IntArray,  # (H, W) of n regions
    cues: FloatArray,  # (K, H, W) strength of a contour at each pixel
    sides: IntArray,  # (B, 2) written: the regions of each border, the lower first
    length: FloatArray,  # (B,) zeros; pixel pairs along it
    strength: FloatArray,  # (B, K) zeros; sum over them of the cue's larger value
    first: IntArray,  # (n,) -1; written: as `merge_all` takes it
    following: IntArray,  # (2 B,) written: the same
) -> int:
    """Borders between 4-neighbours, and how many."""
    n_cues, height, width = cues.shape
    n = 0
    for y in range(height):
        for x in range(width):
            for k in range(2):
                v, u = y + k, x + 1 - k
                if v >= height or u >= width or labels[v, u] == labels[y, x]:
                    continue
                a, b = min(labels[y, x], labels[v, u]), max(labels[y, x], labels[v, u])
                end = first[a]
                while end >= 0 and sides[end >> 1, 1 - (end & 1)] != b:
                    end = following[end]
                if end < 0:
                    sides[n, 0], sides[n, 1] = a, b
                    following[2 * n], first[a] = first[a], 2 * n
                    following[2 * n + 1], first[b] = first[b], 2 * n + 1
                    end = 2 * n
                    n += 1
                length[end >> 1] += 1
                for c in range(n_cues):
                    strength[end >> 1, c] += max(cues[c, y, x], cues[c, v, u])
    return n


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
    border: int,
    area: FloatArray,  # (n,) pixels
    color: FloatArray,  # (n, 3) sums
    histogram: FloatArray,  # (n, B)
    length: FloatArray,  # (E,) of borders
    strength: FloatArray,  # (E, K)
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
    cost += weights[CONTOUR] * strength[border, 0] / length[border]
    if strength.shape[1] > 1:
        crease = strength[border, 1] / length[border]
        cost *= weights[KEEP] + (1 - weights[KEEP]) * crease
        cost += weights[CREASE] * crease
    result: float = cost * (min(area[a], area[b]) / total) ** weights[SIZE]
    return result


@kernel
def replay(winner: IntArray, least: FloatArray, a: int) -> None:
    """Bring a tournament for the least value, of equal ones the lower index, up to date after
    ``least[a]`` has changed: ``winner[1]`` has won, of 2 k and 2 k + 1 goes on ``winner[k]``."""
    k = (len(least) + a) >> 1
    while k > 0:
        one, other = winner[2 * k], winner[2 * k + 1]
        winner[k] = one if least[one] <= least[other] else other
        k >>= 1


@kernel
def merge_all(
    area: FloatArray,  # (n,); all arrays up to `following` are changed in place
    color: FloatArray,  # (n, 3)
    histogram: FloatArray,  # (n, B)
    sides: IntArray,  # (E, 2) the regions of each border
    length: FloatArray,  # (E,)
    strength: FloatArray,  # (E, K)
    first: IntArray,  # (n,) end of a border at each region, -1 = none: 2 e + s is `sides[e, s]`
    following: IntArray,  # (2 E,) the next end at the same region
    weights: DoubleArray,  # (6,)
    joined: IntArray,  # (n - 1, 2) written: larger, smaller; the larger goes on for both
    costs: FloatArray,  # (n - 1,) written
    common: FloatArray,  # (n - 1,) written: length of the border that vanished
) -> int:
    """Merge the cheapest pair of neighbours until one is left; number of merges."""
    n, total = len(area), area.sum()
    cost = np.empty(len(length), np.float32)
    for e in range(len(length)):
        a, b = sides[e, 0], sides[e, 1]
        cost[e] = cost_of(a, b, e, area, color, histogram, length, strength, weights, total)
    n_leaves = 1
    while n_leaves < n:
        n_leaves *= 2
    least, with_whom = np.full(n_leaves, np.inf, np.float32), np.full(n, -1, np.int32)
    winner = np.empty(2 * n_leaves, np.int32)
    for a in range(n_leaves):  # no slice: checking its length would compile half of str
        winner[n_leaves + a] = a
    for a in range(n):
        find_cheapest(a, sides, length, first, following, cost, least, with_whom)
    for k in range(n_leaves - 1, 0, -1):
        one, other = winner[2 * k], winner[2 * k + 1]
        winner[k] = one if least[one] <= least[other] else other
    border_to = np.full(n, -1, np.int32)  # of the one that goes on
    for step in range(n - 1):
        a = int(winner[1])
        if not least[a] < np.inf:
            return step
        b = with_whom[a]
        if area[b] > area[a]:
            a, b = b, a
        joined[step, 0], joined[step, 1] = a, b
        costs[step] = min(least[a], least[b])
        end = first[a]
        while end >= 0:
            if length[end >> 1] > 0:
                border_to[sides[end >> 1, 1 - (end & 1)]] = end >> 1
            end = following[end]
        common[step] = length[border_to[b]]
        length[border_to[b]] = 0  # no border any more; lists drop it when they are walked
        area[a] += area[b]
        color[a] += color[b]
        histogram[a] += histogram[b]
        end = first[b]
        while end >= 0:
            e, then = end >> 1, following[end]
            if length[e] > 0:
                t = sides[e, 1 - (end & 1)]
                known = border_to[t]
                if known >= 0:
                    length[known] += length[e]
                    for c in range(strength.shape[1]):
                        strength[known, c] += strength[e, c]
                    length[e] = 0
                else:
                    sides[e, end & 1] = a
                    following[end], first[a] = first[a], end
            end = then
        first[b] = -1
        least[b] = np.inf
        replay(winner, least, b)
        least[a], with_whom[a] = np.inf, -1
        end, before = first[a], -1
        while end >= 0:
            e, then = end >> 1, following[end]
            t = sides[e, 1 - (end & 1)]
            border_to[t] = -1
            if length[e] == 0:
                if before < 0:
                    first[a] = then
                else:
                    following[before] = then
            else:
                before = end
                new = np.float32(
                    cost_of(a, t, e, area, color, histogram, length, strength, weights, total)
                )
                cost[e] = new
                if new < least[a] or (new == least[a] and t < with_whom[a]):
                    least[a], with_whom[a] = new, t
                if with_whom[t] == a or with_whom[t] == b:
                    find_cheapest(t, sides, length, first, following, cost, least, with_whom)
                    replay(winner, least, t)
                elif new < least[t]:
                    least[t], with_whom[t] = new, a
                    replay(winner, least, t)
            end = then
        replay(winner, least, a)
    return n - 1


@kernel
def find_cheapest(
    a: int,
    sides: IntArray,
    length: FloatArray,
    first: IntArray,
    following: IntArray,
    cost: FloatArray,  # (E,)
    least: FloatArray,  # (n or more,) written at ``a``
    with_whom: IntArray,  # (n,) written at ``a``; of equal costs the lower index
) -> None:
    """The cheapest merge of a region; borders that are no more leave its list."""
    least[a], with_whom[a] = np.inf, -1
    end, before = first[a], -1
    while end >= 0:
        e, then = end >> 1, following[end]
        if length[e] == 0:
            if before < 0:
                first[a] = then
            else:
                following[before] = then
        else:
            before = end
            t = sides[e, 1 - (end & 1)]
            if cost[e] < least[a] or (cost[e] == least[a] and t < with_whom[a]):
                least[a], with_whom[a] = cost[e], t
        end = then


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


@kernel
def number(labels: IntArray, names: IntArray, out: IntArray) -> None:
    """Ids (H, W) from 1 in the order of the first pixel of each of ``labels`` (H, W); 0 stays.
    ``names`` (n,) are zeros."""
    height, width = labels.shape
    n = 0
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            if label > 0 and names[label] == 0:
                n += 1
                names[label] = n
            out[y, x] = names[label]
