"""Ways of the camera: shots that a person keeps, and a smooth path through some of them.

The path is a cubic Hermite curve through the keyframes with the tangents of Catmull and Rom (1974)
for unequal times: it passes through every keyframe and its speed has no jumps. Positions, logs of
the fields of view and rotations (as quaternions of one sign, then made unit; Shoemake 1985 calls
for no more where neighbours are less than half a turn apart) all go by the same curve.
"""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.geometry import matrices_to_quats, quats_to_matrices
from gaga_core.io.files import atomic_write
from gaga_core.io.json_file import explain_json_error, read_json
from gaga_core.scene.frame import scale_of

_TURNTABLE_KEYS = 16  # the curve stays within 0.06 % of the circle
_PIECES = 64  # of a segment, when its length is measured
_STILL = 1e-6  # share of the whole way below which a segment does not move
_WIDEST = math.radians(175)  # field of view between keyframes


@dataclass(frozen=True)
class Shot:
    """Pose and field of view of a camera, independent of the size of the picture."""

    eye: tuple[float, float, float]  # world
    quat: tuple[float, float, float, float]  # cam_from_world, wxyz, unit
    fov_x: float  # radians; the least that the picture shows both ways
    fov_y: float
    distance: float  # to what it looks at, scene units
    is_orthographic: bool = False  # a far camera with a long lens

    def __post_init__(self) -> None:
        numbers = (*self.eye, *self.quat, self.fov_x, self.fov_y, self.distance)
        if not all(math.isfinite(x) for x in numbers) or self.distance <= 0:
            raise ValueError("shot: a number is not finite, or the distance not positive")
        if not (0 < self.fov_x < math.pi and 0 < self.fov_y < math.pi):
            raise ValueError(f"shot: fields of view {self.fov_x}, {self.fov_y} are not in 0..pi")
        if not 0.9 < math.hypot(*self.quat) < 1.1:
            raise ValueError("shot: the quaternion is not of unit length")

    @property
    def turn(self) -> DoubleArray:
        """The rotation (3, 3) cam_from_world."""
        return quats_to_matrices(np.array([self.quat])).reshape(3, 3)

    def camera(self, width: int, height: int, name: str = "") -> Camera:
        """The view at this picture size: both fields of view are inside."""
        focal = min(width / 2 / math.tan(self.fov_x / 2), height / 2 / math.tan(self.fov_y / 2))
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        matrix = np.eye(4)
        matrix[:3, :3] = self.turn
        matrix[:3, 3] = -matrix[:3, :3] @ np.array(self.eye)
        return Camera(K, matrix, width, height, name)

    @staticmethod
    def of_camera(camera: Camera, distance: float, *, is_orthographic: bool = False) -> "Shot":
        """What ``camera`` shows; ``distance`` to what it looks at."""
        return Shot(
            _three(camera.position),
            _quat_of(camera.cam_from_world[:3, :3]),
            2 * math.atan(camera.width / 2 / float(camera.K[0, 0])),
            2 * math.atan(camera.height / 2 / float(camera.K[1, 1])),
            distance,
            is_orthographic,
        )


@dataclass(frozen=True)
class Bookmark:
    """A shot with a name, and the key 1..9 that recalls it (0 = none)."""

    name: str
    shot: Shot
    key: int = 0


@dataclass(frozen=True)
class Keyframe:
    """A shot that the path passes, so many seconds after the one before.

    Of the first keyframe ``seconds`` counts in a closed path only: the way back to it.
    """

    shot: Shot
    seconds: float = 2.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.seconds) and self.seconds > 0):
            raise ValueError(f"keyframe: {self.seconds} seconds is no time")


