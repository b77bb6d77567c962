"""From the first screen to a file in six clicks, as the guide's film shows it."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.splat_files import read_splats
from gaga_studio.session.settings import Settings
from tests.app.folders import write_scene
from tests.app.window.driver import Driver, drive

pytestmark = pytest.mark.window


def test_open_find_click_isolate_export(
    display: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = write_scene(tmp_path / "balls")
    ball = int(made.labels.max())
    centre = made.gaussians.means[made.labels == ball].mean(axis=0).astype(np.float64)

    def walk(d: Driver) -> None:
        session, n_clicks = d.session, 0

        def click(ref: str) -> None:
            nonlocal n_clicks
            n_clicks += 1
            d.click(ref)
            d.settle()

        click("Viewport/###Recent 0")
        click("**/###Find objects")
        d.click_picture(*d.project(centre))
        n_clicks += 1
        click("Inspector/###Isolate")
        click("Inspector/###Export…")
        written = Path(d.studio.ui.export.path).expanduser()
        assert not written.exists()
        click("Export/###Export now")
        assert n_clicks == 6
        inside = np.isin(np.arange(len(made.labels)), session.selected_indices())
        truth = made.labels == ball
        assert (inside & truth).sum() / (inside | truth).sum() > 0.9
        assert len(read_splats(written)) == inside.sum()
        assert d.exists("**/###Show in folder")

    drive(walk, settings=Settings(recent=(str(tmp_path / "balls"),)), size=(1280, 720))
