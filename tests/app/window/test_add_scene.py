"""Add a scene through the menu, the window's dialog, the Inspector and the list of changes."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.scene import edits
from gaga_core.scene.objects import group_indices
from gaga_studio.features import add_scene
from tests.app.window.driver import Driver, drive
from tests.core.scene.captures.scenes import any_similarity, write_furnished

pytestmark = pytest.mark.window


def test_no_outline_covers_a_preview_that_waits(display: str, grouped_copy: Path) -> None:
    """Those of a selection, and of what is under the mouse."""

    def walk(d: Driver) -> None:
        document, view = d.session.need(), d.session.view

        def outlined() -> bool:
            pictures = []
            for view.show_outline in (True, False):
                d.settle()
                pictures.append(d.pixels())
            return bool((pictures[0] != pictures[1]).any())

        d.select(1)
        assert outlined()
        tint = edits.recolor(d.scene, group_indices(d.scene, [2]), np.eye(3, 4) * 0.5)
        assert tint is not None
        d.on_main(lambda: document.show(tint, waits_as=add_scene.TITLE))
        assert not outlined()
        d.on_main(d.session.cancel_preview)
        assert outlined()

    drive(walk, path=grouped_copy)


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_a_second_scene_by_the_menu(display: str, tmp_path: Path) -> None:
    first, second = write_furnished(tmp_path, any_similarity(np.random.default_rng(9)))

    def walk(d: Driver) -> None:
        session = d.session
        n = len(session.need().scene)
        before = d.pixels()
        d.menu("File/Add a scene…")
        dialog = d.studio.ui.files.dialog
        assert dialog is not None
        d.engine.item_click("//###File dialog/##Path")
        d.engine.key_chars_replace(str(second))
        d.frames(2)
        d.click("###File dialog/Add")
        d.settle()
        found = add_scene.shown(session)
        assert found is not None
        assert (d.pixels() != before).any()
        d.click("Inspector/###Apply")
        d.settle()
        assert add_scene.shown(session) is None
        assert len(session.need().scene) > n
        d.menu("Object/What changed…")
        d.click("**/###Change 0")
        d.settle()
        change, groups = add_scene.changes(session).found[0]
        assert change.kind == "came"
        assert session.selected_groups() == groups
        sheet = d.engine.window_info("//What changed").window.rect()
        (left, _), (width, _) = d.corner, d.size
        assert sheet.max.x < left + width / 2, "it covered what it is to show"
        assert d.history.undo_title.startswith("Select ")

    drive(walk, path=first, size=(1600, 1000))
