"""Folders in the session: made of a selection, chosen, filled, hidden, locked, colored, listed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.export.export import MeshExport
from gaga_core.export.simulation.export import SimulationExport
from gaga_core.grouping.levels import Levels
from gaga_core.io.splats.splat_files import SplatFormat
from gaga_core.scene import edits
from gaga_core.scene.objects import folder_colors, group_indices
from gaga_core.scene.scene import State
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import (
    commands,
    export,
    folders,
    object_list,
    objects,
    selection,
    transform,
)
from gaga_studio.features.export import ExportPlan, summary
from gaga_studio.features.object_list import Lines, ListFilter, Listing, ObjectListView, lines_of
from gaga_studio.features.selection import select_groups, select_none
from gaga_studio.features.transform import shift
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.tools.pick import PickTool
from tests.app.looks import finish, objects_of, scene_of, snapshot


def _lines(session: Session, *, falls: bool = False) -> Lines:
    table = session.objects()
    return object_list.lines(session, table, "name", falls)


def _listed(session: Session, *, falls: bool = False) -> list[str]:
    table, lines = session.objects(), _lines(session, falls=falls)
    return [
        "  " * line.depth
        + (f"[{line.folder}]" if line.kind == "folder" else str(table.ids[line.row]))
        for line in lines.lines
    ]


def test_the_selection_goes_into_a_new_folder_whose_name_is_asked_for(
    associated: Session,
) -> None:
    scene = scene_of(associated)
    selection.select_groups(associated, (2, 3))
    assert commands.run("object.folder", associated)
    assert associated.take_request() is Request.RENAME
    assert folders.chosen(associated) == ("Folder",)
    assert folders.rename(associated, "Folder", "Kitchen")
    assert folders.chosen(associated) == ("Kitchen",)
    selection.select_groups(associated, (3,))
    assert commands.run("object.folder", associated), "inside of the folder of what is selected"
    assert scene.folders.home == {2: "Kitchen", 3: "Kitchen/Folder"}
    assert commands.run("object.folder_out", associated), "a chosen folder"
    assert scene.folders.home == {2: "Kitchen", 3: "Folder"}
    selection.select_groups(associated, (2,))
    assert commands.run("object.folder_out", associated)
    assert commands.command("object.folder_out").enabled(associated)
    assert scene.folders.home == {3: "Folder"}
    selection.select_groups(associated, (3,))
    assert commands.run("object.folder_delete", associated)
    assert (scene.folders.paths, scene.folders.home) == (("Kitchen",), {})
    assert associated.unsaved
    while associated.undo() is not None:
        pass
    assert scene.folders.paths == ()


def test_a_new_folder_of_one_chosen_folder_lies_inside(associated: Session) -> None:
    """It lay around it; around several, that is where they go."""
    scene = scene_of(associated)
    folders.put_in(associated, "Kitchen", (2, 3))
    folders.put_in(associated, "Hall", (4,))
    folders.choose(associated, "Kitchen")
    assert commands.run("object.folder", associated)
    assert folders.chosen(associated) == ("Kitchen/Folder",)
    assert scene.folders.home == {2: "Kitchen", 3: "Kitchen", 4: "Hall"}
    folders.choose(associated, "Kitchen")
    folders.choose(associated, "Hall", "add")
    assert commands.run("object.folder", associated)
    assert set(scene.folders.home.values()) == {"Folder/Hall", "Folder/Kitchen"}


def test_a_folder_chosen_with_an_object_next_to_it_goes_into_a_new_one(associated: Session) -> None:
    """An empty one was made inside of it."""
    scene = scene_of(associated)
    folders.put_in(associated, "Kitchen", (2, 3))
    selection.select_groups(associated, (4,))
    folders.choose(associated, "Kitchen", "add")
    assert commands.run("object.folder", associated)
    assert scene.folders.home == {2: "Folder/Kitchen", 3: "Folder/Kitchen", 4: "Folder"}


def test_a_folder_is_chosen_while_its_objects_are_selected(associated: Session) -> None:
    folders.put_in(associated, "A", (2, 3))
    folders.put_in(associated, "A/B", (4,))
    folders.put_in(associated, "C", (5,))
    folders.choose(associated, "A")
    assert associated.selected_groups() == (2, 3, 4)
    folders.choose(associated, "C", "add")
    assert folders.chosen(associated) == ("A", "C")
    folders.choose(associated, "A", "remove")
    assert folders.chosen(associated) == ("C",)
    assert associated.selected_groups() == (5,)
    selection.select_groups(associated, (2,), "add")
    assert folders.chosen(associated) == ()
    assert folders.of_selection(associated) == (), "objects of two folders"


def test_a_folder_that_goes_elsewhere_stays_chosen_and_closed(associated: Session) -> None:
    scene = scene_of(associated)
    folders.put_in(associated, "A/B/C", (2, 3))
    folders.put_in(associated, "C", (4,))
    associated.need().feature(ObjectListView).toggle("A/B/C")
    folders.choose(associated, "A/B/C")
    for place in ("A/C", "C 2"):  # the same command twice takes the folder out, not its objects
        assert commands.run("object.folder_out", associated)
        assert scene.folders.home == {2: place, 3: place, 4: "C"}
        assert folders.chosen(associated) == (place,)
        assert place in associated.need().feature(ObjectListView).closed


def test_eye_lock_and_solo_of_a_folder_act_on_all_in_it(associated: Session) -> None:
    scene = scene_of(associated)
    folders.put_in(associated, "A", (2,))
    folders.put_in(associated, "A/B", (3,))
    inside, all_groups = {2, 3}, set(objects_of(associated))
    objects.set_hidden(associated, "A", True)
    assert set(np.unique(scene.labels[scene.has(State.HIDDEN)])) == inside
    objects.set_hidden(associated, "A", False)
    assert scene.visible.all()
    objects.set_locked(associated, "A/B", True)
    assert set(np.unique(scene.labels[scene.has(State.LOCKED)])) == {3}
    objects.set_locked(associated, "A", False)
    objects.isolate_item(associated, "A")
    assert set(np.unique(scene.labels[scene.visible])) == inside
    sums = folders.sums(associated)
    assert folders.is_alone(associated.objects(), sums["A"])
    assert not folders.is_alone(associated.objects(), sums["A/B"])
    objects.isolate_item(associated, "A")
    assert all_groups <= set(np.unique(scene.labels[scene.visible]))


def test_the_list_has_folders_by_name_before_objects(associated: Session) -> None:
    n = len(objects_of(associated))
    folders.put_in(associated, "Shelf 10", (4,))
    folders.put_in(associated, "Shelf 9/Left", (2, 3))
    rest = [str(g) for g in objects_of(associated) if g not in (2, 3, 4)]
    tail = [*rest, *["0"] * int(0 in associated.objects().ids)]
    assert _listed(associated) == [
        "[Shelf 9]", "  [Shelf 9/Left]", "    2", "    3", "[Shelf 10]", "  4", *tail,
    ]  # fmt: skip
    assert _listed(associated, falls=True)[:2] == ["[Shelf 10]", "  4"]
    listing = associated.need().feature(ObjectListView)
    listing.toggle("Shelf 9")
    assert _listed(associated) == ["[Shelf 9]", "[Shelf 10]", "  4", *tail]
    folders.rename(associated, "Shelf 9", "Top")
    assert _listed(associated)[2] == "[Top]", "a closed folder stays closed under its new name"
    sums = folders.sums(associated)
    table = associated.objects()
    of = {int(g): int(count) for g, count in zip(table.ids, table.counts, strict=True)}
    assert (sums["Top"].n_objects, sums["Top"].n_splats) == (2, of[2] + of[3])
    assert _lines(associated).n_kept == n


def test_lines_are_made_again_only_when_the_list_changes(associated: Session) -> None:
    before = _lines(associated)
    selection.select_groups(associated, (2,))
    assert _lines(associated) is before
    folders.put_in(associated, "A", (2,))
    assert _lines(associated) is not before


def test_a_filter_lists_what_is_in_all_its_ranges(associated: Session) -> None:
    folders.put_in(associated, "Full", (2, 3))
    folders.put_in(associated, "Empty", (4,))
    listing, table = associated.need().feature(ObjectListView), associated.objects()
    listing.toggle("Full")
    found = object_list.measures(associated, table)
    counts = found["splats"][[table.ids.tolist().index(g) for g in (2, 3)]]
    whole = object_list.whole_range(table, "splats", found["splats"])
    assert whole is not None
    listing.filter = ListFilter().within("splats", (float(min(counts)), float(max(counts))), whole)
    kept = object_list.kept_rows(associated, table)
    assert kept is not None
    wanted = {int(g) for g in table.ids[kept]}
    assert {2, 3} <= wanted
    assert wanted == {
        int(g)
        for g, n in zip(table.ids, table.counts, strict=True)
        if g > 0 and min(counts) <= n <= max(counts)
    }
    shown = _lines(associated)
    assert set(shown.shown) == wanted
    assert shown.n_kept == len(wanted)
    assert [line.folder for line in shown.lines if line.kind == "folder"] == (
        ["Full"] if 4 not in wanted else ["Empty", "Full"]
    ), "open while it is filtered, and folders without a kept object are left out"
    listing.filter = listing.filter.within("quality", (0.5, 1.0), (0.0, 1.0))
    assert _lines(associated).n_kept == 0, "nothing is measured"
    listing.filter = listing.filter.within("quality", (0.0, 1.0), (0.0, 1.0))
    assert listing.filter.within("splats", whole, whole) == ListFilter(), "all is no filter"


def test_confidence_of_groups_is_the_mean_of_their_splats(associated: Session) -> None:
    scene, table = scene_of(associated), associated.objects()
    rng = np.random.default_rng(0)
    scene.confidence = rng.integers(0, 255, scene.n_opened, np.uint8)
    values = object_list.measures(associated, table)
    for row in range(len(table)):
        rows = group_indices(scene, int(table.ids[row]))
        assert values["confidence"][row] == pytest.approx(scene.confidence[rows].mean() / 255)


def test_groups_have_the_colors_of_their_folders(associated: Session) -> None:
    scene = scene_of(associated)
    associated.need().do(edits.set_color(scene, 2, (1.0, 0.0, 0.0)))
    assert commands.command("view.folder_colors").enabled(associated)
    folders.put_in(associated, "A", (2, 3))
    folders.put_in(associated, "B", (4,))
    plain = associated.objects().colors.copy()
    assert 2 not in associated.muted_colors(), "its own color"
    assert commands.run("view.folder_colors", associated)
    table = associated.objects()
    np.testing.assert_array_equal(table.colors, folder_colors(scene.folders, table.ids))
    shown = associated.muted_colors()
    for group in objects_of(associated):
        np.testing.assert_allclose(shown[group], table.colors[table.row(group)])
    commands.run("view.folder_colors", associated)
    np.testing.assert_array_equal(associated.objects().colors, plain)


def test_parts_are_listed_under_their_object_and_split_here_makes_them_real(
    associated: Session,
) -> None:
    scene, document = scene_of(associated), associated.need()
    assert object_list.part_index(associated) is None
    rows = group_indices(scene, 2)
    half, quarter = scene.labels.copy(), scene.labels.copy()
    half[rows[len(rows) // 2 :]] = 100
    quarter[:] = half
    quarter[rows[: len(rows) // 4]] = 101
    levels = Levels(np.stack([scene.labels, half, quarter]), 0)
    assert scene.bank is not None
    bank = replace(scene.bank, levels=levels)
    document.do(edits.set_grouping(scene, scene.labels, bank, title="x"))
    parts = object_list.part_index(associated)
    assert parts is not None
    one, two = parts.parts(2)
    assert sorted([*one.rows, *two.rows]) == rows.tolist()
    assert parts.parts(3) == ()
    whole = max((one, two), key=lambda p: len(parts.parts(p)))
    assert len(parts.parts(whole)) == 2, "a part has parts, too"

    document.feature(ObjectListView).toggle_parts((2,))
    lines = _lines(associated)
    at = lines.groups.index(2)
    assert [line.kind for line in lines.lines[at : at + 4]] == ["object", "part", "part", "object"]
    object_list.select_part(associated, two, "thing")
    assert np.array_equal(associated.selected_indices(), two.rows)
    assert document.focus == 2
    before = {tuple(one.rows), tuple(two.rows)}
    assert commands.run("object.split_here", associated)
    new = {tuple(group_indices(scene, int(g))) for g in np.unique(scene.labels[rows])}
    assert new == before


def test_clicks_on_one_spot_go_down_through_the_parts_and_with_alt_up(associated: Session) -> None:
    """Objects 1 and 2 are one at the coarsest level; 2 falls into halves, one of them again."""
    scene, document = scene_of(associated), associated.need()
    rows = group_indices(scene, 2)
    together, half = np.where(scene.labels == 2, 1, scene.labels), scene.labels.copy()
    half[rows[len(rows) // 2 :]] = 100
    quarter = half.copy()
    quarter[rows[: len(rows) // 4]] = 101
    levels = Levels(np.stack([together.astype(np.int32), scene.labels, half, quarter]), 1)
    assert scene.bank is not None
    bank = replace(scene.bank, levels=levels)
    document.do(edits.set_grouping(scene, scene.labels, bank, title="x"))
    splat, selected = int(rows[0]), associated.selected_indices
    for groups, ways in (((1,), (False, True)), ((2,), (True, True)), ((3,), (False, False))):
        select_groups(associated, groups)
        assert object_list.clicks_again(associated) == ways
        hint = PickTool().hint(associated)
        assert ("Again: a part" in hint, "Alt: more" in hint) == ways
    select_none(associated)
    assert not object_list.click_again(associated, splat), "nothing is selected: a usual click"
    select_groups(associated, (2,))
    shown = []
    while object_list.click_again(associated, splat):
        shown.append(selected().tolist())
    quarters = rows[: len(rows) // 4], rows[: len(rows) // 2]
    assert shown == [quarters[1].tolist(), quarters[0].tolist()]
    for wanted in (quarters[1], rows, np.sort(np.r_[group_indices(scene, 1), rows])):
        assert object_list.click_again(associated, splat, up=True)
        assert selected().tolist() == wanted.tolist()
        assert document.focus == 2
    assert not object_list.click_again(associated, splat, up=True), "there is no more"
    select_groups(associated, (2,))
    assert commands.run("select.whole", associated), "for those whose desktop keeps Alt+click"
    assert selected().tolist() == np.sort(np.r_[group_indices(scene, 1), rows]).tolist()
    assert not commands.run("select.whole", associated)
    select_groups(associated, (3,))
    assert not object_list.click_again(associated, splat), "another object is selected"


def test_an_object_of_splats_that_were_added_has_no_levels_to_go_through(
    associated: Session,
) -> None:
    """Splats that were added after the objects were found: one object of these alone, one with
    others."""
    scene, document = scene_of(associated), associated.need()
    labels = scene.labels.copy()
    labels[-20:] = 900
    of_two = group_indices(scene, 2)
    half = np.where(np.isin(np.arange(len(scene)), of_two[::2]), 100, labels)[:-40]
    labels[-40:-20] = 2
    assert scene.bank is not None
    levels = Levels(np.stack([labels[:-40], half]).astype(np.int32), 0)
    document.do(edits.set_grouping(scene, labels, replace(scene.bank, levels=levels), title="x"))
    select_groups(associated, (900,))
    assert object_list.clicks_again(associated) == (False, False)
    assert "Again" not in PickTool().hint(associated)
    assert not object_list.click_again(associated, len(scene) - 1)
    select_groups(associated, (2,))
    assert object_list.click_again(associated, int(of_two[0]))
    assert set(associated.selected_indices()) < set(of_two), "a part of what has levels"
    assert object_list.click_again(associated, int(of_two[0]), up=True)
    assert np.array_equal(associated.selected_indices(), group_indices(scene, 2)), "all again"


@pytest.fixture
def laid(associated: Session) -> Session:
    """3 under 2 under 1, which is in a folder."""
    assert folders.put_in(associated, "Kitchen", (1,))
    assert folders.put_under(associated, 1, (2,))
    assert folders.put_under(associated, 2, (3,))
    return associated


def _nested(session: Session) -> list[str]:
    table = session.objects()
    lines = object_list.lines(session, table, "name", False)
    return [
        "  " * line.depth + (line.folder or str(table.ids[line.row]))
        if line.kind == "folder"
        else "  " * line.depth + str(table.ids[line.row])
        for line in lines.lines
        if line.kind in ("folder", "object")
    ]


def _listing(
    session: Session,
    kept: BoolArray | None = None,
    behind: frozenset[int] = frozenset(),
) -> Listing:
    table = session.objects()
    rows, order = range(len(table)), scene_of(session).folders
    return Listing(table, rows, order, kept, behind, behind, False, None)


def _groups(session: Session, bit: State) -> set[int]:
    scene = scene_of(session)
    return set(np.unique(scene.labels[scene.has(bit)]).tolist())


def test_what_lies_under_an_object_is_listed_under_it(laid: Session) -> None:
    view = laid.need().feature(ObjectListView)
    assert _nested(laid)[:4] == ["Kitchen", "  1", "    2", "      3"]
    view.toggle_group(2, True)
    assert _nested(laid)[:4] == ["Kitchen", "  1", "    2", "4"]
    view.toggle_group(1, True)
    view.toggle("Kitchen")
    view.reveal_group(scene_of(laid).folders, 3)
    assert _nested(laid)[:4] == ["Kitchen", "  1", "    2", "      3"]
    view.toggle_group(1, True)
    table = laid.objects()
    kept = np.isin(table.ids, (1, 3))
    listing = _listing(laid, kept=kept)
    found = [(x.depth, int(table.ids[x.row])) for x in lines_of(listing, view).lines if x.row >= 0]
    assert found == [(1, 1), (2, 3)], "under the next that is listed, and open"


def test_an_object_whose_parent_is_deleted_is_listed_under_the_next(laid: Session) -> None:
    commands.run("object.children_go_along", laid)
    selection.select_groups(laid, (2,))
    assert objects.delete(laid)
    assert _nested(laid)[:3] == ["Kitchen", "  1", "    3"]
    laid.undo()
    assert _nested(laid)[:4] == ["Kitchen", "  1", "    2", "      3"]


def test_an_object_that_others_lie_under_is_no_background(laid: Session) -> None:
    assert folders.put_in(laid, "", (1,))
    table, view = laid.objects(), laid.need().feature(ObjectListView)
    for behind in (frozenset({1, 4}), frozenset({1, 2, 4})):
        lines = lines_of(_listing(laid, behind=behind), view)
        assert lines.background == (4,)
        shown = [int(table.ids[x.row]) for x in lines.lines if x.kind == "object"]
        assert {1, 2, 3} <= set(shown)
        assert 4 not in shown, "folded"


def test_no_filter_leaves_out_the_object_whose_name_is_typed(laid: Session) -> None:
    table, view = laid.objects(), laid.need().feature(ObjectListView)
    view.filter = ListFilter({"splats": (1e6, 2e6)})
    for renamed in (None, 2):
        lines = object_list.lines(laid, table, "name", False, renamed)
        assert [group for group in lines.shown if group] == ([] if renamed is None else [2])


def test_eye_lock_and_circle_of_an_object_act_on_what_lies_under_it(laid: Session) -> None:
    assert objects.set_hidden(laid, 2, True)
    assert _groups(laid, State.HIDDEN) == {2, 3}
    assert objects.set_hidden(laid, 1, False)
    assert _groups(laid, State.HIDDEN) == set()
    assert objects.set_locked(laid, 1, True)
    assert _groups(laid, State.LOCKED) == {1, 2, 3}
    assert objects.set_locked(laid, 1, False)
    assert objects.isolate_item(laid, 2)
    scene = scene_of(laid)
    assert set(np.unique(scene.labels[scene.visible]).tolist()) == {2, 3}


def test_a_row_selects_its_own_splats_and_with_children_all(laid: Session) -> None:
    selection.select_groups(laid, (1,))
    assert laid.selected_groups() == (1,)
    assert commands.run("select.children", laid)
    assert laid.selected_groups() == (1, 2, 3)
    selection.select_groups(laid, (3,))
    assert "nothing under this" in commands.command("select.children").enabled(laid)


def test_moving_a_whole_object_takes_along_what_lies_under_it(laid: Session) -> None:
    scene = scene_of(laid)
    selection.select_groups(laid, (2,))
    transform.preview_move(laid, shift(np.array([0.0, 0.0, 1.0])))
    moved = scene.placement > 0
    assert set(np.unique(scene.labels[moved]).tolist()) == {2, 3}
    assert laid.need().commit_preview()
    assert laid.need().history.undo_title.endswith(" and 1 under it")
    laid.undo()
    half = laid.selected_indices()[::2]
    laid.need().select(half)
    assert transform.move(laid, shift(np.array([0.0, 0.0, 1.0])))
    assert np.flatnonzero(scene.placement > 0).tolist() == half.tolist(), "a part goes alone"
    while laid.undo() is not None:
        pass
    assert scene.folders.parent == {}
    while laid.redo() is not None:
        pass
    assert scene.folders.parent == {2: 1, 3: 2}


def test_what_is_locked_stays_and_what_is_hidden_goes_along(laid: Session) -> None:
    scene = scene_of(laid)
    assert objects.set_hidden(laid, 3, True)
    selection.select_groups(laid, (1,))
    assert folders.along(laid).groups == (2, 3)
    assert objects.set_locked(laid, 2, True)
    selection.select_groups(laid, (1,))
    assert folders.along(laid).groups == ()
    assert objects.set_locked(laid, 3, False)
    selection.select_groups(laid, (1,))
    taken = folders.along(laid)
    assert taken.groups == (3,)
    assert set(np.unique(scene.labels[taken.splats]).tolist()) == {1, 3}


def test_deleting_says_what_goes_along_and_undo_brings_it_back(laid: Session) -> None:
    scene = scene_of(laid)
    before = snapshot(scene)
    selection.select_groups(laid, (1,))
    selected = snapshot(scene)
    assert objects.delete(laid)
    assert _groups(laid, State.DELETED) == {1, 2, 3}
    assert " and 2 under it. Undo" in laid.notices[-1].text
    laid.undo()
    assert snapshot(scene) == selected != before
    assert commands.run("object.children_go_along", laid)
    assert objects.delete(laid)
    assert _groups(laid, State.DELETED) == {1}


def test_cleaning_first_takes_them_along_too(laid: Session) -> None:
    assert commands.run("object.clean_first", laid)
    selection.select_groups(laid, (2,))
    assert commands.run("edit.delete", laid)
    finish(laid)
    assert {2, 3} <= _groups(laid, State.DELETED)
    assert laid.need().history.undo_title.endswith(" and 1 under it")


def test_copies_lie_under_each_other(laid: Session) -> None:
    selection.select_groups(laid, (2,))
    assert transform.duplicate(laid)
    parent = scene_of(laid).folders.parent
    one, two = laid.selected_groups()
    assert {one: parent[one], two: parent[two]} == {one: 1, two: one}


def test_copies_of_several_stand_on_what_the_originals_stand_on(associated: Session) -> None:
    """The camera's right leads off the floor, whose edge is at 1.5."""
    scene, rig = scene_of(associated), associated.rig
    means = world_means(scene)
    floor = np.abs(means[:, 2] + 0.3) < 0.01
    balls = [g for g in objects_of(associated) if g != np.bincount(scene.labels[floor]).argmax()]
    pair = sorted(balls, key=lambda group: -means[scene.labels == group].mean(axis=0)[0])[:2]
    for group in set(balls) - set(pair):
        assert objects.set_hidden(associated, group, True)
    for yaw in range(0, 360, 45):
        rig.pose = replace(rig.pose, yaw=float(np.radians(yaw)))
        selection.select_groups(associated, pair)
        assert transform.duplicate(associated)
        copies = world_means(scene, associated.selected_indices())
        assert len(copies) == np.isin(scene.labels, pair).sum()
        assert np.abs(np.median(copies, axis=0)[:2]).max() < 1.5, yaw
        associated.undo()


