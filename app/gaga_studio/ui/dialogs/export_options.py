"""The sheets that ask how a film, a picture or the files of objects shall be written."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from imgui_bundle import ImVec2, imgui

from gaga_core.io.splat_files import SplatFormat
from gaga_core.io.video_out import VideoConfig
from gaga_core.pipeline import video as pipeline_video
from gaga_studio.actions import camera_path, cleanup
from gaga_studio.actions import files as file_actions
from gaga_studio.session.notices import notifies
from gaga_studio.session.requests import Request
from gaga_studio.session.session import Session
from gaga_studio.ui.dialogs.file_dialog import FilePicker
from gaga_studio.ui.dialogs.open_and_save import new_folder, stem, writing
from gaga_studio.ui.kit import icons, widgets
from gaga_studio.ui.kit.modal import begin_modal
from gaga_studio.ui.kit.requests import RequestTable
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

_FILM, _PICTURE, _OBJECTS = "Save film", "Save picture", "Export objects"
_NAMES = 9.0  # width of the names of fields, ems
_SIZES = ((1280, 720), (1920, 1080), (3840, 2160), (1080, 1080), (1080, 1920))
_WHATS: tuple[tuple[pipeline_video.What, str, str], ...] = (
    ("rgb", icons.COLOR, "Color"),
    ("groups", icons.GROUPS, "Groups"),
    ("depth", icons.DEPTH, "Depth"),
)
_FORMS = (
    (SplatFormat.PLY, "PLY", "Keeps everything. Every program for splats opens it."),
    (
        SplatFormat.COMPRESSED_PLY,
        "Compressed PLY",
        "A quarter of the size, rounded. SuperSplat opens it.",
    ),
    (
        SplatFormat.SPLAT,
        "SPLAT",
        "Small, rounded, for browsers. Colors look the same from every side.",
    ),
    (SplatFormat.SPZ, "SPZ", "Small, rounded, for phones. Colors still change with the view."),
)


@dataclass
class ExportChoices:
    """What was chosen last, kept while the program runs."""

    what: pipeline_video.What = "rgb"
    width: int = 1920  # pixels
    height: int = 1080
    fps: float = 30.0
    quality: int = 75
    transparent: bool = False
    form: SplatFormat = SplatFormat.PLY  # of objects' files

    def config(self, session: Session) -> pipeline_video.FilmConfig:
        """The film's settings; ``GagaError`` when they do not do."""
        video = VideoConfig(self.width, self.height, self.fps, self.quality)
        return pipeline_video.FilmConfig(self.what, session.view.background, video=video)


def register(table: RequestTable) -> None:
    """Answer the requests for the three sheets."""
    table.register_popup(Request.SAVE_FILM, _FILM)
    table.register_popup(Request.SAVE_PICTURE, _PICTURE)
    table.register_popup(Request.EXPORT_OBJECTS, _OBJECTS)


def draw(session: Session, choices: ExportChoices, files: FilePicker) -> None:
    """Whichever sheet is open; ``files`` asks for the path."""
    if begin_modal(_FILM, em(36)):
        if _film(session, choices):
            _ask_film(session, choices, files)
        imgui.end_popup()
    if begin_modal(_PICTURE, em(36)):
        if _picture(session, choices):
            _ask_picture(session, choices, files)
        imgui.end_popup()
    if begin_modal(_OBJECTS, em(30)):
        if _objects(session, choices):
            _ask_objects(session, choices.form, files)
        imgui.end_popup()


