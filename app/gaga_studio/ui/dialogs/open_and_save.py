"""The file dialogs that commands ask for: what they are called, where they begin, what follows."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from gaga_core.io.splats.splat_files import READ_SUFFIXES
from gaga_core.placing.photos import VIDEO_SUFFIXES
from gaga_studio.features import camera, files, fill
from gaga_studio.features.find import masks
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.ui.dialogs.file_dialog import FileDialog, FilePicker, PathKind
from gaga_studio.ui.kit.requests import RequestTable


def register(table: RequestTable, picker: FilePicker) -> None:
    """Answer every request for a path; but for opening there must be a scene."""
    table.register(Request.OPEN_FOLDER, partial(_open_folder, picker))
    table.register(Request.OPEN_FILE, partial(_open_file, picker))
    table.register(Request.INPAINTING_MODEL, partial(_inpainting_model, picker))
    for request, opener in (
        (Request.ADD_SPLATS, _add_splats),
        (Request.IMPORT_MASK_FOLDER, _import_mask_folder),
        (Request.IMPORT_MASK_FILE, _import_mask_file),
        (Request.SAVE_AS, _save_as),
        (Request.SAVE_SCRIPT, _save_script),
        (Request.OPEN_PATH, _open_path),
        (Request.SAVE_PATH, _save_path),
    ):
        table.register(request, partial(_of_scene, opener, picker))


def start_folder(session: Session) -> Path:
    """The folder of what is open, else of what was open last, else the user's own."""
    places = []
    if session.project is not None:
        folder = session.project.folder
        places.append(folder.root if folder is not None else session.project.model_path.parent)
    places += [Path(name).parent for name in session.settings.recent[:1]]
    return next((place for place in places if place.is_dir()), Path.home())


def stem(session: Session) -> str:
    """The name of the open scene without a suffix: what file names begin with."""
    return Path(session.document.name).stem if session.document is not None else ""


def new_folder(title: str, session: Session, name: str, action: str = "Export") -> FileDialog:
    """A dialog for a folder that is made."""
    return FileDialog(title, PathKind.NEW_FOLDER, start_folder(session), name, action=action)


def _of_scene(
    opener: Callable[[FilePicker, Session], None], picker: FilePicker, session: Session
) -> None:
    if session.document is not None:
        opener(picker, session)


def _open_folder(picker: FilePicker, session: Session) -> None:
    dialog = FileDialog("Open a scene folder", PathKind.OPEN_FOLDER, start_folder(session))
    picker.ask(dialog, session.open)


def _open_file(picker: FilePicker, session: Session) -> None:
    title = "Open a splat file, a project or a video"
    suffixes = (*READ_SUFFIXES, ".json", *VIDEO_SUFFIXES)
    dialog = FileDialog(title, PathKind.OPEN_FILE, start_folder(session), suffixes=suffixes)
    picker.ask(dialog, session.open)


def _add_splats(picker: FilePicker, session: Session) -> None:
    title = "Add the splats of another file"
    dialog = _reading(title, session, READ_SUFFIXES, "Add")
    picker.ask(dialog, lambda path: files.add_splats(session, path))


def _import_mask_folder(picker: FilePicker, session: Session) -> None:
    title = "Import masks from a folder"
    dialog = FileDialog(title, PathKind.OPEN_FOLDER, start_folder(session), action="Import")
    picker.ask(dialog, lambda path: masks.import_from(session, path))


def _import_mask_file(picker: FilePicker, session: Session) -> None:
    title = "Import masks from a file"
    dialog = _reading(title, session, (".json", ".npz", ".npy"), "Import")
    picker.ask(dialog, lambda path: masks.import_from(session, path))


def _inpainting_model(picker: FilePicker, session: Session) -> None:
    dialog = _reading("Choose an inpainting model", session, (".pt", ".pth", ".ts"), "Use")
    picker.ask(dialog, lambda path: fill.choose_model(session, path))


def _save_as(picker: FilePicker, session: Session) -> None:
    title = "Save the project in a folder"
    dialog = new_folder(title, session, f"{stem(session)}.gaga", "Save")
    picker.ask(dialog, session.save)


def _save_script(picker: FilePicker, session: Session) -> None:
    name = f"{stem(session)} edits.json"
    dialog = writing("Save the edits as a script", session, name, (".json",))
    picker.ask(dialog, lambda path: files.save_script(session, path))


def _open_path(picker: FilePicker, session: Session) -> None:
    dialog = _reading("Open a camera path", session, (".json",), "Open")
    picker.ask(dialog, lambda path: camera.open_path_file(session, path))


def _save_path(picker: FilePicker, session: Session) -> None:
    name = f"{stem(session)} path.json"
    dialog = writing("Save the camera's path", session, name, (".json",))
    picker.ask(dialog, lambda path: camera.save_path_file(session, path))


def _reading(title: str, session: Session, suffixes: tuple[str, ...], action: str) -> FileDialog:
    start = start_folder(session)
    return FileDialog(title, PathKind.OPEN_FILE, start, suffixes=suffixes, action=action)


def writing(title: str, session: Session, name: str, suffixes: tuple[str, ...]) -> FileDialog:
    """A dialog for a file that is written."""
    start = start_folder(session)
    return FileDialog(title, PathKind.SAVE_FILE, start, name, suffixes, action="Save")
