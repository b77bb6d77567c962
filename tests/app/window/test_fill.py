"""Delete and fill in the window: where the colors of the hole come from, and why not."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.ply import write_ply
from gaga_core.scene.project import Project, save_project
from gaga_core.scene.scene import Scene
from gaga_studio.features import fill, selection
from tests.app.window.driver import Driver, drive
from tests.core.scene.fill import models
from tests.core.scene.fill.tables import BOX, table_with_box

pytestmark = pytest.mark.window
_SURROUNDINGS, _MODEL = "Inspector/###object.fill_continue", "Inspector/###object.fill_model"


def test_a_model_is_chosen_in_the_preview_and_left_again(display: str, tmp_path: Path) -> None:
    table = table_with_box()
    write_ply(tmp_path / "table.ply", table.gaussians)
    scene = Scene.of(table.gaussians, table.labels)
    saved = save_project(Project(scene, tmp_path / "table.ply"), tmp_path / "table.gaga")
    red = models.saved(models.Red(), tmp_path / "red.pt")

    def walk(d: Driver) -> None:
        session = d.session
        assert d.on_main(lambda: selection.select_groups(session, (BOX,)))
        d.menu("Object/Delete and fill")
        d.settle()
        plain = d.pixels().astype(np.int32)
        d.click(_MODEL)
        d.answer_path(red)
        d.settle()
        found = fill.shown(session)
        assert found is not None
        assert found.model == "red.pt"
        painted = d.pixels().astype(np.int32)
        redder = (painted - plain)[:, :, 0] - (painted - plain)[:, :, 1]
        assert (redder > 60).sum() > 200, "the preview shows it"
        d.click(_SURROUNDINGS)
        d.settle()
        assert session.settings.inpainting_model == ""
        assert np.abs(d.pixels().astype(np.int32) - plain).mean() < 0.5

        with models.no_torch():
            d.click(_MODEL)
            d.frames(3)
            assert d.studio.ui.files.dialog is None, "it is off without PyTorch"

    drive(walk, path=saved, size=(1100, 700))
