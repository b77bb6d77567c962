"""Align to ground in the window: three clicks, an orbit between them, a click on nothing."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import measure
from gaga_studio.session.view import ToolName
from tests.app.window.driver import KEY, Driver, drive
from tests.scenes import objects_scene

pytestmark = pytest.mark.window
_TILT = np.radians(20.0)


@pytest.mark.parametrize("size", [(800, 500), (1280, 800)], ids=str)
def test_three_clicks_lay_the_scene_level(
    display: str, tmp_path: Path, size: tuple[int, int]
) -> None:
    made = Scene.of(objects_scene().gaussians)
    c, s = np.cos(_TILT), np.sin(_TILT)
    tilted = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 1.0]])
    edit = edits.transform(made, np.arange(len(made)), tilted)
    assert edit is not None
    edit.apply(made)
    write_splats(tmp_path / "slope.ply", bake(made))
    floor = np.flatnonzero(objects_scene().gaussians.means[:, 2] < -0.299)

    def ground(d: Driver) -> DoubleArray:
        return world_means(d.session.need().scene)[floor].astype(np.float64)

    def click_ground(d: Driver, inside: tuple[float, float], n: int) -> None:
        """On the bare floor near this share of the picture, with nothing of the window there."""
        pixels, _ = d.session.rig.camera(*d.size).project(ground(d))
        wanted = np.array(inside) * d.size
        for u, v in pixels[np.argsort(np.linalg.norm(pixels - wanted, axis=1))]:
            found = d.session.pick(float(u), float(v), *d.size)
            if found is not None and found.splat in floor:
                break
        d.click_picture(float(u), float(v))
        assert len(measure.clicked(d.session).points) == n

    def walk(d: Driver) -> None:
        session = d.session
        session.rig.look_from((0, -1, 1))
        session.notices = ()
        d.settle()
        plain = d.pixels()
        d.keys(KEY.b)
        d.menu("Tools/###Align to ground by three points")
        click_ground(d, (0.3, 0.45), 1)
        d.drag_picture((d.size[0] / 2, d.size[1] / 2), (40, 0))
        d.settle()
        assert len(measure.clicked(session).points) == 1
        empty = [(20, v) for v in range(70, 300) if session.pick(20, v, *d.size) is None]
        d.click_picture(*empty[0])
        assert "no surface" in session.hint
        click_ground(d, (0.7, 0.45), 2)
        d.keys(KEY.backspace)
        assert len(measure.clicked(session).points) == 1
        click_ground(d, (0.7, 0.45), 2)
        assert not session.unsaved
        click_ground(d, (0.5, 0.75), 0)
        d.settle()
        assert session.tool is ToolName.BRUSH
        history = session.need().history
        assert history.undo_title == "Align to ground"
        laid = ground(d)
        normal = np.linalg.svd(laid - laid.mean(axis=0))[2][2]
        assert np.linalg.norm(np.cross(normal, session.rig.up)) < 0.06
        assert np.abs(laid @ session.rig.up).max() < 0.1
        seen = (d.pixels() != np.array([28, 28, 31])).any(axis=2).mean()
        assert seen > 0.5 * (plain != np.array([28, 28, 31])).any(axis=2).mean()
        d.keys(KEY.mod_ctrl, KEY.z)
        d.settle()
        assert not session.unsaved
        seen = (d.pixels() != np.array([28, 28, 31])).any(axis=2).mean()
        assert seen > 0.5 * (plain != np.array([28, 28, 31])).any(axis=2).mean()
        d.menu("Tools/###Align to ground by three points")
        d.keys(KEY.escape)
        assert session.tool is ToolName.BRUSH

    drive(walk, path=tmp_path / "slope.ply", size=size)
