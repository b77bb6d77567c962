"""What commands ask of the window is answered, each by exactly one dialog."""

from pathlib import Path

import pytest
from imgui_bundle import imgui

from gaga_studio.features import selection
from gaga_studio.features.commands import COMMANDS
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.studio import SceneUi, UiState, openers
from gaga_studio.ui.dialogs.files import FileDialog, draw, start_folder, writing
from gaga_studio.ui.panels.film_strip import FilmStripState
from tests.app.window.driver import KEY, Driver, drive

_BY_MOUSE = {Request.OBJECT_MENU, Request.SCENE_MENU, Request.OBJECT_MASKS}
_LATER = {Request.TIMELINE, Request.CAMERA_PATH}  # when what they show was made
_PANELS = {Request.HISTORY, *_LATER}  # come to the front
_KEYBOARD = {Request.RENAME, Request.FIND, Request.FIND_IN_VIEW}  # open nothing
_AT_ONCE = {Request.PANELS_BACK}


def test_every_request_has_exactly_one_dialog() -> None:
    assert set(openers(UiState())) == set(Request)


def test_every_request_is_asked_by_a_command_or_the_mouse(session: Session) -> None:
    asked = set()
    for command in COMMANDS:
        if command.run.__qualname__.startswith("ask."):
            command.run(session)
            asked.add(session.take_request())
    assert asked == set(Request) - _BY_MOUSE - _LATER


def test_no_folder_of_ours_is_proposed(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """The demo lies in a hidden folder, where nobody finds a film again."""
    assert session.project is not None
    assert session.project.folder is not None
    root = session.project.folder.root
    assert start_folder(session) == root
    monkeypatch.setenv("GAGA_HOME", str(root.parent))
    assert start_folder(session) == Path.home()


def test_a_scene_to_add_is_looked_for_next_to_the_open_one(session: Session) -> None:
    """The dialog began inside the open scene, and showed no files."""
    ui, document = UiState(), session.need()
    openers(ui)[Request.ADD_SCENE](session)
    folder = document.project.folder
    assert folder is not None
    assert ui.files.dialog is not None
    assert ui.files.dialog.folder == folder.root.parent
    assert ".ply" in ui.files.dialog.suffixes


@pytest.mark.parametrize("request_", [Request.OPEN_FILE, Request.OPEN_PHOTOS, Request.SAVE_PATH])
def test_each_dialog_begins_in_the_folder_that_its_kind_used_last(
    session: Session, tmp_path: Path, request_: Request
) -> None:
    """All but films and pictures began next to the scene every time."""
    ui, taken = UiState(), list[Path]()

    def begins() -> FileDialog:
        openers(ui)[request_](session)
        assert ui.files.dialog is not None
        return ui.files.dialog

    def answer(path: Path | None) -> None:
        dialog = begins()
        dialog.result, dialog.is_done = path, True
        ui.files._then = taken.append
        ui.files.take()

    first = begins().folder
    assert first == start_folder(session)
    ui.files.dialog = None
    used = tmp_path / "used"
    used.mkdir()
    answer(used / "a.json")
    assert taken == [used / "a.json"]
    answer(None)  # cancelled: no folder was used
    assert begins().folder == used
    ui.files.dialog = None
    openers(ui)[Request.ADD_SPLATS](session)
    assert ui.files.dialog is not None
    assert ui.files.dialog.folder == first, "of another kind"
    ui.files.dialog = None
    used.rmdir()
    assert begins().folder == first


def test_save_as_proposes_what_a_save_writes(session: Session, tmp_path: Path) -> None:
    """It proposed x.gaga, the former project, where x.2.gaga is saved."""

    def proposed() -> str:
        ui = UiState()
        openers(ui)[Request.SAVE_AS](session)
        assert ui.files.dialog is not None
        return ui.files.dialog.name

    assert session.project is not None
    assert session.project.folder is not None
    assert proposed() == f"{session.project.folder.root.name}.gaga"
    session.project.path = tmp_path / "x.2.gaga"
    assert proposed() == "x.2.gaga"


class _Native:
    """The desktop's dialog, answered."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def ready(self, _: int) -> bool:
        return True

    def result(self) -> str:
        return str(self.path)


@pytest.mark.parametrize(
    ("typed", "taken"),
    [
        ("a.mp4", "a.mp4"),
        ("there.mp4", "there.mp4"),  # the desktop asked whether it is replaced
        ("a", "a.mp4"),
        ("there", None),  # nobody asked whether there.mp4 is replaced
        ("a.avi", None),
    ],
)
def test_a_name_of_the_desktops_dialog_is_looked_at_like_ours(
    session: Session, tmp_path: Path, typed: str, taken: str | None
) -> None:
    """It was refused after the dialog had gone, and a name without an ending got none."""
    (tmp_path / "there.mp4").touch()
    dialog = writing("Save the film", session, "film.mp4", (".mp4", ".webm"))
    dialog.use_native, dialog._native = True, _Native(tmp_path / typed)  # type: ignore[assignment]
    draw(dialog)
    assert dialog.result == (tmp_path / taken if taken else None)
    assert dialog.is_done is bool(taken)
    if taken is None:  # ours goes on, with the name and why it is not taken
        assert (dialog.use_native, dialog.folder, dialog.name) == (False, tmp_path, typed)
        assert dialog.message


def test_another_scene_forgets_what_belonged_to_the_former() -> None:
    ui = UiState()
    ui.scene.film_strip = FilmStripState(shows_masks=True, seen=3)
    ui.scene.inspector.placement.each_axis, ui.scene.bookmarks.text = True, "half typed"
    ui.film.fps, before = 12.0, ui.scene
    ui.forget_scene()
    assert ui.scene is not before
    assert ui.scene == SceneUi(
        film_strip=FilmStripState(shows_masks=True), select_by=ui.scene.select_by,
        inspector=ui.scene.inspector,
    )  # fmt: skip
    assert (ui.scene.inspector.placement.each_axis, ui.scene.bookmarks.text) == (False, "")
    assert ui.film.fps == 12.0, "what was chosen for a film stays"


@pytest.mark.window
def test_each_request_opens_one_thing(display: str, grouped_scene: Path) -> None:
    def walk(d: Driver) -> None:
        selection.select_groups(d.session, (1,))
        files = d.studio.ui.files
        any_popup = imgui.PopupFlags_.any_popup_id | imgui.PopupFlags_.any_popup_level
        for request in Request:
            if request in _KEYBOARD | _PANELS | _AT_ONCE | {Request.MAKE_SPLATS}:  # of photos
                continue
            d.session.request = request
            d.frames(4)
            assert d.session.request is None
            is_open = d.on_main(lambda: imgui.is_popup_open("", any_popup))
            assert is_open, request
            d.keys(KEY.escape)
            assert files.dialog is None
            assert not d.on_main(lambda: imgui.is_popup_open("", any_popup)), request
        d.session.request = Request.RENAME
        d.frames(3)
        assert d.studio.ui.scene.objects.rows.renaming == 1

    drive(walk, path=grouped_scene, size=(1000, 640), settings=Settings(first_steps_done=True))
