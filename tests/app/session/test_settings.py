"""Settings: what is saved comes back; what is damaged does no harm."""

from dataclasses import replace
from pathlib import Path

import pytest

from gaga_core.errors import GagaError
from gaga_studio.features import selection
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings, load_settings, save_settings, settings_file
from gaga_studio.system import paths


@pytest.fixture(autouse=True)
def _home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))


def test_defaults_without_a_file() -> None:
    assert load_settings() == (Settings(), "")


def test_pictures_of_what_left_the_list_are_removed() -> None:
    kept, gone = (paths.picture_of(name) for name in ("/a", "/b"))
    kept.parent.mkdir(parents=True)
    for file in (kept, gone):
        file.write_bytes(b"")
    paths.forget_pictures(("/a", "/c"))
    assert list(kept.parent.iterdir()) == [kept]


def test_two_windows_keep_what_each_of_them_changed() -> None:
    """The later one wrote its whole settings: recent files and preferences of the other went."""
    first, second = Session(), Session()
    first.change_settings(replace(first.settings, theme="light", recent=("/a", "/b")))
    second.change_settings(replace(second.settings, clean_first=True, recent=("/c",)))
    first.change_settings(replace(first.settings, recent=("/a",)))  # takes one off its list
    saved, _ = load_settings()
    assert (saved.theme, saved.clean_first, saved.recent) == ("light", True, ("/a", "/c"))


def test_load_gives_what_was_saved() -> None:
    settings = Settings(
        recent=("/a/b c.ply", "/ü"), preset="paper", fly_speed=2.5, invert_zoom=True
    )
    save_settings(settings)
    assert load_settings() == (settings, "")
    assert [p.name for p in settings_file().parent.iterdir()] == ["settings.json"]


_DAMAGED = [
    b"",
    b"{",
    b"[1, 2]",
    b"\xff\xfe\x00",
    b'"text"',
    b'{"fly_speed": NaN}',
    b'{"undo_megabytes": 1e999}',
    b'{"recent": ' + b"[" * 1_000_000,
]


@pytest.mark.parametrize("content", _DAMAGED, ids=range(len(_DAMAGED)))
def test_damaged_file_gives_defaults_and_says_so(content: bytes) -> None:
    settings_file().parent.mkdir()
    settings_file().write_bytes(content)
    settings, problem = load_settings()
    assert settings == Settings()
    assert str(settings_file()) in problem
    aside = settings_file().with_name("settings.json.damaged")
    assert aside.name in problem
    assert aside.read_bytes() == content
    assert not settings_file().exists()
    assert load_settings() == (Settings(), "")


def test_values_of_another_kind_and_unknown_names_are_left_out() -> None:
    settings_file().parent.mkdir()
    settings_file().write_text(
        '{"recent": ["/a", 3], "preset": 7, "fly_speed": -1, "ui_scale": 2, "color": "red"}'
    )
    assert load_settings() == (Settings(recent=("/a",), ui_scale=2.0), "")


def test_newest_recent_file_stands_first_once(tmp_path: Path) -> None:
    settings = Settings()
    for i in range(14):
        settings = settings.opened(tmp_path / f"{i}.ply")
    settings = settings.opened(tmp_path / "9.ply")
    names = [Path(p).name for p in settings.recent]
    assert names[:3] == ["9.ply", "13.ply", "12.ply"]
    assert len(names) == len(set(names)) == 10


def test_home_that_cannot_be_written_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "file" / "home"))
    with pytest.raises(GagaError):
        save_settings(Settings())


@pytest.mark.parametrize(
    ("name", "written", "kept"),
    [
        ("ui_scale", "40", 2.0),
        ("ui_scale", "0.01", 0.7),
        ("ui_scale", "true", 1.0),
        ("fly_speed", "-1e300", 1.0),
        ("autosave_minutes", "0", 1.0),
        ("autosave_minutes", "5", 5.0),
        ("theme", '"purple"', "dark"),
        ("keys", '"emacs"', "supersplat"),
        ("preset", '"fast"', "robust"),
        ("background", '"#12345"', "#1c1c1f"),
        ("background", '"#A0b1C2"', "#A0b1C2"),
        ("first_steps_done", "1", False),
        ("first_steps_done", "true", True),
    ],
)
def test_what_is_out_of_range_or_unknown_is_mended(name: str, written: str, kept: object) -> None:
    settings_file().parent.mkdir()
    settings_file().write_text(f'{{"{name}": {written}}}')
    settings, problem = load_settings()
    assert getattr(settings, name) == kept
    assert problem == ""


def test_the_bytes_that_undo_may_hold_are_those_of_the_settings(associated: Session) -> None:
    history = associated.history
    assert history is not None
    assert history.budget == associated.settings.undo_bytes == 1_024_000_000
    for group in associated.objects().ids[1:6]:
        selection.select_groups(associated, (int(group),))
    n, latest = history.cursor, history.entries()[-1]
    associated.need().undo()
    associated.need().redo()
    history.set_budget(latest.nbytes)
    assert history.nbytes <= history.budget
    assert n > len(history.entries()) == history.cursor == 1
    assert history.entries()[-1] == latest
    associated.change_settings(replace(associated.settings, undo_megabytes=64.0))
    assert history.budget == 64_000_000
