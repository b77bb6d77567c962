"""The object list and the memory bank in the window: colors, switches, dragging, moved masks."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from gaga_studio.features import objects, selection
from gaga_studio.features.commands import run
from gaga_studio.features.find import memory_bank
from gaga_studio.features.find.search import SearchState
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


def test_objects_are_colored_sorted_joined_and_repaired(
    display: str, grouped_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "table"
    shutil.copytree(grouped_scene, folder)

    def walk(d: Driver) -> None:
        session, document = d.session, d.session.need()
        assert d.studio.images is not None

        # Rows move once when it is known what is background, which lies folded at the end.
        d.until(
            lambda: document.feature(SearchState).described is not None, "the objects are described"
        )
        d.frames(3)
        row = "Objects/**/object {}/{}"
        d.click(row.format(3, "Color"))
        d.type_into("$FOCUSED/##Picker/##hex/##Text", "#FF8000")
        d.keys(KEY.escape)
        np.testing.assert_allclose(document.scene.colors[3], [1, 128 / 255, 0], atol=1e-3)

        objects.isolate_item(session, 2)
        assert session.objects().n_hidden.sum() > 0
        objects.show_all(session)

        n_masks = len(session.decisions(4)), len(session.decisions(5))
        d.engine.key_down(KEY.mod_ctrl)  # without it 4 would go under 5
        d.engine.item_drag_and_drop(f"//{row.format(4, '##row')}", f"//{row.format(5, '##row')}")
        d.engine.key_up(KEY.mod_ctrl)
        d.frames()
        assert not (document.scene.labels == 4).any()
        assert len(session.decisions(5)) == sum(n_masks)
        session.undo()

        d.on_main(lambda: selection.select_groups(session, (3,)))
        d.frames(3)
        mask = session.decisions(3)[2]
        line = f"//Memory bank/**/{mask.view} {mask.mask}/##decision"
        d.engine.item_drag_and_drop(line, f"//{row.format(2, '##row')}")
        d.settle()
        moved = document.read.decision_of(mask.view, mask.mask)
        assert moved is not None
        assert moved.group == 2
        assert moved.by_hand
        session.undo()

        d.on_main(lambda: selection.select_groups(session, (3,)))
        d.frames(3)
        d.engine.item_click(line, 1)
        d.engine.item_click("//$FOCUSED/###New object")
        d.settle()
        moved = document.read.decision_of(mask.view, mask.mask)
        assert moved is not None
        assert moved.group > 6
        session.undo()

        assert run("object.quality", session)
        d.settle()
        d.on_main(lambda: selection.select_groups(session, (3,)))
        d.frames(3)
        d.click("Inspector/###Quality")
        d.frames(3)
        measured = memory_bank.quality_of(session, 3)
        assert measured is not None
        info = d.engine.item_info(f"//Inspector/###Worst {measured.views[0].view}")
        whole, seen = info.rect_full, info.rect_clipped
        assert whole.max.y - whole.min.y == seen.max.y - seen.min.y > 10, "it came into sight"
        d.click("Inspector/###Confidence")
        d.frames(3)
        assert d.exists("Inspector/##Uncertain below")

    drive(walk, path=folder, size=(1280, 720))
