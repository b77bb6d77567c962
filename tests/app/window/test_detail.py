"""The slider of the level of detail: it shows while it is held, and its release is one edit."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import ImVec2

from gaga_core.scene import edits
from gaga_studio.features import object_list, selection
from gaga_studio.features.commands import run
from gaga_studio.features.find import association
from tests.app.window.driver import Driver, drive

pytestmark = pytest.mark.window


def _split_and_join(d: Driver) -> None:
    """The commands of the menus of a right click, as edits."""
    session, document = d.session, d.session.need()
    scene, before = document.scene, document.scene.labels.copy()
    groups = np.flatnonzero(np.bincount(before)[1:]) + 1
    group = next(g for g in groups.tolist() if edits.split_here(scene, g) is not None)
    d.on_main(lambda: selection.select_groups(session, (group,)))
    assert d.on_main(lambda: run("object.split_here", session))
    d.frames(3)
    assert len(np.unique(document.scene.labels[before == group])) > 1
    assert np.array_equal(document.scene.labels[before != group], before[before != group])
    d.on_main(lambda: selection.select_groups(session, (group,)))
    assert d.on_main(lambda: run("object.join_here", session))
    assert (document.scene.labels[before == group] == group).all()
    for _ in ("join", "select", "split"):
        session.undo()
    assert np.array_equal(document.scene.labels, before)


def test_the_slider_of_detail_is_one_edit(
    display: str, grouped_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "regions"
    shutil.copytree(grouped_scene, folder)
    (masks,) = (folder / "masks").iterdir()
    (masks / "provider.json").write_text(json.dumps({"provider": "regions", "views": {}}))

    def walk(d: Driver) -> None:
        session, document = d.session, d.session.need()
        assert object_list.levels_of(session) is None
        d.on_main(lambda: association.associate(session, preset="robust"))
        d.settle()
        levels = object_list.levels_of(session)
        assert levels is not None
        before, place = document.scene.labels.copy(), session.need().history.cursor
        d.engine.mouse_move("//Objects/##Detail")
        d.engine.mouse_down(0)
        slider = d.engine.item_info("//Objects/##Detail").rect_full.min
        d.engine.mouse_move_to_pos(ImVec2(slider.x + 3, slider.y + 8))
        d.frames(3)
        assert session.live is not None
        assert np.array_equal(document.scene.labels, before)
        d.engine.mouse_up(0)
        d.frames(3)
        assert session.live is None
        assert np.array_equal(document.scene.labels, levels.labels[0])
        assert session.need().history.cursor == place + 1
        session.undo()
        assert np.array_equal(document.scene.labels, before)
        _split_and_join(d)

    drive(walk, path=folder, size=(1280, 720))
