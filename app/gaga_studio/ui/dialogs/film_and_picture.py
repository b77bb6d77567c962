"""The sheets with the settings of a film or a picture to write."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from imgui_bundle import ImVec2, imgui

from gaga_core.errors import GagaError, counted
from gaga_core.evaluate.photo_film import PhotoFilmConfig, PhotoSide
from gaga_core.io.video import VideoConfig
from gaga_core.pipeline import film as pipeline_video
from gaga_core.pipeline.film import Split, What
from gaga_studio.features import camera, export, split_view
from gaga_studio.features.camera import no_path, no_photo_files
from gaga_studio.features.find.association import duration_text
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import Side
from gaga_studio.ui.dialogs.files import FilePicker, stem, writing
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.modal import answer, begin_modal, body
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

FILM, PICTURE = "Save film", "Save picture"
_NAMES = 9.0  # width of the names of fields, ems
_SIZES = ((1280, 720), (1920, 1080), (3840, 2160), (1080, 1080), (1080, 1920))
_WHATS: tuple[tuple[What, str, str], ...] = (
    ("rgb", icons.COLOR, "Color"),
    ("groups", icons.GROUPS, "Groups"),
    ("depth", icons.DEPTH, "Depth"),
)


Left = Literal["", "rgb", "groups", "depth", "before"]
_LEFTS: dict[Left, str] = {
    "": "Nothing",
    "rgb": "Color",
    "groups": "Groups",
    "depth": "Depth",
    "before": "Before the last edit",
}
_PHOTO_SIDES: tuple[tuple[PhotoSide, str, Side], ...] = (
    ("photo", "Photo", Side.PHOTO),
    ("truth", "True masks", Side.TRUTH),
    ("errors", "Errors", Side.ERRORS),
)
Views = Literal["all", "train", "test"]


@dataclass
class FilmChoices:
    """What was chosen last, kept while the program runs."""

    what: What = "rgb"
    film_size: tuple[int, int] = (1920, 1080)  # pixels
    picture_size: tuple[int, int] = (1920, 1080)
    fps: float = 30.0
    quality: int = 75
    left: Left = ""  # of the line of a film; "" = no line
    sweeps: bool = False  # the line
    through_photos: bool = False  # else along the camera's path
    wants_photos: bool | None = None  # as a person chose; None: along the path where there is one
    side: PhotoSide = "photo"  # left of the line of a film through photos
    views: Views = "all"
    seconds: float = 2.0  # of each photo
    transparent: bool = False

    @property
    def video(self) -> VideoConfig:
        """The file's settings; ``GagaError`` when they do not do."""
        return VideoConfig(*self.film_size, self.fps, self.quality)

    def photo_config(self, session: Session) -> PhotoFilmConfig:
        """Settings of a film through the photos; ``GagaError`` likewise."""
        at = session.view.swipe
        return PhotoFilmConfig(self.side, self.what, at, self.sweeps, self.seconds, self.video)

    def config(self, session: Session) -> pipeline_video.FilmConfig:
        """Settings of a film along the camera's path; ``GagaError`` likewise."""
        split = None
        if self.left:
            what = self.what if self.left == "before" else self.left
            split = Split(what, session.view.swipe, self.sweeps)
        background = session.view.background
        return pipeline_video.FilmConfig(self.what, background, split, video=self.video)


def opens_film(session: Session) -> None:
    """Open the sheet of a film; what plays behind it stops."""
    session.view.playback.is_playing = False
    imgui.open_popup(FILM)


def draw(session: Session, choices: FilmChoices, files: FilePicker) -> None:
    """Whichever sheet is open; ``files`` asks for the path."""
    if begin_modal(FILM, em(36)):
        if _film(session, choices):
            dialog = writing("Save the film", session, f"{stem(session)}.mp4", (".mp4", ".webm"))
            files.ask(dialog, lambda path: _export_film(session, path, choices), FILM)
        imgui.end_popup()
    if begin_modal(PICTURE, em(36)):
        if _picture(session, choices):
            name = f"{stem(session)}.png"
            dialog = writing("Save the picture", session, name, (".png", ".jpg"))
            size, clear = choices.picture_size, choices.transparent
            save = partial(export.save_picture, size=size, transparent=clear)
            files.ask(dialog, lambda path: save(session, path), PICTURE)
        imgui.end_popup()


def _film(session: Session, choices: FilmChoices) -> bool:
    with body("Choices"):
        _along(session, choices)
        whats = [(what, icon, label, f"Film in {label.lower()}") for what, icon, label in _WHATS]
        choices.what = widgets.segmented("What", whats, choices.what, why_not={}, wraps=True)
        if choices.through_photos:
            _photos(session, choices)
        else:
            _left(session, choices)
        choices.film_size = _size(choices.film_size)
        width, height = choices.film_size
        if width % 2 or height % 2:  # see `VideoConfig.size`
            widgets.dim(f"Written as {width - width % 2} × {height - height % 2}: sides are even.")
        widgets.field_name("Pictures a second", em(_NAMES))
        _, choices.fps = widgets.slider("##Pictures a second", choices.fps, 5.0, 60.0, "%.0f")
        widgets.field_name("Quality", em(_NAMES))
        _, choices.quality = widgets.slider("##Quality", choices.quality, 1, 100, "%d")
        seconds, n = _length(session, choices)
        why_not = takes = ""
        try:
            takes = f"; takes {duration_text(_takes(session, choices))} as .mp4" if n else ""
        except GagaError as error:  # a size that no film has
            why_not = str(error)
        kinds = ".mp4 (H.264) or .webm (VP9)"
        said = f"{seconds:.1f} seconds, {counted(n, 'picture')}{takes}; {kinds}"
        widgets.text(why_not or said, theme.WARN if why_not else theme.DIM, wrap=True)
    return _ends(FILM, why_not)


