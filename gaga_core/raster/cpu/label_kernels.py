"""Kernels for labels: the map of labels that a view shows, and votes of labeled pixels.

Tiles are walked as in `blend_kernels`, whose image model they share.
"""

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray
from gaga_core.kernels import kernel
from gaga_core.raster.cpu.blend_kernels import (
    _ALPHA_MAX,
    _ALPHA_MIN,
    _CHECK,
    _LOWEST,
    _T_MIN,
    _exp,
    _is_done,
    _open_tile,
)
from gaga_core.raster.cpu.project_kernels import OPACITY, TILE, Y0, Y1, H, R, S, U, V
from gaga_core.raster.vote_slots_kernels import add_to_slot

_F = np.float32
_ZERO, _HALF = _F(0), _F(0.5)


@kernel
def label_tiles(
    splats: FloatArray,
    splat_labels: IntArray,  # (n,) 0 <= label < n_labels
    offsets: LongArray,
    ids: IntArray,
    n_labels: int,
    labels: IntArray,  # (H, W)
    confidence: FloatArray,
    start: int,
    stop: int,
) -> None:
    """At each pixel the label of greatest summed weight, the smaller one when two are equal.

    A tile keeps one plane of sums per label that occurs in it, so the cost does not depend on the
    number of labels of the scene.
    """
    height, width = labels.shape
    n_tiles_x = (width + TILE - 1) // TILE
    T = np.empty((TILE, TILE), np.float32)
    plane_of = np.full(n_labels, -1, np.int32)
    label_of = np.empty(16, np.int32)
    planes = np.empty((16, TILE, TILE), np.float32)
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        _open_tile(T, n_rows, n_columns)
        n_planes = 0
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            plane = plane_of[splat_labels[k]]
            if plane < 0:
                if n_planes == len(label_of):
                    label_of = np.concatenate((label_of, np.empty_like(label_of)))
                    planes = np.concatenate((planes, np.empty_like(planes)))
                plane = n_planes
                plane_of[splat_labels[k]] = plane
                label_of[plane] = splat_labels[k]
                planes[plane] = _ZERO
                n_planes += 1
            total = planes[plane]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            for y in range(max(0, int(splats[k, Y0]) - top), min(TILE, int(splats[k, Y1]) - top)):
                dy = _F(y) - v
                shift = -s * (u + r * dy)
                rest = -h * dy * dy
                for x in range(TILE):
                    e = s * _F(x) + shift
                    a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, rest - e * e)))
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = T[y, x]
                    after = before - before * a
                    goes_on = after >= _T_MIN
                    total[y, x] += a * before if goes_on else _ZERO
                    T[y, x] = after if goes_on else -abs(before)
            if (j & _CHECK) == _CHECK and _is_done(T):
                break
        for y in range(n_rows):
            for x in range(n_columns):
                best, most = 0, _ZERO
                for p in range(n_planes):
                    w = planes[p, y, x]
                    if w > most or (w == most and w > _ZERO and label_of[p] < best):
                        best, most = label_of[p], w
                labels[top + y, left + x] = best
                confidence[top + y, left + x] = most
        for p in range(n_planes):
            plane_of[label_of[p]] = -1


@kernel
def tile_labels(
    labels: IntArray,  # (H, W)
    local: IntArray,  # (n_tiles, TILE, TILE) position in `found`; -1 = ignore
    found: IntArray,  # (n_tiles, TILE * TILE) the labels of each tile
    n_found: LongArray,
    start: int,
    stop: int,
) -> None:
    """Number the labels that occur in each tile, in the order met."""
    height, width = labels.shape
    n_tiles_x = (width + TILE - 1) // TILE
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        local[tile] = -1
        n = 0
        last = 0
        for y in range(min(TILE, height - top)):
            for x in range(min(TILE, width - left)):
                label = labels[top + y, left + x]
                if label < 0:
                    continue
                if not (n > 0 and found[tile, last] == label):
                    last = 0
                    while last < n and found[tile, last] != label:
                        last += 1
                    if last == n:
                        found[tile, n] = label
                        n += 1
                local[tile, y, x] = last
        n_found[tile] = n