def _film(session: Session, choices: ExportChoices) -> bool:
    whats = [(what, icon, label, f"Film in {label.lower()}") for what, icon, label in _WHATS]
    choices.what = widgets.segmented("What", whats, choices.what, why_not={})
    _size(choices)
    widgets.field_name("Pictures a second", em(_NAMES))
    _, choices.fps = imgui.slider_float("##Pictures a second", choices.fps, 5, 60, "%.0f")
    widgets.field_name("Quality", em(_NAMES))
    _, choices.quality = imgui.slider_int("##Quality", choices.quality, 1, 100)
    path = camera_path.path_of(session)
    n = len(path.frame_times(choices.fps)) if path.keyframes else 0
    widgets.dim(f"{path.seconds:.1f} seconds, {n:,} pictures; .mp4 (H.264) or .webm (VP9)")
    return _ends(_FILM, "Save as…")


def _picture(session: Session, choices: ExportChoices) -> bool:
    mode = session.view.mode.value
    widgets.dim(f"What the camera sees, in {mode}; .png or .jpg")
    _size(choices)
    clicked, choices.transparent = widgets.checkbox(
        "Without background (transparent)", choices.transparent
    )
    del clicked
    return _ends(_PICTURE, "Save as…")


def _objects(session: Session, choices: ExportChoices) -> bool:
    n = len(session.selected_groups())
    which = "the selected object" if n == 1 else f"each of the {n} selected objects"
    which = which if n else "every object that is visible"
    widgets.dim(f"One file for {which}, and groups.json with the names.", wrap=True)
    imgui.dummy(ImVec2(0, em(0.2)))
    for form, name, text in _FORMS:
        if widgets.radio_button(f"{name} ({form.suffix})###{name}", choices.form is form):
            choices.form = form
        imgui.indent(em(1.7))
        widgets.dim(text, wrap=True)
        imgui.unindent(em(1.7))
    return _ends(_OBJECTS, "Choose a folder…")


def _size(choices: ExportChoices) -> None:
    widgets.field_name("Width and height", em(_NAMES))
    values = [choices.width, choices.height]
    changed, values = imgui.input_int2("##Width and height", values)
    if changed:
        choices.width, choices.height = (max(16, min(value, 16384)) for value in values)
    for position, (width, height) in enumerate(_SIZES):
        if position:
            imgui.same_line()
        is_on = (choices.width, choices.height) == (width, height)
        if widgets.toggle(f"{width} × {height}", is_on, hint="Take this size"):
            choices.width, choices.height = width, height


def _ends(title: str, label: str) -> bool:
    """The last row of buttons; whether to go on to the file."""
    imgui.dummy(ImVec2(0, em(0.3)))
    width, spacing = em(9), imgui.get_style().item_spacing.x
    room = imgui.get_content_region_avail().x
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(room - 2 * width - spacing, 0.0))
    goes = widgets.button(f"{title}…", Face(label, width=width, primary=True))
    imgui.same_line()
    if widgets.button("Cancel", Face(width=width)) or goes:
        imgui.close_current_popup()
    return goes


def _ask_film(session: Session, choices: ExportChoices, files: FilePicker) -> None:
    name = f"{stem(session)}.mp4"
    dialog = writing("Save the film", session, name, (".mp4", ".webm"))
    files.ask(dialog, lambda path: _export_film(session, path, choices))


@notifies
def _export_film(session: Session, path: Path, choices: ExportChoices) -> bool:
    return camera_path.export_film(session, path, choices.config(session))


def _ask_picture(session: Session, choices: ExportChoices, files: FilePicker) -> None:
    dialog = writing("Save the picture", session, f"{stem(session)}.png", (".png", ".jpg"))
    size, clear = (choices.width, choices.height), choices.transparent
    files.ask(dialog, lambda path: camera_path.save_picture(session, path, size, transparent=clear))


def _ask_objects(session: Session, form: SplatFormat, files: FilePicker) -> None:
    """The folder into which one file per object goes."""

    def export(path: Path) -> None:
        then = partial(cleanup.export, session, "objects", path, form=form)
        file_actions.when_agreed(session, "objects", path, then, form)

    title = f"Export one {form.suffix} per object into a folder"
    files.ask(new_folder(title, session, f"{stem(session)} objects"), export)