@dataclass(frozen=True)
class CameraPath:
    """Keyframes in their order, and how they are passed."""

    keyframes: tuple[Keyframe, ...] = ()
    is_closed: bool = False  # goes on to the first keyframe
    even_speed: bool = False  # the eye's speed is the same all the way

    @property
    def seconds(self) -> float:
        """Time of the whole path; 0 with fewer than two keyframes."""
        return float(sum(self._spans()))

    def times(self) -> tuple[float, ...]:
        """Seconds (K,) at which the keyframes are passed (at ``even_speed``, too)."""
        spans = self._travel_spans() if self.even_speed else self._spans()
        starts = (0.0, *np.cumsum(spans).tolist())
        return tuple(float(t) for t in starts[: len(self.keyframes)])

    def shot(self, seconds: float) -> Shot:
        """The shot at a moment; before the start and after the end the path stands still.

        Raises ``ValueError`` when there are no keyframes.
        """
        if not self.keyframes:
            raise ValueError("shot: the path has no keyframes")
        if len(self.keyframes) == 1:
            return self.keyframes[0].shot
        time = self._curve_time(min(max(seconds, 0.0), self.seconds))
        knots, keys = self._knots(), self._closed_keys()
        row = _hermite(knots, self._values(), np.array([time]), self.is_closed)[0]
        before = keys[max(int(np.searchsorted(knots, time, "right")) - 1, 0)].shot
        w, x, y, z = (row[3:7] / np.linalg.norm(row[3:7])).tolist()
        fov_x, fov_y = (min(math.exp(value), _WIDEST) for value in row[7:9])
        distance = math.exp(row[9])
        return Shot(_three(row[:3]), (w, x, y, z), fov_x, fov_y, distance, before.is_orthographic)

    def frame_times(self, fps: float) -> DoubleArray:
        """Moments (F,) of the frames of a film, at least one; a closed path does not show its
        first picture twice."""
        n = max(round(self.seconds * fps), 0)
        return np.arange(max(n + (not self.is_closed), 1)) / fps

    # --- inside: keyframes as rows, the first one again at the end of a closed path

    def _closed_keys(self) -> tuple[Keyframe, ...]:
        keys = self.keyframes
        return (*keys, keys[0]) if self.is_closed and len(keys) > 1 else keys

    def _spans(self) -> list[float]:
        return [key.seconds for key in self._closed_keys()[1:]]

    def _knots(self) -> DoubleArray:
        return np.concatenate([[0.0], np.cumsum(self._spans())])

    def _values(self) -> DoubleArray:
        """Eye, quaternion, log fields of view, log distance (K, 10); quaternions of one sign."""
        shots = [key.shot for key in self._closed_keys()]
        lengths = [[shot.fov_x, shot.fov_y, shot.distance] for shot in shots]
        logs = [[math.log(value) for value in row] for row in lengths]
        rows = np.array([[*s.eye, *s.quat, *log] for s, log in zip(shots, logs, strict=True)])
        for i in range(1, len(rows)):
            if rows[i, 3:7] @ rows[i - 1, 3:7] < 0:
                rows[i, 3:7] *= -1
        return rows

    def _lengths(self) -> tuple[DoubleArray, DoubleArray]:
        """Moments (P,) of the curve and the way (P,) until there, scene units."""
        knots = self._knots()
        steps = np.linspace(0, 1, _PIECES, endpoint=False)
        moments = np.concatenate(
            [(knots[:-1, None] + np.diff(knots)[:, None] * steps).ravel(), knots[-1:]]
        )
        eyes = _hermite(knots, self._values(), moments, self.is_closed)[:, :3]
        steps_of = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
        return moments, np.concatenate([[0.0], np.cumsum(steps_of)])

    def _travel_spans(self) -> list[float]:
        """Seconds of each segment at even speed; one without a way (a turn) keeps its time."""
        spans = np.array(self._spans())
        if len(spans) == 0:
            return []
        _, way = self._lengths()
        ways = np.diff(way[::_PIECES])
        moves = ways > _STILL * max(float(ways.sum()), 1e-300)
        if moves.any():
            spans[moves] = ways[moves] / ways[moves].sum() * spans[moves].sum()
        return [float(span) for span in spans]

    def _curve_time(self, seconds: float) -> float:
        """The curve's own time at a moment of the film: another one at even speed."""
        if not self.even_speed:
            return seconds
        moments, way = self._lengths()
        starts = np.concatenate([[0.0], np.cumsum(self._travel_spans())])
        last = len(starts) - 2
        i = min(max(int(np.searchsorted(starts, seconds, "right")) - 1, 0), last)
        share = (seconds - starts[i]) / (starts[i + 1] - starts[i])
        piece = slice(i * _PIECES, (i + 1) * _PIECES + 1)
        from_, to = way[piece][0], way[piece][-1]
        if to - from_ <= _STILL * max(float(way[-1]), 1e-300):
            return float(moments[piece][0] + share * (moments[piece][-1] - moments[piece][0]))
        return float(np.interp(from_ + share * (to - from_), way[piece], moments[piece]))


