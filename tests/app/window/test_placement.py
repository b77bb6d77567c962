"""The sheet of a reconstruction has what messages advise, and what is chosen reaches the plan."""

from pathlib import Path

import pytest

from gaga_core.reconstruct.controls import IN_WINDOW
from tests.app.window.driver import Driver, drive
from tests.core.reconstruct.photo_scenes import write_photos

pytestmark = pytest.mark.window
_ELSEWHERE = {"Frames of each second", "Quality"}  # films only; driven by test_reconstruct


def test_the_controls_that_messages_name_are_there(display: str, tmp_path: Path) -> None:
    write_photos(tmp_path / "room" / "images", 4)

    def walk(d: Driver) -> None:
        d.click("**/###Settings…")
        d.frames(4)
        for control in set(IN_WINDOW.values()) - _ELSEWHERE:
            assert d.exists(f"**/{control}") or d.exists(f"**/##{control}"), control
        d.click("**/Object on a turntable")
        d.click("**/Antialiased")
        d.click("**/Photos differ in brightness")
        d.type_into("**/##Minutes for placing", "7")
        d.frames(2)
        plan = d.studio.ui.plan.plan
        assert plan is not None
        assert plan.config.turntable
        assert plan.config.train().antialiased
        assert plan.config.train().exposure
        assert plan.config.place_minutes == 7

    drive(walk, path=tmp_path / "room", size=(1000, 760))
