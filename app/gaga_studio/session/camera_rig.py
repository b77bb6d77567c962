"""The camera that a person moves: orbit, pan, zoom, fly, look, and smooth jumps."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.scene.camera_path import Shot
from gaga_core.scene.frame import inverse, scale_of
from gaga_core.scene.orientation import (
    common_target,
    estimate_up,
    upright_basis,
)
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.bounds import object_box
from gaga_core.scene.selection.clear_view import Clearest, clearest_view, clearest_view_of

FLY_KEYS = frozenset("WASDQE")  # by their place on a US keyboard
_JUMP_S = 0.35  # time of an animated jump
_STEEPEST = np.radians(89.9)  # straight up and down has no heading
_ORBIT_PER_HEIGHT = np.pi  # drag over the picture's height: half a turn
_ZOOM_PER_NOTCH = 0.15
_FAR = 300.0  # scene radii between the pivot and an orthographic camera: 0.3 % of perspective left
_LEVEL_PER_DRAG = 0.85  # share of a training camera's roll that an orbit step leaves
_SIDES = 8  # from which a scene without photos may be seen first
_NEARER = (1, 2, 3, 4, 6)  # times, to come inside of what surrounds a scene
# There splats cover so much of the picture, and so much of what is seen from afar is seen: inside
# of eight trainings 0.81 to 0.92 and 0.97 to 2.9. Of three lone objects that fill as much, 0.4 to
# 0.8 is left. Of all such views the farthest that shows nearly the most.
_FILLED, _NO_LESS, _NEARLY = 0.8, 0.97, 0.95
_THREE_QUARTERS = np.radians(30.0)  # from the front, of the first view without photos


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of the camera relative to the scene's up, as a bookmark keeps it.

    ``yaw`` turns around up, ``pitch`` looks down when negative, ``roll`` turns the picture
    clockwise; radians. The fields of view are the least that the picture shows both ways.
    """

    pivot: DoubleArray  # (3,) world: what orbit turns around
    distance: float  # from the pivot
    yaw: float
    pitch: float
    roll: float = 0.0
    fov_x: float = np.radians(50.0)
    fov_y: float = np.radians(50.0)
    is_orthographic: bool = False  # the same size near and far: a far camera with a long lens


