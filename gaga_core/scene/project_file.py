"""The file project.json: its fields, and reading it while another program may replace it."""

import time
from pathlib import Path
from typing import Annotated

import msgspec

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.json_file import PathText, read_json
from gaga_core.io.spz_axes import SilentAxes

FORMAT = 1
FILE = "project.json"
CURE = "Move project.json away to open the scene from the start."
_TRIES, _PAUSE_S = 50, 0.02  # a writer removes the former scene file right after the new note

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
    scene: Annotated[str, msgspec.Meta(pattern=r"^scene-[0-9a-f]{12}\.npz$")]
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
    file = folder / FILE
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