def _along(session: Session, choices: FilmChoices) -> None:
    """Where the camera goes; what this scene does not have cannot be chosen."""
    why_not = {False: no_path(session), True: no_photo_files(session)}
    now = choices.wants_photos
    if now is None or why_not[now]:
        now = bool(why_not[False]) and not why_not[True]
    ways = [
        (False, icons.PATH, "Along the path", "Along the keyframes of the camera's path"),
        (True, icons.IMAGES, "Through the photos", "One photo after the other, with a line"),
    ]
    picked = widgets.segmented("Way", ways, now, why_not=why_not, wraps=True)
    if picked != now:
        choices.wants_photos = picked
    choices.through_photos = picked


def _length(session: Session, choices: FilmChoices) -> tuple[float, int]:
    """Seconds and pictures of the film."""
    if choices.through_photos:
        n_photos = len(export.photos_of(session, choices.views))
        n_each = max(round(choices.seconds * choices.fps), 1)
        return n_photos * n_each / choices.fps, n_photos * n_each
    path = camera.path_of(session)
    return path.seconds, len(path.frame_times(choices.fps)) if path.keyframes else 0


def _takes(session: Session, choices: FilmChoices) -> float:
    """Seconds until the film is written as .mp4."""
    if choices.through_photos:
        config = choices.photo_config(session)
        return export.photo_film_seconds(session, config, choices.views)
    is_before = choices.left == "before"
    return export.film_seconds(session, choices.config(session), before=is_before)


def _photos(session: Session, choices: FilmChoices) -> None:
    """Which photos, for how long, and what is left of the line."""
    why_not = {side: split_view.why_not(session, shown) for side, _, shown in _PHOTO_SIDES}
    named = {side: name for side, name, _ in _PHOTO_SIDES}
    if why_not[choices.side]:
        choices.side = "photo"
    choices.side = widgets.choice("Left of the line", named, choices.side, em(_NAMES), why_not)
    parts: dict[Views, str] = {"all": "All", "train": "Those trained on", "test": "Held out"}
    none = "The scene has no such photos."
    lacking = {part: "" if export.photos_of(session, part) else none for part in parts}
    if lacking[choices.views]:
        choices.views = "all"
    choices.views = widgets.choice("Photos", parts, choices.views, em(_NAMES), lacking)
    widgets.field_name("Seconds each", em(_NAMES))
    _, choices.seconds = widgets.slider("##Seconds each", choices.seconds, 0.2, 10.0, "%.1f")
    _sweeps(choices)


def _sweeps(choices: FilmChoices) -> None:
    hint = "Moves from the left edge to the right and back; otherwise as in the split view"
    choices.sweeps = widgets.tick("The line sweeps", choices.sweeps, hint, em(_NAMES))


def _left(session: Session, choices: FilmChoices) -> None:
    """What is left of a line through the film, and whether the line sweeps."""
    why_not: dict[Left, str] = {"before": split_view.why_not(session, Side.BEFORE)}
    if choices.left == "before" and why_not["before"]:
        choices.left = ""
    choices.left = widgets.choice("Left of a line", _LEFTS, choices.left, em(_NAMES), why_not)
    if choices.left:
        _sweeps(choices)


def _picture(session: Session, choices: FilmChoices) -> bool:
    mode = session.view.mode.value
    widgets.dim(f"What the camera sees, in {mode}; .png or .jpg")
    choices.picture_size = _size(choices.picture_size)
    label = "Without background (transparent)"
    choices.transparent = widgets.tick(label, choices.transparent)
    return _ends(PICTURE)


def _size(size: tuple[int, int]) -> tuple[int, int]:
    widgets.field_name("Width and height", em(_NAMES))
    changed, values = imgui.input_int2("##Width and height", [*size])
    if changed:
        width, height = (max(16, min(value, 16384)) for value in values)
        size = width, height
    for position, known in enumerate(_SIZES):
        name = f"{known[0]} × {known[1]}"
        if position:
            widgets.next_to(name)
        if widgets.toggle(name, size == known, hint="Take this size"):
            size = known
    return size


def _ends(title: str, why_not: str = "") -> bool:
    imgui.dummy(ImVec2(0, em(0.3)))
    return answer(f"{title}…", Face("Save as…", width=em(9), primary=True), why_not=why_not)


@notifies
def _export_film(session: Session, path: Path, choices: FilmChoices) -> bool:
    if choices.through_photos:
        shown = choices.photo_config(session)
        return export.export_photo_film(session, path, shown, choices.views)
    config, before = choices.config(session), choices.left == "before"
    return export.export_film(session, path, config, before=before)
