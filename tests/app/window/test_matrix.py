"""The main job in a small and a large window, in both themes, from masks to a file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.color import rgb_from_dc
from gaga_core.io.splats.ply import read_ply
from gaga_studio.session.settings import Settings
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


def test_the_main_job(display: str, tmp_path: Path) -> None:
    made = write_scene(tmp_path / "balls")
    means = made.gaussians.means.astype(np.float64)

    def walk(d: Driver) -> None:
        d.click("**/###Find objects")
        d.settle()
        before = d.pixels()
        for ball, theme, size in ((1, "light", (800, 500)), (5, "dark", (1440, 900))):
            d.session.change_settings(replace(d.session.settings, theme=theme))
            if theme == "light":
                np.testing.assert_array_equal(d.pixels(), before)  # the picture has no theme
            d.resize(*size)
            d.settle()
            edit(d, means[made.labels == ball].mean(axis=0), tmp_path / f"{theme}.ply")
            inside = (made.labels == ball).sum()
            written = read_ply(tmp_path / f"{theme}.ply")
            assert abs(len(written.means) - inside) < 0.15 * inside
            mean = rgb_from_dc(written.sh[:, 0]).mean(axis=0)
            np.testing.assert_allclose(mean, [0.94, 0.13, 0.06], atol=0.08)

    def edit(d: Driver, centre: np.ndarray, target: Path) -> None:
        d.click_picture(*d.project(centre))
        assert len(d.session.selected_groups()) == 1
        d.click("Inspector/Properties/Color")
        d.frames()
        d.type_into("$FOCUSED/##Picker/##hex/##Text", "#F02010")
        d.keys(KEY.escape)
        d.click("Inspector/###Isolate")
        d.menu("File/###Export scene…")
        d.export_to(target)
        d.settle()
        d.engine.item_click("//Viewport/##picture", 2)  # no text field has the keyboard
        d.keys(KEY.mod_shift, KEY.h)
        d.session.notices = ()

    drive(walk, path=tmp_path / "balls", size=(800, 500), settings=Settings(first_steps_done=True))
