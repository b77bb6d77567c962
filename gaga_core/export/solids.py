"""Solids of objects: a convex hull, an oriented box, and the surface as a triangle mesh."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import (
    BoolArray,
    DoubleArray,
    FloatArray,
    LongArray,
    UInt8Array,
    check_shape,
)
from gaga_core.camera import Camera
from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import turned
from gaga_core.io.meshes import TriangleMesh
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Frame, Rasterizer
from gaga_core.scene.orientation import even_directions, views_around
from gaga_core.scene.selection.bounds import OrientedBox, oriented_box, robust_box
from gaga_core.training.stereo import DepthView

# --- Solids that physics engines take in place of an object: a convex hull, and its oriented box.


MOST_TRIANGLES = 255  # that PhysX, and the engines on it, take of a convex hull
# Rows of `OrientedBox.corners`, counter-clockwise seen from outside.
_BOX_FACES = np.array(
    [
        [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5], [0, 1, 5], [0, 5, 4],
        [2, 6, 7], [2, 7, 3], [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6],
    ],
    np.int32,
)  # fmt: skip
_PLANES = 64  # of a hull that is simplified: 4 * 64 - 12 triangles at most


def convex_collider(points: DoubleArray) -> TriangleMesh:
    """A convex solid around points (N, 3), of at most 255 triangles.

    It is their convex hull where that has so few, else the hull of 64 planes around them: the faces
    of the oriented box, and the rest evenly around it. Raises ``GagaError`` when the points
    lie in a plane.
    """
    from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

    check_shape("points", points, ("N", 3))
    finite = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    try:
        hull = ConvexHull(finite)
        corners = finite[hull.vertices]
        if len(hull.simplices) > MOST_TRIANGLES:
            normals = _normals(oriented_box(corners, share=1.0))
            planes = np.column_stack([normals, -(corners @ normals.T).max(axis=0)])
            corners = HalfspaceIntersection(planes, corners.mean(axis=0)).intersections
        return _hull_mesh(corners)
    except (QhullError, ValueError) as error:
        raise GagaError("An object that is flat or of a few points has no convex solid.") from error


def box_mesh(box: OrientedBox) -> TriangleMesh:
    """The oriented box as twelve triangles; sides without a length get one that float32 tells."""
    least = 1e-6 * max(float(box.size.max()), float(np.abs(box.centre).max()), 1e-12)
    corners = OrientedBox(box.centre, box.axes, np.maximum(box.size, least)).corners()
    faces = _BOX_FACES if np.linalg.det(box.axes) > 0 else _BOX_FACES[:, ::-1]
    return TriangleMesh(corners.astype(np.float32), np.ascontiguousarray(faces))


def _normals(box: OrientedBox | None) -> DoubleArray:
    """Unit directions (P, 3) of the planes of a simplified hull."""
    sides = np.zeros((0, 3)) if box is None else np.vstack([box.axes.T, -box.axes.T])
    even = even_directions(_PLANES - len(sides))
    if box is not None:  # even where the box is a cube: long objects are wrapped as tightly
        even = even / np.maximum(box.size, 1e-6 * box.size.max()) @ box.axes.T
        even /= np.linalg.norm(even, axis=1, keepdims=True)
    return np.vstack([sides, even])


def _hull_mesh(corners: DoubleArray) -> TriangleMesh:
    """The convex hull of ``corners`` (N, 3), triangles counter-clockwise seen from outside."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(corners)
    faces = hull.simplices.copy()
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    used, rows = np.unique(faces, return_inverse=True)
    return TriangleMesh(
        np.ascontiguousarray(corners[used], np.float32),
        np.ascontiguousarray(rows.reshape(-1, 3), np.int32),
    )


# --- The surface of an object as a triangle mesh: depth of rendered views, fused (Curless 1996).
# The object alone is drawn from all around. In a grid of voxels, each view says of a voxel how far
# in front of the surface it is, up to a few voxels, or that it sees past the object; the mean of
# that is a signed distance whose zero is the surface. A voxel that no view sees into is inside, so
# the mesh is closed. Views from below only cut at the outline: most objects were never seen from
# there, and through an open bottom one would see their inner side.


