"""What commands ask of the window: file dialogs and sheets."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from gaga_core.io.splat_files import READ_SUFFIXES, WRITE_SUFFIXES, SplatFormat
from gaga_core.reconstruct.photos import VIDEO_SUFFIXES
from gaga_core.segmentation.weights import models_folder
from gaga_studio.actions import (
    camera_path,
    cleanup,
    files,
    masks,
)
from gaga_studio.actions import (
    search as search_actions,
)
from gaga_studio.session.document import Document
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import Session
from gaga_studio.ui.dialogs import export_options, file_dialog, make_masks
from gaga_studio.ui.dialogs.file_dialog import FileDialog, Kind
from gaga_studio.ui.kit.state import UiState
from gaga_studio.ui.panels import objects, search

SHEETS = (
    "palette",
    "shortcuts",
    "about",
    "preferences",
    "masks",
    "export_masks",
    "object_menu",
    "photos",
    "scene_menu",
    *export_options.SHEETS,
)


def take(session: Session, ui: UiState) -> None:
    """Turn a request of the session into a dialog; take the answer of the open one."""
    request = session.take_request()
    if request in SHEETS:
        ui.open_popup = request
    elif request == "rename":
        objects.rename_selected(session, ui)
    elif request == "find":
        search.focus(ui)
    elif request == "find_in_view":
        search_actions.find_here(session, search.picture_size(ui))
    elif request and ui.dialog is None:
        found = _masks(session, ui, request) or _camera(session, ui, request)
        ui.dialog, ui.on_path = found or _dialog(session, ui, request)
    if ui.dialog is None:
        return
    file_dialog.draw(ui.dialog)
    if ui.dialog.is_done:
        path, act = ui.dialog.result, ui.on_path
        ui.dialog = ui.on_path = None
        if path is not None and act is not None:
            act(path)


def _camera(
    session: Session, ui: UiState, request: str
) -> tuple[FileDialog, Callable[[Path], object]] | None:
    """Dialogs about the camera's path, its film, and pictures."""
    if session.document is None:
        return None
    stem, start, wishes = Path(session.document.name).stem, _start_folder(session), ui.wishes

    def ask(
        title: str, name: str, suffixes: tuple[str, ...], kind: Kind = Kind.SAVE_FILE
    ) -> FileDialog:
        action = "Save" if kind is Kind.SAVE_FILE else "Open"
        native = ui.native_dialogs
        return FileDialog(title, kind, start, name, suffixes, use_native=native, action=action)

    if request == "film_file":
        dialog = ask("Save the film", f"{stem}.mp4", (".mp4", ".webm"))
        return dialog, lambda path: _export_film(session, path, wishes)
    if request == "picture_file":
        dialog = ask("Save the picture", f"{stem}.png", (".png", ".jpg"))
        size, clear = (wishes.width, wishes.height), wishes.transparent
        return dialog, lambda path: camera_path.save_picture(session, path, size, transparent=clear)
    if request == "save_path":
        dialog = ask("Save the camera's path", f"{stem} path.json", (".json",))
        return dialog, lambda path: camera_path.save_path_file(session, path)
    if request == "open_path":
        dialog = ask("Open a camera path", "", (".json",), Kind.OPEN_FILE)
        return dialog, lambda path: camera_path.open_path_file(session, path)
    return None


