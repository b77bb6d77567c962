"""Numbers of the Inspector: absolute position, rotation and scale, own axes, reset, boxes."""

import os
from pathlib import Path

import numpy as np
import pytest

from gaga_core.scene.orientation import degrees_of
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import selection
from gaga_studio.session.settings import Settings
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window
_PICTURES = os.environ.get("GAGA_TEST_PICTURES")  # a folder: pictures are taken, at more sizes
_SIZES = [((800, 500), 1.0), ((1440, 900), 1.0), ((2560, 1440), 2.0)]


@pytest.mark.parametrize(("size", "scale"), _SIZES if _PICTURES else _SIZES[:1], ids=str)
def test_numbers_are_typed_read_again_and_reset(
    display: str, grouped_scene: Path, size: tuple[int, int], scale: float
) -> None:
    def walk(d: Driver) -> None:
        session = d.session
        document = session.need()
        group = int(session.objects().ids[-1])
        d.on_main(lambda: selection.select_groups(session, (group,)))
        d.focus("Inspector")
        d.settle()
        splats = session.selected_indices()
        start = world_means(document.scene, splats)
        n = document.history.cursor
        for field, typed in (("Rotation Z", "30"), ("Scale X", "2"), ("Position Y", "0.25")):
            d.type_into(f"Inspector/Properties/##{field}", typed)
            d.settle()
        assert document.history.cursor == n + 3, "one edit for each number"
        pose = document.selected_pose()
        assert pose is not None
        np.testing.assert_allclose(degrees_of(pose, local=False), [0, 0, 30], atol=1e-4)
        np.testing.assert_allclose(pose.scale, 2.0, rtol=1e-6)
        assert pose.centre[1] == pytest.approx(0.25, abs=2e-3)
        d.click("Inspector/Each axis")
        d.click("Inspector/Own axes")
        d.type_into("Inspector/Properties/##Scale Z", "1")
        d.settle()
        pose = document.selected_pose()
        assert pose is not None
        np.testing.assert_allclose(pose.scale, [2, 2, 1], rtol=1e-6)
        sizes, box = document.selected_sizes(local=True), document.selected_oriented_box()
        assert sizes is not None
        assert box is not None
        assert np.prod(box.size) < 1.02 * np.prod(sizes)
        d.click("Inspector/Box")
        d.settle()
        assert session.view.show_box
        if _PICTURES:
            d.capture(Path(_PICTURES) / f"placement_{size[0]}.png")
        d.click("Inspector/###Reset placement")
        d.settle()
        np.testing.assert_array_equal(world_means(document.scene, splats), start)
        for _ in range(5):
            d.keys(KEY.mod_ctrl, KEY.z)
        d.settle()
        assert document.history.cursor == n
        np.testing.assert_array_equal(world_means(document.scene, splats), start)

    settings = Settings(first_steps_done=True, ui_scale=scale)
    drive(walk, path=grouped_scene, size=size, settings=settings)
