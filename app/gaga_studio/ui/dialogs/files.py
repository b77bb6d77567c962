"""Choosing a file or a folder: the desktop's own dialog where there is one, else ours.

Both are asked in the same way (``FileDialog``) and answer through ``draw``, so that the rest of the
window does not know which of the two was on the screen.
"""

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from functools import partial
from pathlib import Path

from imgui_bundle import ImVec2, imgui
from imgui_bundle import portable_file_dialogs as native

from gaga_core.io.files import safe_name, too_long
from gaga_core.io.images import IMAGE_SUFFIXES
from gaga_core.io.splats.splat_files import READ_SUFFIXES
from gaga_core.placing.photos import VIDEO_SUFFIXES
from gaga_core.placing.recordings import R3D
from gaga_core.scene.project import SUFFIX
from gaga_studio.features import add_scene, camera, files, fill, reconstruction
from gaga_studio.features.find import masks
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.system import paths
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.modal import answers, begin_part, enter_is_free
from gaga_studio.ui.kit.path_field import path_field
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face
from gaga_studio.ui.viewport.training import SHEET as MAKE_SPLATS

_OWN = ("Desktop", "Documents", "Downloads", "Pictures", "Videos")
_MOUNTS = (Path("/media"), Path("/mnt"), Path("/Volumes"))
_HELPERS = ("zenity", "kdialog", "matedialog", "qarma")


class PathKind(Enum):
    """What is to be chosen."""

    OPEN_FOLDER = auto()
    OPEN_FILE = auto()
    SAVE_FILE = auto()
    NEW_FOLDER = auto()  # one that is there, or a new one in a folder that is there


_FOLDERS = (PathKind.OPEN_FOLDER, PathKind.NEW_FOLDER)
_OPENING = (PathKind.OPEN_FOLDER, PathKind.OPEN_FILE)


@dataclass
class FileDialog:
    """One question for a path; ``draw`` it every frame until it ``is_done``."""

    title: str
    kind: PathKind
    folder: Path
    name: str = ""  # proposed file name
    suffixes: tuple[str, ...] = ()  # (".ply",); empty = any file, for a folder none
    use_native: bool = False
    action: str = "Open"  # text of the button
    is_further: bool = False  # film or picture: with a free name
    is_placed: bool = False  # begins in ``folder``, wherever the last one of its title ended
    takes_folder: bool = False  # of a file: nothing named means the folder that holds such files
    is_done: bool = False
    result: Path | None = None  # None after it is done: cancelled
    message: str = ""
    _text: str = ""
    _is_open: bool = False
    _entries: list[Path] = field(default_factory=list)
    _listed: Path | None = None
    _new_name: str = ""  # of a folder to make
    _wants_keyboard: bool = True  # the path field, at the next frame
    _native: native.open_file | native.save_file | native.select_folder | None = None


@dataclass
class FilePicker:
    """The file dialog that is open, if any, and what its answer is for."""

    use_native: bool = False
    dialog: FileDialog | None = None
    _then: Callable[[Path], object] | None = None
    _back: str = ""
    _used: dict[str, Path] = field(default_factory=dict)  # folders that were used last, by title

    def ask(self, dialog: FileDialog, then: Callable[[Path], object], back: str = "") -> None:
        """Show ``dialog``; ``then`` gets the path, and without one the sheet ``back`` comes back.

        It begins in the folder that one of its title used last, else in its own (`start_folder`).
        Nothing happens while another one is open.
        """
        if self.dialog is None:
            dialog.use_native = self.use_native
            used = self._used.get(dialog.title)
            if used is not None and used.is_dir() and not dialog.is_placed:
                dialog.folder = used
            if dialog.is_further:
                dialog.name = _free_name(dialog.folder, dialog.name)
            self.dialog, self._then, self._back = dialog, then, back

    def draw(self) -> None:
        """Show the open dialog and pass its answer on."""
        if self.dialog is not None:
            draw(self.dialog)
            self.take()

    def take(self) -> None:
        """Pass the answer of the dialog on, if there is one."""
        if self.dialog is None or not self.dialog.is_done:
            return
        path, then, back = self.dialog.result, self._then, self._back
        if path is not None:
            self._used[self.dialog.title] = path.parent
        self.dialog = self._then = None
        if path is not None and then is not None:
            then(path)
        elif back:
            imgui.open_popup(back)


def has_native() -> bool:
    """Whether this desktop can show its own file dialogs."""
    if not sys.platform.startswith("linux"):
        return True
    return any(shutil.which(helper) for helper in _HELPERS)