STEP = "Mesh the surface"
_RINGS = ((0.0, 12), (30.0, 8), (65.0, 5), (-30.0, 8), (-65.0, 4))  # elevation, views around
_SIDE = 384  # pixels of a view
_FIELD = np.radians(6.0)  # field of view: nearly parallel, or level views would not see a bottom
_ROOM = 1.1  # times the distance at which the object's ball fills a view
_SHARE = 0.995  # of the centres lie in the box that is meshed, along each axis
_BAND = 3.0  # voxels around a depth in which a view measures a distance
_MARGIN = 3  # voxels around the object
_SOLID = 0.5  # alpha from which on a pixel shows the object
_HIDDEN = 0.1  # what a view counts that sees a voxel far behind the surface
_FRONT = 0.5  # percent of the pixels may be nearer than what counts as the front
# Percent of the level views that are behind by less: those on edges, which have few pixels, say
# more. At 20, 50 and 80 volumes of ycb_table are too small by 20, 18 and 16 %.
_FLAT = 80.0
_CRUMB = 0.05  # parts smaller than this share of the largest one are left out
# What photos see through ends this share of the depth, and so many voxels, before a depth that they
# confirm; shafts of a radius of this share of the longest side are errors. Chosen on ycb_table.
_UNSURE, _NEAR_SURFACE, _SHAFT = 0.003, 1.0, 0.04
_SEEN = 2.0  # voxels: a vertex no farther from a view's depth has its color


MOST_OVER = 1.1  # times the triangles that are asked for: near enough
_TRIES = 4  # to get there


@dataclass(frozen=True)
class MeshConfig:
    """Resolution of a mesh."""

    voxels: int = 96  # along the longest side of the object
    triangles: int = 20_000  # about so many at most, by fewer voxels; 0 = no limit

    def __post_init__(self) -> None:
        if not 8 <= self.voxels <= 512:
            raise ValueError(f"voxels: expected 8 to 512, got {self.voxels}")
        if self.triangles < 0:
            raise ValueError(f"triangles: expected 0 or more, got {self.triangles}")


@dataclass(frozen=True, eq=False)
class _Grid:
    origin: DoubleArray  # (3,) centre of the first voxel, world
    voxel: float  # side, scene units
    shape: tuple[int, int, int]

    def slabs(self, camera: Camera) -> Iterator[tuple[slice, DoubleArray]]:
        """The voxels' centres (3, M) in the camera's frame, slab by slab of the first axis, and
        which they are. Each coordinate is a sum of one number for each axis of the grid."""
        turn, shift = camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3, None, None]
        n = self.shape[1] * self.shape[2]
        x, y, z = (
            turn[:, axis, None] * (self.origin[axis] + self.voxel * np.arange(self.shape[axis]))
            for axis in range(3)
        )
        for i in range(self.shape[0]):
            centres = (x[:, i, None] + y)[:, :, None] + z[:, None, :] + shift
            yield slice(i * n, (i + 1) * n), centres.reshape(3, n)


def proxy_mesh_stage(
    gaussians: Gaussians,
    rasterizer: Rasterizer,
    *,
    up: DoubleArray | None = None,  # (3,) unit, world; None: z
    config: MeshConfig | None = None,
    is_soft: bool = False,
    photos: Sequence[DepthView] = (),
) -> Stage[TriangleMesh]:
    """The closed surface of ``gaussians`` (an object alone, world) with a color a vertex.

    ``is_soft``: the outlines of views say how large it is, as depths of trained splats lie deeper
    than the surface: for lengths that are to be true. ``photos``: what they saw through is empty,
    so a vessel is open whose inside trained splats close. Every edge has two triangles, which face
    outwards. Raises ``GagaError`` when there is no surface: too few splats, or all nearly
    transparent.
    """
    config = config or MeshConfig()
    finite: BoolArray = np.isfinite(gaussians.means.sum(axis=1))
    if finite.sum() < 4:
        raise GagaError("An object of so few splats has no surface.")
    lo, hi = robust_box(gaussians.means, _SHARE)
    extent = float((hi - lo).max())
    if not extent > 0:
        raise GagaError("An object without extent has no surface.")
    voxel = extent / config.voxels
    shape = np.ceil((hi - lo) / voxel).astype(int) + 1 + 2 * _MARGIN
    grid = _Grid(lo - _MARGIN * voxel, voxel, (int(shape[0]), int(shape[1]), int(shape[2])))
    up = np.array([0.0, 0.0, 1.0]) if up is None else up
    cameras = views_around((lo, hi), up, _RINGS, side=_SIDE, field=_FIELD, room=_ROOM, phase=0.5)
    is_above = np.repeat(*np.array([(elevation >= 0, n) for elevation, n in _RINGS]).T) > 0
    n = int(np.prod(grid.shape))
    total, weight = np.zeros(n, np.float32), np.zeros(n, np.float32)
    frames: list[tuple[Camera, Frame]] = []
    n_steps = 2 * len(cameras) + 2  # a cancel is heard before each
    for k, camera in enumerate(cameras):
        yield Progress(STEP, k, n_steps, camera.name)
        frames.append((camera, rasterizer.render(gaussians, camera)))
    nearer = _nearer(frames[: _RINGS[0][1]]) if is_soft else 0.0
    frames = [(c, replace(f, median_depth=f.median_depth - nearer)) for c, f in frames]
    for k, ((camera, frame), above) in enumerate(zip(frames, is_above, strict=True)):
        yield Progress(STEP, len(cameras) + k, n_steps, camera.name)
        _fuse(grid, camera, frame, total, weight, is_above=bool(above))
    frames = [seen for seen, above in zip(frames, is_above, strict=True) if above]
    field = np.where(weight > 0, total / np.maximum(weight, 1e-6), -1).reshape(grid.shape)
    yield Progress(STEP, n_steps - 2, n_steps)
    if photos:
        field = _carved(grid, field, photos)
    yield Progress(STEP, n_steps - 1, n_steps)
    vertices, faces = _at_most(field, config.triangles)
    world = grid.origin + grid.voxel * vertices
    colors = _colors(world, gaussians.take(finite), frames, _SEEN * voxel)
    yield Progress(STEP, n_steps, n_steps)
    return TriangleMesh(
        np.ascontiguousarray(world, np.float32), np.ascontiguousarray(faces, np.int32), colors
    )


