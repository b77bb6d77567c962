"""The object list and the memory bank in the window: colors, switches, dragging, moved masks."""

import json
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imgui_bundle import ImVec2, imgui
from PIL import Image

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.grouping.levels import Levels
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.progress import Progress, Stage
from gaga_core.scene import edits
from gaga_core.scene.edits.values import joined
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import State
from gaga_studio.features import folders, measure, object_list, objects, selection, split_view
from gaga_studio.features.commands import run
from gaga_studio.features.find import association, memory_bank
from gaga_studio.features.find.search import SearchState
from gaga_studio.features.object_list import UNSURE, ListFilter, ObjectListView, measures
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings, load_settings
from gaga_studio.tools.move import MoveTool
from gaga_studio.ui.panels import rows
from gaga_studio.ui.panels.rows import RowColumns
from gaga_studio.ui.viewport import gizmo
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive
from tests.scenes import random_gaussians

pytestmark = pytest.mark.window


def test_objects_are_colored_sorted_joined_and_repaired(display: str, grouped_copy: Path) -> None:
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

        d.select(3)
        weights, n = document.scene.weights, document.history.cursor
        for kind, value in (("Mass", 0.35), ("Density", 800.0)):
            d.engine.item_input_value(f"//Inspector/**/##{kind}", value)
            d.frames()
            assert document.scene.weights[3].kind == kind.lower()
            assert document.scene.weights[3].value == pytest.approx(value)
        assert document.history.cursor == n + 2
        session.undo()
        session.undo()
        assert document.scene.weights == weights

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

        d.select(3)
        mask = session.decisions(3)[2]
        line = f"//Memory bank/**/{mask.view} {mask.mask}/##decision"
        d.engine.item_drag_and_drop(line, f"//{row.format(2, '##row')}")
        d.settle()
        moved = document.read.decision_of(mask.view, mask.mask)
        assert moved is not None
        assert moved.group == 2
        assert moved.by_hand
        session.undo()

        d.select(3)
        d.engine.item_click(line, 1)
        d.engine.item_click("//$FOCUSED/###New object")
        d.settle()
        moved = document.read.decision_of(mask.view, mask.mask)
        assert moved is not None
        assert moved.group > 6
        session.undo()

        assert run("object.quality", session)
        d.settle()
        d.select(3)
        d.click("Inspector/###Quality")
        d.frames(3)
        measured = memory_bank.quality_of(session, 3)
        assert measured is not None
        info = d.engine.item_info(f"//Inspector/###Worst {measured.views[0].view}")
        whole, seen = info.rect_full, info.rect_clipped
        assert whole.max.y - whole.min.y == seen.max.y - seen.min.y > 10, "it came into sight"
        d.click("Inspector/###Confidence")
        assert d.exists("Inspector/##Uncertain below")

    drive(walk, path=grouped_copy, size=(1280, 720))


# --- The object list in the window: words as names, the folded background, partial selections.