def turntable(
    shot: Shot,
    up: DoubleArray,
    seconds: float = 8.0,
    *,
    clockwise: bool = False,
    seen_from: DoubleArray | None = None,  # (P, 3) world
    basis: DoubleArray | None = None,  # (3, 3) of `upright_basis(up)`, goes with ``seen_from``
) -> CameraPath:
    """A closed circle of ``seconds`` around what ``shot`` looks at, about the axis ``up`` (3,).

    Height, distance and tilt stay those of the shot; seen from above the camera goes against the
    clock unless ``clockwise``. With the places ``seen_from`` of photos it keeps to the upright box
    around them: in a room, a circle would lead through the walls. Where photos saw one side only,
    of a wall say, it stays on that side.
    """
    axis = np.asarray(up, np.float64) / np.linalg.norm(up)
    pivot = np.array(shot.eye) + shot.distance * shot.turn[2]
    basis, box = np.eye(3) if basis is None else basis, None
    if seen_from is not None:
        basis = _facing(seen_from - pivot, basis)
        shot, box = _between(shot, pivot, seen_from @ basis.T, basis)
    eye, keys = np.array(shot.eye), []
    for k in range(_TURNTABLE_KEYS):
        half = (-1 if clockwise else 1) * 2 * np.pi * k / _TURNTABLE_KEYS / 2
        turn = quats_to_matrices(np.array([[math.cos(half), *(math.sin(half) * axis)]]))[0]
        at = _three(pivot + turn @ (eye - pivot))
        turned = replace(shot, eye=at, quat=_quat_of(shot.turn @ turn.T))
        if box is not None:
            turned = _kept_in(turned, box, pivot, basis)
        keys.append(Keyframe(turned, seconds / _TURNTABLE_KEYS))
    return CameraPath(tuple(keys), is_closed=True)


_ROUND = 0.5  # times its corners' distance: radius in a box from which the path is a circle there
_NEAREST = 0.1  # of its distance: how near a turntable in a room may come to what it looks at


def _facing(ways: DoubleArray, basis: DoubleArray) -> DoubleArray:
    """``basis`` (3, 3), turned about up so that its first axis is the middle of the headings of
    ``ways`` (P, 3) where these are less than half a turn apart: a box around their ends that is
    aligned with it has all of them, and no point behind their beginning."""
    headings = np.sort(np.arctan2(ways @ basis[1], ways @ basis[0]))
    gaps = np.diff(headings, append=headings[0] + 2 * np.pi)
    widest = int(gaps.argmax())
    if gaps[widest] <= np.pi:
        return basis
    middle = headings[widest] + gaps[widest] / 2 + np.pi  # opposite to the middle of the gap
    c, s = np.cos(middle), np.sin(middle)
    turned: DoubleArray = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ basis
    return turned


def _between(
    shot: Shot, pivot: DoubleArray, places: DoubleArray, basis: DoubleArray
) -> tuple[Shot, DoubleArray]:
    """``shot``, and the box (2, 3), low and high in the upright frame, that its circle keeps to.

    The box is that of the ``places`` (P, 3) from above, at any height. Where the shot is nearer to
    ``pivot`` than photos were, it reaches to the shot. One from behind all photos, and maybe behind
    a wall, comes to the largest circle in the box, or as near as its farthest corner where that is
    far larger, at the height of photos.
    """
    low, high = places.min(axis=0), places.max(axis=0)
    # The first photo itself is often on the edge.
    edge = 1e-3 * max(float(np.ptp(places[:, :2], axis=0).max()), 1e-9)
    low, high = low - edge, high + edge
    eye, middle = basis @ np.array(shot.eye), basis @ pivot
    out, out_of_middle = (np.linalg.norm((p - np.clip(p, low, high))[:2]) for p in (eye, middle))
    if out < out_of_middle:
        low, high = np.minimum(low, eye), np.maximum(high, eye)
    elif out > 0:
        way = eye - middle
        reach = float(np.linalg.norm(np.maximum(middle - low, high - middle)[:2]))
        inner = float(np.minimum(middle - low, high - middle)[:2].min())
        reach = inner if inner > _ROUND * reach else reach
        share = min(reach / float(np.linalg.norm(way[:2])), 1.0)
        nearer = _three(basis.T @ (middle + share * way))
        shot = replace(shot, eye=nearer, distance=share * shot.distance)
        low[2], high[2] = min(low[2], middle[2]), max(high[2], middle[2])
        return shot, np.stack([low, high])
    low[2], high[2] = -np.inf, np.inf
    return shot, np.stack([low, high])


