"""Choosing a cut: which nodes are divided, so that no more splats than a budget are drawn."""

import math

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.kernels import kernel


@kernel
def node_errors(
    boxes: FloatArray,  # (M, 6) lo, hi, world
    details: FloatArray,  # (M,) scene units
    pose: DoubleArray,  # (3, 4) cam_from_world
    lens: DoubleArray,  # fx, fy, cx, cy, width, height, near, margin in pixels
    outside: float,  # factor of the error of nodes that are not in the picture
    errors: FloatArray,  # (M,) out, pixels
    seen: BoolArray,  # (M,) out
) -> None:
    """Size in pixels of what each node cannot show, and whether it can be in the picture.

    The nearest point of a node's box says how large it is drawn; it is out of the picture when all
    eight corners lie beyond one of its sides.
    """
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    width, height, near, margin = lens[4], lens[5], lens[6], lens[7]
    focal = max(fx, fy)
    eye = np.empty(3)
    for a in range(3):
        eye[a] = -(pose[0, a] * pose[0, 3] + pose[1, a] * pose[1, 3] + pose[2, a] * pose[2, 3])
    for i in range(boxes.shape[0]):
        square = 0.0
        for a in range(3):
            d = max(boxes[i, a] - eye[a], eye[a] - boxes[i, 3 + a], 0.0)
            square += d * d
        behind = left = right = above = below = 0
        for corner in range(8):
            x = boxes[i, 0 if corner & 1 == 0 else 3]
            y = boxes[i, 1 if corner & 2 == 0 else 4]
            z = boxes[i, 2 if corner & 4 == 0 else 5]
            tx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
            ty = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
            tz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
            behind += tz < near
            # Planes through the eye: also right for corners behind it.
            left += fx * tx + (cx + margin) * tz < 0
            right += fx * tx + (cx - width - margin) * tz > 0
            above += fy * ty + (cy + margin) * tz < 0
            below += fy * ty + (cy - height - margin) * tz > 0
        seen[i] = behind < 8 and left < 8 and right < 8 and above < 8 and below < 8
        error = focal * details[i] / max(math.sqrt(square), near)
        errors[i] = error if seen[i] else outside * error


@kernel
def divide(
    errors: FloatArray,  # (M,)
    seen: BoolArray,  # (M,)
    counts: IntArray,  # (M,) splats of each node
    levels: IntArray,  # (L + 1,) first node of each level, and of all
    fan: int,
    least: float,  # nodes with a greater error are divided
    divided: BoolArray,  # (M,) out
) -> tuple[int, int]:
    """Divide from the top down; splats of the cut that are seen, and all of the cut."""
    n_levels = levels.shape[0] - 1
    divided[:] = False
    n_seen = n_all = 0
    for level in range(n_levels - 1, -1, -1):
        for i in range(levels[level], levels[level + 1]):
            if level < n_levels - 1:
                parent = levels[level + 1] + (i - levels[level]) // fan
                if not divided[parent]:
                    continue
            if level > 0 and errors[i] > least:
                divided[i] = True
            else:
                n_all += counts[i]
                if seen[i]:
                    n_seen += counts[i]
    return n_seen, n_all


# --- A coarse picture of where the view ends, and which nodes lie behind it.


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


# --- What has been done to the splats of each node of level 0.


@kernel
def leaf_facts(
    order: IntArray,  # (N,) rows
    state: UInt8Array,
    placement: IntArray,
    bits: int,  # of a state byte that count
    unseen: int,  # those of them that hide a splat
    node: int,  # splats of a node
    mixed: BoolArray,  # (K,) out: splats differ in state or placement
    torn: BoolArray,  # (K,) out: some are hidden and some not, or they were placed differently
    states: UInt8Array,  # (K,) out: bits of the first splat
    found: IntArray,  # (K, C) out: different placements
    n_found: IntArray,  # (K,) out; C + 1 = more than C
    start: int,
    stop: int,
) -> None:
    """Facts of the nodes start..stop."""
    n, most = order.shape[0], found.shape[1]
    for k in range(start, stop):
        first = order[k * node]
        mixed[k] = torn[k] = False
        states[k] = state[first] & bits
        found[k, 0] = placement[first]
        n_found[k] = 1
        last = placement[first]
        for j in range(k * node, min((k + 1) * node, n)):
            row = order[j]
            if state[row] & bits != states[k]:
                mixed[k] = True
                torn[k] |= (state[row] ^ states[k]) & unseen != 0
            p = placement[row]
            if p == last:
                continue
            last = p
            mixed[k] = torn[k] = True
            is_known = False
            for c in range(min(n_found[k], most)):
                is_known |= found[k, c] == p
            if not is_known:
                if n_found[k] < most:
                    found[k, n_found[k]] = p
                n_found[k] = min(n_found[k] + 1, most + 1)
