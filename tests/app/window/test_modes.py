"""The rarer modes, the look and the background in the window; a moving picture comes back."""

from pathlib import Path

import numpy as np
import pytest

from gaga_studio.features import commands, selection
from gaga_studio.session.view import Mode, SplatLook
from tests.app.window.driver import Driver, drive

pytestmark = pytest.mark.window


def _choose(d: Driver, title: str) -> None:
    """An entry of the drop-down next to the modes."""
    d.click("**/###More render modes")
    d.engine.item_click(f"//$FOCUSED/###{title}")
    d.check(title)
    d.frames()


def test_modes_look_background_and_a_motion(
    display: str, grouped_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))

    def walk(d: Driver) -> None:
        color = d.pixels()
        _choose(d, "Centres")
        assert d.mode() is Mode.CENTRES
        assert np.abs(d.pixels().astype(int) - color).mean() > 5
        _choose(d, "Antialiased look (mip)")
        assert d.session.view.look is SplatLook.ANTIALIASED
        _choose(d, "Next background color")
        assert d.session.view.background == (0.0, 0.0, 0.0)
        _choose(d, "Mask of the object")
        d.on_main(lambda: selection.select_groups(d.session, (int(d.session.objects().ids[1]),)))
        mask = d.pixels()
        assert np.ptp(mask.astype(int), axis=2).max() <= 2  # white on black
        assert mask.max() > 150
        d.capture(tmp_path / "mask.png")

        d.on_main(lambda: commands.run("view.color", d.session))
        d.on_main(lambda: commands.run("view.look_auto", d.session))
        full = d.pixels()
        pacing = d.studio._pacing
        d.drag_picture((200, 150), (60, 0), 2)
        d.settle()
        assert pacing.is_settled
        d.drag_picture((260, 150), (-60, 0), 2)
        assert np.abs(d.pixels().astype(int) - full).mean() < 1  # full again, as before

    drive(walk, path=grouped_scene)
