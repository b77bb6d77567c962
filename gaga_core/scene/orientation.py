"""Which way is up in a scene, by its cameras or by its splats, and what the cameras look at."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, IntArray, check_shape
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at, principal_axes, quats_to_matrices
from gaga_core.scene.frame import scale_of
from gaga_core.scene.scene import Scene

_SNAP = np.cos(np.radians(3.0))  # an up this near to a world axis is that axis
NEARLY = np.cos(np.radians(30.0))  # of ups: nearer ones are meant to be the same
_NOTHING = 1e-9  # share of the right axes, of the tops: rounding
_FLATTEST = 0.15  # the cameras' right axes must spread over a plane this much better than along up
_COLMAP_UP = np.array([0.0, -1.0, 0.0])  # of models without cameras: OpenCV axes, y down

_SAMPLE = 50_000  # splats that are sampled
_SEEN = 0.3  # opacity from which on a splat shows a surface
_THIN = 0.4  # of a splat's middle side: it lies along a surface
_ALONG = 0.9  # cosine between the normal of a surface and an axis across which it lies
_MORE = 2.0  # times the surface across either other axis: so much lies across the vertical
_GROUND, _TOP = 0.5, 0.2  # of that surface: at least so much at the foot, at most at the top
_END = 0.15  # of the extent along the axis
_TALL = 1.4  # times either other side: what is so long stands


def estimate_up(cameras: Sequence[Camera]) -> DoubleArray:
    """The scene's up direction (3,), unit, world.

    People hold cameras level: up is what the pictures' right axes have least of, on the side to
    which their tops point. When all look the same way that is no direction, and the mean of the
    pictures' tops is taken. Without cameras: -y, as in the world of most single models.
    """
    if not cameras:
        return _COLMAP_UP.copy()
    return up_of_rotations(np.stack([camera.cam_from_world[:3, :3] for camera in cameras]))


def up_of_rotations(cam_from_world: DoubleArray) -> DoubleArray:
    """`estimate_up` of cameras with these rotations (V, 3, 3)."""
    tops = -cam_from_world[:, 1].mean(axis=0)
    rights = cam_from_world[:, 0]
    values, vectors = (
        found[0] for found in principal_axes((rights.T @ rights)[None] / len(rights))
    )
    up: DoubleArray = np.array(tops, np.float64)
    if values[1] > _NOTHING and values[0] < _FLATTEST * values[1]:
        up = vectors[:, 0] * (1.0 if vectors[:, 0] @ tops > -_NOTHING else -1.0)
    length = float(np.linalg.norm(up))
    if length < 1e-6:
        return _COLMAP_UP.copy()
    up /= length
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > _SNAP:
        up = np.eye(3)[axis] * np.sign(up[axis])
    return up


def saying_up(gaussians: Gaussians, up: AnyArray | Sequence[float]) -> Gaussians:
    """``gaussians`` with the comment on ``up`` (3,), where their shape alone tells another one."""
    is_guessed = np.allclose(guess_up(gaussians), up, atol=1e-6)
    return gaussians if is_guessed else gaussians.with_up(up)


def up_of_moved(
    opened: Sequence[Camera],
    placed: Sequence[Camera],
    known: Sequence[float] | None = None,
    world: DoubleArray | None = None,
) -> DoubleArray:
    """The up direction (3,), unit, world, of a scene that was moved as a whole.

    ``known`` (3,): what the program said that placed its photos; ``world`` (4, 4): the motion.

    ``opened`` are its cameras as they were, ``placed`` as they stand now. A scene that was laid
    level was laid level along the up of the cameras as they were: where both ups nearly agree it is
    that one, else the one of the cameras as they stand now.
    """
    if known is None:
        was, now = estimate_up(opened), estimate_up(placed)
    else:
        was = np.array(known, np.float64) / np.linalg.norm(known)
        now = was if world is None else world[:3, :3] @ was / scale_of(world)
    return was if float(was @ now) > NEARLY else now


def up_of_turned(guess: DoubleArray, world: DoubleArray) -> DoubleArray:
    """The up direction (3,), unit, of splats without cameras that were moved as a whole, ``world``
    (4, 4).

    They were turned to stand along the ``guess`` (3,): where that moved, it had been wrong. Only
    scripts lay a scene level along z by default, and the guess with it.
    """
    now = world[:3, :3] @ guess / scale_of(world)
    return np.array([0.0, 0.0, 1.0]) if now[2] > NEARLY else guess


def known_up(gaussians: Gaussians) -> DoubleArray | None:
    """The up direction (3,) that the file of splats says or their ground shows; None for neither.

    Cameras know more, see `up_of_moved`.
    """
    return _from_ground(gaussians) if gaussians.up is None else gaussians.up


def guess_up(gaussians: Gaussians) -> DoubleArray:
    """The up direction (3,) of splats without cameras: as their file says, else one of the axes.

    Where much more surface lies across one axis than across the others, and most of it at one end,
    that end is the ground. What is much longer along y or z stands. Else, and for the sign then, y
    points down, as in the world of most single models, and z up.
    """
    found = known_up(gaussians)
    if found is not None:
        return found
    means = gaussians.means[np.isfinite(gaussians.means).all(axis=1)]
    if len(means) == 0:
        return _COLMAP_UP.copy()
    sides = np.ptp(np.percentile(means[:: len(means) // _SAMPLE + 1], [2, 98], axis=0), axis=0)
    stands = sides[2] > _TALL * max(sides[0], sides[1])
    return np.array([0.0, 0.0, 1.0]) if stands else _COLMAP_UP.copy()


def _from_ground(gaussians: Gaussians) -> DoubleArray | None:
    """The axis (3,) that points away from the ground; None where no ground is seen."""
    rows = np.flatnonzero((gaussians.opacities > _SEEN) & np.isfinite(gaussians.means).all(axis=1))
    rows = rows[:: len(rows) // _SAMPLE + 1]
    if len(rows) == 0:
        return None
    means, sides = gaussians.means[rows].astype(np.float64), np.exp(gaussians.log_scales[rows])
    turned = quats_to_matrices(gaussians.quats[rows])
    normals = np.abs(turned[np.arange(len(rows)), :, sides.argmin(axis=1)])
    thin, middle, long = np.sort(sides, axis=1).T
    low, high = np.percentile(means, [2, 98], axis=0)
    at = (means - low) / np.maximum(high - low, 1e-12)
    area = np.minimum(middle * long, np.percentile(middle * long, 95))
    area = area * (thin < _THIN * middle) * ((at >= 0) & (at <= 1)).all(axis=1)
    across = area[:, None] * (normals > _ALONG)  # (K, 3)
    total = across.sum(axis=0)
    axis = int(total.argmax())
    if total[axis] <= _MORE * np.delete(total, axis).max():
        return None
    ends = at[:, axis] < _END, at[:, axis] > 1 - _END
    foot, top = (float(across[end, axis].sum() / total[axis]) for end in ends)
    if max(foot, top) < _GROUND or min(foot, top) > _TOP:
        return None
    up = np.zeros(3)
    up[axis] = 1.0 if foot > top else -1.0
    return up


def upright_basis(up: DoubleArray) -> DoubleArray:
    """Rotation (3, 3) from world to a frame whose z axis is ``up``; the identity for +z."""
    z = up / np.linalg.norm(up)
    helper = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = helper - (helper @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def even_directions(n: int) -> DoubleArray:
    """Unit directions (N, 3), evenly over the sphere: turned by the golden angle one by one."""
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    z = 1 - 2 * (np.arange(n) + 0.5) / n
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def views_around(
    box: tuple[DoubleArray, DoubleArray],
    up: DoubleArray,
    rings: Sequence[tuple[float, int]],  # elevation in degrees, views around
    *,
    side: int,
    field: float,
    room: float,
    phase: float = 0.0,
    name: str = "view",
) -> tuple[Camera, ...]:
    """Square views of ``side`` pixels on rings around a box lo, hi (3,), towards its middle.

    ``field``: of view, radians; ``room``: times the distance at which the box's ball fills a view;
    ``phase``: share of a step by which each ring is turned.
    """
    lo, hi = box
    middle, radius = (lo + hi) / 2, float(np.linalg.norm(hi - lo)) / 2
    distance = room * max(radius, 1e-12) / np.sin(field / 2)
    world_from_upright = upright_basis(up).T
    focal = 0.5 * side / np.tan(field / 2)
    K = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1.0]])
    views: list[Camera] = []
    for elevation, n in rings:
        e = np.radians(elevation)
        for turn in 2 * np.pi * (np.arange(n) + phase) / n:
            way = np.array([np.cos(e) * np.cos(turn), np.cos(e) * np.sin(turn), np.sin(e)])
            pose = look_at(middle + distance * (world_from_upright @ way), middle, up)
            views.append(Camera(K, pose, side, side, f"{name} {len(views)}"))
    return tuple(views)


def common_target(cameras: Sequence[Camera]) -> DoubleArray | None:
    """The point (3,) nearest to all optical axes; None when they do not meet before the cameras."""
    if len(cameras) < 2:
        return None
    matrix, right_side = np.zeros((3, 3)), np.zeros(3)
    for camera in cameras:
        across = np.eye(3) - np.outer(camera.forward, camera.forward)
        matrix += across
        right_side += across @ camera.position
    if np.linalg.eigvalsh(matrix)[0] < 0.01 * len(cameras):
        return None
    point = np.asarray(np.linalg.solve(matrix, right_side), np.float64)
    n_before = sum(float((point - c.position) @ c.forward) > 0 for c in cameras)
    return point if n_before > len(cameras) / 2 else None


# --- Maps (3, 4) of the world that arrange things.


_FLAT = 0.02  # height of a triangle over its longest side, below which it counts as a line


def mirror_map(axis: int, about: AnyArray) -> DoubleArray:
    """Mirror in the plane through ``about`` (3,) whose normal is world axis 0, 1 or 2."""
    if axis not in (0, 1, 2):
        raise ValueError(f"axis: expected 0, 1 or 2, got {axis}")
    centre = np.asarray(about, np.float64)
    check_shape("about", centre, (3,))
    linear = np.eye(3)
    linear[axis, axis] = -1
    return np.column_stack([linear, centre - linear @ centre])


def ground_map(points: AnyArray, up: AnyArray, seen_from: AnyArray) -> DoubleArray:
    """The rigid map that lays the plane through three ``points`` (3, 3) on the ground.

    The plane's normal that points to ``seen_from`` (3,), a place above the ground, becomes ``up``
    (3,), and the plane goes through the origin's height; the middle of the points stays over its
    place. Raises ``GagaError`` when the points lie on a line, or so nearly that they do not say how
    the plane lies.
    """
    corners = np.asarray(points, np.float64)
    check_shape("points", corners, (3, 3))
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    size = np.linalg.norm(normal)  # longest side times height
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max()
    if not size > _FLAT * longest**2:
        raise GagaError(
            "The three points are nearly on a line. Choose three corners of the ground, far apart."
        )
    normal /= size
    middle = corners.mean(axis=0)
    if normal @ (np.asarray(seen_from, np.float64) - middle) < 0:
        normal = -normal
    top = np.asarray(up, np.float64) / np.linalg.norm(up)
    turn = turn_between(normal, top)
    target = middle - top * (top @ middle)
    return np.column_stack([turn, target - turn @ middle])


def turn_between(start: DoubleArray, stop: DoubleArray) -> DoubleArray:
    """The smallest rotation (3, 3) that takes unit vector ``start`` to ``stop`` (Rodrigues)."""
    axis, cosine = np.cross(start, stop), float(start @ stop)
    if cosine < -1 + 1e-12:
        # Opposite: half a turn about any axis across.
        across = np.eye(3)[np.argmin(np.abs(start))]
        side = np.cross(start, across)
        side /= np.linalg.norm(side)
        return 2 * np.outer(side, side) - np.eye(3)
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + cosine)


# --- The placement of splats as a whole: absolute position, rotation and scale, and the motion
# between two placements.
# Rotation and scale count from how the file was opened or added, carried along when the scene is
# moved as a whole. A map that shears keeps its shear when its rotation or scale is changed.


_SAME = 1e-9  # how far placements of one object may differ, absolute


@dataclass(frozen=True, eq=False)
class Pose:
    """A position, a rotation and a scale."""

    centre: DoubleArray  # (3,) world
    turn: DoubleArray  # (3, 3) rotation, world, since the file came
    scale: DoubleArray  # (3,) along its own axes; one is negative where it is mirrored
    base: DoubleArray  # (3, 3) rotation of the scene as a whole: the file's axes, world
    is_one: bool = True  # False: of several placements; rotation and scale are of the first

    @property
    def axes(self) -> DoubleArray:
        """The object's own axes as columns (3, 3), world: those of the file, turned."""
        return self.turn @ self.base


