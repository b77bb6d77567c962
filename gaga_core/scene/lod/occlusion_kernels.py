"""A coarse picture of where the view ends, and which nodes lie behind it."""

import math

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray
from gaga_core.kernels import kernel

_MOST = 1.0  # coverage of a cell by one sample: several have to agree


@kernel
def cover_cells(
    means: FloatArray,  # (K, 3)
    covers: FloatArray,  # (K,) world units squared
    pose: DoubleArray,  # (3, 4) cam_from_world
    lens: DoubleArray,  # fx, fy, cx, cy, of a picture whose pixels are the cells
    near: float,
    bins: float,  # a factor of e of the depth has so many
    grid: FloatArray,  # (H, W, B) in and out: how often each cell is covered, by depth
) -> None:
    """Add what splats cover to the cells that their centres lie in."""
    height, width, n_bins = grid.shape
    for i in range(means.shape[0]):
        x, y, z = means[i, 0], means[i, 1], means[i, 2]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if not depth > near:
            continue
        u = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / depth
        v = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / depth
        column, row = lens[0] * u + lens[2], lens[1] * v + lens[3]
        if not (0.0 <= column < width and 0.0 <= row < height):
            continue
        k = min(int(math.log(depth / near) * bins), n_bins - 1)
        covered = covers[i] * lens[0] * lens[1] / (depth * depth)
        if covered > 0.0:
            grid[int(row), int(column), k] += min(covered, _MOST)


@kernel
def end_depths(
    grid: FloatArray,  # (H, W, B) in: of `cover_cells`; out: summed up along the depths
    near: float,
    bins: float,
    opaque: float,  # coverage behind which nothing is seen
    thin: float,  # share of it that each single cell must have
    depths: FloatArray,  # (H, W) out; inf = open
) -> None:
    """Depth at which each cell is closed: all around it together, and each of these by itself.

    Together they tell it with less noise; one of them that is open may be a gap.
    """
    height, width, n_bins = grid.shape
    for row in range(height):
        for column in range(width):
            for k in range(1, n_bins):
                grid[row, column, k] += grid[row, column, k - 1]
    for row in range(height):
        upper, lower = max(row - 1, 0), min(row + 2, height)
        for column in range(width):
            left, right = max(column - 1, 0), min(column + 2, width)
            n_cells = (lower - upper) * (right - left)
            depths[row, column] = math.inf
            for k in range(n_bins - 1):  # the last one has no end
                if grid[row, column, k] < thin * opaque:
                    continue
                total, least = 0.0, math.inf
                for r in range(upper, lower):
                    for c in range(left, right):
                        total += grid[r, c, k]
                        least = min(least, grid[r, c, k])
                if total >= opaque * n_cells and least >= thin * opaque:
                    depths[row, column] = near * math.exp((k + 1) / bins)
                    break


@kernel
def behind(
    boxes: FloatArray,  # (M, 6) lo, hi
    pose: DoubleArray,  # (3, 4)
    lens: DoubleArray,  # fx, fy, cx, cy of the cells
    near: float,
    depths: FloatArray,  # (H, W)
    hidden: BoolArray,  # (M,) out
) -> None:
    """Whether all of a box that is in the picture lies behind the depths of its cells."""
    height, width = depths.shape
    for i in range(boxes.shape[0]):
        hidden[i] = False
        nearest, left, top, right, bottom = math.inf, math.inf, math.inf, -math.inf, -math.inf
        for corner in range(8):
            x = boxes[i, 0 if corner & 1 == 0 else 3]
            y = boxes[i, 1 if corner & 2 == 0 else 4]
            z = boxes[i, 2 if corner & 4 == 0 else 5]
            depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
            nearest = min(nearest, depth)
            if depth > near:
                u = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
                v = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
                u, v = lens[0] * u / depth + lens[2], lens[1] * v / depth + lens[3]
                left, right = min(left, u), max(right, u)
                top, bottom = min(top, v), max(bottom, v)
        if not nearest > near:
            continue
        first, last = int(max(left, 0.0)), int(min(right, width - 1.0))
        upper, lower = int(max(top, 0.0)), int(min(bottom, height - 1.0))
        if right < 0.0 or bottom < 0.0 or first > last or upper > lower:
            continue
        hidden[i] = True
        for row in range(upper, lower + 1):
            for column in range(first, last + 1):
                if not depths[row, column] < nearest:
                    hidden[i] = False
                    break
            if not hidden[i]:
                break