@kernel
def vote_tiles(
    splats: FloatArray,
    offsets: LongArray,
    ids: IntArray,
    local: IntArray,
    n_found: LongArray,
    sum_offsets: LongArray,  # (stop of batch - first + 1,) where a tile's sums begin
    first: int,
    size: LongArray,  # (2,) width, height
    sums: FloatArray,
    start: int,
    stop: int,
) -> None:
    """Sums of weights of each (splat, label) of tiles first + start .. first + stop.

    ``sums`` of a tile is (splats of the tile, labels of the tile), row-major; it comes zeroed.
    """
    width, height = size[0], size[1]
    n_tiles_x = (width + TILE - 1) // TILE
    T = np.empty((TILE, TILE), np.float32)
    weights = np.empty(TILE, np.float32)
    row_label = np.empty(TILE, np.int32)
    for tile in range(first + start, first + stop):
        n_labels = n_found[tile]
        if n_labels == 0:
            continue
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        _open_tile(T, n_rows, n_columns)
        # A row of one label is summed at once; -2 = mixed. Pixels beyond the picture have w = 0.
        for y in range(TILE):
            row_label[y] = local[tile, y, 0]
            for x in range(1, n_columns):
                if local[tile, y, x] != row_label[y]:
                    row_label[y] = -2
        at = sum_offsets[tile - first]
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            for y in range(max(0, int(splats[k, Y0]) - top), min(TILE, int(splats[k, Y1]) - top)):
                dy = _F(y) - v
                shift = -s * (u + r * dy)
                rest = -h * dy * dy
                for x in range(TILE):
                    e = s * _F(x) + shift
                    a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, rest - e * e)))
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = T[y, x]
                    after = before - before * a
                    goes_on = after >= _T_MIN
                    weights[x] = a * before if goes_on else _ZERO
                    T[y, x] = after if goes_on else -abs(before)
                if row_label[y] >= 0:
                    total = _ZERO
                    for x in range(TILE):
                        total += weights[x]
                    sums[at + row_label[y]] += total
                elif row_label[y] == -2:
                    for x in range(n_columns):
                        if local[tile, y, x] >= 0:
                            sums[at + local[tile, y, x]] += weights[x]
            at += n_labels
            if (j & _CHECK) == _CHECK and _is_done(T):
                break


@kernel
def add_sums(
    order: IntArray,
    offsets: LongArray,
    ids: IntArray,
    found: IntArray,
    n_found: LongArray,
    sum_offsets: LongArray,
    first: int,
    sums: FloatArray,
    histogram: FloatArray,  # (N, K)
    start: int,
    stop: int,
) -> None:
    """Add a batch's sums to the rows of splats ``start`` to ``stop`` (depth order), tile by tile.

    A row has one writer and a fixed order, so the result does not depend on threads.
    """
    for b in range(len(sum_offsets) - 1):
        tile = first + b
        n_labels = n_found[tile]
        at = sum_offsets[b]
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            if k >= start and k < stop:
                for m in range(n_labels):
                    w = sums[at + m]
                    if w > _ZERO:
                        histogram[order[k], found[tile, m]] += w
            at += n_labels


@kernel
def add_sums_to_slots(
    order: IntArray,
    offsets: LongArray,
    ids: IntArray,
    found: IntArray,
    n_found: LongArray,
    sum_offsets: LongArray,
    first: int,
    sums: FloatArray,
    slot_labels: IntArray,  # (N, K), like the next two changed in place
    slot_weights: FloatArray,  # (N, K)
    lost: FloatArray,  # (N,)
    start: int,
    stop: int,
) -> None:
    """`add_sums` where each Gaussian keeps a few labels (`VoteSlots`)."""
    for b in range(len(sum_offsets) - 1):
        tile = first + b
        n_labels = n_found[tile]
        at = sum_offsets[b]
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            if k >= start and k < stop:
                for m in range(n_labels):
                    w = sums[at + m]
                    if w > _ZERO:
                        add_to_slot(slot_labels, slot_weights, lost, order[k], found[tile, m], w)
            at += n_labels