def test_the_list_can_be_read(display: str, grouped_copy: Path, tmp_path: Path) -> None:
    def walk(d: Driver) -> None:
        session, document = d.session, d.session.need()
        d.until(
            lambda: document.feature(SearchState).described is not None, "objects are described"
        )
        d.settle()
        _words_stay(d)
        _background_folds(d)

        row = "Objects/**/object 2/##row"
        some = group_indices(document.scene, 2)
        d.on_main(lambda: document.select(some[: len(some) // 3]))
        d.settle()
        assert session.selected_groups() == (2,)
        partial = _pixels(d, row, tmp_path)
        d.on_main(lambda: document.select(some))
        d.settle()
        whole = _pixels(d, row, tmp_path)
        d.on_main(lambda: document.select(some[:0]))
        d.settle()
        none = _pixels(d, row, tmp_path)
        blue = [float(np.median(shown[..., 2])) for shown in (none, partial, whole)]
        assert blue[0] < blue[1] < blue[2]  # half-lit

    drive(walk, path=grouped_copy, size=(1280, 720))


def test_columns_give_way_by_width_only(
    display: str, grouped_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first folder took the column Splats away from a list that had room for it."""
    asked: list[tuple[tuple[int | bool, ...], ...]] = []
    columns_for, avail = rows.columns_for, imgui.get_content_region_avail

    def shown(depth: int, has_arrows: bool) -> tuple[int | bool, ...]:
        now = columns_for(True, 50.0, depth, has_arrows)
        return now.splats, now.views, now.quality, now.shown, now.n_switches, now.has_picture

    def noted(*settings: Any) -> RowColumns:
        if not asked:
            for width in range(160, 800, 10):  # pixels of a list
                monkeypatch.setattr(imgui, "get_content_region_avail", lambda w=width: ImVec2(w, 9))
                asked.append((shown(0, False), shown(0, True), shown(3, True)))
            monkeypatch.setattr(imgui, "get_content_region_avail", avail)
        return columns_for(*settings)

    monkeypatch.setattr(rows, "columns_for", noted)
    drive(lambda d: d.frames(2), path=grouped_copy)
    assert len(set(asked)) > 5, "wider lists have more"
    assert all(plain == in_arrows == deep for plain, in_arrows, deep in asked)


def test_the_row_of_what_is_selected_is_seen_whole(display: str, tmp_path: Path) -> None:
    """At the end of a list of which few rows fit, too."""
    n = 24

    def walk(d: Driver) -> None:
        document = d.session.need()
        every = np.arange(len(document.scene))
        d.on_main(
            lambda: document.do(
                edits.set_labels(document.scene, every, (every % n + 1).astype(np.int32), "x")
            )
        )
        d.settle()
        for group in (n - 1, 2, n // 2):
            d.on_main(lambda group=group: selection.select_groups(d.session, (group,)))  # type: ignore[misc]
            d.frames(4)
            info = d.engine.item_info(f"//Objects/**/object {group}/##row")
            row, seen = info.rect_full, info.rect_clipped
            assert row.max.y - row.min.y == seen.max.y - seen.min.y > 10, group

    write_scene(tmp_path / "balls", masks=False)
    drive(walk, path=tmp_path / "balls", size=(800, 500))


def _pixels(d: Driver, ref: str, folder: Path) -> UInt8Array:
    """What the window shows of an item."""
    d.move_to(4, 4)
    d.capture(folder / "window.png")
    rect = d.engine.item_info(f"//{ref}").rect_full
    left, top, right, bottom = (round(x) for x in (*rect.min, *rect.max))
    with Image.open(folder / "window.png") as image:
        return np.asarray(image.convert("RGB"))[top:bottom, left:right]


def _words_stay(d: Driver) -> None:
    session, document = d.session, d.session.need()
    before = dict(document.scene.described)
    assert set(before) == {int(g) for g in session.objects().ids if g > 0}
    assert not any(name.startswith("group") for name in session.objects().names[1:])
    found = document.feature(SearchState).described
    assert d.on_main(lambda: objects.rename(session, 3, "lamp"))
    d.until(lambda: document.name_of(3) == "lamp", "the name is shown")
    d.select(4)
    assert d.on_main(lambda: objects.delete(session))
    d.until(
        lambda: document.feature(SearchState).described is not found, "objects are described again"
    )
    after = document.scene.described
    assert {g: after[g] for g in after} == {g: before[g] for g in before if g not in (3, 4)}


def _background_folds(d: Driver) -> None:
    document = d.session.need()
    found = document.feature(SearchState).described
    assert found is not None
    behind = found.description.background
    assert behind
    row = f"Objects/**/object {min(behind)}/##row"
    assert not d.exists(row)
    d.select(min(behind))
    d.until(lambda: d.exists(row), "what is selected has its row")
    d.keys(KEY.f2)
    d.keys(KEY.escape)
    assert d.exists(row)
    d.keys(KEY.escape)
    d.until(lambda: not d.exists(row), "it is folded again")
    d.click("Objects/**/##background")
    assert d.exists(row)
    assert not load_settings()[0].folds_background
    d.click("Objects/**/##background")
    assert not d.exists(row)


# --- Folders and parts in the window: by keys, by dragging, by their switches; the filter; why
# not.

_ROW, _FOLDER = "Objects/**/object {}/{}", "Objects/**/folder {}/{}"


def test_objects_go_into_folders_by_hand(display: str, grouped_copy: Path) -> None:
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

    drive(walk, path=grouped_copy, size=(1110, 760))


def _make(d: Driver) -> None:
    """Ctrl+Shift+G and a name; F2 gives another one."""
    d.select(2, 3)
    d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.g)
    d.engine.key_chars_replace_enter("Kitchen")
    d.frames(3)
    scene = d.scene
    assert scene.folders.home == {2: "Kitchen", 3: "Kitchen"}
    d.keys(KEY.f2)
    d.engine.key_chars_replace_enter("Room")
    d.frames(3)
    assert scene.folders.paths == ("Room",)
    d.click(_FOLDER.format("Room", "Fold"))
    assert not d.exists(_ROW.format(2, "##row"))
    d.click(_FOLDER.format("Room", "Fold"))
    assert d.exists(_ROW.format(2, "##row"))


def _drag(d: Driver) -> None:
    """Objects and folders onto a folder, and out of all."""
    scene = d.scene
    onto = f"//{_FOLDER.format('Room', '##row')}"
    d.engine.item_drag_and_drop(f"//{_ROW.format(4, '##row')}", onto)
    d.frames(3)
    assert d.session.selected_groups() == (2, 3), "the dragged row was not selected"
    d.menu_of(_FOLDER.format("Room", "##row"), "###Hide")
    hidden = np.unique(scene.labels[scene.has(State.HIDDEN)])
    assert hidden.tolist() == [2, 3, 4], "the menu of a folder acts on all that is in it"
    d.keys(KEY.mod_ctrl, KEY.z)
    for item, change in (("Duplicate", 1), ("Delete", -1)):
        n = int((~scene.has(State.DELETED)).sum())
        inside = sum(len(group_indices(scene, group)) for group in (2, 3, 4))
        d.menu_of(_FOLDER.format("Room", "##row"), f"###{item}")
        assert (~scene.has(State.DELETED)).sum() == n + change * inside, item
        d.keys(KEY.mod_ctrl, KEY.z)
    d.menu_of(_FOLDER.format("Room", "##row"), "###Recolor…")
    assert d.session.selected_groups() == (2, 3, 4)
    d.keys(KEY.escape)
    d.menu_of(_FOLDER.format("Room", "##row"), "###Export selection…")
    assert d.engine.get_window_by_ref("//Export").active
    d.keys(KEY.escape)
    d.select(4, 5)
    d.engine.item_drag_and_drop(f"//{_ROW.format(4, '##row')}", onto)
    d.frames(3)
    assert set(scene.folders.groups("Room")) == {2, 3, 4, 5}, "all that is selected"
    d.on_main(lambda: folders.put_in(d.session, "Top", (1,)))
    d.frames(3)
    d.engine.item_drag_and_drop(f"//{_FOLDER.format('Top', '##row')}", onto)
    d.frames(3)
    assert scene.folders.paths == ("Room", "Room/Top")
    d.select(3)
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
    scene = d.scene
    inside = set(scene.folders.groups("Room"))
    d.click(_FOLDER.format("Room", "###Shown"))
    assert set(np.unique(scene.labels[scene.has(State.HIDDEN)])) == inside
    d.click(_FOLDER.format("Room", "###Shown"))
    d.click(_FOLDER.format("Room", "###Locked"))
    assert set(np.unique(scene.labels[scene.has(State.LOCKED)])) == inside
    d.click(_FOLDER.format("Room", "###Locked"))
    d.click(_FOLDER.format("Room", "##row"))
    assert set(d.session.selected_groups()) == inside
    d.menu_of(_FOLDER.format("Room", "##row"), "###Delete the folder, keep its objects")
    assert scene.folders.paths == ("Top",)
    assert inside <= set(np.unique(scene.labels[scene.visible]))


def _under(d: Driver) -> None:
    """An object goes under the one that it is dropped on; its arrow, its eye; out again."""
    scene = d.scene
    d.select(5)
    d.drop(_ROW.format(4, "##row"), _ROW.format(3, "##row"))
    assert scene.folders.parent == {4: 3}, "only what was dragged: it was not selected"
    assert (scene.labels == 4).any(), "nothing was merged"
    d.click(_ROW.format(3, "Fold"))
    assert not d.exists(_ROW.format(4, "##row"))
    d.click(_ROW.format(3, "Fold"))
    d.click(_ROW.format(3, "###Shown"))
    assert set(np.unique(scene.labels[scene.has(State.HIDDEN)])) == {3, 4}
    d.click(_ROW.format(3, "###Shown"))
    d.click(_ROW.format(3, "##row"))
    assert d.session.selected_groups() == (3,)
    d.engine.item_double_click(f"//{_ROW.format(3, '##row')}")
    d.frames(3)
    assert d.session.selected_groups() == (3, 4)
    d.select(3)
    d.drop(_ROW.format(3, "##row"), _ROW.format(4, "##row"))
    assert "under itself" in d.session.notices[-1].text
    d.select(4)
    d.menu_of(_ROW.format(4, "##row"), "###Take out from under its object")
    assert scene.folders.parent == {}


def _filter(d: Driver) -> None:
    """It says how many it lists, and goes with one click."""
    listing, table = d.session.need().feature(ObjectListView), d.session.objects()
    d.click("Objects/###Filter")
    assert d.exists("$FOCUSED/##splats/##from") or d.exists("**/##splats/##from")
    d.click("**/Unsure only")
    d.frames(3)
    sure = measures(d.session, table)["confidence"]
    for group, of_group in zip(table.ids.tolist(), sure.tolist(), strict=True):
        assert not group or d.exists(_ROW.format(group, "##row")) == (0 <= of_group <= UNSURE)
    d.click("**/Unsure only")
    assert not listing.filter.is_on
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
    d.click("Objects/###Clear filter")
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
    _clicks_on_one_spot(d, rows)
    d.click(_ROW.format(2, "Fold"))
    d.click("Objects/**/part 2 1/##row")
    assert d.session.selected_indices().tolist() == rows[: len(rows) // 3].tolist()
    d.menu_of("Objects/**/part 2 1/##row", "###Split here")
    assert set(np.unique(scene.labels[rows])) == {2, 100}


def _clicks_on_one_spot(d: Driver, rows: IntArray) -> None:
    """The first click selects the object, the second a part of it, Alt the object again."""
    u, v = d.project(d.scene.gaussians.means[rows].mean(axis=0))
    io = imgui.get_io()
    slow, io.mouse_double_click_time = io.mouse_double_click_time, 0.0
    d.click_picture(u, v)
    assert d.session.selected_indices().tolist() == rows.tolist()
    d.click_picture(u, v)
    part = d.session.selected_indices()
    assert 0 < len(part) < len(rows)
    assert np.isin(part, rows).all()
    d.engine.key_down(KEY.mod_alt)
    d.click_picture(u, v)
    d.engine.key_up(KEY.mod_alt)
    assert d.session.selected_indices().tolist() == rows.tolist()
    io.mouse_double_click_time = slow


# --- The slider of the level of detail: it shows while it is held, and its release is one edit.


def _split_and_join(d: Driver) -> None:
    """The commands of the menus of a right click, as edits."""
    session, document = d.session, d.session.need()
    scene, before = document.scene, document.scene.labels.copy()
    group = int(np.bincount(before)[1:].argmax()) + 1
    # Halves at the finest level: which groups have parts that were found hangs on rounding.
    half = (before == group) & (np.arange(len(before)) % 2 > 0)
    finest = np.where(half, before.max() + 1, before)
    assert scene.bank is not None
    scene.bank = replace(scene.bank, levels=Levels(np.stack([before, finest]), 0))
    d.select(group)
    assert d.on_main(lambda: run("object.split_here", session))
    d.frames(3)
    assert len(np.unique(document.scene.labels[before == group])) > 1
    assert np.array_equal(document.scene.labels[before != group], before[before != group])
    d.select(group)
    assert d.on_main(lambda: run("object.join_here", session))
    assert (document.scene.labels[before == group] == group).all()
    assert np.array_equal(session.selected_indices(), np.flatnonzero(before == group)), "whole"
    for _ in ("join", "select", "split"):
        session.undo()
    assert np.array_equal(document.scene.labels, before)


def _the_row_stays_in_view(d: Driver) -> None:
    """Of an object that keeps its number while hundreds of others come before it."""
    document, last = d.session.need(), 500
    scene, found, start = document.scene, document.scene.bank, document.history.cursor
    assert found is not None
    before, own = scene.labels.copy(), scene.labels == scene.labels.max()
    coarse = np.where(own, last, before).astype(np.int32)
    fine = np.where(own, last, np.arange(len(own)) % 300 + 1).astype(np.int32)
    bank = replace(found, levels=Levels(np.stack([coarse, fine]), 0))
    d.on_main(lambda: document.do(edits.set_grouping(scene, coarse, bank)))
    d.select(last)
    slider = d.engine.item_info("//Objects/##Detail").rect_full
    d.engine.mouse_move("//Objects/##Detail")
    d.engine.mouse_down(0)
    d.engine.mouse_move_to_pos(ImVec2(slider.max.x - 3, slider.min.y + 8))
    d.frames(3)
    d.engine.mouse_up(0)
    d.frames(4)
    assert np.array_equal(scene.labels, fine)
    assert d.session.selected_groups() == (last,)
    assert d.exists(f"Objects/**/object {last}/##row"), "rows out of view are not drawn"
    while document.history.cursor > start:
        d.session.undo()


def _no_row_moves_while_a_job_runs(d: Driver) -> None:
    """The slider above them went, and came back when the job ended."""
    ends = threading.Event()

    def job() -> Stage[None]:
        yield Progress("Wait", 0, 1)
        ends.wait(120)

    row = f"//Objects/**/object {int(d.session.objects().ids[1])}/##row"

    def top() -> float:
        return float(d.engine.item_info(row).rect_full.min.y)

    search = d.session.need().feature(SearchState)
    d.until(
        lambda: search.described is not None, "rows move once when it is known what lies behind"
    )
    d.frames(3)
    before, labels = top(), d.session.need().scene.labels.copy()
    slider = d.engine.item_info("//Objects/##Detail").rect_full.min
    d.on_main(lambda: d.session.jobs.start("Wait", job()))
    d.frames(3)
    assert top() == before
    d.engine.mouse_move_to_pos(ImVec2(slider.x + 3, slider.y + 8))
    d.engine.mouse_click(0)
    d.frames(2)
    assert d.session.live is None
    assert np.array_equal(d.session.need().scene.labels, labels)
    ends.set()
    d.settle()
    assert top() == before


def test_the_slider_of_detail_is_one_edit(display: str, grouped_copy: Path) -> None:
    (masks,) = (grouped_copy / "masks").iterdir()
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
        _no_row_moves_while_a_job_runs(d)
        _the_row_stays_in_view(d)
        _split_and_join(d)

    drive(walk, path=grouped_copy, size=(1280, 720))


def test_what_was_selected_when_saved_has_its_masks_when_reopened(
    display: str, grouped_copy: Path
) -> None:
    def save(d: Driver) -> None:
        d.select(int(d.session.objects().ids[1]))
        d.keys(KEY.mod_ctrl, KEY.s)
        d.settle()

    def reopened(d: Driver) -> None:
        (group,) = d.session.selected_groups()
        assert memory_bank.group_of_panel(d.session) == group, "the panel has its masks"

    drive(save, path=grouped_copy)
    drive(reopened, path=grouped_copy)


def test_the_selected_row_of_a_reopened_scene_is_in_view(display: str, grouped_copy: Path) -> None:
    """The floor goes to the end of the list once the objects have their names."""

    def save(d: Driver) -> None:
        d.select(1)
        d.keys(KEY.mod_ctrl, KEY.s)
        d.settle()

    def reopened(d: Driver) -> None:
        d.until(lambda: bool(d.scene.described), "the objects are described")
        d.frames(12)
        assert d.session.selected_groups() == (1,)
        row = d.engine.item_info("//Objects/**/object 1/##row")
        assert row.rect_clipped.get_height() == row.rect_full.get_height() > 0

    settings = Settings(ui_scale=2.0, first_steps_done=True)
    drive(save, path=grouped_copy)
    drive(reopened, path=grouped_copy, size=(800, 500), settings=settings)


def test_a_click_on_the_handles_moves_nothing(display: str, grouped_scene: Path) -> None:
    def walk(d: Driver) -> None:
        d.select(int(d.session.objects().ids[1]))
        d.keys(KEY._1)
        handles, cursor = MoveTool().handles(d.session), d.history.cursor
        assert handles is not None
        u, v = d.project(handles[:3, 3])
        for at in ((u, v), (u, v - 40)):  # the middle, and the arrow that points up
            d.click_picture(*at)
            d.frames(3)
        assert d.history.cursor == cursor
        assert not d.session.unsaved
        d.drag_picture((u, v - 40), (0, -30))
        assert d.history.cursor == cursor + 1

    drive(walk, path=grouped_scene)


def test_handles_are_not_taken_where_an_earlier_version_is_shown(
    display: str, grouped_scene: Path
) -> None:
    """A drag there moved what stands there now, which that side does not show."""

    def walk(d: Driver) -> None:
        d.select(int(d.session.objects().ids[1]))
        d.keys(KEY.mod_ctrl, KEY.d)
        split_view.compare_version(d.session, 0)
        d.keys(KEY._1)
        handles, cursor = MoveTool().handles(d.session), d.history.cursor
        assert handles is not None
        for swipe, n_edits in ((1.0, 0), (0.0, 1)):
            d.session.view.swipe = swipe
            d.frames(3)
            u, v = d.project(handles[:3, 3])  # the first drag turns the camera
            d.drag_picture((u, v - 40), (0, -30))
            assert d.history.cursor == cursor + n_edits

    drive(walk, path=grouped_scene)


def test_handles_and_size_are_of_the_object_without_its_floaters(
    display: str, tmp_path: Path
) -> None:
    """Of an object selected by keys: what the Inspector, the handles and the box are made of."""
    ball = random_gaussians(900, seed=4, extent=0.2)
    far = random_gaussians(45, seed=5, extent=0.1)
    far = replace(far, means=(far.means + np.array([3, 0, 0])).astype(np.float32))
    far.logit_opacities[:], ball.logit_opacities[:] = -2, 2
    ball.log_scales[:] = far.log_scales[:] = -5
    write_splats(tmp_path / "ball.ply", joined(ball, far))

    def walk(d: Driver) -> None:
        d.keys(KEY.mod_ctrl, KEY.a)
        document = d.session.need()
        assert len(d.session.selected_indices()) == 945
        handles = MoveTool().handles(d.session)
        sizes, box = document.selected_sizes(local=False), document.selected_oriented_box()
        assert handles is not None
        assert sizes is not None
        assert box is not None
        np.testing.assert_allclose(handles[:3, 3], 0, atol=0.02)
        np.testing.assert_allclose(sizes, 0.4, atol=0.03)
        np.testing.assert_allclose(box.centre, 0, atol=0.05)
        d.keys(KEY.f)  # looks at it from nearby
        d.settle()
        np.testing.assert_allclose(d.session.rig.pivot, 0, atol=0.02)

    drive(walk, path=tmp_path / "ball.ply")


def test_objects_have_their_names_where_no_list_is_shown(display: str, grouped_copy: Path) -> None:
    def walk(d: Driver) -> None:
        d.focus("Inspector")
        assert d.engine.get_window_by_ref("//Objects").hidden
        d.until(lambda: bool(d.scene.described), "the objects are described")

    settings = Settings(ui_scale=2.0, first_steps_done=True)
    drive(walk, path=grouped_copy, size=(800, 500), settings=settings)


def test_the_label_of_a_handle_has_the_unit_of_the_scene(
    display: str, grouped_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It said "X : 0.123" in a scene in metres."""
    asked: list[str] = []

    def unit(session: Session) -> str:
        asked.append(measure.unit(session))
        return asked[-1]

    def walk(d: Driver) -> None:
        d.select(2)
        d.on_main(
            lambda: d.session.edit(lambda scene: edits.set_scale(scene, 1.0, 2.0, np.zeros(3)))
        )
        d.keys(KEY._1)
        d.settle()
        handles = MoveTool().handles(d.session)
        assert handles is not None
        d.move_to(*d.project(handles[:3, 3]))
        d.frames(2)
        d.engine.mouse_down(0)
        x, y = d.corner
        u, v = d.project(handles[:3, 3])
        d.engine.mouse_move_to_pos(ImVec2(x + u + 60, y + v + 20))
        d.frames(4)
        monkeypatch.setattr(gizmo, "length_unit", unit)
        d.frames(2)
        assert asked
        assert {*asked} == {" m"}
        d.engine.mouse_up(0)
        d.frames(2)

    drive(walk, path=grouped_copy, size=(1280, 720))


def test_a_search_in_a_low_window_shows_three_hits(display: str, grouped_copy: Path) -> None:
    """A sentence, a button and ways out took all of the panel: the hits had no height."""

    def is_seen(d: Driver, group: int) -> bool:
        row = d.engine.item_info(f"//{_ROW.format(group, '##row')}")
        high = row.rect_full.get_height() - imgui.get_style().item_spacing.y  # without the gaps
        return bool(row.rect_clipped.get_height() >= high > 0)

    def walk(d: Driver) -> None:
        d.until(lambda: bool(d.scene.described), "the objects are described")
        d.keys(KEY.mod_ctrl, KEY.f)
        d.engine.key_chars("round left of the bowl")
        search = d.session.need().feature(SearchState)
        d.until(lambda: bool(search.unknown), "it is answered, but not all of it")
        d.frames(4)
        assert len(search.hits) > 3
        assert d.engine.get_window_by_ref("//Objects").scroll_max.y == 0
        assert all(is_seen(d, hit.group) for hit in search.hits[:3])
        for _ in search.hits:
            d.keys(KEY.down_arrow)
        assert is_seen(d, search.hits[-1].group)
        way_out = "Objects/###Index this scene"
        assert not d.exists(way_out), "it is in the menu"
        changed = replace(d.session.settings, ui_scale=1.0)
        d.on_main(lambda: d.session.change_settings(changed))
        d.resize(1600, 1000)
        assert d.exists(way_out)

    settings = Settings(ui_scale=2.0, first_steps_done=True)
    drive(walk, path=grouped_copy, size=(800, 500), settings=settings)
