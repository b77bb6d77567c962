"""One document: a scene that was opened, its edits, and where they are saved.

A project is a folder (``SCENE/gaga``, or ``NAME.gaga`` next to a single NAME.ply) with

    project.json      which model (with a fingerprint), names of groups, which scene file
    scene-<id>.npz    the columns and tables of the scene, and the memory bank with its log

The model itself is never copied. A save writes a new scene file first and then replaces
project.json in one step, so a failure at any moment leaves the former save whole.
"""

import json
import logging
import re
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from uuid import uuid4

import numpy as np

from gaga_core import __version__
from gaga_core.arrays import AnyArray, IntArray, UInt8Array, check_shape
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import bank_arrays, bank_of, load_bank
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.files import atomic_write, explain_os_error, fingerprint
from gaga_core.io.scene_folder import SceneFolder, is_scene_folder, open_scene_folder
from gaga_core.io.sog import META, is_sog_meta
from gaga_core.io.splat_files import read_splats_stage
from gaga_core.progress import Progress, Stage
from gaga_core.scene.camera_json import bookmarks_entry, bookmarks_of, path_entry, path_of
from gaga_core.scene.camera_path import Bookmark, CameraPath
from gaga_core.scene.edits.append import with_added_stage
from gaga_core.scene.edits.groups import as_bytes
from gaga_core.scene.index_set import IndexSet
from gaga_core.scene.scene import RGB, Added, Placements, Scene

_FORMAT = 1
_FILE = "project.json"
_CURE = "Move project.json away to open the scene from the start."
_SCENE_FILE = re.compile(r"scene-[0-9a-f]{12}\.npz")

_log = logging.getLogger(__name__)


@dataclass(eq=False)
class Project:
    """What a window or command has open."""

    scene: Scene
    model_path: Path
    folder: SceneFolder | None = None  # None: a single .ply
    path: Path | None = None  # folder of the saved project; None: never saved
    model_fingerprint: str = ""  # of the model as it was opened
    bookmarks: tuple[Bookmark, ...] = ()
    film: CameraPath = field(default_factory=CameraPath)  # the camera's path

    @property
    def default_path(self) -> Path:
        """Where a first save goes."""
        if self.folder is not None:
            return self.folder.work
        path, n = self.model_path.with_suffix(".gaga"), 1
        while (path / _FILE).exists():  # a single .ply opens without edits: keep a former save
            n += 1
            path = self.model_path.with_suffix(f".{n}.gaga")
        return path


def open_path_stage(path: Path) -> Stage[Project]:
    """Open whatever a person chose: a scene folder, a file of splats, or a saved project.

    A scene folder that has a saved project is opened with its edits; else with the groups of the
    last association, if any. Raises ``GagaError`` with one sentence.
    """
    path = Path(path)
    if not path.exists():
        raise GagaError(f"{path} does not exist. Check the path.")
    saved = _saved_project(path)
    if saved is not None:
        return (yield from _open_saved(saved))
    path = path / META if is_sog_meta(path / META) else path
    if path.is_dir():
        yield Progress("Look at the folder", 0, 1, path.name)
        return (yield from _open_folder(open_scene_folder(path)))
    if path.suffix.lower() == ".json" and not is_sog_meta(path):
        raise GagaError(
            f"{path.name} is not a saved project. Choose a project.json of gaga-studio."
        )
    digest = fingerprint(path)
    gaussians = yield from read_splats_stage(path)
    scene = Scene.of(gaussians, _labels_of_columns(gaussians))
    return Project(scene, path, model_fingerprint=digest)


def save_project(project: Project, path: Path | None = None) -> Path:
    """Save all edits to ``path`` (default: where it was, else `Project.default_path`).

    Returns the folder and remembers it in ``project``. Raises ``GagaError`` when it cannot be
    written; the former save stays whole.
    """
    target = Path(path or project.path or project.default_path)
    target = target.parent if target.name == _FILE else target
    scene = project.scene
    arrays: dict[str, AnyArray] = {
        "labels": scene.labels,
        "state": scene.state,
        "placement": scene.placement,
        "source": scene.source,
        "matrix": scene.placements.matrix,
        "color": scene.placements.color,
        "opacity": scene.placements.opacity,
    }
    if scene.bank is not None:
        arrays |= {f"bank_{name}": array for name, array in bank_arrays(scene.bank).items()}
    if scene.confidence is not None:
        arrays["confidence"] = scene.confidence
    for i, kept in enumerate(scene.named_selections.values()):
        arrays[f"set_{i}"] = np.packbits(kept.mask())
        arrays[f"length_{i}"] = np.array(kept.n)
    name = f"scene-{uuid4().hex[:12]}.npz"
    document = {
        "format": _FORMAT,
        "gaga_studio": __version__,
        "model": _model_entry(project, target),
        "added": [_added_entry(item, target) for item in scene.added],
        "folder": _shown(project.folder.root, target) if project.folder else None,
        "scene": name,
        "names": {str(group): text for group, text in sorted(scene.names.items())},
        "colors": {str(group): list(rgb) for group, rgb in sorted(scene.colors.items())},
        "sets": list(scene.named_selections),
        "bookmarks": bookmarks_entry(project.bookmarks),
        "path": path_entry(project.film),
    }
    with atomic_write(target / name) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    try:
        with atomic_write(target / _FILE) as temporary:
            temporary.write_text(json.dumps(document, indent=2), encoding="utf-8")
    except GagaError:
        (target / name).unlink(missing_ok=True)
        raise
    for stale in target.glob("scene-*.npz"):
        if _SCENE_FILE.fullmatch(stale.name) and stale.name != name:
            with suppress(OSError):  # in use elsewhere: the next save removes it
                stale.unlink()
    project.path = target
    return target


