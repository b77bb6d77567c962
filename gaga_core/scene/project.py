"""One document: a scene that was opened, its edits, and where they are saved.

A project is a folder (``SCENE/gaga``; or ``NAME.gaga``: next to a single NAME.ply, or in the folder
NAME of exported objects) with

    project.json      which model (with a fingerprint), names of groups, folders, which scene file
    scene-<id>.npz    the columns and tables of the scene, and the memory bank with its log

The model itself is not copied, unless it changed since it was opened and the caller asks for it;
files of splats that were added are, as added-<digest>/NAME. A save writes a new scene file first
and then replaces project.json in one step, so a failure at any moment leaves the former save whole.
Only one program writes at a time, and none over a save that it does not know.
"""

import json
import re
import shutil
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated
from uuid import uuid4

import msgspec
import numpy as np

from gaga_core.arrays import MOST_GROUP, AnyArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import bank_arrays, bank_digest, bank_of, load_bank, read_labels
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.identity.classifier_io import CLASSIFIER_FILE, field_of_model
from gaga_core.identity.field import FILE as IDENTITY_FILE
from gaga_core.identity.field import LABELLING, encoding_colors
from gaga_core.io.arrays_file import Column, checked, damage, read_arrays, read_columns
from gaga_core.io.files import atomic_write, explain_os_error, fingerprint, is_file
from gaga_core.io.folder.lock import lock_folder
from gaga_core.io.folder.scene_folder import (
    SCENE_INPUTS,
    SceneFolder,
    is_scene_folder,
    open_scene_folder,
)
from gaga_core.io.json_file import PathText, decode_json, read_json
from gaga_core.io.splats.packing import READS
from gaga_core.io.splats.ply import write_ply
from gaga_core.io.splats.sog import LOD_META, META, is_sog_meta, is_streamed_sog
from gaga_core.io.splats.splat_files import (
    files_of_model,
    is_same_model,
    model_fingerprint,
    read_splats_stage,
)
from gaga_core.io.splats.spz import OURS, SilentAxes
from gaga_core.progress import Progress, Stage, part, portion
from gaga_core.scene.camera_path import (
    Bookmark,
    CameraPath,
    bookmarks_entry,
    bookmarks_of,
    carried_path,
    path_entry,
    path_of,
)
from gaga_core.scene.edits.objects import as_bytes
from gaga_core.scene.edits.splats import with_added_stage
from gaga_core.scene.edits.values import joined, read_added_stage
from gaga_core.scene.export_manifest import MANIFEST, is_manifest, manifests_in, read_manifest
from gaga_core.scene.folders import Folders
from gaga_core.scene.frame import Frame, carried_cameras
from gaga_core.scene.index_set import IndexSet
from gaga_core.scene.named_arrays import (
    PLACEMENTS,
    columns_of,
    identities_of,
    identity_arrays,
    placements_of,
    splats_of,
)
from gaga_core.scene.objects import group_colors
from gaga_core.scene.orientation import guess_up, up_of_moved, up_of_turned
from gaga_core.scene.scene import RGB, Added, Identities, Labelling, Scene, Weight
from gaga_core.version import __version__

# --- The file project.json: its fields, and reading it while another program may replace it.


FORMAT = 1
PROJECT_FILE = "project.json"
SUFFIX = ".gaga"  # of a project that is not in a scene folder
CURE = "Move project.json away to open the scene from the start."
READS_OBJECTS = "Read the objects"  # of a folder of exported ones
_TRIES, _PAUSE_S = 50, 0.02  # a writer removes the former scene file right after the new note
_SCENE_FILE = r"^scene-[0-9a-f]{12}\.npz$"
_PATIENCE_S = 10.0  # for another program that is saving

Group = Annotated[str, msgspec.Meta(pattern="^[0-9]{1,8}$")]  # id of a group
Rows = Annotated[int, msgspec.Meta(ge=0, lt=1 << 31)]


class FileEntry(msgspec.Struct, frozen=True):
    """A file of splats that the project needs."""

    path: PathText  # relative to the project's folder, or absolute; "": splats that an edit made
    fingerprint: str
    gaussians: Rows = 0
    # As which an .spz is read that does not say its axes; projects without this took RUB.
    axes: SilentAxes = "RUB"
    # Of added splats: how the scene had been moved by then, rows of (4, 4); none: not at all.
    frame: tuple[tuple[float, float, float, float], ...] = ()
    merged: bool = False  # splats that an edit made of others, which it deleted


class ProjectFile(msgspec.Struct, frozen=True):
    """Content of project.json. ``bookmarks``, ``path`` and ``colors`` are checked entry by entry:
    what is damaged there is left out, it is no edit of the scene."""

    format: int
    model: FileEntry
    scene: Annotated[str, msgspec.Meta(pattern=_SCENE_FILE)]
    names: dict[Group, str]
    called: dict[Group, str] = {}  # what others were called: it stays where it is still true
    gaga_studio: str = ""
    added: list[FileEntry] = []
    folder: PathText | None = ".."
    manifest: PathText = ""  # groups.json whose files are all open; "": one file, or a folder
    colors: object = None
    weights: dict[Group, Weight] = {}
    folders: list[str] = []  # of the object list
    in_folder: dict[Group, str] = {}
    parents: dict[Group, Annotated[int, msgspec.Meta(gt=0, le=MOST_GROUP)]] = {}
    sets: list[str] = []
    bookmarks: object = None
    path: object = None
    masks: str = ""  # name of the masks that the objects are of


class _Head(msgspec.Struct, frozen=True):
    format: int


class _SceneName(msgspec.Struct, frozen=True):
    scene: str