def draw(dialog: FileDialog) -> None:
    """Show the dialog and take its answer when there is one."""
    if dialog.use_native:
        _draw_native(dialog)
    else:
        _draw_own(dialog)


def _draw_native(dialog: FileDialog) -> None:
    """Wait for the desktop's dialog; ours goes on from a name that only the desktop's accepts."""
    if dialog._native is None:
        dialog._native = _start_native(dialog)
    if not dialog._native.ready(0):
        return
    answer = dialog._native.result()
    chosen = answer[0] if isinstance(answer, list) and answer else answer
    path = Path(chosen) if isinstance(chosen, str) and chosen else None
    if path is None or dialog.kind is not PathKind.SAVE_FILE:
        dialog.result, dialog.is_done = path, True
        return
    dialog.folder, dialog.name = path.parent, path.name
    dialog.message = _overwrite(path)  # was asked by the desktop
    _accept_save(dialog, path, path.name)
    dialog.use_native = dialog.is_done


def _start_native(
    dialog: FileDialog,
) -> native.open_file | native.save_file | native.select_folder:
    start = str(dialog.folder / dialog.name) if dialog.name else str(dialog.folder)
    patterns = " ".join(f"*{suffix}" for suffix in dialog.suffixes)
    filters = [patterns, patterns, "All files", "*"] if patterns else ["All files", "*"]
    if dialog.kind in _FOLDERS:
        return native.select_folder(dialog.title, start)
    if dialog.kind is PathKind.OPEN_FILE:
        return native.open_file(dialog.title, start, filters)
    return native.save_file(dialog.title, start, filters)


def _draw_own(dialog: FileDialog) -> None:
    name = f"{dialog.title}###File dialog"
    if not dialog._is_open:
        imgui.open_popup(name)
        dialog._is_open = True
        dialog._text = dialog.name
    viewport = imgui.get_main_viewport()
    size = ImVec2(min(em(42), viewport.size.x * 0.94), min(em(29), viewport.size.y * 0.9))
    imgui.set_next_window_size(size)
    imgui.set_next_window_pos(viewport.get_center(), imgui.Cond_.always, ImVec2(0.5, 0.5))
    flags = imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_saved_settings
    opened, _ = imgui.begin_popup_modal(name, None, flags)
    if not opened:
        dialog.is_done = True
        return
    theme.dim_behind(True)
    _path_row(dialog)
    _entries(dialog)
    _answer_row(dialog)
    if enter_is_free():
        _accept(dialog)
    if dialog.is_done:
        imgui.close_current_popup()
    imgui.end_popup()


def _path_row(dialog: FileDialog) -> None:
    if widgets.icon_button("Up", icons.UP, hint="The folder above"):
        _enter(dialog, dialog.folder.parent)
    imgui.same_line()
    if widgets.icon_button("Home", icons.HOME, hint="Your home folder"):
        _enter(dialog, Path.home())
    imgui.same_line()
    if widgets.icon_button("Places", icons.BOOKMARK, hint="Folders that are used often"):
        imgui.open_popup("Places")
    widgets.popup("Places", lambda: _places(dialog), of_button=True)
    imgui.same_line()
    if widgets.icon_button("New folder", icons.FOLDER, hint="Make a folder here"):
        dialog._new_name = "New folder"
        imgui.open_popup("New folder")
    widgets.popup("New folder", lambda: _new_folder(dialog), of_button=True)
    imgui.same_line()
    imgui.align_text_to_frame_padding()
    widgets.line(str(dialog.folder), theme.DIM)


def _places(dialog: FileDialog) -> None:
    """Folders of the person and of the system that are here, one click away."""
    for i, place in enumerate(places()):
        if imgui.menu_item_simple(
            f"{icons.FOLDER_PLAIN}  {theme.visual(place.name or str(place))}###place {i}"
        ):
            _enter(dialog, place)


def places() -> list[Path]:
    """Folders that people keep things in, those that exist: own ones, then mounted disks."""
    own = [Path.home(), *(Path.home() / name for name in _OWN)]
    mounted = [disk for root in _MOUNTS for disk in sorted(root.glob("*"))]
    found = [*own, *mounted, Path(Path.home().anchor)]
    return [place for place in dict.fromkeys(found) if place.is_dir()]


def _new_folder(dialog: FileDialog) -> None:
    """Ask for a name and make the folder; it is entered at once."""
    if imgui.is_window_appearing():
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(em(14))
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    entered, dialog._new_name = imgui.input_text("##New folder name", dialog._new_name, flags)
    if entered and dialog._new_name.strip():
        _make_folder(dialog, dialog.folder / dialog._new_name.strip())
        imgui.close_current_popup()


