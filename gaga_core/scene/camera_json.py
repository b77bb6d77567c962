"""Bookmarks and the camera's path as JSON: entries of a project, or a file of their own."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.json_file import explain_json_error, read_json
from gaga_core.scene.camera_path import Bookmark, CameraPath, Keyframe, Shot

_KIND = "gaga camera path"
_MOST_KEYFRAMES = 100_000
_Number = Annotated[float, msgspec.Meta(ge=-1e18, le=1e18)]
_Angle = Annotated[float, msgspec.Meta(gt=0, lt=math.pi)]


class ShotEntry(msgspec.Struct):
    """Where a camera stands, see `Shot`."""

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

    seconds: Annotated[float, msgspec.Meta(gt=0, le=1e6)]


class PathEntry(msgspec.Struct):
    """A camera path: an entry of a project, or a file of its own."""

    keyframes: Annotated[list[KeyframeEntry], msgspec.Meta(max_length=_MOST_KEYFRAMES)]
    kind: str = _KIND
    format: int = 1
    is_closed: bool = False
    even_speed: bool = False


def bookmarks_entry(bookmarks: tuple[Bookmark, ...]) -> list[dict[str, object]]:
    """What a project keeps of bookmarks."""
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
    """What a project, or a file, keeps of a path."""
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
