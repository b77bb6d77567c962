"""Folders and parts in the window: by keys, by dragging, by their switches; the filter; why not."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.grouping.levels import Levels
from gaga_core.scene import edits
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import State
from gaga_studio.features import folders, selection
from gaga_studio.features.find.search import SearchState
from gaga_studio.features.object_list import ListFilter, ObjectListView
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window

_ROW, _FOLDER = "Objects/**/object {}/{}", "Objects/**/folder {}/{}"


def test_objects_go_into_folders_by_hand(display: str, grouped_scene: Path, tmp_path: Path) -> None:
    folder = tmp_path / "table"
    shutil.copytree(grouped_scene, folder)

    def walk(d: Driver) -> None:
        d.until(
            lambda: d.session.need().feature(SearchState).described is not None,
            "objects are described",
        )
        d.settle()
        _make(d)
        _drag(d)
        _switch(d)
        _under(d)
        _filter(d)
        _add_views(d)
        _parts(d)

    drive(walk, path=folder, size=(1110, 760))


def _make(d: Driver) -> None:
    """Ctrl+Shift+G and a name; F2 gives another one."""
    d.on_main(lambda: selection.select_groups(d.session, (2, 3)))
    d.frames(3)
    d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.g)
    d.frames(4)
    d.engine.key_chars_replace_enter("Kitchen")
    d.frames(3)
    scene = d.session.need().scene
    assert scene.folders.home == {2: "Kitchen", 3: "Kitchen"}
    d.keys(KEY.f2)
    d.frames(4)
    d.engine.key_chars_replace_enter("Room")
    d.frames(3)
    assert scene.folders.paths == ("Room",)
    d.click(_FOLDER.format("Room", "Fold"))
    d.frames(3)
    assert not d.exists(_ROW.format(2, "##row"))
    d.click(_FOLDER.format("Room", "Fold"))
    d.frames(3)
    assert d.exists(_ROW.format(2, "##row"))


def _drag(d: Driver) -> None:
    """Objects and folders onto a folder, and out of all."""
    scene = d.session.need().scene
    onto = f"//{_FOLDER.format('Room', '##row')}"
    d.on_main(lambda: selection.select_groups(d.session, (4, 5)))
    d.frames(3)
    d.engine.item_drag_and_drop(f"//{_ROW.format(4, '##row')}", onto)
    d.frames(3)
    assert set(scene.folders.groups("Room")) == {2, 3, 4, 5}, "all that is selected"
    d.on_main(lambda: folders.put_in(d.session, "Top", (1,)))
    d.frames(3)
    d.engine.item_drag_and_drop(f"//{_FOLDER.format('Top', '##row')}", onto)
    d.frames(3)
    assert scene.folders.paths == ("Room", "Room/Top")
    d.on_main(lambda: selection.select_groups(d.session, (3,)))
    d.frames(3)
    d.engine.mouse_move(f"//{_ROW.format(3, '##row')}")
    d.engine.mouse_down(0)
    d.engine.mouse_lift_drag_threshold(0)
    d.frames(2)
    out = d.engine.item_info("//Objects/###Drop here: in no folder").rect_full
    middle = out.get_center()
    d.engine.mouse_move_to_pos(middle)
    d.frames(2)
    d.engine.mouse_up(0)
    d.frames(3)
    assert 3 not in scene.folders.home
    assert (scene.labels == 3).any(), "nothing was merged"


def _switch(d: Driver) -> None:
    """The eye and the lock of a folder; a click selects what is in it; its menu."""
    scene = d.session.need().scene
    inside = set(scene.folders.groups("Room"))
    d.click(_FOLDER.format("Room", "###Shown"))
    d.frames(3)
    assert set(np.unique(scene.labels[scene.has(State.HIDDEN)])) == inside
    d.click(_FOLDER.format("Room", "###Shown"))
    d.click(_FOLDER.format("Room", "###Locked"))
    d.frames(3)
    assert set(np.unique(scene.labels[scene.has(State.LOCKED)])) == inside
    d.click(_FOLDER.format("Room", "###Locked"))
    d.click(_FOLDER.format("Room", "##row"))
    d.frames(3)
    assert set(d.session.selected_groups()) == inside
    d.engine.item_click(f"//{_FOLDER.format('Room', '##row')}", 1)
    d.frames(3)
    d.click("$FOCUSED/###Delete the folder, keep its objects")
    d.frames(3)
    assert scene.folders.paths == ("Top",)
    assert inside <= set(np.unique(scene.labels[scene.visible]))


def _under(d: Driver) -> None:
    """An object goes under the one that it is dropped on; its arrow, its eye; out again."""
    scene = d.session.need().scene
    d.on_main(lambda: selection.select_groups(d.session, (5,)))
    d.frames(3)
    d.engine.item_drag_and_drop(f"//{_ROW.format(4, '##row')}", f"//{_ROW.format(3, '##row')}")
    d.frames(3)
    assert scene.folders.parent == {4: 3}, "only what was dragged: it was not selected"
    assert (scene.labels == 4).any(), "nothing was merged"
    d.click(_ROW.format(3, "Fold"))
    d.frames(3)
    assert not d.exists(_ROW.format(4, "##row"))
    d.click(_ROW.format(3, "Fold"))
    d.frames(3)
    d.click(_ROW.format(3, "###Shown"))
    d.frames(3)
    assert set(np.unique(scene.labels[scene.has(State.HIDDEN)])) == {3, 4}
    d.click(_ROW.format(3, "###Shown"))
    d.click(_ROW.format(3, "##row"))
    d.frames(3)
    assert d.session.selected_groups() == (3,)
    d.engine.item_double_click(f"//{_ROW.format(3, '##row')}")
    d.frames(3)
    assert d.session.selected_groups() == (3, 4)
    d.on_main(lambda: selection.select_groups(d.session, (3,)))
    d.frames(3)
    d.engine.item_drag_and_drop(f"//{_ROW.format(3, '##row')}", f"//{_ROW.format(4, '##row')}")
    d.frames(3)
    assert "under itself" in d.session.notices[-1].text
    d.on_main(lambda: selection.select_groups(d.session, (4,)))
    d.frames(3)
    d.engine.item_click(f"//{_ROW.format(4, '##row')}", 1)
    d.frames(3)
    d.click("$FOCUSED/###Take out from under its object")
    d.frames(3)
    assert scene.folders.parent == {}


def _filter(d: Driver) -> None:
    """It says how many it lists, and goes with one click."""
    listing, table = d.session.need().feature(ObjectListView), d.session.objects()
    d.click("Objects/###Filter")
    d.frames(3)
    assert d.exists("$FOCUSED/##splats/##min") or d.exists("**/##splats/##min")
    d.keys(KEY.escape)
    most = float(table.counts[table.ids > 0].max())
    listing.filter = ListFilter({"splats": (most, most)})
    d.frames(3)
    (kept,) = table.ids[(table.counts == most) & (table.ids > 0)][:1]
    others = [int(g) for g in table.ids if g not in (0, kept)]
    assert not any(d.exists(_ROW.format(g, "##row")) for g in others)
    d.type_into("Objects/##Find", "round")
    d.frames(6)
    search = d.session.need().feature(SearchState)
    assert set(search.meant) <= {kept}, "answers are filtered, too"
    assert search.n_left_out > 0
    d.click("Objects/###Clear search")
    d.frames(3)
    d.click("Objects/###Clear filter")
    d.frames(3)
    assert not listing.filter.is_on


def _add_views(d: Driver) -> None:
    """The sheet says which photos took no part, and lets their masks join."""
    document = d.session.need()
    scene, bank = document.scene, document.scene.bank
    assert bank is not None
    last = bank.log[-1].view
    older = replace(bank, log=tuple(x for x in bank.log if x.view != last))
    names, order = scene.names, scene.folders
    d.on_main(
        lambda: document.do(
            edits.set_grouping(scene, scene.labels, older, names, "Older", folders=order)
        )
    )
    d.settle()
    d.menu("Find/###Add new photos and masks…")
    d.frames(3)
    d.click("Add new photos and masks/###Add views")
    d.settle()
    assert scene.bank is not None
    assert {x.view for x in scene.bank.log} == {x.view for x in bank.log}
    assert (scene.names, scene.folders) == (names, order)


def _parts(d: Driver) -> None:
    """An arrow shows the parts of an object; a click selects one."""
    document = d.session.need()
    scene = document.scene
    rows = group_indices(scene, 2)
    fine = scene.labels.copy()
    fine[rows[: len(rows) // 3]] = 100
    assert scene.bank is not None
    bank = replace(scene.bank, levels=Levels(np.stack([scene.labels, fine]), 0))
    names, order = scene.names, scene.folders
    d.on_main(
        lambda: document.do(
            edits.set_grouping(scene, scene.labels, bank, names, "Levels", folders=order)
        )
    )
    d.settle()
    d.click(_ROW.format(2, "Fold"))
    d.frames(3)
    d.click("Objects/**/part 2 1/##row")
    d.frames(3)
    assert d.session.selected_indices().tolist() == rows[: len(rows) // 3].tolist()
    d.engine.item_click("//Objects/**/part 2 1/##row", 1)
    d.frames(3)
    d.click("$FOCUSED/###Split here")
    d.frames(3)
    assert set(np.unique(scene.labels[rows])) == {2, 100}