def _make_folder(dialog: FileDialog, folder: Path) -> None:
    try:
        folder.mkdir()
    except FileExistsError:
        dialog.message = f"There is a {folder.name} here already."
    except OSError as error:
        dialog.message = f"No folder could be made here: {error.strerror}."
    else:
        _enter(dialog, folder)
        dialog._listed = None


def _entries(dialog: FileDialog) -> None:
    if dialog._listed != dialog.folder:
        _list(dialog)
    height = -imgui.get_frame_height_with_spacing() * (3 if dialog.message else 2)
    imgui.push_style_color(imgui.Col_.child_bg, theme.BACK)
    visible = begin_part("Entries", ImVec2(0, height), imgui.ChildFlags_.borders)
    imgui.pop_style_color()
    if visible:
        if not dialog._entries:
            widgets.dim(
                "Nothing to open here." if dialog.kind in _OPENING else "Nothing is here yet."
            )
        imgui.push_item_flag(imgui.ItemFlags_.no_tab_stop, True)  # arrows walk through them
        for entry in dialog._entries:
            _entry(dialog, entry)
        imgui.pop_item_flag()
    imgui.end_child()


def _is_package(dialog: FileDialog, path: Path) -> bool:
    """Whether this folder is chosen as a file is: a project, where one is asked for."""
    return path.suffix.lower() == SUFFIX and SUFFIX in dialog.suffixes and path.is_dir()


def _entry(dialog: FileDialog, entry: Path) -> None:
    is_folder = entry.is_dir() and not _is_package(dialog, entry)
    icon = icons.FOLDER_PLAIN if is_folder else icons.FILE_PLAIN
    flags = imgui.SelectableFlags_.allow_double_click | imgui.SelectableFlags_.no_auto_close_popups
    is_chosen = dialog._text == entry.name
    with widgets.lit_while_hovered(is_chosen):
        clicked, _ = imgui.selectable(
            f"{icon}  {theme.visual(entry.name)}###{entry.name}", is_chosen, flags
        )
    if not clicked:
        return
    is_double = imgui.is_mouse_double_clicked(imgui.MouseButton_.left)
    if is_folder and (is_double or dialog.kind not in _FOLDERS):
        _enter(dialog, entry)
    elif is_double:
        dialog._text = entry.name
        _accept(dialog)
    else:
        dialog._text = entry.name


def _follow(dialog: FileDialog) -> None:
    """List the folder whose whole path was typed."""
    try:
        typed = Path(dialog._text).expanduser()
        if typed.is_absolute() and typed.is_dir():
            dialog.folder = typed
    except (OSError, RuntimeError):  # of another user, of none
        return


def _answer_row(dialog: FileDialog) -> None:
    if dialog.message:
        widgets.line(dialog.message, theme.WARN)
    imgui.set_next_item_width(-1)
    what = "Folder" if dialog.kind in _FOLDERS else "File name"
    hint = f"{what} or path; Tab completes"
    if dialog._wants_keyboard:
        imgui.set_keyboard_focus_here()
        dialog._wants_keyboard = False
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    entered, dialog._text = path_field(
        "##Path",
        dialog._text,
        dialog.folder,
        dialog.suffixes,
        only_folders=dialog.kind in _FOLDERS,
        must_exist=dialog.kind in _OPENING,
        hint=hint,
        flags=flags,
    )
    if imgui.is_item_edited() and dialog._text.endswith(("/", "\\")):
        _follow(dialog)
    elif imgui.is_item_edited() and dialog.is_further:
        dialog.message = _wrong_ending(dialog, Path(dialog._text.strip()), is_typed=True)
    if entered:
        _accept(dialog)
        dialog._wants_keyboard = True  # what was not taken is typed again
    accepts, cancels = answers(dialog.action, Face(width=em(7), primary=True))
    if accepts:
        _accept(dialog)
    elif cancels:
        dialog.is_done = True