def pose_of(scene: Scene, splats: IntArray, centre: DoubleArray) -> Pose:
    """The pose of splats (K,), at least one, about their ``centre`` (3,), world."""
    rows = np.unique(scene.placement[splats])
    table = scene.placements.matrix[rows]
    is_one = bool(np.abs(table - table[:1]).max() <= _SAME)
    motion = scene.motion_of(int(scene.source[splats[0]]))
    whole = scale_of(motion)
    base = motion[:3, :3] / whole
    linear = scene.placements.matrix[scene.placement[splats[0]]][:, :3] / whole
    mirror = np.diag([1.0 if np.linalg.det(linear) > 0 else -1.0, 1.0, 1.0])
    u, _, vt = np.linalg.svd(linear @ mirror)
    axes: DoubleArray = u @ vt
    return Pose(centre, axes @ base.T, np.diag(axes.T @ linear).copy(), base, is_one)


def motion_between(start: Pose, stop: Pose) -> DoubleArray:
    """The world map (3, 4) that takes splats from ``start`` to ``stop``.

    Raises ``ValueError`` when a scale is 0 or not finite.
    """
    factor = stop.scale / start.scale
    if not (np.isfinite(factor).all() and factor.all()):
        raise ValueError(f"scale: expected three numbers other than 0, got {stop.scale}")
    linear = stop.axes @ np.diag(factor) @ start.axes.T
    return np.column_stack([linear, stop.centre - linear @ start.centre])


