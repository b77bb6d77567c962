"""The surfaces next to an object: planes through the splats around it."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.scene.fill.config import FillConfig

_TRIES = 300  # planes that are tried for each surface
_LEAST = 30  # splats of a surface
_WIDE = 2.5  # reaches: so far around the object a surface that begins next to it is followed
_FLAT = 0.5  # a splat has a normal when it is thinner than this share of its second axis
_ALIGNED = 0.8  # cosine between its normal and the plane's
_SOLID = 0.2  # opacity
_LAYER = 0.7  # spacings: half the height of the layer of splats that make a surface
_NEAR = 6  # neighbours that tell the spacing


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane in space with the splats that lie on it."""

    origin: DoubleArray  # (3,) world
    axes: DoubleArray  # (3, 3) columns u, v and the normal, which looks to the object
    splats: LongArray  # (K,) rows of the Gaussians
    spacing: float  # usual distance between neighbours among them
    thickness: float  # heights of the splats scatter by this much
    label: int  # group of the surface

    def local(self, points: DoubleArray) -> DoubleArray:
        """Coordinates (N, 3) along u, v and the normal of world points (N, 3)."""
        result: DoubleArray = (points - self.origin) @ self.axes
        return result

    def world(self, points: DoubleArray) -> DoubleArray:
        """World points (N, 3) of coordinates (N, 3)."""
        result: DoubleArray = points @ self.axes.T + self.origin
        return result


def normals_of(gaussians: Gaussians) -> tuple[DoubleArray, BoolArray]:
    """Shortest axis (N, 3) of each splat, and whether it is a normal: the splat is flat."""
    order = np.argsort(gaussians.log_scales, axis=1)
    turns = quats_to_matrices(gaussians.quats)
    normals = np.take_along_axis(turns, order[:, None, :1], axis=2)[:, :, 0]
    sorted_scales = np.take_along_axis(gaussians.log_scales, order, axis=1)
    flat: BoolArray = sorted_scales[:, 0] - sorted_scales[:, 1] < np.log(_FLAT)
    return normals, flat


def surfaces_around(
    gaussians: Gaussians,
    labels: IntArray,
    is_object: BoolArray,
    is_known: BoolArray,
    config: FillConfig,
) -> list[Plane]:
    """Planes near the object, of known splats of one group each, those with most splats first.

    ``labels``, ``is_object``, ``is_known``: (N,). RANSAC (Fischler & Bolles 1981) over positions
    and normals.
    """
    points = gaussians.means.astype(np.float64)
    own = points[is_object]
    size = float(np.linalg.norm(np.percentile(own, 98, 0) - np.percentile(own, 2, 0)))
    tree = cKDTree(own[:: max(1, len(own) // 4000)])
    candidates = np.flatnonzero(~is_object & is_known)
    reach = _WIDE * config.reach * size
    lo, hi = own.min(0) - reach, own.max(0) + reach
    candidates = candidates[((points[candidates] > lo) & (points[candidates] < hi)).all(axis=1)]
    distance = np.asarray(tree.query(points[candidates])[0])
    candidates, distance = candidates[distance < reach], distance[distance < reach]
    normals, flat = normals_of(gaussians.take(candidates))
    solid = gaussians.opacities[candidates] > _SOLID
    rng = np.random.default_rng(config.seed)
    found: list[Plane] = []
    for label in np.unique(labels[candidates]):
        rows = np.flatnonzero(labels[candidates] == label)
        while len(found) < 4 * config.most_surfaces:
            firm = rows[solid[rows]]
            near = distance[firm] < config.reach * size
            if near.sum() < _LEAST:
                break
            cloud = points[candidates[firm]]
            fit, inliers = _ransac(cloud, normals[firm], flat[firm], near, size, rng)
            if fit is None or inliers.sum() < _LEAST:
                break
            plane = _plane(cloud[inliers], fit, own.mean(axis=0), int(label))
            # With it go all splats in its layer: faint and round ones are part of what is seen.
            layer = max(4 * plane.thickness, _LAYER * plane.spacing)
            within = np.abs(plane.local(points[candidates[rows]])[:, 2]) < layer
            found.append(replace(plane, splats=candidates[rows[within]]))
            rows = rows[~within]
    found.sort(key=lambda plane: -len(plane.splats))
    return found


def _ransac(
    points: DoubleArray,
    normals: DoubleArray,
    flat: BoolArray,
    near: BoolArray,
    size: float,
    rng: np.random.Generator,
) -> tuple[DoubleArray | None, BoolArray]:
    """The plane (n, d) with most splats on it, and which these are."""
    tolerance = 0.02 * size
    best, most = None, np.zeros(len(points), np.bool_)
    for k in range(_TRIES):
        if k % 2 and (flat & near).any():
            at = rng.choice(np.flatnonzero(flat & near))
            normal, through = normals[at], points[at]
        else:
            a, b, c = points[rng.choice(np.flatnonzero(near), 3, replace=False)]
            normal, through = np.cross(b - a, c - a), a
        length = np.linalg.norm(normal)
        if length < 1e-12:
            continue
        normal = normal / length
        inliers = np.abs((points - through) @ normal) < tolerance
        inliers &= ~flat | (np.abs(normals @ normal) > _ALIGNED)
        if (inliers & near).sum() > (most & near).sum():
            best, most = np.append(normal, through @ normal), inliers
    if best is None:
        return None, most
    for _ in range(2):  # least squares on the inliers
        middle = np.median(points[most], axis=0)
        _, _, vt = np.linalg.svd(points[most] - middle, full_matrices=False)
        normal = vt[2]
        heights = (points - middle) @ normal
        inliers = np.abs(heights - np.median(heights[most])) < tolerance
        inliers &= ~flat | (np.abs(normals @ normal) > _ALIGNED)
        if inliers.sum() < 3:
            break
        most = inliers
        best = np.append(normal, normal @ middle)
    return best, most


def _plane(points: DoubleArray, plane: DoubleArray, towards: DoubleArray, label: int) -> Plane:
    normal = plane[:3]
    middle = np.median(points, axis=0)
    if (towards - middle) @ normal < 0:
        normal = -normal
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    axes = np.stack([u, np.cross(normal, u), normal], axis=1)
    origin = towards - ((towards - middle) @ normal) * normal
    heights = (points - origin) @ normal
    near = np.asarray(cKDTree(points).query(points, k=_NEAR + 1)[0])[:, _NEAR]
    # So many of them lie on a disc of area pi r^2.
    spacing = float(np.median(near)) * np.sqrt(np.pi / _NEAR)
    thickness = float(1.4826 * np.median(np.abs(heights - np.median(heights))))
    return Plane(origin, axes, np.zeros(0, np.int64), spacing, thickness, label)
