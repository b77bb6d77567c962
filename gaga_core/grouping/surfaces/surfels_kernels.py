"""Kernels of surface samples: normals from depth maps, thinning, seeds."""

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.kernels import exact_kernel, kernel

# Of features that one tree judges in a run: 1.5 times as fast as row by row on 8,000 rows and 400
# trees, since a tree stays in the cache.
_ROWS = 1024


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
    points: DoubleArray,  # (S, 3)
    order: LongArray,  # (S,) of the points by their reach, ascending
    reach: DoubleArray,  # (S,) > 0
    level: IntArray,  # (S,) from 0: grids of cells of the side ``side[level]``, not under the reach
    side: DoubleArray,  # (L,) ascending
    head: LongArray,  # (2^k,) -1; scratch: first entry of each slot of the table of cells
    following: LongArray,  # (S * L,) scratch: next entry of a slot
    kept: BoolArray,  # (S,) written
) -> None:
    """Keep points that have no kept one within their reach, those of the least reach first.

    A kept point is entered in the grid of its level and of all above; a point asks the 27 cells
    around it in the grid of its own level. An entry is the point times L, plus the level.
    """
    n_levels, mask = len(side), len(head) - 1
    for i in order:
        kept[i] = True
        size = side[level[i]]
        x, y = int(np.floor(points[i, 0] / size)), int(np.floor(points[i, 1] / size))
        z = int(np.floor(points[i, 2] / size))
        for n in range(27):
            slot = slot_of(x + n // 9 - 1, y + n // 3 % 3 - 1, z + n % 3 - 1, level[i]) & mask
            entry = head[slot]
            while entry >= 0:
                j = entry // n_levels
                if entry % n_levels == level[i]:
                    a, b = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
                    c = points[j, 2] - points[i, 2]
                    if a * a + b * b + c * c < reach[i] * reach[i]:
                        kept[i] = False
                        break
                entry = following[entry]
            if not kept[i]:
                break
        if not kept[i]:
            continue
        for above in range(level[i], n_levels):
            size = side[above]
            x, y = int(np.floor(points[i, 0] / size)), int(np.floor(points[i, 1] / size))
            z = int(np.floor(points[i, 2] / size))
            slot = slot_of(x, y, z, above) & mask
            entry = i * n_levels + above
            following[entry], head[slot] = head[slot], entry


@kernel
def slot_of(x: int, y: int, z: int, level: int) -> int:
    """Hash of a cell (Teschner 2003)."""
    return (x * 73856093) ^ (y * 19349663) ^ (z * 83492791) ^ (level * 2654435761)


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
    """The sum of what each tree says of each row; a tree is read once for `_ROWS` of them."""
    out[:] = 0.0
    for start in range(0, len(features), _ROWS):
        for root in roots:
            for r in range(start, min(start + _ROWS, len(features))):
                node = root
                while right[node] > 0:
                    is_next = features[r, feature[node]] <= threshold[node]
                    node = node + 1 if is_next else right[node]
                out[r] += value[node]


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
def add_agreement(
    start: IntArray,  # (n + 1,) of the rows of a sparse table
    column: IntArray,  # region of a map, ascending in each row
    value: DoubleArray,  # samples that show in it
    map_of: IntArray,  # of each region, ascending
    level_of: IntArray,  # of each map, -1 = every level
    one: LongArray,  # (B,) rows
    other: LongArray,  # (B,)
    half_voice: float,  # samples with which a map has half a voice
    same: DoubleArray,  # (B, L) added to: chance that a sample of each shows in one region
    voice: DoubleArray,  # (B, L) added to: voice of the maps that show both
) -> None:
    """What each map says about pairs of rows, summed over maps."""
    for k in range(len(one)):
        i, j, i_end, j_end = start[one[k]], start[other[k]], start[one[k] + 1], start[other[k] + 1]
        while i < i_end and j < j_end:
            at, then = map_of[column[i]], map_of[column[j]]
            if at < then:
                i += 1
                continue
            if then < at:
                j += 1
                continue
            a, b, common = 0.0, 0.0, 0.0
            while (i < i_end and map_of[column[i]] == at) or (
                j < j_end and map_of[column[j]] == at
            ):
                has_one = i < i_end and map_of[column[i]] == at
                has_other = j < j_end and map_of[column[j]] == at
                if has_one and has_other and column[i] == column[j]:
                    common += value[i] * value[j]
                    a, b, i, j = a + value[i], b + value[j], i + 1, j + 1
                elif has_one and (not has_other or column[i] < column[j]):
                    a, i = a + value[i], i + 1
                else:
                    b, j = b + value[j], j + 1
            said = (a / (a + half_voice)) * (b / (b + half_voice))
            chance = common / (a * b)
            for level in range(same.shape[1]):
                if level_of[at] < 0 or level_of[at] == level:
                    same[k, level] += said * chance
                    voice[k, level] += said


@kernel
def add_parted(
    regions: IntArray,  # (S, M) 0 = none
    first: LongArray,  # (E,)
    second: LongArray,  # (E,)
    parted: LongArray,  # (E,) added to: maps that show both ends in two regions
    both: LongArray,  # (E,) added to: maps that show both
) -> None:
    """Count the maps that part the ends of edges."""
    for e in range(len(first)):
        one, other = regions[first[e]], regions[second[e]]
        n_both, n_parted = 0, 0
        for m in range(len(one)):
            shown = (one[m] > 0) & (other[m] > 0)
            n_both += shown
            n_parted += shown & (one[m] != other[m])
        both[e] += n_both
        parted[e] += n_parted
