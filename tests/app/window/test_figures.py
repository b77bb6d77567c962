"""The paper's figures in the window: the splats of a mask, the growth of the bank, two pictures."""

from pathlib import Path

import numpy as np
import pytest

from gaga_studio.actions import mask_splats, selection
from gaga_studio.commands import run
from gaga_studio.session.view_state import CentreColors
from tests.app.window.driver import Driver, drive

pytestmark = pytest.mark.window


def test_figures_of_the_paper(
    display: str, grouped_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))

    def walk(d: Driver) -> None:
        plain = d.pixels().astype(int)
        _mask_in_3d(d, plain)
        _centres_by_group(d, plain)

    drive(walk, path=grouped_scene)


def _mask_in_3d(d: Driver, plain: np.ndarray) -> None:
    """A click on a row lights up the splats of its mask; the gate is a switch."""
    d.on_main(lambda: selection.select_groups(d.session, (3,)))
    d.focus("Memory bank")
    decision = d.session.decisions(3)[0]
    d.click(f"Memory bank/**/{decision.view} {decision.mask}/##decision")
    d.until(lambda: mask_splats.found(d.session, decision) is not None, "the view is read")
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