def test_an_export_of_an_object_has_what_lies_under_it(laid: Session, tmp_path: Path) -> None:
    selection.select_groups(laid, (2,))
    assert summary(laid, ExportPlan(tmp_path, "objects")).n_files == 2
    n = int((scene_of(laid).labels == 2).sum() + (scene_of(laid).labels == 3).sum())
    assert summary(laid, ExportPlan(tmp_path / "a.ply", "selected")).n_splats == n
    export.export(laid, "objects", tmp_path / "out")
    finish(laid)
    manifest = json.loads((tmp_path / "out" / "groups.json").read_text())
    assert {e["id"]: e["parent"] for e in manifest["groups"]} == {2: 0, 3: 2}
    assert laid.selected_groups() == (2,), "the selection stays"
    commands.run("object.children_go_along", laid)
    assert summary(laid, ExportPlan(tmp_path, "objects")).n_files == 1


def test_an_object_leaves_what_it_lies_under(laid: Session) -> None:
    selection.select_groups(laid, (3,))
    assert commands.run("object.leave_parent", laid)
    assert scene_of(laid).folders.parent == {2: 1, 3: 1}
    assert folders.put_in(laid, "", (3,))
    assert scene_of(laid).folders.parent == {2: 1}
    assert "under no object" in commands.command("object.leave_parent").enabled(laid)
    assert not folders.put_under(laid, 2, (1,))
    assert "under itself" in laid.notices[-1].text


