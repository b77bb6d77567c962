"""The paper's figures in the window: the splats of a mask, the growth of the bank, two pictures."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import ImVec2

from gaga_core.io.splats.splat_files import SplatFormat, write_splats
from gaga_studio.features import selection
from gaga_studio.features.commands import run
from gaga_studio.features.find import memory_bank
from gaga_studio.features.find.memory_bank import Timeline
from gaga_studio.session.view import CentreColors, Mode, Side
from tests.app.window.driver import KEY, Driver, drive
from tests.scenes import random_gaussians

pytestmark = pytest.mark.window


def test_figures_of_the_paper(
    display: str, grouped_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))

    def walk(d: Driver) -> None:
        plain = d.pixels().astype(int)
        _mask_in_3d(d, plain)
        _centres_by_group(d, plain)
        _replay(d)
        _split(d, d.pixels().astype(int))

    drive(walk, path=grouped_scene)


def _mask_in_3d(d: Driver, plain: np.ndarray) -> None:
    """A click on a row lights up the splats of its mask; the gate is a switch."""
    d.on_main(lambda: selection.select_groups(d.session, (3,)))
    d.focus("Memory bank")
    decision = d.session.decisions(3)[0]
    d.click(f"Memory bank/**/{decision.view} {decision.mask}/##decision")
    d.until(lambda: memory_bank.mask_splats_of(d.session, decision) is not None, "the view is read")
    lit = d.pixels().astype(int)
    assert np.abs(lit - plain).mean() > 5
    d.click("Memory bank/Depth gate")
    free = d.pixels().astype(int)
    assert np.abs(free - lit).max() > 60  # the floor behind the ball is pink
    d.click("Memory bank/###Light up")
    assert np.abs(d.pixels().astype(int) - plain).mean() < 2  # but for the outline
    d.on_main(lambda: run("select.none", d.session))
    d.click("**/###Close photo")


def _centres_by_group(d: Driver, plain: np.ndarray) -> None:
    d.menu("View/###Centres in the colors of their groups")
    assert d.session.view.centre_colors is CentreColors.GROUPS
    assert np.abs(d.pixels().astype(int) - plain).mean() > 5
    d.menu("View/###Centres in the colors of their groups")
    d.menu("View/###Color")


def _replay(d: Driver) -> None:
    """The bank grows from nothing to the saved groups; a step can be taken from the curve."""
    d.on_main(lambda: run("view.groups", d.session))
    saved = d.pixels().astype(int)
    d.on_main(lambda: run("view.color", d.session))
    timeline = d.session.document.feature(Timeline)  # type: ignore[union-attr]
    timeline.follows = False
    d.menu("View/###Replay the memory bank")
    d.until(lambda: timeline.is_open, "the growth is known")
    growth = timeline.growth
    assert growth is not None
    d.until(lambda: not timeline.is_playing, "the replay has ended")
    assert timeline.step == growth.last_step
    d.click("Timeline/**/###Step back")
    assert timeline.step == growth.last_step - 1
    d.click("Timeline/**/###Close replay")
    assert d.mode() is Mode.COLOR
    d.on_main(lambda: run("view.groups", d.session))
    assert np.abs(d.pixels().astype(int) - saved).mean() < 1
    d.on_main(lambda: run("view.color", d.session))
    d.menu("View/###Replay the memory bank")
    d.until(lambda: timeline.is_open, "the replay is shown at once")
    d.click("Timeline/**/###Camera follows")
    d.until(lambda: d.session.active_view is not None, "the camera follows")
    d.on_main(lambda: run("view.depth", d.session))
    d.keys(KEY.escape)
    assert not timeline.is_open
    assert d.mode() is Mode.DEPTH  # chosen during the replay
    d.on_main(lambda: run("view.color", d.session))


def _split(d: Driver, plain: np.ndarray) -> None:
    """Picture left of the line, groups right of it; the line moves by a drag."""
    d.menu("Camera/###Split: picture and groups")
    d.frames(8)
    d.on_main(lambda: setattr(d.session.view, "swipe", 0.4))
    width, height = d.size
    d.move_to(0.4 * width, 0.7 * height)
    d.engine.mouse_drag_with_delta(ImVec2(0.3 * width, 0), 0)
    d.frames()
    assert abs(d.session.view.swipe - 0.7) < 0.03
    right = d.pixels().astype(int)  # the picture under it all: groups
    assert d.studio.left is not None
    left = d.on_main(d.studio.left.read_pixels).astype(int)
    assert np.abs(left - plain).mean() < 2
    assert np.abs(right - plain).mean() > 5
    assert d.on_main(d.session.muted_colors)
    d.on_main(lambda: setattr(d.session.view, "sides", (Side.GROUPS, Side.GROUPS)))
    d.frames(8)
    left = d.on_main(d.studio.left.read_pixels).astype(int)
    assert np.abs(left - right).mean() < 0.1, "groups have the same colors on both sides"
    d.on_main(lambda: selection.select_groups(d.session, (3,)))
    d.on_main(lambda: run("object.hide", d.session))
    d.on_main(lambda: run("select.none", d.session))
    d.menu("Camera/###Split: before and after the last edit")
    d.settle()
    left = d.on_main(d.studio.left.read_pixels).astype(int)
    assert np.abs(left - plain).mean() < 2
    assert np.abs(d.pixels().astype(int) - plain).mean() > 0.5
    d.click("**/###Close split view")
    d.frames(3)
    assert d.studio.left is None
    d.on_main(lambda: run("edit.undo", d.session))


def test_a_file_that_may_stand_on_its_head_offers_to_turn_it(
    display: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))
    path = tmp_path / "toy.spz"
    write_splats(path, random_gaussians(200, seed=4), SplatFormat.SPZ)
    data = bytearray(gzip.decompress(path.read_bytes())[:-12])
    data[14] &= ~2  # the flag of extensions: nothing says which way is up
    path.write_bytes(gzip.compress(bytes(data)))

    def walk(d: Driver) -> None:
        before = d.pixels().astype(int)
        d.click("Notice 0/###Turn upright")
        assert np.abs(d.pixels().astype(int) - before).mean() > 1
        assert d.session.settings.upright == (str(path),)
        assert not d.exists("Notice 0/###Turn upright")

    drive(walk, path=path)
