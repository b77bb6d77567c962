"""A right click in the picture: the menu of the object there, or of the scene."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.scene.scene import State
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


def test_the_menu_of_the_object_under_the_mouse(display: str, tmp_path: Path) -> None:
    made = write_scene(tmp_path / "balls")
    ball = int(made.labels.max())
    centre = made.gaussians.means[made.labels == ball].mean(axis=0).astype(np.float64)

    def walk(d: Driver) -> None:
        d.click("**/###Find objects")
        d.settle()
        u, v = d.project(centre)
        d.click_picture(u, v, 1)
        d.frames(3)
        (group,) = d.session.selected_groups()
        inside = made.labels[d.session.selected_indices()]
        assert np.bincount(inside).argmax() == ball
        d.click("$FOCUSED/###Set the pivot here")
        assert d.session.view.pivot is not None
        assert np.linalg.norm(np.array(d.session.view.pivot) - centre) < 0.5
        d.click_picture(u, v, 1)
        d.frames(3)
        d.click("$FOCUSED/###Hide")
        assert d.session.need().scene.has(State.HIDDEN)[made.labels == ball].mean() > 0.9
        before = d.session.rig.pose.pivot.copy()
        d.drag_picture((u, v), (60, 10), 1)
        assert not np.array_equal(d.session.rig.pose.pivot, before), "a right drag pans"
        assert not d.exists("$FOCUSED/###Set the pivot here")
        d.click_picture(4, 4, 1)
        d.frames(3)
        d.click("$FOCUSED/###Show all")
        assert not d.session.need().scene.has(State.HIDDEN).any()
        d.keys(KEY.escape)
        assert group in d.session.objects().ids

    drive(walk, path=tmp_path / "balls", size=(800, 500))
