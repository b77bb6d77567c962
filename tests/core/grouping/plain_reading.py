"""Section 3.2 of the paper, and what its released code does instead, in plain numpy.

Masks one by one, groups as arrays of Gaussians, nothing shared with `gaga_core.grouping`: only
depth maps and blending weights are the rasterizer's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Rasterizer

_THRESHOLD = 0.1


@dataclass
class Reading:
    """The memory bank after some views."""

    owner: IntArray  # (N,) group that a Gaussian joined first, 0 = none
    groups: dict[int, LongArray] = field(default_factory=dict)  # Gaussians of each, by id
    of_mask: dict[tuple[str, int], int] = field(default_factory=dict)  # 0 = none
    overlap: dict[tuple[str, int], float] = field(default_factory=dict)  # with the best group
    opened: set[tuple[str, int]] = field(default_factory=set)  # masks that opened a group


def read(
    gaussians: Gaussians,
    views: Sequence[Camera],
    maps: Mapping[str, IntArray],
    rasterizer: Rasterizer,
) -> Reading:
    """The bank after all views, in the order given; groups are counted from 1."""
    bank = Reading(np.zeros(len(gaussians), np.int32))
    for camera in views:
        labels = maps[camera.name]
        behind = _inliers(gaussians, camera, labels, rasterizer)
        for mask in sorted(set(labels[labels > 0].tolist())):
            chosen, best = 0, 0.0
            for group, held in sorted(bank.groups.items()):
                n = len(np.intersect1d(behind[mask], held, assume_unique=True))
                if n and n / len(behind[mask]) > best:
                    chosen, best = group, n / len(behind[mask])
            bank.overlap[camera.name, mask] = best
            if len(behind[mask]) == 0:
                bank.of_mask[camera.name, mask] = 0
                continue
            if best < _THRESHOLD:
                chosen = len(bank.groups) + 1
            free = behind[mask][bank.owner[behind[mask]] == 0]
            bank.groups[chosen] = np.union1d(bank.groups.get(chosen, free[:0]), free)
            bank.owner[free] = chosen
            bank.of_mask[camera.name, mask] = chosen
    return bank


def read_released(
    gaussians: Gaussians, views: Sequence[Camera], maps: Mapping[str, IntArray]
) -> Reading:
    """The released code's bank after all views, sorted as strings; groups are counted from 1.

    No depth map; overlap n / (size + n); a mask that joins brings what no group holds, one that
    opens a group brings all of it; a mask without Gaussians opens an empty group.
    """
    bank = Reading(np.zeros(len(gaussians), np.int32))
    for camera in sorted(views, key=lambda view: view.name):
        labels = maps[camera.name]
        behind = _front(gaussians, camera, labels)
        for mask in sorted(set(labels[labels > 0].tolist())):
            chosen, best, key = 0, 0.0, (camera.name, mask)
            for group, held in sorted(bank.groups.items()):
                n = len(np.intersect1d(behind[mask], held, assume_unique=True))
                if n and n / (len(behind[mask]) + n) > best:
                    chosen, best = group, n / (len(behind[mask]) + n)
            bank.overlap[key] = best
            free = behind[mask][bank.owner[behind[mask]] == 0]
            if best >= _THRESHOLD:
                bank.groups[chosen] = np.union1d(bank.groups[chosen], free)
            else:
                chosen = len(bank.groups) + 1
                bank.groups[chosen] = behind[mask]
                bank.opened.add(key)
            bank.owner[free] = chosen
            bank.of_mask[key] = chosen
    return bank


def votes(
    gaussians: Gaussians,
    views: Sequence[Camera],
    maps: Mapping[str, IntArray],
    bank: Reading,
    rasterizer: Rasterizer,
) -> IntArray:
    """The group (N,) to whose pixels a Gaussian gives most weight; unseen, that of the bank."""
    sums = np.zeros((len(gaussians), max(bank.of_mask.values()) + 1))
    for camera in views:
        flat = maps[camera.name].ravel()
        lookup = np.zeros(flat.max() + 1, np.int64)
        for mask in set(flat[flat > 0].tolist()):
            lookup[mask] = bank.of_mask[camera.name, mask]
        pixels = np.flatnonzero(lookup[flat])
        rows = rasterizer.weights(gaussians, camera, pixels, w_min=0.0)
        voter = np.repeat(lookup[flat[pixels]], np.diff(rows.indptr))
        cell = rows.indices * np.int64(sums.shape[1]) + voter
        sums += np.bincount(cell, rows.weights, sums.size).reshape(sums.shape)
    return np.where(sums.any(axis=1), sums.argmax(axis=1), bank.owner).astype(np.int32)


def _inliers(
    gaussians: Gaussians, camera: Camera, labels: IntArray, rasterizer: Rasterizer
) -> dict[int, LongArray]:
    """G(m) of section 3.2: D_min < z < Q3 + IQR over the depths of the mask."""
    frame = rasterizer.render(gaussians, camera)
    column, row, z, inside = _projected(gaussians, camera)
    result = {}
    for mask in set(labels[labels > 0].tolist()):
        depths = frame.expected_depth[(labels == mask) & (frame.alpha >= 0.5)].astype(np.float64)
        rows = np.flatnonzero(inside)
        rows = rows[labels[row[rows], column[rows]] == mask]
        if len(depths) == 0:
            result[mask] = rows[:0]
            continue
        q1, q3 = np.quantile(depths, [0.25, 0.75])
        result[mask] = rows[(z[rows] > depths.min()) & (z[rows] < q3 + (q3 - q1))]
    return result


def _projected(
    gaussians: Gaussians, camera: Camera
) -> tuple[LongArray, LongArray, DoubleArray, BoolArray]:
    """Pixel of each centre (column, row), its depth, and whether it is in the picture."""
    x, y, z = camera.cam_from_world[:3] @ np.c_[gaussians.means, np.ones(len(gaussians))].T
    ahead = z > 0.01
    u, v = (np.full(len(z), -1.0) for _ in range(2))
    u[ahead] = camera.K[0, 0] * x[ahead] / z[ahead] + camera.K[0, 2]
    v[ahead] = camera.K[1, 1] * y[ahead] / z[ahead] + camera.K[1, 2]
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    pixel = [np.where(inside, at, 0).astype(np.int64) for at in (u, v)]
    return pixel[0], pixel[1], z, inside


def _front(gaussians: Gaussians, camera: Camera, labels: IntArray) -> dict[int, LongArray]:
    """The front fifth of the Gaussians of each mask in each of 32 x 32 patches, at least one."""
    column, row, z, inside = _projected(gaussians, camera)
    result = {}
    for mask in set(labels[labels > 0].tolist()):
        kept = [np.zeros(0, np.int64)]
        of_mask = np.flatnonzero(inside & (labels[row, column] == mask))
        patch = row[of_mask] * 32 // camera.height * 32 + column[of_mask] * 32 // camera.width
        for k in range(32 * 32):
            found = of_mask[patch == k]
            nearest = found[np.argsort(z[found])]
            kept.append(nearest[: max(1, int(0.2 * len(found)))])
        result[mask] = np.sort(np.concatenate(kept))
    return result