class CameraRig:
    """A pose and its motion. Lengths are scene units, drags are pixels of the picture."""

    def __init__(self) -> None:
        self.up: DoubleArray = np.array([0.0, 0.0, 1.0])
        self._basis = upright_basis(self.up)
        self.radius = 1.0  # size of the scene: the scale of flying and of the nearest distance
        self.pose = Pose(np.zeros(3), 3.0, 0.0, -0.35)
        self.is_flying = False  # left drag looks around instead of orbiting
        self._size = (1280, 720)
        self._start: Pose | None = None
        self._goal: Pose | None = None
        self._elapsed = 0.0
        self._world: DoubleArray | None = None  # (4, 4) that `follow` saw last

    # --- reading

    @property
    def is_moving(self) -> bool:
        """Whether a jump is under way."""
        return self._goal is not None

    @property
    def goal(self) -> Pose:
        """The pose at the end of a jump, or the present one: the same object until it changes."""
        return self._goal if self._goal is not None else self.pose

    def return_to(self, pose: Pose) -> None:
        """Fly back to a pose that was the `goal`."""
        self._jump(pose)

    @property
    def pivot(self) -> DoubleArray:
        """Centre of the orbit (3,), world."""
        return self.pose.pivot

    @property
    def eye(self) -> DoubleArray:
        """Centre of projection (3,), world."""
        return self.pose.pivot - self.pose.distance * self._axes(self.pose)[2]

    @property
    def seen_from(self) -> DoubleArray:
        """Position of the camera (3,), world: far off when it is orthographic."""
        return self._camera(self._size).position

    @property
    def cam_from_world(self) -> DoubleArray:
        """The camera's rigid transform (4, 4)."""
        return self._camera(self._size).cam_from_world

    @property
    def sideways(self) -> DoubleArray:
        """The picture's right (3,), unit, world."""
        return self._axes(self.pose)[0]

    def camera(self, width: int, height: int) -> Camera:
        """Return the camera at this picture size (at least 1 x 1), for drawing and for picking."""
        self._size = (max(width, 1), max(height, 1))
        return self._camera(self._size)

    def _camera(self, size: tuple[int, int]) -> Camera:
        focal, away, axes = self._focal(size), self.pose.distance, self._axes(self.pose)
        if self.pose.is_orthographic:  # what is at the pivot keeps its size
            away += _FAR * self.radius
            focal *= away / self.pose.distance
        eye = self.pose.pivot - away * axes[2]
        K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])
        matrix = np.eye(4)
        matrix[:3, :3] = axes
        matrix[:3, 3] = -axes @ eye
        return Camera(K, matrix, *size, "view")

    def shot(self) -> Shot:
        """Return the present view, for a bookmark, a keyframe or a picture of any size.

        Another picture size shows it as the picture does when the window is resized.
        """
        pose, camera = self.pose, self._camera(self._size)
        distance = float((pose.pivot - camera.position) @ camera.forward)
        near = pose.distance / distance  # 1, or little: the long lens of an orthographic camera
        shot = Shot.of_camera(camera, distance, is_orthographic=pose.is_orthographic)
        fov_x = 2 * float(np.arctan(near * np.tan(pose.fov_x / 2)))
        fov_y = 2 * float(np.arctan(near * np.tan(pose.fov_y / 2)))
        return replace(shot, fov_x=fov_x, fov_y=fov_y)

    # --- moving by hand: each ends a jump

    def orbit(self, dx: float, dy: float) -> None:
        """Turn around the pivot by a drag in pixels."""
        self._stop()
        yaw, pitch = self._turned(dx, dy)
        self.pose = replace(self.pose, yaw=yaw, pitch=pitch, roll=self._levelled())

    def look(self, dx: float, dy: float) -> None:
        """Turn the camera about its own position by a drag in pixels."""
        self._stop()
        eye = self.eye
        yaw, pitch = self._turned(0.5 * dx, 0.5 * dy)
        self.pose = replace(self.pose, yaw=yaw, pitch=pitch, roll=self._levelled())
        self._put_eye(eye)

    def pan(self, dx: float, dy: float) -> None:
        """Move sideways by a drag in pixels: the pivot follows the mouse."""
        self._stop()
        right, down, _ = self._axes(self.pose)
        shift = (dx * right + dy * down) * self.pose.distance / self._focal()
        self.pose = replace(self.pose, pivot=self.pose.pivot - shift)

    def zoom(self, notches: float) -> None:
        """Go nearer to the pivot (positive) or away from it, by wheel notches."""
        self._stop()
        distance = self.pose.distance * float(np.exp(-_ZOOM_PER_NOTCH * notches))
        nearest, farthest = 1e-3 * self.radius, 1e3 * self.radius
        self.pose = replace(self.pose, distance=float(np.clip(distance, nearest, farthest)))

    def fly(self, move: Sequence[float], dt: float, speed: float = 1.0) -> None:
        """Move by ``move`` (right, up, forward), each -1..1, for ``dt`` seconds.

        At ``speed`` 1 the scene is crossed in about four seconds; up is the scene's.
        """
        if not any(move):
            return
        self._stop()
        right, _, forward = self._axes(self.pose)
        direction = move[0] * right + move[1] * self.up + move[2] * forward
        shift = direction * (0.5 * self.radius * speed * dt)
        self.pose = replace(self.pose, pivot=self.pose.pivot + shift)

    def set_pivot(self, point: DoubleArray) -> None:
        """Turn around ``point`` (3,) from now on; the camera jumps to face it, smoothly."""
        distance = float(np.linalg.norm(point - self.eye))
        self._jump(replace(self.goal, pivot=np.array(point), distance=distance))

    # --- jumps

    def focus(self, centre: DoubleArray, radius: float, *, animated: bool = True) -> None:
        """Show a ball (3,), scene units, from the present direction."""
        fov = min(self.pose.fov_x, self.pose.fov_y)
        distance = 1.15 * max(radius, 1e-4 * self.radius) / float(np.sin(fov / 2))
        self._jump(replace(self.goal, pivot=np.array(centre), distance=distance), animated)

    def go_to(self, camera: Camera, *, animated: bool = True) -> None:
        """Move to the pose of ``camera``, roll included, and show at least what it shows."""
        yaw, pitch, roll = self._angles(camera.cam_from_world[:3, :3])
        distance = self._depth_of_interest(camera)
        fov_x = 2 * float(np.arctan(camera.width / 2 / camera.K[0, 0]))
        fov_y = 2 * float(np.arctan(camera.height / 2 / camera.K[1, 1]))
        pivot = camera.position + distance * camera.forward
        self._jump(Pose(pivot, distance, yaw, pitch, roll, fov_x, fov_y), animated)

    def go_to_shot(self, shot: Shot, *, animated: bool = True) -> None:
        """Show what ``shot`` shows, and turn around what it looks at."""
        camera = shot.camera(*self._size)
        yaw, pitch, roll = self._angles(camera.cam_from_world[:3, :3])
        pivot = camera.position + shot.distance * camera.forward
        distance, fov_x, fov_y = shot.distance, shot.fov_x, shot.fov_y
        if shot.is_orthographic:  # what would be seen from near by with a common lens
            fov_x, fov_y = self.pose.fov_x, self.pose.fov_y
            distance *= self._focal() / float(camera.K[0, 0])
        pose = Pose(pivot, distance, yaw, pitch, roll, fov_x, fov_y, shot.is_orthographic)
        self._jump(pose, animated)

    def set_orthographic(self, flat: bool) -> None:
        """Switch the orthographic projection; what is at the pivot keeps its size."""
        self._jump(replace(self.goal, is_orthographic=flat), animated=False)

    def look_from(self, side: Sequence[float]) -> None:
        """See the pivot from ``side`` (right, back, up) of the upright scene, in halves of a cube:
        (0, -1, 0) is the front, (1, -1, 1) a corner. Raises ``ValueError`` for (0, 0, 0)."""
        x, y, z = (float(value) for value in side)
        flat = float(np.hypot(x, y))
        if flat == 0 and z == 0:
            raise ValueError("look_from: no side")
        pose = self.goal
        yaw = float(np.arctan2(-y, -x)) if flat else _quarter(pose.yaw)
        pitch = float(np.clip(np.arctan2(-z, flat), -_STEEPEST, _STEEPEST))
        self._jump(replace(pose, yaw=yaw, pitch=pitch, roll=0.0))

    @property
    def cube(self) -> DoubleArray:
        """Right, back and up of the upright scene as columns (3, 3) in the picture's axes right,
        down, forward: how the view cube stands."""
        return self._axes(self.pose) @ self._basis.T

    def look_along(self, axis: str) -> None:
        """Show an axis view: "front", "back", "left", "right", "top" or "bottom" of the pivot."""
        headings = {"front": 90.0, "back": -90.0, "left": 0.0, "right": 180.0}
        pose = self.goal
        if axis in headings:
            yaw, pitch = float(np.radians(headings[axis])), 0.0
        elif axis in ("top", "bottom"):
            yaw = float(np.radians(90.0))
            pitch = float(-_STEEPEST if axis == "top" else _STEEPEST)
        else:
            raise ValueError(f"axis: {axis!r} is none of {(*headings, 'top', 'bottom')}")
        self._jump(replace(pose, yaw=yaw, pitch=pitch, roll=0.0))

    def follow(self, world: DoubleArray, kept: Sequence[tuple[DoubleArray, Pose]] = ()) -> None:
        """Follow a turn of the whole scene: ``world`` (4, 4) is its motion since it was opened.

        The picture stays what it was, then it is levelled, smoothly; from one of the ``kept``
        worlds to another, the pose that was kept of that comes back.
        """
        before, self._world = self._world, world
        if before is None or before is world:
            return
        if any(np.array_equal(known, before) for known, _ in kept):
            for known, pose in kept:
                if np.array_equal(known, world):
                    self._jump(pose, animated=False)
                    return
        motion = world @ inverse(before)
        self.radius *= scale_of(motion)
        goal = self._carried(self.goal, motion)
        self.pose = self._carried(self.pose, motion)
        steepest = float(np.clip(goal.pitch, -_STEEPEST, _STEEPEST))
        self._jump(replace(goal, pitch=steepest, roll=0.0))

    def frame_scene(
        self,
        lo: DoubleArray,
        hi: DoubleArray,
        cameras: Sequence[Camera] = (),
        *,
        up: DoubleArray | None = None,
        animated: bool = False,
    ) -> None:
        """Set a first view of a scene with the robust box lo..hi (3,): its first photo, if any.

        Without cameras: three quarters from the front, a little above, the whole box. Sets up,
        which is ``up`` (3,) or what the cameras say, and the scale too.
        """
        self._world = None
        self.up = estimate_up(cameras) if up is None else up
        self._basis = upright_basis(self.up)
        centre = (lo + hi) / 2
        self.radius = max(float(np.linalg.norm(hi - lo)) / 2, 1e-6)
        if not cameras:
            # Models without cameras are made in a world where cameras look along +z.
            yaw = float(np.arctan2(*(self._basis @ np.array([0, 0, 1.0]))[1::-1]))
            self.pose = Pose(centre, 3 * self.radius, yaw + _THREE_QUARTERS, -0.3)
            self.focus(centre, self.radius, animated=animated)
            return
        target = common_target(cameras)
        inside = target is not None and np.all(target > lo - self.radius)
        inside = inside and target is not None and np.all(target < hi + self.radius)
        self.pose = replace(self.pose, pivot=target if inside and target is not None else centre)
        self.go_to(cameras[0], animated=animated)

    def turn_to_clearest(self, scene: Scene, box: tuple[DoubleArray, DoubleArray]) -> None:
        """Look at the scene from the side that is open, of eight all around: the present one,
        unless another shows much more of its middle. From nearer where that is surrounded, as by
        the far shell of a training (`gaga_core.training.start`): where splats fill the picture, and
        no less of the middle is seen."""
        start, found = self.pose, list[tuple[Pose, Clearest]]()
        for nearness in _NEARER:
            poses, views = self._around(replace(start, distance=start.distance / nearness))
            clearest = clearest_view(scene, box, views)
            found.append((poses[clearest.number], clearest))
        least = _NO_LESS * found[0][1].share
        inside = [one for one in found if one[1].covered >= _FILLED and one[1].share >= least]
        enough = _NEARLY * max((one.share for _, one in inside), default=0.0)
        self.pose = next((pose for pose, one in inside if one.share >= enough), found[0][0])

    def focus_clearly(self, scene: Scene, indices: IntArray) -> None:
        """Show splats (K,) from the present direction, or from the clearest of eight around them
        where others hide them."""
        lo, hi = object_box(scene, indices)
        self.focus((lo + hi) / 2, float(np.linalg.norm(hi - lo)) / 2)
        poses, views = self._around(self.goal)
        self._jump(poses[clearest_view_of(scene, indices, views)])

    def _around(self, pose: Pose) -> tuple[list[Pose], list[Camera]]:
        """``pose`` turned about its pivot, eight times, and what each shows."""
        turns = 2 * np.pi * np.arange(_SIDES) / _SIDES
        poses, present = [replace(pose, yaw=pose.yaw + turn) for turn in turns], self.pose
        views = []
        for self.pose in poses:
            views.append(self._camera(self._size))
        self.pose = present
        return poses, views

    def fly_from(self, start: Pose) -> None:
        """Come to the present pose from ``start``, as a jump does."""
        goal, self.pose = self.pose, start
        self._jump(goal, animated=True)

    def update(self, dt: float) -> bool:
        """Advance a jump by ``dt`` seconds; return whether the camera moved."""
        if self._goal is None or self._start is None:
            return False
        self._elapsed += dt
        t = min(self._elapsed / _JUMP_S, 1.0)
        self.pose = _between(self._start, self._goal, t * t * (3 - 2 * t))
        if t >= 1:
            self.pose = self._goal
            self._stop()
        return True

    # --- private

    def _axes(self, pose: Pose) -> DoubleArray:
        """Rows right, down, forward (3, 3), world: the rotation of ``cam_from_world``."""
        cos_p, sin_p = math.cos(pose.pitch), math.sin(pose.pitch)
        cos_y, sin_y = math.cos(pose.yaw), math.sin(pose.yaw)
        cos_r, sin_r = math.cos(pose.roll), math.sin(pose.roll)
        level = [
            [sin_y, -cos_y, 0.0],
            [sin_p * cos_y, sin_p * sin_y, -cos_p],
            [cos_p * cos_y, cos_p * sin_y, sin_p],
        ]
        roll = np.array([[cos_r, sin_r, 0.0], [-sin_r, cos_r, 0.0], [0.0, 0.0, 1.0]])
        return roll @ np.array(level) @ self._basis

    def _angles(self, axes: DoubleArray) -> tuple[float, float, float]:
        """Yaw, pitch and roll of a camera with the rows right, down, forward (3, 3), world."""
        local = self._basis @ axes[2]
        pitch = float(np.arcsin(np.clip(local[2], -1, 1)))
        yaw = float(np.arctan2(local[1], local[0]))
        right, down, _ = self._axes(replace(self.pose, yaw=yaw, pitch=pitch, roll=0.0))
        return yaw, pitch, float(np.arctan2(axes[0] @ down, axes[0] @ right))

    def _carried(self, pose: Pose, motion: DoubleArray) -> Pose:
        """``pose`` after the world map ``motion`` (4, 4), a rotation times a scale."""
        scale = scale_of(motion)
        yaw, pitch, roll = self._angles(self._axes(pose) @ motion[:3, :3].T / scale)
        pivot, distance = motion[:3, :3] @ pose.pivot + motion[:3, 3], pose.distance * scale
        return replace(pose, pivot=pivot, distance=distance, yaw=yaw, pitch=pitch, roll=roll)

    def _focal(self, size: tuple[int, int] | None = None) -> float:
        """Focal length in pixels at a picture size: both fields of view are inside."""
        width, height = size or self._size
        pose = self.pose
        return float(min(width / 2 / np.tan(pose.fov_x / 2), height / 2 / np.tan(pose.fov_y / 2)))

    def _turned(self, dx: float, dy: float) -> tuple[float, float]:
        per_pixel = _ORBIT_PER_HEIGHT / self._size[1]
        pitch = float(np.clip(self.pose.pitch - dy * per_pixel, -_STEEPEST, _STEEPEST))
        return self.pose.yaw - dx * per_pixel, pitch

    def _levelled(self) -> float:
        roll = self.pose.roll * _LEVEL_PER_DRAG
        return roll if abs(roll) > 1e-3 else 0.0

    def _put_eye(self, eye: DoubleArray) -> None:
        forward = self._axes(self.pose)[2]
        self.pose = replace(self.pose, pivot=eye + self.pose.distance * forward)

    def _depth_of_interest(self, camera: Camera) -> float:
        """Distance at which ``camera`` passes the present pivot, if it looks towards it."""
        depth = float((self.pose.pivot - camera.position) @ camera.forward)
        return depth if depth > 0.05 * self.radius else self.radius

    def _jump(self, goal: Pose, animated: bool = True) -> None:
        if not animated:
            self._stop()
            self.pose = goal
            return
        self._start, self._goal, self._elapsed = self.pose, goal, 0.0

    def _stop(self) -> None:
        self._start = self._goal = None


def _between(a: Pose, b: Pose, t: float) -> Pose:
    """Interpolate two poses at ``t`` in 0..1; angles take the shorter way."""

    def angle(x: float, y: float) -> float:
        return x + t * float(np.angle(np.exp(1j * (y - x))))

    return Pose(
        pivot=a.pivot + t * (b.pivot - a.pivot),
        distance=float(np.exp((1 - t) * np.log(a.distance) + t * np.log(b.distance))),
        yaw=angle(a.yaw, b.yaw),
        pitch=angle(a.pitch, b.pitch),
        roll=angle(a.roll, b.roll),
        fov_x=a.fov_x + t * (b.fov_x - a.fov_x),
        fov_y=a.fov_y + t * (b.fov_y - a.fov_y),
        is_orthographic=b.is_orthographic,
    )


def _quarter(yaw: float) -> float:
    """Return the nearest quarter turn: a view from the top keeps its edges upright."""
    return round(yaw / (np.pi / 2)) * float(np.pi / 2)
