"""The sheets that ask how a film, a picture or the files of objects shall be written."""

from dataclasses import dataclass

from imgui_bundle import ImVec2, imgui

from gaga_core.io.splat_files import SplatFormat
from gaga_core.io.video_out import VideoConfig
from gaga_core.pipeline import video as pipeline_video
from gaga_studio.actions import camera_path
from gaga_studio.session.session import Session
from gaga_studio.ui.dialogs.modal import begin_modal
from gaga_studio.ui.kit import icons, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

SHEETS = {
    "film": "Save film",
    "save_picture": "Save picture",
    "export_objects": "Export objects",
}
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
class Wishes:
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


def draw(session: Session, wishes: Wishes) -> None:
    """Whichever sheet is open."""
    if begin_modal(SHEETS["film"], em(36)):
        _film(session, wishes)
        imgui.end_popup()
    if begin_modal(SHEETS["save_picture"], em(36)):
        _picture(session, wishes)
        imgui.end_popup()
    if begin_modal(SHEETS["export_objects"], em(30)):
        _objects(session, wishes)
        imgui.end_popup()


def _film(session: Session, wishes: Wishes) -> None:
    choices = [(what, icon, label, f"Film in {label.lower()}") for what, icon, label in _WHATS]
    wishes.what = widgets.segmented("What", choices, wishes.what, why_not={})
    _size(wishes)
    imgui.set_next_item_width(em(10))
    _, wishes.fps = imgui.slider_float("Pictures a second", wishes.fps, 5, 60, "%.0f")
    imgui.set_next_item_width(em(10))
    _, wishes.quality = imgui.slider_int("Quality", wishes.quality, 1, 100)
    path = camera_path.path_of(session)
    n = len(path.frame_times(wishes.fps)) if path.keyframes else 0
    widgets.dim(f"{path.seconds:.1f} seconds, {n:,} pictures; .mp4 (H.264) or .webm (VP9)")
    if _ends("Save film", "Save as…"):
        session.request = "film_file"


def _picture(session: Session, wishes: Wishes) -> None:
    mode = session.view.mode.value
    widgets.dim(f"What the camera sees, in {mode}; .png or .jpg")
    _size(wishes)
    clicked, wishes.transparent = widgets.checkbox(
        "Without background (transparent)", wishes.transparent
    )
    del clicked
    if _ends("Save picture", "Save as…"):
        session.request = "picture_file"


def _objects(session: Session, wishes: Wishes) -> None:
    n = len(session.selected_groups())
    which = "the selected object" if n == 1 else f"each of the {n} selected objects"
    which = which if n else "every object that is visible"
    widgets.dim(f"One file for {which}, and groups.json with the names.", wrap=True)
    imgui.dummy(ImVec2(0, em(0.2)))
    for form, name, text in _FORMS:
        if widgets.radio_button(f"{name} ({form.suffix})###{name}", wishes.form is form):
            wishes.form = form
        imgui.indent(em(1.7))
        widgets.dim(text, wrap=True)
        imgui.unindent(em(1.7))
    if _ends("Export objects", "Choose a folder…"):
        session.request = "export_objects_to"


def _size(wishes: Wishes) -> None:
    imgui.set_next_item_width(em(10))
    values = [wishes.width, wishes.height]
    changed, values = imgui.input_int2("Width and height", values)
    if changed:
        wishes.width, wishes.height = (max(16, min(value, 16384)) for value in values)
    for position, (width, height) in enumerate(_SIZES):
        if position:
            imgui.same_line()
        is_on = (wishes.width, wishes.height) == (width, height)
        if widgets.toggle(f"{width} × {height}", is_on, hint="Take this size"):
            wishes.width, wishes.height = width, height


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
