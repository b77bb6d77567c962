"""The slider of the level of detail: it shows while it is held, and its release is one edit."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import ImVec2

from gaga_studio.actions import detail, files, history
from tests.app.window.driver import Driver, drive

pytestmark = pytest.mark.window


def test_the_slider_of_detail_is_one_edit(
    display: str, grouped_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "regions"
    shutil.copytree(grouped_scene, folder)
    (masks,) = (folder / "masks").iterdir()
    (masks / "provider.json").write_text(json.dumps({"provider": "regions", "views": {}}))

    def walk(d: Driver) -> None:
        session, document = d.session, d.session.need()
        assert detail.levels_of(session) is None
        d.on_main(lambda: files.associate(session, preset="robust"))
        d.settle()
        levels = detail.levels_of(session)
        assert levels is not None
        before, place = document.scene.labels.copy(), session.need().history.cursor
        d.engine.mouse_move("//Objects/Detail")
        d.engine.mouse_down(0)
        slider = d.engine.item_info("//Objects/Detail").rect_full.min
        d.engine.mouse_move_to_pos(ImVec2(slider.x + 3, slider.y + 8))
        d.frames(3)
        assert session.live is not None
        assert np.array_equal(document.scene.labels, before)
        d.engine.mouse_up(0)
        d.frames(3)
        assert session.live is None
        assert np.array_equal(document.scene.labels, levels.labels[0])
        assert session.need().history.cursor == place + 1
        history.undo(session)
        assert np.array_equal(document.scene.labels, before)

    drive(walk, path=folder, size=(1280, 720))
