"""The file project.json: its fields, and reading it while another program may replace it."""

import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.arrays import AnyArray, check_shape
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import bank_arrays, bank_of
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.json_file import PathText, read_json
from gaga_core.io.splats.spz import SilentAxes
from gaga_core.scene.frame import Frame
from gaga_core.scene.index_set import IndexSet
from gaga_core.scene.scene import Identities, Labelling, Placements, Scene

FORMAT = 1
PROJECT_FILE = "project.json"
CURE = "Move project.json away to open the scene from the start."
_TRIES, _PAUSE_S = 50, 0.02  # a writer removes the former scene file right after the new note
SCENE_FILE = r"^scene-[0-9a-f]{12}\.npz$"

Group = Annotated[str, msgspec.Meta(pattern="^[0-9]{1,10}$")]
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
    scene: Annotated[str, msgspec.Meta(pattern=SCENE_FILE)]
    names: dict[Group, str]
    gaga_studio: str = ""
    added: list[FileEntry] = []
    folder: PathText | None = ".."
    colors: object = None
    folders: list[str] = []  # of the object list
    in_folder: dict[Group, str] = {}
    parents: dict[Group, Annotated[int, msgspec.Meta(gt=0, lt=1 << 31)]] = {}
    sets: list[str] = []
    bookmarks: object = None
    path: object = None


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
# Histories of autosaves and recorded edits hold splats and identities in the same form.


_OWN = ("means", "quats", "log_scales", "logit_opacities", "sh")
_EXTRA = "extra:"  # before the names of all other columns


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


def made_of(file: Path, arrays: dict[str, AnyArray], n: int) -> list[Gaussians]:
    """The ``n`` sets of splats that edits made. Raises ``GagaError`` that names ``file``."""
    found = []
    try:
        for i in range(n):
            head = f"made_{i}:"
            columns = {k.removeprefix(head): v for k, v in arrays.items() if k.startswith(head)}
            found.append(splats_of(columns))
    except (ValueError, KeyError) as error:
        raise GagaError(f"{file} is damaged. {CURE}") from error
    return found


def scene_of(file: Path, arrays: dict[str, AnyArray], gaussians: Gaussians, n_opened: int) -> Scene:
    """The scene of `scene_arrays`, on the splats (M,) of all its files.

    ``n_opened`` splats are of the opened file. Raises ``GagaError`` that names ``file`` when the
    arrays do not fit each other or the splats.
    """
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
        confidence = arrays.get("confidence")
        if confidence is not None:
            check_shape("confidence", confidence, (n_opened,), np.uint8)
        frame = Frame()
        if "world" in arrays:
            check_shape("world", arrays["world"], (4, 4), np.float64)
            frame = Frame(arrays["world"], bool(arrays["is_metric"]))
        sets: dict[str, IndexSet] = {}  # named selections, by number
        while f"set_{len(sets)}" in arrays:
            i = len(sets)
            kept = np.unpackbits(arrays[f"set_{i}"], count=int(arrays[f"length_{i}"]))
            sets[f"{i}"] = IndexSet.of(np.flatnonzero(kept), len(kept))
        untouched = n == len(gaussians) and np.array_equal(source, np.arange(n))
        return Scene(
            gaussians=gaussians if untouched else gaussians.take(source),
            labels=arrays["labels"].astype(np.int32),
            state=arrays["state"].astype(np.uint8),
            placement=arrays["placement"].astype(np.int32),
            source=source,
            placements=Placements(arrays["matrix"], arrays["color"], arrays["opacity"]),
            bank=bank_of(bank) if bank else None,
            confidence=confidence,
            identities=identities_of(arrays, n_opened),
            named_selections=sets,
            frame=frame,
        )
    except (ValueError, KeyError, TypeError) as error:
        raise GagaError(f"{file} is damaged. {CURE}") from error


def identity_arrays(identities: Identities) -> dict[str, AnyArray]:
    """``identities`` as named arrays; none where labels are votes and there is nothing else."""
    arrays: dict[str, AnyArray] = {}
    if identities.source != "votes":
        arrays["labels_from"] = np.array(identities.source)
    if identities.other is not None:
        arrays["other_labels"] = identities.other.labels
        if identities.other.confidence is not None:
            arrays["other_confidence"] = identities.other.confidence
    if identities.colors is not None:
        arrays["identity_colors"] = identities.colors
    return arrays


def identities_of(arrays: Mapping[str, AnyArray], n_opened: int) -> Identities:
    """What `identity_arrays` wrote, of a file of ``n_opened`` splats; ``ValueError`` if damaged."""
    source = str(arrays.get("labels_from", "votes"))
    labels, confidence = arrays.get("other_labels"), arrays.get("other_confidence")
    colors = arrays.get("identity_colors")
    if colors is not None:
        check_shape("identity_colors", colors, (n_opened, 3), np.uint8)
    other = None
    if labels is not None:
        check_shape("other_labels", labels, (n_opened,), np.int32)
        if labels.min(initial=0) < 0:
            raise ValueError("other_labels: an id below 0")
        if confidence is not None:
            check_shape("other_confidence", confidence, (n_opened,), np.uint8)
        other = Labelling(labels, confidence)
    if source == "votes":
        return Identities("votes", other, colors)
    if source == "identities" and other is not None:
        return Identities("identities", other, colors)
    raise ValueError(f"labels_from: {source!r} without the other labels")


def columns_of(splats: Gaussians) -> dict[str, AnyArray]:
    """Every column by name, bit for bit."""
    own: dict[str, AnyArray] = {name: getattr(splats, name) for name in _OWN}
    return own | {_EXTRA + name: column for name, column in splats.extra.items()}


def splats_of(columns: Mapping[str, AnyArray]) -> Gaussians:
    """The splats of `columns_of`. Raises ``KeyError`` or ``ValueError`` when they are damaged."""
    extra = {k.removeprefix(_EXTRA): v for k, v in columns.items() if k.startswith(_EXTRA)}
    means, quats, log_scales, opacities, sh = (columns[name] for name in _OWN)
    return Gaussians(means, quats, log_scales, opacities, sh, MappingProxyType(extra))
