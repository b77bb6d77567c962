"""What commands ask of the window: file dialogs and sheets."""

from collections.abc import Callable
from pathlib import Path

from gaga_studio import arranging, cleaning, stages
from gaga_studio.document import Document
from gaga_studio.session import Session
from gaga_studio.ui import files, objects
from gaga_studio.ui.files import FileDialog, Kind
from gaga_studio.ui.state import UiState

SHEETS = ("palette", "shortcuts", "about", "preferences")


def take(session: Session, ui: UiState) -> None:
    """Turn a request of the session into a dialog; take the answer of the open one."""
    request = session.take_request()
    if request in SHEETS:
        ui.open_popup = request
    elif request == "rename":
        objects.rename_selected(session, ui)
    elif request and ui.dialog is None:
        ui.dialog, ui.on_path = _dialog(session, request, ui.native_dialogs)
    if ui.dialog is None:
        return
    files.draw(ui.dialog)
    if ui.dialog.is_done:
        path, act = ui.dialog.result, ui.on_path
        ui.dialog = ui.on_path = None
        if path is not None and act is not None:
            act(path)


def _dialog(
    session: Session, request: str, native: bool
) -> tuple[FileDialog | None, Callable[[Path], object] | None]:
    start = _start_folder(session)
    if request == "open_folder":
        dialog = FileDialog("Open a scene folder", Kind.OPEN_FOLDER, start, use_native=native)
        return dialog, session.open
    if request == "open_file":
        dialog = FileDialog(
            "Open a splat file or a project",
            Kind.OPEN_FILE,
            start,
            suffixes=(".ply", ".json"),
            use_native=native,
        )
        return dialog, session.open
    if session.document is None:
        return None, None
    return _writing(session, session.document, request, native)


def _writing(
    session: Session, document: Document, request: str, native: bool
) -> tuple[FileDialog | None, Callable[[Path], object] | None]:
    stem, start = Path(document.name).stem, _start_folder(session)
    if request == "save_as":
        title, action = "Save the project in a folder", "Save"
        dialog = _new_folder(title, start, f"{stem}.gaga", action, native)
        return dialog, session.save
    if request == "export_objects":
        title = "Export one .ply per object into a folder"
        dialog = _new_folder(title, start, f"{stem} objects", "Export", native)
        return dialog, lambda path: cleaning.export(session, "objects", path)
    if request == "export_selected":
        groups = session.selected_groups()
        name = document.name_of(groups[0]) if len(groups) == 1 else f"{stem} selection"
        dialog = _save_ply("Export the selection", start, f"{name}.ply", native)
        return dialog, lambda path: cleaning.export(session, "selected", path)
    if request == "save_script":
        dialog = FileDialog(
            "Save the edits as a script",
            Kind.SAVE_FILE,
            start,
            f"{stem} edits.json",
            (".json",),
            use_native=native,
            action="Save",
        )
        return dialog, lambda path: arranging.save_script(session, path)
    if request == "export_scene":
        dialog = _save_ply("Export what is visible", start, f"{stem} edited.ply", native)
        return dialog, lambda path: stages.export(session, "scene", path)
    return None, None


def _save_ply(title: str, start: Path, name: str, native: bool) -> FileDialog:
    return FileDialog(
        title, Kind.SAVE_FILE, start, name, (".ply",), use_native=native, action="Export"
    )


def _new_folder(title: str, start: Path, name: str, action: str, native: bool) -> FileDialog:
    return FileDialog(title, Kind.NEW_FOLDER, start, name, use_native=native, action=action)


def _start_folder(session: Session) -> Path:
    """Beside what is open, else beside what was open last, else home."""
    places = []
    if session.project is not None:
        folder = session.project.folder
        places.append(folder.root if folder is not None else session.project.model_path.parent)
    places += [Path(name).parent for name in session.settings.recent[:1]]
    return next((place for place in places if place.is_dir()), Path.home())