def read_project_file(file: Path) -> tuple[ProjectFile, dict[str, AnyArray]]:
    """Read project.json and the columns and tables of its scene file, which belong together.

    Reads again when another program saved in between. Raises ``GagaError`` with one sentence.
    """
    document = _document(file)
    for _ in range(_TRIES):
        scene = file.parent / document.scene
        try:
            return document, read_arrays(scene, CURE)
        except GagaError:
            if scene.is_file():
                raise
        time.sleep(_PAUSE_S)
        document = _document(file)
        if file.parent / document.scene == scene and not scene.is_file():
            break
    raise GagaError(f"{file.parent / document.scene} of the saved project is gone. {CURE}")


def saved_scene(folder: Path) -> str:
    """Name of the scene file that the project saved in ``folder`` has now; "" when there is none.

    A project.json that cannot be read counts as none of ours: "?".
    """
    file = folder / PROJECT_FILE
    if not file.exists():
        return ""
    try:
        return read_json(file, _SceneName, "").scene
    except GagaError:
        return "?"


def _document(file: Path) -> ProjectFile:
    if read_json(file, _Head, CURE).format > FORMAT:
        raise GagaError(f"{file} was saved by a newer gaga-studio. Update it to open the project.")
    return read_json(file, ProjectFile, CURE)


# --- Columns and tables of a scene as named arrays: the file scene-<id>.npz of a project.


def scene_arrays(scene: Scene) -> dict[str, AnyArray]:
    """All that a project keeps of a scene in arrays. No pickles."""
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
    arrays |= identity_arrays(scene.identities)
    if not scene.frame.is_identity:
        arrays["world"] = scene.frame.world
        arrays["is_metric"] = np.array(scene.frame.is_metric)
    for i, kept in enumerate(scene.named_selections.values()):
        arrays[f"set_{i}"] = np.packbits(kept.mask())
        arrays[f"length_{i}"] = np.array(kept.n)
    # No file has the splats that edits made, so their columns are kept.
    made = [item for item in scene.added if item.is_made]
    sources, places = np.unique(scene.source, return_index=True) if made else (scene.source,) * 2
    for i, item in enumerate(made):
        first, end = np.searchsorted(sources, (item.first, item.first + item.n))
        columns = columns_of(scene.gaussians.take(places[first:end]))
        arrays |= {f"made_{i}:{name}": column for name, column in columns.items()}
    return arrays


# N splats of the scene, P placements, M splats of the opened file, F of all files.
_SCENE = {
    "labels": Column(np.int32, ("N",), low=0, high=MOST_GROUP),
    "state": Column(np.uint8, ("N",)),
    "placement": Column(np.int32, ("N",), low=0, below="P"),
    "source": Column(np.int64, ("N",), low=0, below="F"),
    **PLACEMENTS,
    "confidence": Column(np.uint8, ("M",), optional=True),
    "world": Column(np.float64, (4, 4), optional=True),
    "is_metric": Column(np.bool_, optional=True),
}


def made_of(file: Path, arrays: dict[str, AnyArray], n: int) -> list[Gaussians]:
    """The ``n`` sets of splats that edits made. Raises ``GagaError`` that names ``file``."""
    found = []
    with damage(file, CURE):
        for i in range(n):
            found.append(splats_of(_part(arrays, f"made_{i}:")))
    return found


def _part(arrays: dict[str, AnyArray], head: str) -> dict[str, AnyArray]:
    """The arrays whose names begin with ``head``, without it."""
    return {k.removeprefix(head): v for k, v in arrays.items() if k.startswith(head)}