def _kept_in(shot: Shot, box: DoubleArray, pivot: DoubleArray, basis: DoubleArray) -> Shot:
    """``shot`` from the nearest place of ``box`` (2, 3), looking at ``pivot`` (3,), upright."""
    place = basis @ np.array(shot.eye)
    kept = np.clip(place, box[0], box[1])
    if np.allclose(kept, place):
        return shot
    eye = basis.T @ kept
    distance = float(np.linalg.norm(pivot - eye))
    if distance < _NEAREST * shot.distance:
        return replace(shot, eye=_three(eye))
    forward = (pivot - eye) / distance
    right = np.cross(forward, basis[2])
    if np.linalg.norm(right) < 1e-6:  # straight down
        return replace(shot, eye=_three(eye), distance=distance)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(forward, right), forward])
    return replace(shot, eye=_three(eye), quat=_quat_of(turn), distance=distance)


# --- the curve


def _hermite(
    knots: DoubleArray, values: DoubleArray, times: DoubleArray, is_closed: bool
) -> DoubleArray:
    """Values (T, C) at ``times`` (T,) of the curve through ``values`` (K, C) at ``knots`` (K,)."""
    span = np.diff(knots)[:, None]
    slopes = np.diff(values, axis=0) / span
    if is_closed:  # the last row is the first one again, its quaternion perhaps of the other sign
        sign = np.ones(values.shape[1])
        sign[3:7] = 1.0 if values[0, 3:7] @ values[-1, 3:7] > 0 else -1.0
        before, after = slopes[-1] * sign, slopes[0] * sign
        first = _tangent(before, slopes[0], span[-1], span[0])
        last = _tangent(slopes[-1], after, span[-1], span[0])
    else:
        first, last = slopes[0], slopes[-1]
        if len(slopes) > 1:  # the ends turn as the parabola through three keyframes does
            first = slopes[0] + (slopes[0] - slopes[1]) * span[0] / (span[0] + span[1])
            last = slopes[-1] + (slopes[-1] - slopes[-2]) * span[-1] / (span[-1] + span[-2])
    inner = _tangent(slopes[:-1], slopes[1:], span[:-1], span[1:])
    tangents = np.concatenate([first[None], inner, last[None]])
    i = np.clip(np.searchsorted(knots, times, "right") - 1, 0, len(span) - 1)
    h = span[i]
    s = (times - knots[i])[:, None] / h
    return (
        (1 + 2 * s) * (1 - s) ** 2 * values[i]
        + s * (1 - s) ** 2 * h * tangents[i]
        + s**2 * (3 - 2 * s) * values[i + 1]
        + s**2 * (s - 1) * h * tangents[i + 1]
    )


def _tangent(
    before: DoubleArray, after: DoubleArray, h_before: DoubleArray, h_after: DoubleArray
) -> DoubleArray:
    """Slope at a keyframe between two segments: the parabola's through three keyframes."""
    return (before * h_after + after * h_before) / (h_before + h_after)


def _three(point: DoubleArray) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z


def _quat_of(turn: DoubleArray) -> tuple[float, float, float, float]:
    w, x, y, z = matrices_to_quats(turn[None])[0].tolist()
    return w, x, y, z


def carried_shot(shot: Shot, world: DoubleArray) -> Shot:
    """``shot`` moved by a similarity (4, 4), as `carried_camera` moves a camera."""
    if np.array_equal(world, np.eye(4)):
        return shot
    scale = scale_of(world)
    quat = _quat_of(shot.turn @ (world[:3, :3] / scale).T)
    eye = _three(world[:3, :3] @ np.array(shot.eye) + world[:3, 3])
    return replace(shot, eye=eye, quat=quat, distance=shot.distance * scale)


def carried_bookmarks(marks: Iterable[Bookmark], world: DoubleArray) -> tuple[Bookmark, ...]:
    """Bookmarks whose shots moved by a similarity (4, 4)."""
    return tuple(replace(mark, shot=carried_shot(mark.shot, world)) for mark in marks)


