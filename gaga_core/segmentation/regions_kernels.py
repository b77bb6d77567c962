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
