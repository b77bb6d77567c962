"""Bookmarks and the camera's path as JSON: entries of a project, or a file of their own."""

import json
from collections.abc import Mapping
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.scene.camera_path import Bookmark, CameraPath, Keyframe, Shot

_KIND = "gaga camera path"


def bookmarks_entry(bookmarks: tuple[Bookmark, ...]) -> list[dict[str, object]]:
    """What a project keeps of bookmarks."""
    return [{"name": b.name, "key": b.key, **_shot_entry(b.shot)} for b in bookmarks]


def bookmarks_of(content: object) -> tuple[Bookmark, ...]:
    """Bookmarks of a project's entry; what is none is left out."""
    found = []
    for item in content if isinstance(content, list) else ():
        try:
            key = int(item.get("key", 0))
            name, shot = str(item["name"]), _shot_of(item)
        except (AttributeError, KeyError, TypeError, ValueError):
            continue
        found.append(Bookmark(name, shot, key if 0 <= key <= 9 else 0))
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
        items = content["keyframes"]
        keys = tuple(Keyframe(_shot_of(item), float(item["seconds"])) for item in items)
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"a keyframe is damaged ({error})") from error
    return CameraPath(keys, bool(content.get("is_closed")), bool(content.get("even_speed")))


def save_path(path: CameraPath, file: Path) -> Path:
    """Write a path as a JSON file. Raises ``GagaError`` when the disk refuses it."""
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(path_entry(path), indent=1) + "\n", encoding="utf-8")
    return file


def load_path(file: Path) -> CameraPath:
    """Read a path file. Raises ``GagaError`` when it is none."""
    try:
        content = json.loads(Path(file).read_text(encoding="utf-8"))
        return path_of(content)
    except OSError as error:
        raise GagaError(explain_os_error(error, file)) from error
    except ValueError as error:  # also of JSON and of text that is none
        raise GagaError(
            f"{file} is not a camera path ({error}). Save one in the window: Camera, Save path."
        ) from error


def _shot_entry(shot: Shot) -> dict[str, object]:
    return {
        "eye": list(shot.eye),
        "quat": list(shot.quat),
        "fov": [shot.fov_x, shot.fov_y],
        "distance": shot.distance,
        "is_orthographic": shot.is_orthographic,
    }


def _shot_of(item: Mapping[str, object]) -> Shot:
    x, y, z = _numbers(item["eye"], 3)
    w, i, j, k = _numbers(item["quat"], 4)
    fov_x, fov_y = _numbers(item["fov"], 2)
    (distance,) = _numbers([item["distance"]], 1)
    flat = bool(item.get("is_orthographic"))
    return Shot((x, y, z), (w, i, j, k), fov_x, fov_y, distance, flat)


def _numbers(content: object, n: int) -> list[float]:
    if not isinstance(content, list) or len(content) != n:
        raise ValueError(f"expected {n} numbers")
    return [float(value) for value in content]
