"""Beyond the paper: what the shape of the surface says of two clusters of points.

Where few views see two clusters at once, the views alone do not show whether they are parts of one
object. Parts of one object touch along a long border, and the surface is smooth or convex there;
two objects that touch mostly meet in a crease (local convexity: Stein et al., CVPR 2014). This is a
prior only: views that see both outvote it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.grouping.robust.surface_points import DepthMaps, LoadMasks, full_size
from gaga_core.progress import Progress, Stage

_NEIGHBOURS = 16
_RADIUS = 4  # pixels on each side of a point whose depths make its plane
_DEEP = 0.03  # share of its depth by which pixels of that plane may differ from the point
_LEAST = 12  # pixels of a plane
_BORDER = 3.0  # neighbours per point of the smaller cluster at which the border says nothing
_TOUCH = 0.25  # with fewer neighbours per point clusters do not touch
APART = 0.34  # prior of clusters that do not touch
_BIAS, _OF_BORDER, _OF_SHAPE = -0.3, 0.5, 1.0  # log odds; of log border and of convexity


@dataclass(frozen=True, eq=False)
class Contacts:
    """Pairs of neighbouring points: each with its 16 nearest."""

    first: LongArray  # (P,)
    second: LongArray  # (P,)
    convexity: DoubleArray  # (P,) > 0 the surface bulges between them, < 0 it has a crease

    def priors(self, cluster: IntArray) -> "Priors":
        """Chance that two clusters are parts of one object, before the views vote.

        ``cluster`` (S,) has ids 1..C, or 0 = none.
        """
        width = int(cluster.max(initial=0)) + 1
        a, b = cluster[self.first].astype(np.int64), cluster[self.second].astype(np.int64)
        between = (a != b) & (a > 0) & (b > 0)
        a, b, convexity = a[between], b[between], self.convexity[between]
        key, pair = np.unique(np.minimum(a, b) * width + np.maximum(a, b), return_inverse=True)
        count, bulge = np.zeros(len(key)), np.zeros(len(key))
        for way in (a < b, a > b):
            count += np.bincount(pair[way], minlength=len(key))
            bulge += np.bincount(pair[way], convexity[way], minlength=len(key))
        n_points = np.bincount(cluster, minlength=width)
        first, second = np.divmod(key, width)
        border = count / np.maximum(np.minimum(n_points[first], n_points[second]), 1)
        odds = _OF_BORDER * np.log((border + 0.01) / _BORDER)
        odds += _BIAS + _OF_SHAPE * bulge / np.maximum(count, 1)
        return Priors(width, key, np.where(border < _TOUCH, APART, 1 / (1 + np.exp(-odds))))


@dataclass(frozen=True, eq=False)
class Priors:
    """Chances of pairs of clusters; `APART` of all that are not listed."""

    width: int  # C + 1
    key: LongArray  # (P,) first * width + second, first < second, ascending
    value: DoubleArray  # (P,) 0..1

    def of(self, key: LongArray) -> DoubleArray:
        """Chances (Q,) of pairs by their keys."""
        result = np.full(len(key), APART)
        if len(self.key) > 0:
            at = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
            listed = self.key[at] == key
            result[listed] = self.value[at[listed]]
        return result


def contacts_of(points: DoubleArray, normals: DoubleArray) -> Contacts:
    """Neighbours among points (S, 3) with unit normals (S, 3); a normal of 0 is unknown."""
    k = min(_NEIGHBOURS, len(points) - 1)
    if k < 1:
        return Contacts(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    found = cKDTree(points).query(points, k=k + 1)
    distance = np.asarray(found[0])[:, 1:].ravel()
    second = np.asarray(found[1], np.int64)[:, 1:].ravel()
    first = np.repeat(np.arange(len(points)), k)
    way = (points[second] - points[first]) / np.maximum(distance, 1e-12)[:, None]
    convexity = ((normals[second] - normals[first]) * way).sum(axis=1)
    known = np.abs(normals).sum(axis=1) > 0
    return Contacts(first, second, np.where(known[first] & known[second], convexity, 0))


def surface_normals(
    points: DoubleArray,  # (S, 3) world
    mask_of: IntArray,  # (S, V) mask that each point shows in each view, 0 = unknown
    views: Sequence[Camera],
    load_masks: LoadMasks,
    depths: DepthMaps,
) -> Stage[DoubleArray]:
    """Unit normals (S, 3), towards the camera, from the depths of the first view that sees a point
    in a mask; 0 where there are too few."""
    normals = np.zeros((len(points), 3))
    first = np.where((mask_of > 0).any(axis=1), (mask_of > 0).argmax(axis=1), -1)
    for i, camera in enumerate(views):
        yield Progress("Find contacts", i, len(views), camera.name)
        rows = np.flatnonzero(first == i)
        if len(rows) > 0:
            labels = load_masks(camera).labels
            found = _normals(camera, labels, depths, points[rows], mask_of[rows, i])
            normals[rows] = found @ camera.world_from_cam[:3, :3].T
    return normals


def _normals(
    camera: Camera, labels: IntArray, depths: DepthMaps, points: DoubleArray, mask: IntArray
) -> DoubleArray:
    """Normals (P, 3) in the camera's frame of points that show ``mask`` (P,)."""
    pixels, z = camera.project(points)
    columns, rows = pixels.astype(np.int64).T
    dy, dx = np.mgrid[-_RADIUS : _RADIUS + 1, -_RADIUS : _RADIUS + 1]
    rows = np.clip(rows[:, None] + dy.ravel(), 0, camera.height - 1)
    columns = np.clip(columns[:, None] + dx.ravel(), 0, camera.width - 1)
    depth = full_size(camera, depths)[rows, columns].astype(np.float64)
    near = np.abs(depth - z[:, None]) < _DEEP * z[:, None]
    usable = near & (labels[rows, columns] == mask[:, None])
    x = (columns + 0.5 - camera.K[0, 2]) / camera.K[0, 0] * depth
    y = (rows + 0.5 - camera.K[1, 2]) / camera.K[1, 1] * depth
    cloud = np.stack([x, y, depth], axis=2)
    weight = usable[:, :, None]
    middle = (cloud * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1)
    offsets = (cloud - middle[:, None]) * weight
    normal = np.linalg.eigh(np.einsum("pki,pkj->pij", offsets, offsets))[1][:, :, 0]
    away = (normal * middle).sum(axis=1) > 0
    result: DoubleArray = np.where(away[:, None], -normal, normal)
    result[usable.sum(axis=1) < _LEAST] = 0
    return result