def _saved_project(path: Path) -> Path | None:
    """The project.json that ``path`` means, if any."""
    candidates = (path, path / _FILE, path / "gaga" / _FILE)
    for file in candidates:
        if file.name == _FILE and file.is_file():
            return file
    return None


def _open_folder(folder: SceneFolder) -> Stage[Project]:
    if folder.model_path is None:
        raise GagaError(
            f"{folder.root} has photos but no splats (point_cloud.ply). Train a 3D Gaussian "
            "Splatting model of it first, or open its .ply file."
        )
    digest = fingerprint(folder.model_path)
    gaussians = yield from read_splats_stage(folder.model_path)
    scene = Scene.of(gaussians, _labels_of_columns(gaussians))
    labels = folder.work / "labels.npz"
    if labels.is_file():
        scene.labels, scene.confidence = _read_labels_npz(labels, len(gaussians))
        bank = folder.work / "bank.npz"
        scene.bank = load_bank(bank) if bank.is_file() else None
    return Project(scene, folder.model_path, folder, model_fingerprint=digest)


def _open_saved(file: Path) -> Stage[Project]:
    document = _read_document(file)
    entry = document["model"]
    model_path = _resolve(file.parent, str(entry["path"]))
    if not model_path.is_file():
        raise GagaError(
            f"The splats of this project are gone: {model_path}. Put the file back, or open "
            "another one."
        )
    if fingerprint(model_path) != entry["fingerprint"]:
        raise GagaError(
            f"{model_path} changed since this project was saved, so its edits do not fit. "
            f"Put the former file back, or move {file} away to open the model without edits."
        )
    shown = document.get("folder", "..")
    root = _resolve(file.parent, str(shown)) if shown else None
    folder = None
    if root is not None and is_scene_folder(root):
        yield Progress("Look at the folder", 0, 1, root.name)
        folder = replace(open_scene_folder(root), model_path=model_path)
    gaussians = yield from read_splats_stage(model_path)
    added = _added_of(document.get("added"), file.parent, len(gaussians))
    n_opened = len(gaussians)
    gaussians = yield from with_added_stage(gaussians, added)
    scene = _read_scene(file.parent / str(document["scene"]), gaussians, n_opened)
    scene.added = added
    scene.names = {int(group): str(text) for group, text in document["names"].items()}
    scene.colors = _colors_of(document.get("colors"))
    kept = [scene.named_selections[f"{i}"] for i in range(len(scene.named_selections))]
    scene.named_selections = dict(zip(map(str, document.get("sets", [])), kept, strict=False))
    return Project(
        scene,
        model_path,
        folder,
        file.parent,
        str(entry["fingerprint"]),
        bookmarks_of(document.get("bookmarks")),
        _film_of(document.get("path")),
    )


def _film_of(content: object) -> CameraPath:
    """The camera's path; none when the project is older, or its entry is damaged."""
    try:
        return path_of(content)
    except ValueError:
        return CameraPath()


def _colors_of(content: object) -> dict[int, RGB]:
    """List colors of groups; what is no color is left out, it is only a color."""
    colors: dict[int, RGB] = {}
    for group, rgb in content.items() if isinstance(content, dict) else ():
        if str(group).isdigit() and isinstance(rgb, list) and len(rgb) == 3:
            with suppress(TypeError, ValueError):
                colors[int(group)] = (float(rgb[0]), float(rgb[1]), float(rgb[2]))
    return colors


def _read_document(file: Path) -> dict[str, dict[str, object]]:
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        complete = {"format", "model", "scene", "names"} <= set(document)
        complete = complete and {"path", "fingerprint"} <= set(document["model"])
        names = document["names"] if complete else None
        complete = isinstance(names, dict) and all(group.isdigit() for group in names)
    except OSError as error:
        raise GagaError(explain_os_error(error, file)) from error
    except (ValueError, TypeError) as error:
        raise GagaError(
            f"{file} is damaged. Move it away to open the scene from the start."
        ) from error
    if not complete:
        raise GagaError(f"{file} is not a project of gaga-studio.")
    if document["format"] != _FORMAT:
        raise GagaError(f"{file} was saved by a newer gaga-studio. Update it to open the project.")
    result: dict[str, dict[str, object]] = document
    return result