def _masks(
    session: Session, ui: UiState, request: str
) -> tuple[FileDialog, Callable[[Path], object]] | None:
    """Dialogs about masks."""
    start, native = _start_folder(session), ui.native_dialogs
    if request == "mask_weights":
        ui.masks.reopen = True
        dialog = FileDialog(
            "Choose a model's folder, or a sam_vit_*.pth file in it",
            Kind.OPEN_FOLDER,
            models_folder() if models_folder().is_dir() else start,
            use_native=native,
        )
        return dialog, lambda path: make_masks.take_weights(session, ui, path)
    if session.document is None:
        return None
    if request == "import_masks":
        title = "Import masks from a folder"
        dialog = FileDialog(title, Kind.OPEN_FOLDER, start, use_native=native, action="Import")
        return dialog, lambda path: masks.import_from(session, path)
    if request == "import_masks_file":
        suffixes = (".json", ".npz", ".npy")
        title = "Import masks from a file"
        dialog = FileDialog(
            title, Kind.OPEN_FILE, start, "", suffixes, use_native=native, action="Import"
        )
        return dialog, lambda path: masks.import_from(session, path)
    if request == "export_masks_to":
        name = f"{Path(session.document.name).stem} masks"
        dialog = _new_folder("Export masks into a folder", start, name, "Export", native)
        return dialog, lambda path: masks.export(session, ui.masks.form, path)
    return None


def _dialog(
    session: Session, ui: UiState, request: str
) -> tuple[FileDialog | None, Callable[[Path], object] | None]:
    start, native = _start_folder(session), ui.native_dialogs
    if request == "open_folder":
        dialog = FileDialog("Open a scene folder", Kind.OPEN_FOLDER, start, use_native=native)
        return dialog, session.open
    if request == "open_file":
        dialog = FileDialog(
            "Open a splat file, a project or a video",
            Kind.OPEN_FILE,
            start,
            suffixes=(*READ_SUFFIXES, ".json", *VIDEO_SUFFIXES),
            use_native=native,
        )
        return dialog, session.open
    if session.document is None:
        return None, None
    if request == "export_objects_to":
        return _objects(session, session.document, ui.wishes.form, native)
    return _writing(session, session.document, request, native)


def _objects(
    session: Session, document: Document, form: SplatFormat, native: bool
) -> tuple[FileDialog, Callable[[Path], object]]:
    """The folder into which one file per object goes."""
    title = f"Export one {form.suffix} per object into a folder"
    name = f"{Path(document.name).stem} objects"

    def export(path: Path) -> None:
        then = partial(cleanup.export, session, "objects", path, form=form)
        files.when_agreed(session, "objects", path, then, form)

    return _new_folder(title, _start_folder(session), name, "Export", native), export


def _writing(
    session: Session, document: Document, request: str, native: bool
) -> tuple[FileDialog | None, Callable[[Path], object] | None]:
    stem, start = Path(document.name).stem, _start_folder(session)
    if request == "save_as":
        title, action = "Save the project in a folder", "Save"
        dialog = _new_folder(title, start, f"{stem}.gaga", action, native)
        return dialog, session.save
    if request == "add_splats":
        title = "Add the splats of another file"
        dialog = FileDialog(title, Kind.OPEN_FILE, start, "", READ_SUFFIXES, native, "Add")
        return dialog, lambda path: files.add_splats(session, path)
    if request == "export_selected":
        groups = session.selected_groups()
        name = document.name_of(groups[0]) if len(groups) == 1 else f"{stem} selection"
        dialog = _save_splats("Export the selection", start, f"{name}.ply", native)

        def selected(path: Path) -> None:
            then = partial(cleanup.export, session, "selected", path)
            files.when_agreed(session, "selected", path, then)

        return dialog, selected
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
        return dialog, lambda path: files.save_script(session, path)
    if request == "export_scene":
        dialog = _save_splats("Export what is visible", start, f"{stem} edited.ply", native)

        def visible(path: Path) -> None:
            then = partial(files.export, session, "scene", path)
            files.when_agreed(session, "scene", path, then)

        return dialog, visible
    return None, None


def _save_splats(title: str, start: Path, name: str, native: bool) -> FileDialog:
    """The name says the form: the title lists them."""
    title = f"{title} as {', '.join(WRITE_SUFFIXES[:-1])} or {WRITE_SUFFIXES[-1]}"
    return FileDialog(
        title, Kind.SAVE_FILE, start, name, WRITE_SUFFIXES, use_native=native, action="Export"
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


@notifies
def _export_film(session: Session, path: Path, wishes: export_options.Wishes) -> bool:
    return camera_path.export_film(session, path, wishes.config(session))