@pytest.mark.parametrize("cleaned", [False, True])
def test_what_is_locked_is_isolated_and_exported_with_its_parent_and_never_changed(
    laid: Session, tmp_path: Path, cleaned: bool
) -> None:
    """Isolating hid it; `gaga export --with-children` wrote it, the window did not."""
    scene = scene_of(laid)
    assert objects.set_locked(laid, 3, True)
    if cleaned:
        assert commands.run("object.clean_first", laid)
    selection.select_groups(laid, (2,))
    assert commands.run("object.isolate", laid)
    finish(laid)
    assert set(np.unique(scene.labels[scene.visible]).tolist()) - {0} == {2, 3}
    assert laid.need().history.undo_title == "Isolate an object and 1 under it"
    assert summary(laid, ExportPlan(tmp_path, "objects")).n_files == 2
    export.export(laid, "objects", tmp_path / "out")
    finish(laid)
    manifest = json.loads((tmp_path / "out" / "groups.json").read_text())
    assert {e["id"]: e["parent"] for e in manifest["groups"]} == {2: 0, 3: 2}
    assert laid.selected_groups() == (2,)
    assert commands.run("edit.delete", laid)
    finish(laid)
    assert 3 not in _groups(laid, State.DELETED)


@pytest.mark.parametrize("form", [SplatFormat.PLY, MeshExport(), SimulationExport()])
def test_what_is_exported_says_which_objects_are_hidden(
    laid: Session, tmp_path: Path, form: SplatFormat | MeshExport | SimulationExport
) -> None:
    """Two were told to become bodies, and one did."""
    plan = ExportPlan(tmp_path, "objects", form)
    said = " ".join(summary(laid, plan).lost)
    assert "hidden" not in said
    laid.edit(lambda scene: edits.hide(scene, group_indices(scene, 3)))
    select_groups(laid, (2, 3))
    assert laid.selected_groups() == (2, 3)
    said = " ".join(summary(laid, plan).lost)
    assert "1 object is hidden, and not exported." in said
    if isinstance(form, SimulationExport):
        assert f"{laid.need().name_of(2)} becomes a body" in said