def _read_scene(file: Path, gaussians: Gaussians, n_opened: int) -> Scene:
    arrays = read_arrays(file, _CURE)
    try:
        source = arrays["source"].astype(np.int64)
        n = len(source)
        for name in ("labels", "state", "placement"):
            check_shape(name, arrays[name], (n,))
        rows = len(arrays["opacity"])
        check_shape("matrix", arrays["matrix"], (rows, 3, 4))
        check_shape("color", arrays["color"], (rows, 3, 4))
        if source.min() < 0 or source.max() >= len(gaussians):
            raise ValueError("source row outside the model")
        if arrays["placement"].min() < 0 or arrays["placement"].max() >= rows:
            raise ValueError("placement row outside the table")
        bank = {k.removeprefix("bank_"): v for k, v in arrays.items() if k.startswith("bank_")}
        untouched = n == len(gaussians) and np.array_equal(source, np.arange(n))
        return Scene(
            gaussians=gaussians if untouched else gaussians.take(source),
            labels=arrays["labels"].astype(np.int32),
            state=arrays["state"].astype(np.uint8),
            placement=arrays["placement"].astype(np.int32),
            source=source,
            placements=Placements(arrays["matrix"], arrays["color"], arrays["opacity"]),
            bank=bank_of(bank) if bank else None,
            confidence=_read_confidence(arrays, n_opened),
            named_selections=_read_named_selections(arrays),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise GagaError(f"{file} is damaged. {_CURE}") from error


def _read_confidence(arrays: dict[str, AnyArray], n_gaussians: int) -> UInt8Array | None:
    column = arrays.get("confidence")
    if column is not None:
        check_shape("confidence", column, (n_gaussians,), np.uint8)
    return column


def _read_named_selections(arrays: dict[str, AnyArray]) -> dict[str, IndexSet]:
    """Named selections, by number."""
    sets: dict[str, IndexSet] = {}
    while f"set_{len(sets)}" in arrays:
        i = len(sets)
        n = int(arrays[f"length_{i}"])
        rows = np.flatnonzero(np.unpackbits(arrays[f"set_{i}"], count=n))
        sets[str(i)] = IndexSet.of(rows, n)
    return sets


def _read_labels_npz(path: Path, n_gaussians: int) -> tuple[IntArray, UInt8Array | None]:
    """Groups (N,) and their confidence (N,), if it is there."""
    cure = "Run Associate again, or remove it."
    arrays = read_arrays(path, cure)
    labels = arrays.get("labels", np.zeros(0, np.float32))
    confidence = arrays.get("confidence")
    is_right = labels.ndim == 1 and labels.dtype.kind in "iu"
    if confidence is not None:
        is_right &= confidence.shape == labels.shape and confidence.dtype.kind == "f"
    if not is_right:
        raise GagaError(f"{path} is damaged. {cure}")
    if len(labels) != n_gaussians:
        raise GagaError(
            f"{path} is of another model ({len(labels):,} splats, not {n_gaussians:,}). "
            "Run Associate again, or remove it."
        )
    sure = None if confidence is None else as_bytes(confidence)
    return np.ascontiguousarray(labels, np.int32), sure


def _labels_of_columns(gaussians: Gaussians) -> IntArray | None:
    """Group ids that the file itself carries in a column ``group``."""
    column = gaussians.extra.get("group")
    if column is None or column.dtype.kind not in "iu":
        return None
    return np.maximum(column.astype(np.int64), 0).astype(np.int32)


def _model_entry(project: Project, target: Path) -> dict[str, object]:
    if not project.model_fingerprint:
        project.model_fingerprint = fingerprint(project.model_path)
    elif not project.model_path.is_file() or (
        fingerprint(project.model_path) != project.model_fingerprint
    ):
        _log.warning(
            "%s went or changed since it was opened: keep a copy of the former file, the saved "
            "project needs it",
            project.model_path,
        )
    return {
        "path": _shown(project.model_path, target),
        "fingerprint": project.model_fingerprint,
        "gaussians": project.scene.n_opened,
    }


def _added_entry(item: Added, target: Path) -> dict[str, object]:
    return {
        "path": _shown(Path(item.path), target),
        "fingerprint": item.fingerprint,
        "gaussians": item.n,
    }


def _added_of(content: object, base: Path, n_opened: int) -> tuple[Added, ...]:
    """Files whose splats were added; none in older projects."""
    added: list[Added] = []
    first = n_opened
    try:
        for item in content if isinstance(content, list) else ():
            path, n = _resolve(base, str(item["path"])), int(item["gaussians"])
            added.append(Added(str(path), str(item["fingerprint"]), first, n))
            first += n
    except (KeyError, TypeError, ValueError) as error:
        raise GagaError(f"{base / _FILE} is damaged. {_CURE}") from error
    return tuple(added)


def _shown(path: Path, target: Path) -> str:
    """``path`` as the project writes it: relative within the scene, so that it survives moving the
    whole folder; absolute when it is far away."""
    path, base = path.resolve(), target.resolve()
    near = path.is_relative_to(base.parent)
    return (Path("..") / path.relative_to(base.parent) if near else path).as_posix()


def _resolve(base: Path, shown: str) -> Path:
    path = Path(shown)
    return path if path.is_absolute() else (base / path).resolve()