def _accept(dialog: FileDialog) -> None:
    """Take what the text field names, or say why it cannot be taken."""
    text = dialog._text.strip()
    path = (dialog.folder / Path(text).expanduser()) if text else dialog.folder
    if said := too_long(path):
        dialog.message = said
    elif dialog.kind is PathKind.SAVE_FILE:
        _accept_save(dialog, path, text)
    elif dialog.kind is PathKind.NEW_FOLDER and not path.exists() and path.parent.is_dir():
        _finish(dialog, path)
    elif not path.exists():
        dialog.message = f"There is no {text} here."
    elif dialog.kind is PathKind.OPEN_FILE and path.is_dir() and not _is_package(dialog, path):
        if dialog.takes_folder and not text and any(p.is_file() for p in dialog._entries):
            _finish(dialog, path)
        else:
            _enter(dialog, path)
    elif dialog.kind in _FOLDERS and path.is_file() and path.suffix.lower() not in dialog.suffixes:
        dialog.message = (
            f"{path.name} cannot be opened. Choose a scene folder, a splat file or a video."
            if dialog.suffixes
            else f"{path.name} is a file. Choose a folder."
        )
    else:
        _finish(dialog, path)


def _accept_save(dialog: FileDialog, path: Path, text: str) -> None:
    if not text:
        dialog.message = "Type a file name."
    elif path.is_dir():
        _enter(dialog, path)
    elif not path.parent.is_dir():
        dialog.message = f"There is no folder {path.parent}."
    else:
        suffix = dialog.suffixes[0] if dialog.suffixes else ""
        target = path if path.suffix or not suffix else path.with_suffix(suffix)
        if dialog.is_further and (wrong := _wrong_ending(dialog, target)):
            dialog.message = wrong
        elif target.exists() and dialog.message != _overwrite(target):
            dialog.message = _overwrite(target)
        else:
            _finish(dialog, target)


def _wrong_ending(dialog: FileDialog, path: Path, *, is_typed: bool = False) -> str:
    """Why a file called so cannot be written; "" where it can, or where more ``is_typed``."""
    ending = path.suffix.lower()
    if ending in dialog.suffixes or (
        is_typed and any(x.startswith(ending) for x in dialog.suffixes)
    ):
        return ""
    return f"{path.name}: choose a name that ends in {' or '.join(dialog.suffixes)}."


def _overwrite(path: Path) -> str:
    return f"{path.name} exists already. Press again to replace it."


def _finish(dialog: FileDialog, path: Path) -> None:
    dialog.result = path
    dialog.is_done = True


def _enter(dialog: FileDialog, folder: Path) -> None:
    dialog.folder, dialog._wants_keyboard = folder.resolve(), True
    dialog._text = dialog.name if dialog.kind is not PathKind.OPEN_FOLDER else ""
    dialog.message = ""


def _list(dialog: FileDialog) -> None:
    """Read the folder once: folders first, then the files that may be chosen."""
    dialog._listed = dialog.folder
    try:
        children = [p for p in dialog.folder.iterdir() if not p.name.startswith(".")]
    except OSError as error:
        dialog._entries = []
        dialog.message = f"This folder cannot be read: {error.strerror}."
        return
    files: list[Path] = []
    if dialog.kind not in _FOLDERS:
        wanted = dialog.suffixes
        files = [p for p in children if p.is_file() and (not wanted or p.suffix.lower() in wanted)]
        files += [p for p in children if _is_package(dialog, p)]
    folders = [p for p in children if p.is_dir() and p not in files]
    folders.sort(key=lambda p: p.name.lower())
    dialog._entries = folders + sorted(files, key=lambda p: p.name.lower())


# --- The file dialogs of commands: titles, start folders, and what follows.


@dataclass(frozen=True)
class _Asked:
    """What a request asks for, and who gets the path."""

    title: str
    kind: PathKind
    then: Callable[[Session, Path], object]
    suffixes: tuple[str, ...] = ()
    action: str = "Open"
    ending: str = ""  # of the proposed name, after that of the scene
    needs_scene: bool = True
    takes_folder: bool = False
    back: str = ""  # sheet that comes back when nothing was chosen
    starts_above: bool = False  # begins where the open scene lies, not in its folder


