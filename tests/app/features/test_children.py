"""Objects under objects in the session: listed, switched, selected, moved, deleted, exported."""

import json
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.scene.scene import State
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
from gaga_studio.features.object_list import Listing, ObjectListView, lines_of
from gaga_studio.features.transform import shift
from gaga_studio.session.session import Session
from tests.app.looks import finish, scene_of, snapshot


@pytest.fixture
def laid(associated: Session) -> Session:
    """3 under 2 under 1, which is in a folder."""
    assert folders.put_in(associated, "Kitchen", (1,))
    assert folders.put_under(associated, 1, (2,))
    assert folders.put_under(associated, 2, (3,))
    return associated


def _shown(session: Session) -> list[str]:
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
    return Listing(table, rows, order, kept, behind, True, False, None)


def _groups(session: Session, bit: State) -> set[int]:
    scene = scene_of(session)
    return set(np.unique(scene.labels[scene.has(bit)]).tolist())


def test_what_lies_under_an_object_is_listed_under_it(laid: Session) -> None:
    view = laid.need().feature(ObjectListView)
    assert _shown(laid)[:4] == ["Kitchen", "  1", "    2", "      3"]
    view.toggle_group(2, True)
    assert _shown(laid)[:4] == ["Kitchen", "  1", "    2", "4"]
    view.toggle_group(1, True)
    view.toggle("Kitchen")
    view.reveal_group(scene_of(laid).folders, 3)
    assert _shown(laid)[:4] == ["Kitchen", "  1", "    2", "      3"]
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
    assert _shown(laid)[:3] == ["Kitchen", "  1", "    3"]
    laid.undo()
    assert _shown(laid)[:4] == ["Kitchen", "  1", "    2", "      3"]


def test_an_object_that_others_lie_under_is_no_background(laid: Session) -> None:
    assert folders.put_in(laid, "", (1,))
    table, view = laid.objects(), laid.need().feature(ObjectListView)
    for behind in (frozenset({1, 4}), frozenset({1, 2, 4})):
        lines = lines_of(_listing(laid, behind=behind), view)
        assert lines.n_background == 1
        shown = [int(table.ids[x.row]) for x in lines.lines if x.kind == "object"]
        assert {1, 2, 3} <= set(shown)
        assert 4 not in shown, "folded"


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
    assert "Nothing lies under" in commands.command("select.children").enabled(laid)


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
    assert laid.need().history.undo_title == "Isolate group 2 and 1 under it"
    assert summary(laid, ExportPlan(tmp_path, "objects")).n_files == 2
    export.export(laid, "objects", tmp_path / "out")
    finish(laid)
    manifest = json.loads((tmp_path / "out" / "groups.json").read_text())
    assert {e["id"]: e["parent"] for e in manifest["groups"]} == {2: 0, 3: 2}
    assert laid.selected_groups() == (2,)
    assert commands.run("edit.delete", laid)
    finish(laid)
    assert 3 not in _groups(laid, State.DELETED)