def _nearer(level: list[tuple[Camera, Frame]]) -> float:
    """How much too far the depths are: outlines from the side reach farther to the viewer.

    ``level``: views from evenly around. Trained splats are soft, so half of the light comes from
    within: without this an orange of 73 mm had 65 mm.
    """
    behind = []
    quarter = len(level) // 4
    for k, (camera, frame) in enumerate(level):
        axis = camera.cam_from_world[2, :3]
        solid = (frame.alpha >= _SOLID) & (frame.median_depth > 0)
        reaches = []
        for side in (k + quarter, k - quarter):
            other, seen = level[side % len(level)]
            columns = np.flatnonzero((seen.alpha >= _SOLID).any(axis=0))
            if not solid.any() or len(columns) == 0:
                continue
            # From the middle, at whose distance the outline is, to the end that is towards us.
            right, middle = other.cam_from_world[0, :3], other.width / 2
            distance = float(np.linalg.norm(camera.position - _middle_of(level)))
            ends = (columns[[0, -1]] + [0, 1] - middle) * distance / other.K[0, 0]
            reaches.append(float((ends * -(right @ axis)).max()))
        if reaches:
            front = float(np.percentile(frame.median_depth[solid], _FRONT))
            # What one side sees too large, as it is nearer to it, the other sees too small.
            behind.append(front - (distance - min(reaches)))
    return max(float(np.percentile(behind, _FLAT)), 0.0) if behind else 0.0


def _middle_of(level: list[tuple[Camera, Frame]]) -> DoubleArray:
    """What views from evenly around look at (3,)."""
    middle: DoubleArray = np.mean([camera.position for camera, _ in level], axis=0)
    return middle


def _fuse(
    grid: _Grid,
    camera: Camera,
    frame: Frame,
    total: FloatArray,  # (M,) in and out
    weight: FloatArray,  # (M,) in and out
    *,
    is_above: bool,
) -> None:
    """Add what one view says of every voxel."""
    shows = (frame.alpha.ravel() >= _SOLID) & (frame.median_depth.ravel() > 0)
    depth = np.where(shows, frame.median_depth.ravel(), np.inf)
    for at, (x, y, z) in grid.slabs(camera):
        row, column = _nearest(camera, x, y, z)
        flat = row * camera.width + column
        if is_above:
            said = np.clip((depth[flat] - z) / (_BAND * grid.voxel), -1, 1).astype(np.float32)
            share = np.where(said > -1, np.float32(1), np.float32(_HIDDEN))
            total[at] += share * said
        else:  # only what it sees nothing of
            share = (~shows[flat]).astype(np.float32)
            total[at] += share
        weight[at] += share


def _carved(grid: _Grid, field: FloatArray, photos: Sequence[DepthView]) -> FloatArray:
    """``field`` without what photos saw through (space carving, Kutulakos and Seitz 2000).

    Splats of a dark inside of a mug are few, and some lie across its mouth: they look the same.
    Depths of photos matched with each other do not depend on them.
    """
    from scipy.ndimage import distance_transform_edt

    empty = np.zeros(field.size, np.bool_)
    inside = np.flatnonzero(field.ravel() <= 0)
    steps = np.stack(np.unravel_index(inside, field.shape), axis=1)
    points = grid.origin + grid.voxel * steps
    for photo in photos:
        pixels, z = photo.camera.project(points)
        shown = np.flatnonzero(photo.camera.shows(pixels, z))
        column, row = pixels[shown].astype(np.int64).T
        ends = z[shown] * (1 + _UNSURE) + _NEAR_SURFACE * grid.voxel
        empty[inside[shown]] |= ends < photo.depth[row, column]
    # A shaft thinner than this is one wrong depth, as no photo looks through so small a hole.
    thin = _SHAFT * max(grid.shape)
    open_space = np.pad(empty.reshape(field.shape) | (field > 0), 1, constant_values=True)
    core = distance_transform_edt(open_space) > thin
    kept = distance_transform_edt(~core)[1:-1, 1:-1, 1:-1] <= thin
    carved = kept & empty.reshape(field.shape)
    if not carved.any():
        return field
    signed = distance_transform_edt(carved) - distance_transform_edt(~carved)
    return np.maximum(field, np.clip(signed / _BAND, -1, 1)).astype(np.float32)