_OPENED = (*READ_SUFFIXES, ".json", *VIDEO_SUFFIXES, R3D)
_ASKED = {
    Request.OPEN_FOLDER: _Asked(
        "Open a scene folder", PathKind.OPEN_FOLDER, Session.open, _OPENED, needs_scene=False
    ),
    Request.OPEN_FILE: _Asked(
        "Open a splat file, a project or a video",
        PathKind.OPEN_FILE,
        Session.open,
        (*_OPENED, SUFFIX),
        needs_scene=False,
    ),
    Request.OPEN_PHOTOS: _Asked(
        "Choose a film, or any photo of the folder",
        PathKind.OPEN_FILE,
        reconstruction.open_photos,
        (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES, R3D),
        needs_scene=False,
        takes_folder=True,
    ),
    Request.OBJECT_MASKS: _Asked(
        "Choose the folder of masks of the object",
        PathKind.OPEN_FOLDER,
        reconstruction.choose_masks,
        action="Use",
        needs_scene=False,
        back=MAKE_SPLATS,
    ),
    Request.INPAINTING_MODEL: _Asked(
        "Choose an inpainting model",
        PathKind.OPEN_FILE,
        fill.choose_model,
        (".pt", ".pth", ".ts"),
        "Use",
        needs_scene=False,
    ),
    Request.ADD_SPLATS: _Asked(
        "Add the splats of another file",
        PathKind.OPEN_FILE,
        files.add_splats,
        (*READ_SUFFIXES, ".json"),  # of a folder of SOG
        "Add",
    ),
    Request.ADD_SCENE: _Asked(
        "Add a scene of the same place",
        PathKind.OPEN_FOLDER,
        add_scene.start,
        READ_SUFFIXES,
        "Add",
        starts_above=True,
    ),
    Request.IMPORT_MASK_FOLDER: _Asked(
        "Import masks from a folder", PathKind.OPEN_FOLDER, masks.import_from, action="Import"
    ),
    Request.IMPORT_MASK_FILE: _Asked(
        "Import masks from a file",
        PathKind.OPEN_FILE,
        masks.import_from,
        (".json", ".npz", ".npy"),
        "Import",
    ),
    Request.SAVE_AS: _Asked(
        "Save the project in a folder",
        PathKind.NEW_FOLDER,
        Session.save,
        action="Save",
        ending=SUFFIX,
    ),
    Request.SAVE_SCRIPT: _Asked(
        "Save the edits as a script",
        PathKind.SAVE_FILE,
        files.save_script,
        (".json",),
        "Save",
        " edits.json",
    ),
    Request.OPEN_PATH: _Asked(
        "Open a camera path", PathKind.OPEN_FILE, camera.open_path_file, (".json",)
    ),
    Request.SAVE_PATH: _Asked(
        "Save the camera's path",
        PathKind.SAVE_FILE,
        camera.save_path_file,
        (".json",),
        "Save",
        " path.json",
    ),
}


def openers(picker: FilePicker) -> dict[Request, Callable[[Session], object]]:
    """What asks for a path, by request; but for opening there must be a scene."""
    return {request: partial(_ask, picker, asked) for request, asked in _ASKED.items()}


def _ask(picker: FilePicker, asked: _Asked, session: Session) -> None:
    if asked.needs_scene and session.document is None:
        return
    name = f"{stem(session)}{asked.ending}" if asked.ending else ""
    if asked.ending == SUFFIX and session.project is not None:  # what Ctrl+S writes
        now = session.project.saves_to.name
        name = now if now.endswith(SUFFIX) else name
    start = start_folder(session, above=asked.starts_above)
    dialog = FileDialog(asked.title, asked.kind, start, name, asked.suffixes, action=asked.action)
    dialog.takes_folder = asked.takes_folder
    picker.ask(dialog, partial(asked.then, session), asked.back)


def start_folder(session: Session, *, above: bool = False) -> Path:
    """The folder of what is open, or the one ``above`` a scene folder; else of what was open
    before, else the user's own.

    Never a hidden one of ours, where the demo is.
    """
    places: list[Path] = []
    if session.project is not None:
        folder = session.project.folder
        root = session.project.model_path.parent if folder is None else folder.root
        places.append(root.parent if above and folder is not None else root)
    places += [Path(name).parent for name in session.settings.recent]
    seen = (place for place in places if not place.resolve().is_relative_to(paths.home().resolve()))
    return next((place for place in seen if place.is_dir()), Path.home())


def stem(session: Session) -> str:
    """The name of the open scene without a suffix: what file names begin with."""
    return safe_name(Path(session.document.name).stem) if session.document is not None else ""


def new_folder(title: str, session: Session, name: str, action: str = "Export") -> FileDialog:
    """A dialog for a folder that is made."""
    return FileDialog(title, PathKind.NEW_FOLDER, start_folder(session), name, action=action)


def writing(title: str, session: Session, name: str, suffixes: tuple[str, ...]) -> FileDialog:
    """A dialog for a further file that is written, called ``name`` or by a free name."""
    start = start_folder(session)
    dialog = FileDialog(title, PathKind.SAVE_FILE, start, name, suffixes, action="Save")
    dialog.is_further = True
    return dialog


def _free_name(folder: Path, name: str) -> str:
    """``name``, or "film 2.mp4" where one is there."""
    path, k, free = Path(name), 1, name
    while (folder / free).exists():
        k += 1
        free = f"{path.stem} {k}{path.suffix}"
    return free
