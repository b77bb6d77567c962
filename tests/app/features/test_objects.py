"""Edits of the selection beyond moving and coloring, as a person meets them."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.edit_script import run_script
from gaga_core.export.export import export_scene_stage
from gaga_core.grouping.memory_bank import MemoryBank, at_level
from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage
from gaga_core.scene.scene import Scene, State, Weight
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.by_value import shown_colors
from gaga_core.scene.tint import Grade
from gaga_studio.features import export, files, measure, object_list, objects, selection, transform
from gaga_studio.features.commands import command, run
from gaga_studio.features.find import association, memory_bank
from gaga_studio.session.session import Session


def _scene(session: Session) -> Scene:
    assert session.scene is not None
    return session.scene


def _object(session: Session) -> int:
    """Select an object; its id."""
    table = session.objects()
    group = int(table.ids[1 + table.counts[1:].argmax()])
    selection.select_groups(session, (group,))
    return group


def test_growing_and_shrinking_change_the_selection_both_ways(associated: Session) -> None:
    _object(associated)
    chosen = set(associated.selected_indices().tolist())
    assert run("select.grow", associated)
    grown = set(associated.selected_indices().tolist())
    assert chosen < grown
    assert run("select.shrink", associated)
    assert set(associated.selected_indices().tolist()) < grown
    associated.undo()
    associated.undo()
    assert set(associated.selected_indices().tolist()) == chosen


def test_separating_makes_an_object_and_undo_takes_it_back(associated: Session) -> None:
    group = _object(associated)
    half = associated.selected_indices()[::2]
    associated.need().select(half)
    n = len(associated.objects())
    assert run("object.separate", associated)
    assert len(associated.objects()) == n + 1
    new = associated.selected_groups()
    assert len(new) == 1
    assert new[0] != group
    assert objects.assign(associated, group)
    assert len(associated.objects()) == n


def test_an_object_in_one_piece_says_so(associated: Session) -> None:
    _object(associated)
    objects.split(associated)
    selection.select_none(associated)
    reason = command("object.split").enabled(associated)
    assert reason.startswith("Nothing is selected")


def test_locked_splats_cannot_be_selected_until_unlocked(associated: Session) -> None:
    group = _object(associated)
    assert run("object.lock", associated)
    selection.select_groups(associated, (group,))
    assert len(associated.selected_indices()) == 0
    assert run("object.unlock_all", associated)
    assert not _scene(associated).has(State.LOCKED).any()
    assert command("object.unlock_all").enabled(associated) == "Nothing is locked."


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_mirroring_twice_is_where_it_was(associated: Session, axis: int) -> None:
    _object(associated)
    before = world_means(_scene(associated))
    assert run(f"edit.mirror_{'xyz'[axis]}", associated)
    chosen = associated.selected_indices()
    assert np.abs(world_means(_scene(associated)) - before)[chosen, axis].max() > 0.01
    assert run(f"edit.mirror_{'xyz'[axis]}", associated)
    assert np.allclose(world_means(_scene(associated)), before, atol=1e-4)


def test_a_grade_is_previewed_and_one_entry(associated: Session) -> None:
    _object(associated)
    chosen = associated.selected_indices()
    before = shown_colors(_scene(associated))
    n = len(associated.need().history.entries())
    for saturation in (0.7, 0.3, 0.0):
        transform.preview_grade(associated, Grade(saturation=saturation))
    assert np.ptp(shown_colors(_scene(associated))[chosen], axis=1).max() < 1e-5
    associated.cancel_preview()
    assert np.array_equal(shown_colors(_scene(associated)), before)
    assert transform.grade(associated, Grade(saturation=0.0))
    assert len(associated.need().history.entries()) == n + 1


def test_three_points_lay_the_scene_on_the_ground(associated: Session) -> None:
    scene = _scene(associated)
    points = world_means(scene)[[3, 200, 500]].astype(np.float64)
    assert measure.align(associated, points)
    laid = world_means(_scene(associated))[[3, 200, 500]]
    assert np.abs(laid @ associated.rig.up).max() < 1e-4


def test_kept_selections_come_back_by_name(associated: Session) -> None:
    _object(associated)
    chosen = associated.selected_indices().tolist()
    assert run("select.keep", associated)
    assert associated.notices[-1].text.startswith("Kept the selection as “set 1”.")
    assert run("select.none", associated)
    assert selection.select_named(associated, "set 1")
    assert associated.selected_indices().tolist() == chosen
    assert selection.keep_selection(associated, "mine")
    assert selection.forget_named(associated, "set 1")
    assert list(_scene(associated).named_selections) == ["mine"]
    assert not selection.select_named(associated, "set 1")
    assert "no selection named" in associated.notices[-1].text


def test_a_recorded_session_replays_to_the_same_file(associated: Session, tmp_path: Path) -> None:
    session = associated
    path = session.need().project.model_path
    _object(session)
    run("edit.mirror_x", session)
    transform.duplicate(session)
    transform.grade(session, Grade(temperature=0.5, opacity=0.8))
    run("select.grow", session)
    run("object.separate", session)
    session.undo()
    objects.delete(session)
    script, live, again = tmp_path / "edits.json", tmp_path / "live.ply", tmp_path / "again.ply"
    assert files.save_script(session, script)
    export.export(session, "scene", live)
    assert session.jobs.wait()
    session.tick(0.1)
    scene = run_stage(open_path_stage(path)).scene
    run_script(scene, json.loads(script.read_text()))
    run_stage(export_scene_stage(scene, again))
    assert again.read_bytes() == live.read_bytes()


@pytest.fixture
def session(new_session: Callable[[], Session], grouped_scene: Path, tmp_path: Path) -> Session:
    """The small scene with objects found from masks that no model made."""
    folder = tmp_path / "regions"
    shutil.copytree(grouped_scene, folder)
    (masks,) = (folder / "masks").iterdir()
    (masks / "provider.json").write_text(json.dumps({"provider": "regions", "views": {}}))
    made = new_session()
    made.open(folder)
    assert made.jobs.wait()
    association.associate(made, preset="robust")
    assert made.jobs.wait(), made.notices
    return made


def _bank(session: Session) -> MemoryBank:
    bank = _scene(session).bank
    assert bank is not None
    return bank


def test_a_chosen_level_is_one_edit_that_undo_takes_back(session: Session) -> None:
    levels = object_list.levels_of(session)
    assert levels is not None
    before, bank, cursor = _scene(session).labels.copy(), _bank(session), session.need().history
    place, finest = cursor.cursor, len(levels.labels) - 1
    objects.choose_level(session, finest)
    assert cursor.cursor == place + 1
    assert np.array_equal(_scene(session).labels, levels.labels[finest])
    assert _bank(session).levels is not None
    assert _bank(session).levels.chosen == finest  # type: ignore[union-attr]
    session.undo()
    assert np.array_equal(_scene(session).labels, before)
    assert _bank(session) is bank


def test_a_copy_is_one_object_with_its_color_at_every_level(session: Session) -> None:
    """Its color and weight went to another object, and while it was shown it fell into parts."""
    scene = _scene(session)
    selection.select_groups(session, (int(np.bincount(scene.labels)[1:].argmax()) + 1,))
    assert transform.duplicate(session)
    rows = session.selected_indices().copy()
    (copy,) = set(scene.labels[rows].tolist())
    assert objects.set_color(session, copy, (1, 0, 0))
    assert objects.set_weight(session, copy, Weight("mass", 2.0))
    levels = object_list.levels_of(session)
    assert levels is not None
    finest = len(levels.labels) - 1
    objects.preview_level(session, finest)
    assert session.live_labels is not None
    assert len({*session.live_labels[rows].tolist()}) == 1
    objects.choose_level(session, finest)
    (group,) = set(scene.labels[rows].tolist())
    assert scene.colors == {group: (1, 0, 0)}
    assert scene.weights == {group: Weight("mass", 2.0)}
    assert (np.flatnonzero(scene.labels == group) == rows).all()


def test_a_preview_changes_nothing_of_the_scene(session: Session) -> None:
    before, place = _scene(session).labels.copy(), session.need().history.cursor
    objects.preview_level(session, 0)
    assert session.live_labels is not None
    assert np.array_equal(session.live_labels, _bank(session).levels.labels[0])  # type: ignore[union-attr]
    objects.cancel_level(session)
    assert session.live is None
    assert np.array_equal(_scene(session).labels, before)
    assert session.need().history.cursor == place


def test_names_and_masks_stay_with_groups_that_are_there_at_both_levels(session: Session) -> None:
    levels = object_list.levels_of(session)
    assert levels is not None
    group = int(np.bincount(levels.labels[0])[1:].argmax()) + 1
    assert objects.rename(session, group, "floor")
    objects.choose_level(session, 0)
    assert _scene(session).names[group] == "floor"
    assert {d.group for d in _bank(session).log} <= set(range(levels.labels[0].max() + 1))
    assert session.decisions(group)


def test_names_come_back_with_the_level_that_has_the_objects(session: Session) -> None:
    """The slider once to its end and back took the names of all objects between."""
    levels = object_list.levels_of(session)
    assert levels is not None
    first, finest = levels.chosen, len(levels.labels) - 1
    own = set(np.unique(_scene(session).labels).tolist()) - {0}
    for group in own:
        assert objects.rename(session, group, f"object {group}")
    names = dict(_scene(session).names)
    objects.choose_level(session, 0)
    rows = np.flatnonzero(_scene(session).labels == levels.labels[0].max())
    session.need().select(rows[: len(rows) // 2].astype(np.int32), "set", "A part")
    assert objects.separate(session)
    made = int(_scene(session).labels[rows[0]])
    assert objects.rename(session, made, "by hand")  # has no id of any level
    names[made] = "by hand"
    for level in (0, finest, first):
        objects.choose_level(session, level)
        shown = {int(g): session.need().name_of(int(g)) for g in session.objects().ids if g}
        assert all(shown[g] == names[g] for g in own & shown.keys())
        assert not {name for g, name in shown.items() if g not in own} & set(names.values())
    assert own <= shown.keys()
    assert names.pop(made) not in shown.values()
    session.save()
    assert session.jobs.wait()
    session.tick(0.1)
    where = session.need().project.path
    assert where is not None
    assert run_stage(open_path_stage(where)).scene.names == names


def test_masks_follow_their_groups_to_a_coarser_level(session: Session) -> None:
    bank = _bank(session)
    assert bank.levels is not None
    coarse = at_level(bank, 0)
    for before, after in zip(bank.log, coarse.log, strict=True):
        if before.group > 0:
            own = bank.levels.labels[0][bank.group == before.group]
            assert after.group == np.bincount(own).argmax()


def test_a_moved_mask_leaves_other_objects_as_they_are(session: Session) -> None:
    before = _scene(session).labels.copy()
    groups = [d.group for d in _bank(session).log if d.group > 0]
    one, other = np.argsort(-np.bincount(groups))[1:3].tolist()
    moved = session.decisions(one)[-1]
    assert memory_bank.move_mask(session, moved, other)
    assert session.jobs.wait()
    assert any(d.by_hand for d in session.decisions(other))
    rest = (before != one) & (before != other) & (before > 0)
    assert (_scene(session).labels[rest] == before[rest]).mean() > 0.9


def test_scenes_without_levels_have_no_detail(associated: Session) -> None:
    assert object_list.levels_of(associated) is None
    with pytest.raises(ValueError, match="no levels"):
        objects.choose_level(associated, 0)


def test_a_typed_place_too_far_to_be_saved_is_told_and_shows_nothing(associated: Session) -> None:
    """G, X, and a digit that is held down."""
    scene, group = associated.need().scene, int(associated.objects().ids[1])
    selection.select_groups(associated, (group,))
    before = scene.placements.matrix.copy()
    for digits in range(1, 25):
        far = np.column_stack([np.eye(3), [10.0**digits, 0, 0]])
        transform.preview_move(associated, far)
    assert "than can be saved" in associated.notices[-1].text
    associated.commit_preview()
    assert (np.abs(scene.placements.matrix) <= 1e18).all()
    associated.undo()
    np.testing.assert_array_equal(scene.placements.matrix[: len(before)], before)