def scene_of(file: Path, arrays: dict[str, AnyArray], gaussians: Gaussians, n_opened: int) -> Scene:
    """The scene of `scene_arrays`, on the splats (M,) of all its files.

    ``n_opened`` splats are of the opened file. Raises ``GagaError`` that names ``file`` when the
    arrays do not fit each other or the splats.
    """
    with damage(file, CURE):
        own = checked(arrays, _SCENE, M=n_opened, F=len(gaussians))
        source, n = own["source"], len(own["source"])
        if not np.array_equal(source[:n_opened], np.arange(n_opened)):
            raise ValueError("source: the splats of the opened file do not come first")
        bank = _part(arrays, "bank_")
        frame = Frame(own["world"], bool(own["is_metric"])) if "world" in own else Frame()
        sets: dict[str, IndexSet] = {}  # named selections, by number
        while (name := f"set_{len(sets)}") in arrays:
            length = f"length_{len(sets)}"
            spec = {name: Column(np.uint8, ("bytes",)), length: Column(np.int64, low=0, high=n)}
            found = checked(arrays, spec)
            bits, count = found[name], int(found[length])
            if len(bits) != -(-count // 8):
                raise ValueError(f"{name}: {len(bits)} bytes for {count} splats")
            kept = np.flatnonzero(np.unpackbits(bits, count=count))
            sets[f"{len(sets)}"] = IndexSet.of(kept, count)
        untouched = n == len(gaussians) and np.array_equal(source, np.arange(n))
        return Scene(
            gaussians=gaussians if untouched else gaussians.take(source),
            labels=own["labels"],
            state=own["state"],
            placement=own["placement"],
            source=source,
            placements=placements_of(own),
            bank=bank_of(bank) if bank else None,
            confidence=own.get("confidence"),
            identities=identities_of(arrays, M=n_opened),
            named_selections=sets,
            frame=frame,
        )


# --- Files of splats that other programs changed: noticed at every save, and replaced by a copy.


File = tuple[Path, str]  # and the fingerprint of its content


@dataclass(eq=False)
class KnownCopies:
    """Copies that saves have written, and a folder of files that will be removed."""

    files: dict[tuple[Path, str], File] = field(default_factory=dict)  # by folder, fingerprint
    leaving: Path | None = None  # an autosave: files of splats in it are copied as if changed


class ModelChangedError(GagaError):
    """A file of splats is not the one that was opened."""

    def __init__(self, path: Path) -> None:
        what = "was changed by another program" if path.is_file() else "is gone"
        super().__init__(
            f"{path} {what} since it was opened, so a project that names it could not be opened "
            "again. Save with a copy of the splats as they were opened."
        )
        self.path = path


def has_changed(wanted: File) -> bool:
    """Whether a file is not there or has another content than its fingerprint says."""
    path, digest = wanted
    return not is_file(path) or not is_same_model(path, digest)


def current_file(
    wanted: File, target: Path, scene: Scene, rows: tuple[int, int] | None, known: KnownCopies
) -> File:
    """The file that a project in ``target`` must name, where ``wanted`` was opened.

    The file itself when it is as it was and stays, else a copy of it in ``target``: one that
    ``known`` has, or a new .ply of the splats ``rows`` (first, end; rows of all files,
    `Scene.source`).
    Raises ``ModelChangedError`` when a copy is needed and ``rows`` is None.
    """
    copied = known.files.get((target, wanted[1]))
    leaves = known.leaving is not None and wanted[0].is_relative_to(known.leaving)
    for file in (None if leaves else wanted, copied):
        if file is not None and not has_changed(file):
            return file
    if rows is None:
        raise ModelChangedError(wanted[0])
    sources, places = np.unique(scene.source, return_index=True)
    first, end = np.searchsorted(sources, rows)
    path = target / f"model-{uuid4().hex[:12]}.ply"
    write_ply(path, scene.gaussians.take(places[first:end]))
    known.files[target, wanted[1]] = path, fingerprint(path)
    return known.files[target, wanted[1]]


# --- The groups with which a model opens: of the last association, or those that its file carries.
# After an association and a lift there are two labels for every Gaussian: the votes of the masks,
# and the classifier on its identity encoding. The presets paper and released take those of the
# classifier once it is trained as published; otherwise votes are in use. The other ones wait in
# `scene.Identities`.


@dataclass(frozen=True, eq=False)
class OpenedGroups:
    """Initial values of a scene; fields of `Scene`."""

    labels: IntArray  # (N,)
    confidence: UInt8Array | None  # (N,) 0..255
    bank: MemoryBank | None = None
    identities: Identities = field(default_factory=Identities)


def groups_of_folder(work: Path, n_gaussians: int) -> OpenedGroups:
    """The groups of the last association in ``work`` (SCENE/gaga), which has a labels.npz.

    Labels come from the identities where they were trained as published from groups of a published
    preset, else from the votes. Raises ``GagaError`` when a file is damaged or of another model.
    """
    votes = read_labels(work / "labels.npz", n_gaussians)
    labels, sure = votes["labels"], votes.get("confidence")
    confidence, path = None if sure is None else as_bytes(sure), work / "bank.npz"
    bank = load_bank(path, N=n_gaussians) if path.is_file() else None
    found = _lifted(work, bank, n_gaussians)
    if found is None:
        return OpenedGroups(labels, confidence, bank)
    lifted, colors, mode = found
    if bank is not None and bank.is_published and mode == "paper":
        identities = Identities("identities", Labelling(labels, confidence), colors)
        return OpenedGroups(lifted.labels, lifted.confidence, bank, identities)
    return OpenedGroups(labels, confidence, bank, Identities("votes", lifted, colors))


def _lifted(
    work: Path, bank: MemoryBank | None, n_gaussians: int
) -> tuple[Labelling, UInt8Array | None, str] | None:
    """Labels, colors (N, 3) and mode of the last lift; None where it is of other groups."""
    path = work / IDENTITY_FILE
    if not path.is_file() or path.stat().st_mtime_ns < (work / "labels.npz").stat().st_mtime_ns:
        return None
    cure = "Lift the groups again, or remove it."
    digest = str(read_columns(path, cure, {"bank": LABELLING["bank"]}).get("bank", ""))
    if digest and (bank is None or digest != bank_digest(bank)):
        return None
    columns = LABELLING | {"labels": _SCENE["labels"]}
    arrays = read_columns(path, cure, columns, N=n_gaussians)
    labelling = Labelling(arrays["labels"], as_bytes(arrays["confidence"]))
    return labelling, arrays.get("colors"), str(arrays["mode"])


def groups_of_file(gaussians: Gaussians, path: Path) -> OpenedGroups:
    """Groups (N,) and confidence (N,) 0..255 that the file of splats at ``path`` carries.

    A column ``group``; else the argmax, over each encoding, of the classifier that Gaussian
    Grouping and Gaga train, with the softmax as its confidence; else none: all 0. Raises
    ``GagaError`` when the classifier is damaged.
    """
    column = gaussians.extra.get("group")
    if column is not None and column.dtype.kind in "iu":
        groups = np.maximum(column, 0)
        if groups.max(initial=0) > MOST_GROUP:  # numbered anew, 0 is still none
            groups = np.unique(np.append(groups, 0), return_inverse=True)[1][:-1]
        return OpenedGroups(groups.astype(np.int32), None)
    try:
        classifier = field_of_model(gaussians, path)
    except GagaError as error:
        raise GagaError(
            f"{error} Or move {CLASSIFIER_FILE} away to open the splats without groups."
        ) from error
    if classifier is None:
        return OpenedGroups(np.zeros(len(gaussians), np.int32), None)
    labels, confidence = classifier.classify(classifier.encodings)
    identities = Identities(colors=encoding_colors(classifier.encodings))
    return OpenedGroups(labels, as_bytes(confidence), None, identities)


# --- Open exported objects again: the files that groups.json names, with names, colors and order.


_NO_SPLATS = ("mesh", "collider", "box", "html")  # forms, as the manifest names them


def manifest_in(path: Path) -> Path | None:
    """The manifest that ``path``, a file or a folder, means; None when it means none.

    Of a folder with several exports: the first whose files are splats.
    """
    files = manifests_in(path) if path.is_dir() else [path] if is_manifest(path) else []
    for file in files if len(files) > 1 else ():
        with suppress(GagaError):
            if read_manifest(file).form not in _NO_SPLATS:
                return file
    return next(iter(files), None)


def open_objects_stage(manifest: Path) -> Stage[tuple[Scene, Path, str]]:
    """Read all objects of an export as one scene, the first file as the one that was opened.

    Returns the scene, that file and its fingerprint. Ids, names, colors, folders and parents are
    those of the export. Raises ``GagaError`` when the manifest is damaged, names nothing, or a file
    is gone.
    """
    content = read_manifest(manifest)
    entries = content.groups
    if content.form in _NO_SPLATS:
        raise GagaError(
            f"{manifest.parent} holds objects as {content.form}, which has no splats. Open the "
            "scene that they are of, or export them as splats."
        )
    if not entries:
        raise GagaError(f"{manifest} names no objects, so there is nothing to open.")
    if not all(0 < entry.id <= MOST_GROUP for entry in entries):
        raise GagaError(f"{manifest} is damaged: an id of an object cannot be. Export them again.")
    parts: list[Gaussians] = []
    digests: list[str] = []
    files = [(manifest.parent / entry.file).absolute() for entry in entries]
    for i, file in enumerate(files):
        if not file.is_file():
            raise GagaError(f"{file} is gone, which {manifest.name} names. Put it back.")
        splats, digest = yield from part(read_added_stage(file), i, len(files), READS_OBJECTS)
        parts.append(splats)
        digests.append(digest)
    counts = [len(splats) for splats in parts]
    ids = np.array([entry.id for entry in entries], np.int32)
    scene = Scene.of(_all_joined(parts), np.repeat(ids, counts))
    starts = np.cumsum([0, *counts[:-1]]).tolist()
    origins = zip(map(str, files), digests, starts, counts, strict=True)
    scene.added = tuple(Added(*origin) for origin in origins)[1:]
    colors: dict[int, RGB] = {}  # that are not the usual ones
    for entry, usual in zip(entries, group_colors(ids), strict=True):
        red, green, blue = (min(max(value, 0.0), 1.0) for value in entry.color)
        if np.abs(np.array((red, green, blue)) - usual).max() > 1e-3:
            colors[entry.id] = (red, green, blue)
    names = {entry.id: " ".join(entry.name.split()) for entry in entries}
    scene.names = {g: name for g, name in sorted(names.items()) if name not in ("", f"group {g}")}
    scene.colors = dict(sorted(colors.items()))
    parents = {entry.id: entry.parent for entry in entries if entry.parent in names}
    try:
        scene.folders = Folders.of((), {entry.id: entry.folder for entry in entries}, parents)
    except ValueError as error:
        raise GagaError(f"{MANIFEST} is damaged ({error}). Export the objects again.") from error
    return scene, files[0], digests[0]


def _all_joined(parts: Sequence[Gaussians]) -> Gaussians:
    """All splats as one set, in order: pairs first, so that none is copied often."""
    if len(parts) == 1:
        return parts[0]
    middle = len(parts) // 2
    return joined(_all_joined(parts[:middle]), _all_joined(parts[middle:]))


class SavedElsewhereError(GagaError):
    """Another program saved to the same place since this project was opened, or another project is
    there."""


def _of_training(folder: SceneFolder | None) -> tuple[Camera, ...]:
    if folder is None:
        return ()
    train = set(folder.train)
    named = tuple(camera for camera in folder.cameras if camera.name in train)
    return named or folder.cameras


@dataclass(eq=False)
class Project:
    """The document that a window or command has open."""

    scene: Scene
    model_path: Path
    folder: SceneFolder | None = None  # None: a single .ply, or all files of a manifest
    path: Path | None = None  # folder of the saved project; None: never saved
    model_fingerprint: str = ""  # of the model as it was opened
    model_axes: SilentAxes = OURS  # of an .spz that does not say its own
    manifest: Path | None = None  # groups.json: all objects that it names were opened as one scene
    # Both in the frame in which the scene was opened, see `gaga_core.scene.frame`.
    bookmarks: tuple[Bookmark, ...] = ()
    film: CameraPath = field(default_factory=CameraPath)  # the camera's path
    bank_masks: str = ""  # name of the masks that the objects are of; "": not known
    # Both are shared by copies of this value, which are what a save works on.
    known_saves: set[str] = field(default_factory=set)  # scene files read or written by this one
    copies: KnownCopies = field(default_factory=KnownCopies)  # of files that changed

    @property
    def placed_folder(self) -> SceneFolder | None:
        """The scene folder with its cameras where they stand around the edited splats."""
        if self.folder is None:
            return None
        cameras = carried_cameras(self.folder.cameras, self.scene.frame.world)
        return replace(self.folder, cameras=cameras)

    @property
    def opened_views(self) -> tuple[Camera, ...]:
        """`training_views` in the frame in which the scene was opened."""
        return _of_training(self.folder)

    @property
    def training_views(self) -> tuple[Camera, ...]:
        """Cameras whose photos made the splats, around the edited ones; all where none are named.

        () without a scene folder.
        """
        return _of_training(self.placed_folder)

    @property
    def up(self) -> tuple[float, float, float]:
        """Which way is up (3,), unit, around the edited splats: cameras say, else the splats."""
        opened, placed, world = self.folder, self.placed_folder, self.scene.frame.world
        if opened is not None and placed is not None and opened.cameras:
            up = up_of_moved(opened.cameras, placed.cameras, opened.up, world)
        else:
            up = up_of_turned(guess_up(self.scene.gaussians), world)
        x, y, z = (float(value) for value in up)
        return x, y, z

    @property
    def placed_film(self) -> CameraPath:
        """The camera path among the edited splats."""
        return carried_path(self.film, self.scene.frame.world)

    @property
    def source(self) -> Path:
        """What was opened: the scene folder, the manifest of exported objects, or the file."""
        return self.folder.root if self.folder is not None else self.manifest or self.model_path

    @property
    def name(self) -> str:
        """Name of what was opened: of the folder, or of the file."""
        path = self.source
        if path.name in ("", ".."):  # the window asks in every frame: no look at the disk but here
            path = path.resolve()
        if path.name == META or (self.source == self.manifest and path.name == MANIFEST):
            return path.absolute().parent.name  # the one of these in a folder is what the folder is
        return path.name

    @property
    def stem(self) -> str:
        """`name` without the ending of a file."""
        is_file_name = self.folder is None and self.name == self.source.name
        return Path(self.name).stem if is_file_name else self.name

    @property
    def saves_to(self) -> Path:
        """Path that a save writes: where it was, else `default_path`."""
        return self.path or self.default_path

    @property
    def default_path(self) -> Path:
        """Path of the first save."""
        # A single .ply opens without edits: keep a former save.
        return self._free_path()[0] if self.folder is None else self.folder.work

    @property
    def first_path(self) -> Path:
        """Path of the first project that is saved of the files that are open."""
        if self.folder is not None:
            return self.folder.work
        if self.manifest is None:
            return self.model_path.with_suffix(SUFFIX)
        return self.manifest.with_name(self.stem + SUFFIX)

    @property
    def saved_of_file(self) -> Path | None:
        """The project that was saved last of the file, or of the manifest, that is open.

        None without one, and of a scene folder; one that was saved before the file was renamed
        counts where none has its name. Files of the same name in two formats, and a
        manifest and a file that it names, have projects of their own.
        """
        if self.folder is not None or self.path is not None:
            return None
        former = [path for path in self._free_path()[1] if self._is_source_of(path)]
        if former or self.manifest is not None:
            return former[-1] if former else None
        others = sorted(self.model_path.parent.glob(f"*{SUFFIX}"))
        return next((path for path in others if self._was_source_of(path)), None)

    def opened_again_by(self, path: Path) -> Path:
        """The one path, of all that open this as ``path`` did, that a list of scenes names.

        A folder stands for the files in it: a scene's, a saved project's, a SOG's.
        """
        folder, saved = self.folder, self.path
        if folder is not None and (saved is None or saved.resolve() == folder.work.resolve()):
            return folder.root
        if saved is not None:
            return saved
        return listed_path(path)

    def _free_path(self) -> tuple[Path, list[Path]]:
        """Path of the next save of what is open, and those of former ones of this name."""
        former: list[Path] = []
        path = first = self.first_path
        while (path / PROJECT_FILE).exists():
            former.append(path)
            path = first.with_suffix(f".{len(former) + 1}{SUFFIX}")
        return path, former

    def _is_source_of(self, saved: Path) -> bool:
        """Whether the project in ``saved`` was made of what is open; False if it cannot be read."""
        try:
            document = _document(saved / PROJECT_FILE)
        except GagaError:
            return False
        if self.manifest is not None or document.manifest:
            of = _resolve(saved, document.manifest) if document.manifest else None
            return self.manifest is not None and of == self.manifest.resolve()
        model = _resolve(saved, document.model.path)
        return model.parent == saved.resolve() or model == self.model_path.resolve()

    def _was_source_of(self, saved: Path) -> bool:
        """Whether the project in ``saved`` is of this file under another name that it had."""
        if not is_saved_of(self, saved):
            return False
        document = _document(saved / PROJECT_FILE)
        return not document.manifest and not is_file(_resolve(saved, document.model.path))


def listed_path(path: Path) -> Path:
    """``path`` as a list of scenes names it: the folder, if the file is what the folder means."""
    is_inside = path.suffix == ".json" and meant_in(path.parent) == path
    return path.parent if is_inside else path


def meant_in(path: Path) -> Path | None:
    """The file that says what ``path`` is, so that pictures next to it are no photos.

    A saved project's, a SOG's, a streamed SOG's, or the manifest of exported objects; None without.
    """
    for saved in (path, path / PROJECT_FILE, path / "gaga" / PROJECT_FILE):
        if saved.name == PROJECT_FILE and saved.is_file():
            return saved
    if is_sog_meta(path / META):
        return path / META
    if is_streamed_sog(path / LOD_META):
        return path / LOD_META
    return None if is_scene_folder(path) else manifest_in(path)


def open_path_stage(path: Path) -> Stage[Project]:
    """Open a path that a person chose: a scene folder, splats, a saved project, exported objects.

    A scene folder that has a saved project is opened with its edits; else with the groups of the
    last association, else with those that the model itself carries (`opened_labels`). Raises
    ``GagaError`` with one sentence.
    """
    path = Path(path)
    if not path.exists():
        raise GagaError(f"{path} does not exist. Check the path.")
    path = meant_in(path) or path
    if path.name == PROJECT_FILE:
        return (yield from _open_saved(path))
    if is_manifest(path):
        return (yield from _open_objects(path))
    if path.is_dir():
        return (yield from _open_folder(path))
    if path.suffix.lower() == ".json" and not (is_sog_meta(path) or is_streamed_sog(path)):
        raise GagaError(
            f"{path.name} is not a saved project. Choose a project.json of gaga-studio."
        )
    return (yield from _open_model(path))


def _open_objects(manifest: Path) -> Stage[Project]:
    scene, first, digest = yield from open_objects_stage(manifest)
    return Project(scene, first, model_fingerprint=digest, manifest=manifest.absolute())


def _opened_groups(gaussians: Gaussians, path: Path, folder: SceneFolder | None) -> OpenedGroups:
    if folder is not None and (folder.work / "labels.npz").is_file():
        return groups_of_folder(folder.work, len(gaussians))
    return groups_of_file(gaussians, path)


def decided_groups(project: Project) -> IntArray:
    """Ids, ascending, of groups that a person made, merged or split, or moved splats or masks of.

    They are other rows of the opened file than those that were found, or with which it opened. A
    published preset and identities do not tell which rows they found: there, what no mask names.
    Raises ``GagaError`` when the file with which it opened is damaged.
    """
    scene = project.scene
    n, bank = scene.n_opened, scene.bank
    labels, of_masks = scene.labels[:n], np.zeros(0, np.int32)
    if bank is None:
        gaussians = scene.gaussians if n == len(scene) else scene.gaussians.take(np.arange(n))
        before = _opened_groups(gaussians, project.model_path, project.folder).labels
    else:
        of_masks = np.array([d.group for d in bank.log if d.by_hand], np.int32)
        before = np.maximum(bank.group, 0)
        if bank.is_published or scene.identities.source == "identities":
            named = np.array([decision.group for decision in bank.log], np.int32)
            before = np.where(np.isin(labels, named), labels, np.int32(0))
    moved = labels != before
    return np.intersect1d(
        np.concatenate([labels[moved], before[moved], of_masks]), labels[labels > 0]
    )


def _open_model(path: Path, folder: SceneFolder | None = None) -> Stage[Project]:
    digest = model_fingerprint(path)
    gaussians = yield from read_splats_stage(path)
    groups = _opened_groups(gaussians, path, folder)
    frame = Frame(is_metric=gaussians.is_metric or (folder is not None and folder.is_metric))
    scene = replace(Scene.of(gaussians), frame=frame, **vars(groups))
    return Project(scene, path, folder, model_fingerprint=digest)


def is_saved_still(project: Project) -> bool:
    """Whether ``project`` was saved, and what was saved fits the splats as they are on disk now."""
    if project.path is None or not saved_scene(project.path):
        return False
    try:
        _model_of(project.path / PROJECT_FILE, _document(project.path / PROJECT_FILE).model)
    except GagaError:
        return False
    return True


def reopen_stage(project: Project) -> Stage[Project]:
    """Open ``project`` as it is on disk now: with what was saved of it where that still fits
    (`is_saved_still`), else the splats that it was made of."""
    if project.path is not None and is_saved_still(project):
        return (yield from open_path_stage(project.path))
    if project.folder is not None:
        return (yield from _open_folder(project.folder.root))
    if project.manifest is not None:
        return (yield from _open_objects(project.manifest))
    return (yield from _open_model(project.model_path))


def files_read(project: Project) -> tuple[Path, ...]:
    """Files of splats that ``project`` is read from, and the photos of its scene."""
    added = (Path(item.path) for item in project.scene.added if not item.is_made)
    models = (file for model in (project.model_path, *added) for file in files_of_model(model))
    photos = project.folder.image_paths.values() if project.folder is not None else ()
    return (*models, *photos)


def require_other_file(project: Project, path: Path) -> None:
    """Raise ``GagaError`` where an export to ``path`` would replace what ``project`` is read from,
    or a saved project. Saved edits would fit no file then, and what they hid would be gone."""
    if not is_file(path):
        return
    if any(is_file(file) and file.samefile(path) for file in files_read(project)):
        raise GagaError(f"This scene is read from {path}. Choose another name.")
    given = [] if project.folder is None else [project.folder.root / name for name in SCENE_INPUTS]
    if any(path.resolve().is_relative_to(part.resolve()) for part in given):
        raise GagaError(f"{path} belongs to this scene. Choose another place.")
    if is_file(path.parent / PROJECT_FILE):
        raise GagaError(f"{path.parent} holds a saved project. Choose another place.")
    for saved in (path.parent / "gaga", *path.parent.glob(f"*{SUFFIX}")):
        if _is_model_of(path, saved):
            raise GagaError(
                f"The project saved in {saved} is read from {path}. Choose another name."
            )


def _is_model_of(path: Path, saved: Path) -> bool:
    """Whether the project in ``saved`` is of the file ``path``; False if it cannot be read."""
    if not saved_scene(saved):
        return False
    try:
        model = _resolve(saved, _document(saved / PROJECT_FILE).model.path)
    except GagaError:
        return False
    return any(is_file(file) and file.samefile(path) for file in files_of_model(model))


def save_project(
    project: Project,
    path: Path | None = None,
    *,
    copies_model: bool = False,
    overwrites: bool = False,
) -> Path:
    """Save all edits to ``path`` (default: `Project.saves_to`).

    Returns the folder and remembers it in ``project``. Raises ``GagaError`` when it cannot be
    written or ``path`` holds other files, ``InUseError`` when another program has it open,
    ``SavedElsewhereError`` when another one saved there since, or another project is there (not
    with ``overwrites``), and ``ModelChangedError`` when a file of splats is not the one that was
    opened; with ``copies_model`` the splats as they were opened are written next to the project
    then. Files that were added are copied into it. The former save stays whole in every case.
    """
    target = Path(path or project.saves_to)
    target = target.parent if target.name == PROJECT_FILE else target
    is_own = target.resolve() == project.saves_to.resolve()
    may_hold = is_own or overwrites or target.resolve() == project.first_path.resolve()
    if not (may_hold or saved_scene(target)) and _holds_files(target):
        raise GagaError(
            f"{target} holds other files, and would open as this project. Choose a new folder, or "
            "an empty one."
        )
    entries = None if copies_model else _entries(project, target, False)  # before a folder is made
    with lock_folder(target, patience_s=_PATIENCE_S):
        found = saved_scene(target)
        if found and found not in project.known_saves and not overwrites:
            said = (
                f"Another program saved a project in {target} since this one was opened."
                if is_own
                else f"Another project is saved in {target}."
            )
            raise SavedElsewhereError(f"{said} Save elsewhere to keep both.")
        entries = entries or _entries(project, target, True)
        kept = (_kept_in(target, entry, project.copies) for entry in entries[1:])
        entries = [entries[0], *kept]
        _write_project(project, target, entries)
    project.path = target
    return target


def _holds_files(folder: Path) -> bool:
    """Whether there is something in it that is not hidden, nor left by a save that failed."""
    names = [item.name for item in folder.iterdir()] if folder.is_dir() else []
    return any(not re.match(_OF_A_SAVE, name) for name in names)


def is_saved_of(project: Project, target: Path) -> bool:
    """Whether ``target`` holds a saved project of the same splats."""
    if not saved_scene(target):
        return False
    try:
        saved = _document(target / PROJECT_FILE).model.fingerprint
    except GagaError:
        return False
    return saved == (project.model_fingerprint or model_fingerprint(project.model_path))


def _write_project(project: Project, target: Path, entries: list[FileEntry]) -> None:
    """Write the scene file, then project.json. ``entries``: the model's, then of added files."""
    scene = project.scene
    name = f"scene-{uuid4().hex[:12]}.npz"
    document = ProjectFile(
        format=FORMAT,
        gaga_studio=__version__,
        model=entries[0],
        added=entries[1:],
        folder=_shown(project.folder.root, target) if project.folder else None,
        manifest=_shown(project.manifest, target) if project.manifest else "",
        scene=name,
        names={str(group): text for group, text in sorted(scene.names.items())},
        called={str(group): text for group, text in sorted(scene.described.items())},
        colors={str(group): list(rgb) for group, rgb in sorted(scene.colors.items())},
        weights={str(group): weight for group, weight in sorted(scene.weights.items())},
        folders=list(scene.folders.paths),
        in_folder={str(group): path for group, path in scene.folders.home.items()},
        parents={str(group): above for group, above in scene.folders.parent.items()},
        sets=list(scene.named_selections),
        bookmarks=bookmarks_entry(project.bookmarks),
        path=path_entry(project.film),
        masks=project.bank_masks,
    )
    arrays = scene_arrays(scene)
    text = json.dumps(msgspec.to_builtins(document, enc_hook=np.generic.item), indent=2)
    _require_readable(scene, arrays, text)
    with atomic_write(target / name) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    try:
        with atomic_write(target / PROJECT_FILE) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except GagaError:
        (target / name).unlink(missing_ok=True)
        raise
    project.known_saves.add(name)
    for stale in target.glob("scene-*.npz"):
        if re.match(_SCENE_FILE, stale.name) and stale.name != name:
            with suppress(OSError):  # in use elsewhere: the next save removes it
                stale.unlink()
    used = {Path(entry.path).parts[0] for entry in entries[1:] if entry.path}
    for copy in target.glob("added-*"):
        if re.fullmatch(_ADDED_COPY, copy.name) and copy.name not in used:
            shutil.rmtree(copy, ignore_errors=True)


def _require_readable(scene: Scene, arrays: dict[str, AnyArray], text: str) -> None:
    """``GagaError`` when what is about to be saved could not be opened: the last save stays."""
    try:
        checked(arrays, _SCENE, M=scene.n_opened, F=scene.n_rows_of_files)
        placements_of(arrays)
        decode_json(text.encode(), ProjectFile, PROJECT_FILE, CURE)
    except (ValueError, GagaError) as error:
        raise GagaError(
            f"The project was not saved: it could not be opened again ({error}). What was saved "
            "before is as it was. Undo the last steps, and save again."
        ) from error


def _open_folder(root: Path) -> Stage[Project]:
    yield Progress("Look at the folder", 0, 1, root.name)
    folder = open_scene_folder(root)
    if folder.model_path is None:
        raise GagaError(
            f"{folder.root} has photos but no splats (point_cloud.ply). Train a 3D Gaussian "
            "Splatting model of it first, or open its .ply file."
        )
    return (yield from _open_model(folder.model_path, folder))


def _renamed(path: Path, digest: str) -> Path | None:
    """The file next to ``path`` with this fingerprint, of the same kind under another name."""
    if path.name in (META, LOD_META) or not path.parent.is_dir():
        return None
    for other in sorted(path.parent.iterdir()):
        with suppress(GagaError):  # it cannot be read
            if other.suffix == path.suffix and not has_changed((other, digest)):
                return other
    return None


def _model_of(file: Path, entry: FileEntry) -> Path:
    """The splats of the project ``file`` as they were. ``GagaError``: they are gone, or changed."""
    path, digest = _resolve(file.parent, entry.path), entry.fingerprint
    if not has_changed((path, digest)):
        return path
    aside = file.parent / path.name  # where a later training puts it, with the project
    if not is_file(path) and not is_file(aside) and (renamed := _renamed(path, digest)):
        return renamed
    path = aside if is_file(aside) else path
    if not is_file(path):
        raise GagaError(
            f"The splats of this project are gone: {path}. Put the file back, or open another one."
        )
    if not is_same_model(path, digest):
        raise GagaError(
            f"{path} changed since this project was saved, so its edits do not fit. "
            f"Put the previous file back, or move {file} away to open the model without edits."
        )
    return path


def _open_saved(file: Path) -> Stage[Project]:
    document, arrays = read_project_file(file)
    entry = document.model
    model_path = _model_of(file, entry)
    root = _resolve(file.parent, document.folder) if document.folder else None
    folder = None
    if root is not None and not is_file(root) and is_scene_folder(root):
        yield Progress("Look at the folder", 0, 1, root.name)
        folder = replace(open_scene_folder(root), model_path=model_path)
    n_added = sum(item.gaussians for item in document.added)
    of_model = entry.gaussians / max(entry.gaussians + n_added, 1)
    read = read_splats_stage(model_path, entry.axes)
    gaussians = yield from portion(read, 0, of_model, READS)
    added = _added_of(document.added, file.parent, len(gaussians))
    n_opened = len(gaussians)
    made = made_of(file.parent / document.scene, arrays, sum(item.is_made for item in added))
    gaussians = yield from with_added_stage(gaussians, added, made)
    scene = scene_of(file.parent / document.scene, arrays, gaussians, n_opened)
    scene.added = added
    scene.names = {int(group): text for group, text in document.names.items()}
    scene.described = {int(group): text for group, text in document.called.items()}
    scene.colors = _colors_of(document.colors)
    if not all(0 < weight.value < np.inf for weight in document.weights.values()):
        raise GagaError(f"{file} is damaged (a weight that is not above 0). {CURE}")
    scene.weights = {int(group): weight for group, weight in document.weights.items()}
    homes = {int(group): path for group, path in document.in_folder.items()}
    parents = {int(group): above for group, above in document.parents.items()}
    try:
        scene.folders = Folders.of(document.folders, homes, parents)
    except ValueError as error:  # an object lies under itself
        raise GagaError(f"{file} is damaged ({error}). {CURE}") from error
    kept = [scene.named_selections[f"{i}"] for i in range(len(scene.named_selections))]
    scene.named_selections = dict(zip(document.sets, kept, strict=False))
    film = CameraPath()
    with suppress(ValueError):  # the project is older, or its entry is damaged
        film = path_of(document.path)
    return Project(
        scene=scene,
        model_path=model_path,
        folder=folder,
        path=file.parent,
        model_fingerprint=model_fingerprint(model_path),
        model_axes=entry.axes,
        manifest=_resolve(file.parent, document.manifest) if document.manifest else None,
        bookmarks=bookmarks_of(document.bookmarks),
        film=film,
        bank_masks=document.masks,
        known_saves={document.scene},
    )


def _colors_of(content: object) -> dict[int, RGB]:
    """List colors of groups; what is no color is left out, it is only a color."""
    colors: dict[int, RGB] = {}
    for group, rgb in content.items() if isinstance(content, dict) else ():
        if str(group).isdecimal() and len(group) <= 10 and isinstance(rgb, list) and len(rgb) == 3:
            with suppress(TypeError, ValueError, OverflowError):
                color = (float(rgb[0]), float(rgb[1]), float(rgb[2]))
                if all(0 <= channel <= 1 for channel in color):
                    colors[int(group)] = color
    return colors


def _entries(project: Project, target: Path, copies_model: bool) -> list[FileEntry]:
    """The model's entry, then those of added files."""
    if not project.model_fingerprint:
        project.model_fingerprint = model_fingerprint(project.model_path)
    scene = project.scene
    model = str(project.model_path), project.model_fingerprint
    opened = Added(*model, 0, scene.n_opened, project.model_axes)
    entries = []
    for item in (opened, *scene.added):
        if item.is_made:
            entries.append(FileEntry("", "", item.n, item.axes, item.frame, item.is_merged))
            continue
        rows = (item.first, item.first + item.n) if copies_model else None
        wanted = Path(item.path), item.fingerprint
        if item is not opened and has_changed(wanted):  # a save may have copied it
            copies = list(project.copies.files.items())  # an autosave may add to it
            kept = (file for (_, of), file in copies if of == wanted[1])
            wanted = next((file for file in kept if not has_changed(file)), wanted)
        path, digest = current_file(wanted, target, scene, rows, project.copies)
        entries.append(FileEntry(_shown(path, target), digest, item.n, item.axes, item.frame))
    return entries


_ADDED_COPY = r"added-[0-9a-f]{16}"  # folder of an added file in the project's
_OF_A_SAVE = rf"\.|{_ADDED_COPY}$|model-[0-9a-f]{{12}}\.ply$|{_SCENE_FILE}$"


def _kept_in(target: Path, entry: FileEntry, known: KnownCopies) -> FileEntry:
    """The ``entry`` of an added file as a copy in ``target``, made once: without it the
    project could not be opened when the file was moved or changed.

    A file stays where it is if its parts lie elsewhere. ``GagaError``: it cannot be copied.
    """
    if not entry.path:
        return entry
    path, base = _resolve(target, entry.path), target.resolve()
    if path.is_relative_to(base):
        return msgspec.structs.replace(entry, path=path.relative_to(base).as_posix())
    folder = base / f"added-{entry.fingerprint[:16]}"
    try:
        if not folder.is_dir():
            files = files_of_model(path)
            if not all(file.is_relative_to(path.parent) and is_file(file) for file in files):
                return entry
            with TemporaryDirectory(prefix=".added-", dir=base) as temporary:
                for file in files:
                    copy = Path(temporary) / "made" / file.relative_to(path.parent)
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(file, copy)
                (Path(temporary) / "made").rename(folder)
    except OSError as error:
        raise GagaError(explain_os_error(error, folder)) from error
    known.files[target, entry.fingerprint] = folder / path.name, entry.fingerprint
    return msgspec.structs.replace(entry, path=f"{folder.name}/{path.name}")


def _added_of(entries: Sequence[FileEntry], base: Path, n_opened: int) -> tuple[Added, ...]:
    """Files whose splats were added; none in older projects. ``GagaError``: a frame is none."""
    added: list[Added] = []
    first = n_opened
    for item in entries:
        path = str(_resolve(base, item.path)) if item.path else ""  # "": see `Added`
        try:
            origin = path, item.fingerprint, first, item.gaussians, item.axes
            added.append(Added(*origin, item.frame, item.merged))
        except ValueError as error:
            raise GagaError(f"{base / PROJECT_FILE} is damaged ({error}). {CURE}") from error
        first += item.gaussians
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
