"""Render modes, looks and the background as commands, without a window."""

from dataclasses import replace

import pytest

from gaga_studio.features.commands import command, run
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings, hex_color, load_settings
from gaga_studio.session.view import Mode, SplatLook


def test_modes_without_anything_to_show_are_left_out(session: Session) -> None:
    """Not associated: no groups, no mask, no confidence."""
    assert "Find objects" in command("view.confidence").enabled(session)
    seen = []
    for _ in range(8):
        run("view.next_mode", session)
        seen.append(session.view.mode)
    assert seen[:4] == [Mode.DEPTH, Mode.CENTRES, Mode.RINGS, Mode.COLOR]
    assert seen[4:] == seen[:4]


def test_from_a_mode_that_lost_its_subject_the_next_one_is_taken(session: Session) -> None:
    session.view.mode = Mode.MASK
    run("view.next_mode", session)
    assert session.view.mode is Mode.COLOR
    session.view.mode = Mode.GROUPS
    run("view.next_mode", session)
    assert session.view.mode is Mode.DEPTH


def test_the_look_follows_the_file_unless_it_is_chosen(associated: Session) -> None:
    scene = associated.scene
    assert scene is not None
    assert not associated.view.is_antialiased(scene)
    scene.gaussians = replace(scene.gaussians, comments=("SplatRenderMode: mip",))
    assert associated.view.is_antialiased(scene)
    run("view.look_classic", associated)
    assert associated.view.look is SplatLook.CLASSIC
    assert not associated.view.is_antialiased(scene)
    run("view.look_auto", associated)
    assert associated.view.is_antialiased(scene)


def test_a_background_is_used_and_remembered(associated: Session) -> None:
    seen = set()
    for _ in range(4):
        run("view.background", associated)
        assert associated.view.background == associated.settings.background_color
        seen.add(associated.view.background)
    assert len(seen) == 4
    assert {(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)} < seen
    run("view.background", associated)
    again, _ = load_settings()
    assert again.background_color == associated.view.background


@pytest.mark.parametrize("color", ["#1c1c1f", "#000000", "#ffffff", "#0a80fe"])
def test_colors_as_html_writes_them(color: str) -> None:
    assert hex_color(Settings(background=color).background_color) == color


@pytest.mark.parametrize("color", ["", "red", "#12", "#1234567", "#gggggg"])
def test_a_color_that_is_none_is_black(color: str) -> None:
    assert Settings(background=color).background_color == (0.0, 0.0, 0.0)