def carried_path(path: CameraPath, world: DoubleArray) -> CameraPath:
    """A camera path whose shots moved by a similarity (4, 4)."""
    keys = tuple(replace(key, shot=carried_shot(key.shot, world)) for key in path.keyframes)
    return replace(path, keyframes=keys)


# --- Bookmarks and the camera's path as JSON: entries of a project, or a file of their own.


_KIND = "gaga camera path"
_MOST_KEYFRAMES = 100_000
_Number = Annotated[float, msgspec.Meta(ge=-1e18, le=1e18)]
_Angle = Annotated[float, msgspec.Meta(gt=0, lt=math.pi)]


class ShotEntry(msgspec.Struct):
    """Pose of a camera, see `Shot`."""

    eye: tuple[_Number, _Number, _Number]
    quat: tuple[_Number, _Number, _Number, _Number]
    fov: tuple[_Angle, _Angle]
    distance: Annotated[float, msgspec.Meta(gt=0, le=1e18)]
    is_orthographic: bool = False

    def shot(self) -> Shot:
        """The shot; ``ValueError`` when it is none."""
        return Shot(self.eye, self.quat, *self.fov, self.distance, self.is_orthographic)


class BookmarkEntry(ShotEntry, kw_only=True):
    """A bookmark of a project."""

    name: str
    key: Annotated[int, msgspec.Meta(ge=0)] = 0


class KeyframeEntry(ShotEntry, kw_only=True):
    """A keyframe of a path."""

    seconds: Annotated[float, msgspec.Meta(ge=1e-3, le=1e6)]  # less vanishes in a sum


class PathEntry(msgspec.Struct):
    """A camera path: an entry of a project, or a file of its own."""

    keyframes: Annotated[list[KeyframeEntry], msgspec.Meta(max_length=_MOST_KEYFRAMES)]
    kind: str = _KIND
    format: int = 1
    is_closed: bool = False
    even_speed: bool = False


def bookmarks_entry(bookmarks: tuple[Bookmark, ...]) -> list[dict[str, object]]:
    """Bookmarks in a project."""
    return [{"name": b.name, "key": b.key, **_shot_entry(b.shot)} for b in bookmarks]


def bookmarks_of(content: object) -> tuple[Bookmark, ...]:
    """Bookmarks of a project's entry; what is none is left out."""
    found = []
    for item in content if isinstance(content, list) else ():
        try:
            entry = msgspec.convert(item, BookmarkEntry)
            found.append(Bookmark(entry.name, entry.shot(), entry.key if entry.key <= 9 else 0))
        except ValueError:  # msgspec's too
            continue
    return tuple(found)


def path_entry(path: CameraPath) -> dict[str, object]:
    """A path in a project or a file."""
    return {
        "kind": _KIND,
        "format": 1,
        "is_closed": path.is_closed,
        "even_speed": path.even_speed,
        "keyframes": [{"seconds": k.seconds, **_shot_entry(k.shot)} for k in path.keyframes],
    }


def path_of(content: object) -> CameraPath:
    """The path of an entry. Raises ``ValueError`` when it is none."""
    if not isinstance(content, Mapping) or content.get("kind") != _KIND:
        raise ValueError("no camera path")
    if content.get("format") != 1:
        raise ValueError("a camera path of a newer gaga-studio")
    try:
        entry = msgspec.convert(content, PathEntry)
    except msgspec.ValidationError as error:
        raise ValueError(explain_json_error(error)) from error
    keys = tuple(Keyframe(item.shot(), item.seconds) for item in entry.keyframes)
    return CameraPath(keys, entry.is_closed, entry.even_speed)


def save_path(path: CameraPath, file: Path) -> Path:
    """Write a path as a JSON file. Raises ``GagaError`` when the disk refuses it."""
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(path_entry(path), indent=1) + "\n", encoding="utf-8")
    return file


def load_path(file: Path) -> CameraPath:
    """Read a path file. Raises ``GagaError`` when it is none."""
    cure = "Save one in the window: Camera, Save path."
    content = read_json(Path(file), object, cure)
    try:
        return path_of(content)
    except ValueError as error:
        raise GagaError(f"{file} is not a camera path ({error}). {cure}") from error


def _shot_entry(shot: Shot) -> dict[str, object]:
    return {
        "eye": list(shot.eye),
        "quat": list(shot.quat),
        "fov": [shot.fov_x, shot.fov_y],
        "distance": shot.distance,
        "is_orthographic": shot.is_orthographic,
    }
