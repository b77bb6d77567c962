"""The texts of the window: all of them in one file, each findable again when it is filled in."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from imgui_bundle import imgui

from gaga_studio import commands
from gaga_studio.actions import navigation
from gaga_studio.commands import COMMANDS
from gaga_studio.session.settings import Settings
from gaga_studio.session.view_state import Mode
from gaga_studio.system import paths, words
from gaga_studio.ui import translated
from tests import strings
from tests.app.window.driver import Driver, drive

_FOREIGN = re.compile("[áçéíñöšüýÁÇÉÍÑÖŠÜÝ~]")  # what `strings.pseudo` leaves behind


@pytest.fixture
def pseudo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """Accented English, a third longer, in the user's own folder of languages."""
    monkeypatch.setenv("GAGA_HOME", str(tmp_path))
    texts = {key: strings.pseudo(value) for key, value in strings.texts().items()}
    texts[words.NAME] = "Ächtung"
    write_language("en-XA", texts)
    yield texts
    words.use(words.ENGLISH)


def write_language(name: str, texts: dict[str, str]) -> None:
    folder = paths.home() / "strings"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(texts), encoding="utf-8")


def test_the_catalogue_is_complete() -> None:
    """When this fails: python -m tests.strings --write."""
    written = strings.CATALOGUE.read_text(encoding="utf-8")
    missing = strings.texts().keys() - json.loads(written).keys()
    assert not missing, "run: python -m tests.strings --write"
    assert written == strings.content(), "run: python -m tests.strings --write"


def test_every_title_and_every_reason_is_in_the_catalogue(pseudo: dict[str, str]) -> None:
    words.use("en-XA")
    for command in COMMANDS:
        assert words.tr(command.title) != command.title
    assert {c.group for c in COMMANDS} <= pseudo.keys()


def test_a_filled_text_is_found_by_its_template(pseudo: dict[str, str]) -> None:
    assert words.tr("Found 7 objects.") == "Found 7 objects."
    assert words.use("en-XA")
    assert words.tr("Found 7 objects.") == pseudo["Found {group} objects."].replace("{group}", "7")
    # What fills it is a text too: "Undo {undo_title}" of "Hide {..}".
    undo = pseudo["Undo {undo_title}"].replace("{undo_title}", pseudo["Unlock all"])
    assert words.tr("Undo Unlock all") == undo
    assert words.tr("teapot") == "teapot"
    assert words.use("en")
    assert words.tr("Hide") == "Hide"


def test_icons_blanks_and_identities_stay(pseudo: dict[str, str]) -> None:
    words.use("en-XA")
    hide = pseudo["Hide"]
    assert words.tr("\ue123  Hide ") == f"\ue123  {hide} "
    assert words.label("Hide") == f"{hide}###Hide"
    assert words.label("\ue123  Hide###object.hide") == f"\ue123  {hide}###object.hide"
    assert words.label("##picture") == "##picture"
    assert words.label("mug 3###Hide") == "mug 3###Hide"


def test_languages_are_those_that_have_a_file(pseudo: dict[str, str]) -> None:
    assert words.languages() == {"en": "English", "en-XA": "Ächtung"}
    (paths.home() / "strings" / "xx.json").write_text("{ broken")
    assert words.languages()["xx"] == "xx"
    words.use("xx")
    assert words.tr("Hide") == "Hide"
    words.use("zz")
    assert words.tr("Hide") == "Hide"


@pytest.mark.window
def test_the_window_speaks_another_language(
    display: str, scene_folder: Path, pseudo: dict[str, str]
) -> None:
    """Every text changes, every control keeps its identity, nothing is wider than its panel."""

    def walk(d: Driver) -> None:
        assert d.exists("**/###Find objects")
        d.click("**/###Find objects")
        d.settle()
        d.session.select_group(1)
        d.frames(3)
        d.click("###Inspector/###Hide")
        assert d.session.history is not None
        assert d.session.history.undo_title.startswith("Hide")
        foreign = d.on_main(lambda: imgui.calc_text_size("Hide").x)
        d.session.change_settings(Settings(first_steps_done=True))
        d.frames(3)
        assert foreign > 1.2 * d.on_main(lambda: imgui.calc_text_size("Hide").x)
        d.session.select_group(2)
        d.frames(3)
        d.click("###Inspector/###Isolate")

    settings = Settings(language="en-XA", first_steps_done=True, preset="paper")
    drive(walk, path=scene_folder, size=(1280, 720), settings=settings)


@pytest.mark.window
def test_what_is_drawn_without_a_widget_is_translated_too(
    display: str,
    grouped_scene: Path,
    pseudo: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every word that reaches the screen through a draw list is in the catalogue, or a name."""
    drawn: set[str] = set()
    plain = imgui.ImDrawList.add_text

    def record(*args: Any) -> None:
        drawn.update(a for a in args if isinstance(a, str))
        plain(*args)

    # Below the translation, which is put over it again.
    monkeypatch.setattr(imgui.ImDrawList, "add_text", record)
    monkeypatch.setattr(translated._Installed, "done", False)

    def walk(d: Driver) -> None:
        assert pseudo["Try the demo"] in drawn
        d.session.open(grouped_scene)
        d.settle()
        d.session.select_group(1)
        for mode in (Mode.GROUPS, Mode.DEPTH, Mode.MASK):
            d.session.view.mode = mode
            d.frames(3)
        navigation.go_to_view(d.session, 0)
        d.settle()
        commands.run("camera.swipe", d.session)
        d.settle()
        names = {camera.name for camera in d.session.cameras} | {d.session.title}
        for text in drawn - names:
            assert not re.search(r"[^\W\d_]{2}", text) or _FOREIGN.search(text), text
        swipe = pseudo["Photo left of the line, picture right of it"]
        assert {swipe, pseudo["test"]} <= drawn
        assert {pseudo[side].upper() for side in ("front", "back", "left", "right")} & drawn

    settings = Settings(language="en-XA", first_steps_done=True, preset="paper")
    drive(walk, size=(1280, 720), settings=settings)
