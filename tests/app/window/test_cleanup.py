"""Clean up in the window: button, picture, Apply, and the keys."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.io.splats.ply import write_ply
from gaga_core.scene.project import Project, save_project
from gaga_core.scene.scene import State
from gaga_studio.features import cleanup, selection
from gaga_studio.session.view import Mode
from tests.app.floaters import GROUP, planted
from tests.app.looks import snapshot
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


def reddish(picture: UInt8Array) -> int:
    red, green, blue = np.moveaxis(picture.astype(np.int32), -1, 0)
    return int(((red > 110) & (red > green + 40) & (red > blue + 40)).sum())


def test_clean_up_and_apply(display: str, tmp_path: Path) -> None:
    scene, floaters = planted()
    model = tmp_path / "balls.ply"
    write_ply(model, scene.gaussians)
    saved = save_project(Project(scene, model), tmp_path / "balls.gaga")

    def walk(d: Driver) -> None:
        session, document = d.session, d.session.need()
        assert d.on_main(lambda: selection.select_groups(session, (GROUP,)))
        d.on_main(lambda: setattr(session.view, "mode", Mode.DEPTH))
        before, plain = snapshot(document.scene), d.pixels()

        d.click("Inspector/###Clean up")
        d.settle()
        assert cleanup.shown(session) is not None
        seen = d.pixels()
        assert reddish(seen) > 100
        assert seen.std(axis=2).mean() < 0.3 * plain.std(axis=2).mean(), "the rest is gray"
        d.on_main(lambda: setattr(session.view, "mode", Mode.COLOR))
        np.testing.assert_array_equal(seen, d.pixels(), "it looks the same in every render mode")
        assert not d.exists("Inspector/###Hide")
        d.keys(KEY.escape)
        assert not d.exists("Inspector/###Apply")
        assert snapshot(document.scene) == before
        assert session.selected_groups() == (GROUP,)

        d.click("Inspector/###Clean up")
        d.settle()
        d.click("Inspector/###Cancel")
        d.frames()
        assert snapshot(document.scene) == before

        d.click("Inspector/###Clean up")
        d.settle()
        d.click("Inspector/###Apply")
        d.settle()
        assert (document.scene.labels[floaters] == 0).mean() > 0.9
        cleaned = snapshot(document.scene)
        d.keys(KEY.mod_ctrl, KEY.z)
        assert snapshot(document.scene) == before

        d.click("Inspector/###Clean up")
        d.settle()
        d.keys(KEY.enter)
        assert snapshot(document.scene) == cleaned
        d.keys(KEY.mod_ctrl, KEY.z)

        name = document.name_of(GROUP)
        d.click("Inspector/###Clean first")
        d.click("Inspector/###Delete")
        d.settle()
        assert document.scene.has(State.DELETED)[floaters].all()
        assert document.history.undo_title == f"Delete {name}"

    drive(walk, path=saved)
