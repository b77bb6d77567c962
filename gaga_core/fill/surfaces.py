"""The surfaces next to an object, and what the photos saw of them while it stood there."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at, quats_to_matrices
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer


@dataclass(frozen=True)
class FillConfig:
    """Settings to find and fill a hole."""

    lighten: bool = True  # take the object's shadow off the surface that it stood on
    most_views: int = 64  # photos that are looked at, spread over those that show the object
    view_pixels: int = 320  # longer side of a looked-at view
    seen: float = 0.1  # pixels: a splat with less weight in all views together was never seen
    seen_share: float = 0.15  # of its weight without the object: less shimmers through it only
    most_surfaces: int = 4  # that are filled
    most_cells: int = 200  # of a side of a chart
    reach: float = 0.6  # of the object's size: how far around it a surface is looked at
    seed: int = 0  # of the choice of donors
    model: str = ""  # file of an inpainting model that colors the hole; "" = continue its rim
    model_sha256: str = ""  # of that file, hexadecimal; "" = any

    def __post_init__(self) -> None:
        if self.most_views < 1 or self.view_pixels < 16 or self.most_cells < 16:
            raise ValueError("most_views, view_pixels, most_cells: too small")
        if self.model_sha256 and not self.model:
            raise ValueError("model_sha256: there is no model that it could be of")
        if self.reach <= 0 or self.seen < 0 or self.most_surfaces < 1:
            raise ValueError("reach, seen, most_surfaces: too small")


# --- The surfaces next to an object: planes through the splats around it.


_TRIES = 300  # planes that are tried for each surface
_N_SURFACE = 30  # splats: fewer are no surface
_WIDE = 2.5  # reaches: so far around the object a surface that begins next to it is followed
_FLAT = 0.5  # a splat has a normal when it is thinner than this share of its second axis
_ALIGNED = 0.8  # cosine between its normal and the plane's
_SOLID = 0.2  # opacity
_LAYER = 0.7  # spacings: half the height of the layer of splats that make a surface
_NEAR = 6  # neighbours that tell the spacing
_TOLERANCE = 0.02  # of the object's size: how far from a plane a splat is still on it
_LEVEL = 0.99  # cosine between the normals of two planes of which one lies on the other


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane in space with the splats that lie on it."""

    origin: DoubleArray  # (3,) world
    axes: DoubleArray  # (3, 3) columns u, v and the normal, which looks to the object
    splats: LongArray  # (K,) rows of the Gaussians
    spacing: float  # usual distance between neighbours among them
    thickness: float  # heights of the splats scatter by this much
    label: int  # group of the surface
    is_layered: bool = False  # another surface lies on it, as a cloth on a table

    def local(self, points: DoubleArray) -> DoubleArray:
        """Coordinates (N, 3) along u, v and the normal of world points (N, 3)."""
        return (points - self.origin) @ self.axes

    def world(self, points: DoubleArray) -> DoubleArray:
        """World points (N, 3) of coordinates (N, 3)."""
        return points @ self.axes.T + self.origin


def _normals_of(gaussians: Gaussians) -> tuple[DoubleArray, BoolArray]:
    """Shortest axis (N, 3) of each splat, and whether it is a normal: the splat is flat."""
    order = np.argsort(gaussians.log_scales, axis=1, kind="stable")
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
    normals, flat = _normals_of(gaussians.take(candidates))
    solid = gaussians.opacities[candidates] > _SOLID
    rng = np.random.default_rng(config.seed)
    found: list[Plane] = []
    # What most of its surroundings is comes first: only so many planes are looked at.
    near_labels = labels[candidates[distance < config.reach * size]]
    around, n_near = np.unique(near_labels, return_counts=True)
    for label in around[np.argsort(-n_near, kind="stable")]:
        rows = np.flatnonzero(labels[candidates] == label)
        while len(found) < 4 * config.most_surfaces:
            firm = rows[solid[rows]]
            near = distance[firm] < config.reach * size
            if near.sum() < _N_SURFACE:
                break
            cloud = points[candidates[firm]]
            fit, inliers = _ransac(cloud, normals[firm], flat[firm], near, size, rng)
            if fit is None or inliers.sum() < _N_SURFACE:
                break
            plane = _plane(cloud[inliers], fit, own.mean(axis=0), int(label))
            # With it go all splats in its layer: faint and round ones are part of what is seen.
            layer = max(4 * plane.thickness, _LAYER * plane.spacing)
            within = np.abs(plane.local(points[candidates[rows]])[:, 2]) < layer
            found.append(replace(plane, splats=candidates[rows[within]]))
            rows = rows[~within]
    found.sort(key=lambda plane: -len(plane.splats))
    return _laid_on(found, points, own.mean(axis=0), _TOLERANCE * size)


def _laid_on(
    planes: Sequence[Plane], points: DoubleArray, towards: DoubleArray, height: float
) -> list[Plane]:
    """``planes`` (most splats first) where those lying up to ``height`` on another are part of it.

    A cloth and its table are one picture: its edge is continued, not one of them over the other.
    """
    result: list[Plane] = []
    for plane in planes:
        for k, other in enumerate(result):
            level = np.median(other.local(points[plane.splats])[:, 2])
            if abs(level) < height and plane.axes[:, 2] @ other.axes[:, 2] > _LEVEL:
                both = np.union1d(other.splats, plane.splats)
                normal = other.axes[:, 2]
                through = np.median(points[both] @ normal)
                joined = _plane(points[both], np.append(normal, through), towards, other.label)
                # Both levels are the surface: `tolerance_of` is four times this.
                thickness = max(joined.thickness, other.thickness, abs(float(level)) / 2)
                result[k] = replace(joined, splats=both, thickness=thickness, is_layered=True)
                break
        else:
            result.append(plane)
    return result