def _nearest(
    camera: Camera, x: DoubleArray, y: DoubleArray, z: DoubleArray
) -> tuple[LongArray, LongArray]:
    """Row and column (N,) of the picture nearest to points (N,) before the camera (z > 0), in its
    frame."""
    column = (x / z * camera.K[0, 0] + camera.K[0, 2]).astype(np.int64)
    row = (y / z * camera.K[1, 1] + camera.K[1, 2]).astype(np.int64)
    return np.clip(row, 0, camera.height - 1), np.clip(column, 0, camera.width - 1)


def _at_most(field: FloatArray, triangles: int) -> tuple[DoubleArray, DoubleArray]:
    """`_surface` of about ``triangles`` at most (0: all), of a coarser ``field`` where needed."""
    from scipy import ndimage

    vertices, faces = _surface(field)
    share = 1.0
    for _ in range(_TRIES if triangles and len(faces) > MOST_OVER * triangles else 0):
        share *= np.sqrt(triangles / len(faces))  # their number goes with the square, nearly
        coarse = ndimage.zoom(field, share, order=1)
        steps = (np.array(field.shape) - 1) / np.maximum(np.array(coarse.shape) - 1, 1)
        vertices, faces = _surface(coarse)
        vertices = vertices * steps
        if triangles / MOST_OVER < len(faces) < MOST_OVER * triangles:
            break
    return vertices, faces


def _surface(field: FloatArray) -> tuple[DoubleArray, DoubleArray]:
    """Vertices (V, 3), voxels, and triangles (F, 3) of the zero of ``field``; closed."""
    from scipy import ndimage
    from skimage.measure import marching_cubes

    inside = field < 0
    parts, n_parts = ndimage.label(inside)
    if n_parts == 0:
        raise GagaError("The object is too transparent or too thin for a surface.")
    sizes = np.bincount(parts.ravel())[1:]
    small = np.append(False, sizes < _CRUMB * sizes.max())
    outside = np.where(small[parts], 1.0, field)
    # Exact zeros would be corners of the mesh with triangles of no area; a border closes it.
    outside = np.pad(np.where(outside == 0, 1e-6, outside), 1, constant_values=1.0)
    found = marching_cubes(outside, 0.0, gradient_direction="descent")  # type: ignore[no-untyped-call]
    vertices, faces = found[:2]
    return vertices.astype(np.float64) - 1, faces


def _colors(
    vertices: DoubleArray,
    gaussians: Gaussians,
    frames: list[tuple[Camera, Frame]],
    near: float,
) -> UInt8Array:
    """sRGB (V, 3) of the views that see each vertex; of the nearest splats where none does."""
    from scipy.spatial import cKDTree

    total = np.zeros((len(vertices), 4), np.float32)
    for camera, frame in frames:
        x, y, z = (turned(vertices, camera.cam_from_world[:3, :3]) + camera.cam_from_world[:3, 3]).T
        row, column = _nearest(camera, x, y, z)
        alpha = frame.alpha[row, column]
        seen = (alpha >= _SOLID) & (np.abs(frame.median_depth[row, column] - z) < near)
        total[seen, :3] += frame.image[row[seen], column[seen]]
        total[seen, 3] += alpha[seen]
    mean = total[:, :3] / np.maximum(total[:, 3:], 1e-6)
    unseen = total[:, 3] == 0
    if unseen.any():
        k = min(8, len(gaussians))
        _, near_rows = cKDTree(gaussians.means).query(vertices[unseen], k=k)
        rows = near_rows.reshape(-1, k)
        weights = gaussians.opacities[rows][..., None]
        shown = 0.5 + SH_C0 * gaussians.sh[rows, 0]
        mean[unseen] = (weights * shown).sum(axis=1) / np.maximum(weights.sum(axis=1), 1e-6)
    return np.rint(np.clip(mean, 0, 1) * 255).astype(np.uint8)
