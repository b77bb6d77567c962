"""The tool Measure in the window: click, read, set the scale, undo; at several sizes."""

import os
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.splat_files import write_splats
from gaga_core.scene.frame import scale_of
from gaga_studio.features import measure
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import ViewportPoint
from gaga_studio.tools.ground import surface_point
from tests.app.window.driver import KEY, Driver, drive
from tests.scenes import objects_scene

pytestmark = pytest.mark.window
_PICTURES = os.environ.get("GAGA_TEST_PICTURES")  # a folder: pictures are taken, at more sizes
_SIZES = [(800, 500), (1440, 900), (2560, 1440)]


@pytest.mark.parametrize("size", _SIZES if _PICTURES else _SIZES[:1], ids=str)
def test_a_length_is_clicked_and_made_a_metre(
    display: str, tmp_path: Path, size: tuple[int, int]
) -> None:
    write_splats(tmp_path / "balls.ply", objects_scene().gaussians)

    def walk(d: Driver) -> None:
        session = d.session
        session.notices = ()
        d.menu("Tools/###Measure lengths, angles and heights")
        width, height = d.size
        spots = [
            (u, v)
            for u in np.linspace(0.4, 0.6, 9) * width
            for v in np.linspace(0.35, 0.8, 10) * height
            if surface_point(session, ViewportPoint(float(u), float(v), width, height)) is not None
        ]
        first, second, third = spots[0], spots[-1], spots[len(spots) // 2]
        for n, spot in enumerate((first, second, third), 1):
            d.click_picture(*spot)
            assert len(measure.clicked(session).points) == n
        d.settle()
        if _PICTURES:
            d.capture(Path(_PICTURES) / f"measure_{size[0]}.png")
        d.keys(KEY.backspace)
        assert len(measure.clicked(session).points) == 2
        d.type_into("**/##Known length", "2.5")
        d.click("**/###Set scale")
        d.settle()
        assert session.need().history.undo_title == "Set scale"
        assert measure.reading(session).lengths == pytest.approx((2.5,), rel=1e-4)
        assert session.need().scene.frame.is_metric
        if _PICTURES:
            d.capture(Path(_PICTURES) / f"measure_metres_{size[0]}.png")
        d.keys(KEY.mod_ctrl, KEY.z)
        d.settle()
        assert scale_of(session.need().world) == pytest.approx(1.0)
        d.keys(KEY.escape)
        assert session.tool is ToolName.PICK

    drive(walk, path=tmp_path / "balls.ply", size=size)