def _ransac(
    points: DoubleArray,
    normals: DoubleArray,
    flat: BoolArray,
    near: BoolArray,
    size: float,
    rng: np.random.Generator,
) -> tuple[DoubleArray | None, BoolArray]:
    """The plane (n, d) with most splats on it, and which these are."""
    tolerance = _TOLERANCE * size
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


# --- Views of the photos' cameras with the object in place.


AROUND = 32  # cameras where there are no photos
_FROM = 3.0  # radii of the object: how far away they stand
_UP = np.array([0.0, 0.0, 1.0])  # any: only what is in the picture counts
_CLEAR = 0.02  # weight of the object under which a pixel does not show it
_MOST_POINTS = 2000  # of the object, projected to find the views that show it


@dataclass(frozen=True, eq=False)
class SeenView:
    """The surface that a view showed."""

    camera: Camera
    depth: FloatArray  # (H, W) camera depth of the surface; 0 where there is none
    is_object: BoolArray  # (H, W) the surface is the object
    is_clear: BoolArray  # (H, W) nothing of the object shows
    after: FloatArray  # (H, W) depth of the surface that is left without it; 0 where there is none
    after_alpha: FloatArray  # (H, W) of what is left without it


@dataclass(frozen=True, eq=False)
class Seen:
    """All looked-at views, and which splats they determine."""

    views: tuple[SeenView, ...]
    known: BoolArray  # (N,) shown by the photos; what only shimmers through the object is not


def seen_stage(
    gaussians: Gaussians,
    is_object: BoolArray,
    cameras: Sequence[Camera],
    rasterizer: Rasterizer,
    config: FillConfig,
    made: BoolArray | None = None,
) -> Stage[Seen]:
    """Draw the views in which the object (``is_object`` (N,)) is, with it in its place.

    ``made``: (N,) splats that no photo can have shown, and that are there because an edit put
    them there.
    Depths are those at which half of the light is taken (median), so that they lie on a surface.
    """
    chosen = _views_of(gaussians.means[is_object].astype(np.float64), cameras, config)
    n = len(chosen)
    total = np.zeros((len(gaussians), 1), np.float32)
    mark = np.repeat(is_object.astype(np.float32)[:, None], 3, axis=1)
    frames = []
    for i, camera in enumerate(chosen):
        yield Progress("Look behind the object", 2 * i, 4 * n, camera.name)
        frame = rasterizer.render(gaussians, camera, channels=mark)
        shape = (camera.height, camera.width)
        rasterizer.vote(gaussians, camera, np.zeros(shape, np.int32), total)
        frames.append(frame)
    others = np.flatnonzero(~is_object)
    bare, alone = gaussians.take(others), np.zeros((len(others), 1), np.float32)
    for i, camera in enumerate(chosen):
        yield Progress("Look behind the object", 2 * n + i, 4 * n, camera.name)
        rasterizer.vote(bare, camera, np.zeros((camera.height, camera.width), np.int32), alone)
    known = total[:, 0] > config.seen
    known[others] &= total[others, 0] > config.seen_share * alone[:, 0]
    if made is not None:
        known |= made
    rest = gaussians.take(~is_object & known)
    views = []
    for i, (camera, frame) in enumerate(zip(chosen, frames, strict=True)):
        yield Progress("Look behind the object", 3 * n + i, 4 * n, camera.name)
        after = rasterizer.render(rest, camera)
        share = frame.image[:, :, 0]
        shown = camera, frame.median_depth, share > 0.5, share < _CLEAR
        views.append(SeenView(*shown, after.median_depth, after.alpha))
    return Seen(tuple(views), known)


def _views_of(
    points: DoubleArray, cameras: Sequence[Camera], config: FillConfig
) -> tuple[Camera, ...]:
    """Views that show some of ``points`` (K, 3), world, at the size at which they are drawn.

    Without any (a file of splats alone): cameras on a sphere around the points.
    """
    sample = points[:: max(1, len(points) // _MOST_POINTS)]
    found = []
    for camera in cameras:
        pixels, depth = camera.project(sample)
        inside = (depth > 0) & (pixels >= 0).all(axis=1)
        inside &= (pixels < [camera.width, camera.height]).all(axis=1)
        if inside.any():
            found.append(camera)
    if not found:
        return _around(sample, config)
    if len(found) > config.most_views:
        places = np.linspace(0, len(found) - 1, config.most_views).round().astype(int)
        found = [found[i] for i in places]
    return tuple(camera.at_most(config.view_pixels) for camera in found)


def _around(points: DoubleArray, config: FillConfig) -> tuple[Camera, ...]:
    """Cameras evenly on a sphere around ``points``, which look at their middle."""
    middle = np.median(points, axis=0)
    radius = max(float(np.percentile(np.linalg.norm(points - middle, axis=1), 95)), 1e-6)
    side = config.view_pixels
    K = np.array([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1.0]])
    k = np.arange(AROUND) + 0.5  # Fibonacci sphere
    height, turn = 1 - 2 * k / AROUND, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - height**2)
    towards = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    return tuple(
        Camera(K, look_at(middle + _FROM * radius * d, middle, _UP), side, side) for d in towards
    )