def with_degrees(pose: Pose, degrees: DoubleArray, *, local: bool) -> Pose:
    """``pose`` turned to these angles (3,), see `degrees_of`."""
    x, y, z = (_about(axis, float(angle)) for axis, angle in enumerate(np.radians(degrees)))
    turn = pose.base @ x @ y @ z @ pose.base.T if local else z @ y @ x
    return replace(pose, turn=turn)


def degrees_of(pose: Pose, *, local: bool) -> DoubleArray:
    """Angles (3,) about x, then y, then z, degrees: of the world, or the object's own axes."""
    turn = pose.base.T @ pose.turn @ pose.base if local else pose.turn.T
    sine = float(np.clip(turn[0, 2], -1, 1))
    y = np.arcsin(sine)
    if abs(sine) < 1 - 1e-9:
        x, z = np.arctan2(-turn[1, 2], turn[2, 2]), np.arctan2(-turn[0, 1], turn[0, 0])
    else:  # x and z are about one axis: all of it is x
        x, z = np.arctan2(turn[2, 1], turn[1, 1]), 0.0
    angles = np.degrees([x, y, z])
    return (angles if local else -angles) + 0.0


def _about(axis: int, angle: float) -> DoubleArray:
    """The rotation (3, 3) about a world axis, radians."""
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[i, j], matrix[j, i] = -np.sin(angle), np.sin(angle)
    return matrix
