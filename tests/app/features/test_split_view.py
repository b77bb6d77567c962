"""What stands on the two sides of the line: nothing there changes the scene."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.evaluate.photo_film import _VERDICTS, Verdict, truth_picture
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import read_labels, write_labels
from gaga_core.scene import edits
from gaga_core.scene.orientation import ground_map
from gaga_core.scene.scene import State
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import objects, selection, split_view
from gaga_studio.features.commands import command, run
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, PhotoCompareMode, Side


def test_a_split_is_a_switch_and_says_why_not(associated: Session) -> None:
    session = associated
    assert "gt/instance" in command("camera.split_truth").enabled(session)
    assert "edited" in command("camera.split_before").enabled(session)
    assert run("camera.split_groups", session)
    assert split_view.is_shown(session, Side.PICTURE, Side.GROUPS)
    found = split_view.left_drawn(session, session.view)
    assert found is not None
    assert found[0] is session.scene
    assert found[1].mode is Mode.COLOR
    assert split_view.right_view(session, session.view).mode is Mode.GROUPS
    assert session.view.mode is Mode.COLOR
    assert run("camera.split_groups", session)
    assert session.view.compare is PhotoCompareMode.OFF
    assert split_view.left_drawn(session, session.view) is None
    assert split_view.right_view(session, session.view) is session.view


def test_before_is_the_scene_without_its_last_edit(associated: Session) -> None:
    session, scene = associated, associated.scene
    assert scene is not None
    selection.select_groups(session, (2,))
    assert objects.hide(session)
    once = scene.state.copy()
    selection.select_groups(session, (3,))
    assert objects.hide(session)
    now, revision = scene.state, scene.revision.total()
    selection.select_groups(session, (4,))  # no edit
    before = split_view.scene_before(session)
    assert before is not None
    hidden = np.uint8(State.HIDDEN)
    assert np.array_equal(before.state & hidden, once & hidden)
    assert not np.array_equal(now & hidden, once & hidden)
    assert np.array_equal(scene.state & hidden, now & hidden)
    assert split_view.scene_before(session) is before
    assert scene.revision.total() >= revision
    assert run("edit.undo", session)
    assert session.history.cursor > 0  # type: ignore[union-attr]
    assert split_view.scene_before(session) is before, "a selection is no edit"
    assert run("edit.undo", session)
    other = split_view.scene_before(session)
    assert other is not None
    assert other is not before


@pytest.mark.parametrize("how", ["scale", "ground"])
def test_things_are_in_the_same_place_of_both_sides(associated: Session, how: str) -> None:
    session, scene = associated, associated.need().scene
    start = world_means(scene).astype(np.float64)
    before = session.rig.camera(640, 480)
    if how == "scale":
        edit = edits.set_scale(scene, 2.0, 0.5, np.zeros(3))
    else:
        points = np.array([[0, 0, 0], [1, 0.2, 0.3], [-0.3, 1, 0.1]])
        moved = ground_map(points, session.rig.up, session.rig.seen_from)
        edit = edits.move_scene(scene, moved, "Align to ground")
    assert session.need().do(edit)
    session.tick(0.0)
    split_view.compare_version(session, session.history.cursor - 1)  # type: ignore[union-attr]
    found = split_view.left_drawn(session, session.view)
    assert found is not None
    camera = session.rig.camera(640, 480)
    left = split_view.camera_in(found[0], scene, camera)
    here = camera.project(world_means(scene).astype(np.float64))[0]
    there = left.project(world_means(found[0]).astype(np.float64))[0]
    np.testing.assert_allclose(here, there, atol=0.05)
    np.testing.assert_allclose(world_means(found[0]), start, atol=1e-5)
    assert split_view.camera_in(scene, scene, before) is before


def test_the_other_preset_keeps_the_ids_of_what_is_alike(associated: Session) -> None:
    session, scene = associated, associated.scene
    assert scene is not None
    labels = scene.labels
    assert split_view.other_preset(session) == "robust"
    assert run("camera.split_preset", session)
    assert split_view.left_drawn(session, session.view) is None  # on its way
    assert "being computed" in split_view.missing_text(session)
    assert session.jobs.wait()
    found = split_view.left_drawn(session, session.view)
    assert found is not None, session.notices
    other = found[2]
    assert other is not None
    assert scene.labels is labels
    assert not session.unsaved
    both = (other > 0) & (labels > 0)
    assert (other[both] == labels[both]).mean() > 0.9
    assert len(other) == len(scene)
    assert split_view.found_text(session) == "Groups of robust, labels by vote of the masks"
    session.settings = replace(session.settings, preset="released")
    assert split_view.other_preset(session) == "released"  # the chosen one, and not known yet
    assert split_view.other_labels(session) is None
    assert split_view.associate_other(session)
    assert session.jobs.wait(), session.notices
    assert split_view.other_labels(session) is not None


def test_a_cancelled_association_is_not_on_the_way(associated: Session) -> None:
    assert run("camera.split_preset", associated)
    associated.jobs.cancel()
    assert associated.jobs.wait()
    assert split_view.other_labels(associated) is None
    assert "open it again" in split_view.missing_text(associated)


def test_errors_are_where_groups_differ_from_the_truth(associated: Session) -> None:
    session = associated
    folder = session.project.folder  # type: ignore[union-attr]
    assert folder is not None
    camera = folder.cameras[0]
    truth = folder.root / "gt" / "instance"
    shutil.copytree(folder.root / "masks" / "made", truth)  # true maps under other ids
    assert command("camera.split_errors").enabled(session) == ""
    assert run("camera.split_errors", session)
    assert session.active_view is not None
    assert session.scene is not None
    args = (camera, folder.image_paths[camera.name], truth, 512)
    picture, share = split_view.errors_of(session.scene, *args)
    assert share > 0.95
    whole = read_rgb(folder.image_paths[camera.name], 512).shape
    assert picture.shape == whole
    assert truth_picture(truth, camera.name, 512).shape == whole
    selection.select_groups(session, (3,))
    assert objects.hide(session)
    worse, less = split_view.errors_of(session.scene, *args)
    assert less < share
    yellow = _VERDICTS[Verdict.MISSING] @ [1, 1, -2] > 0
    assert yellow
    assert (worse.astype(int) @ [1, 1, -2] > 150).sum() > (picture @ [1, 1, -2] > 150).sum()


def test_a_photo_that_has_no_true_map_is_named(associated: Session, tmp_path: Path) -> None:
    from gaga_core.errors import GagaError

    write_labels(tmp_path / "other.png", np.ones((4, 4), np.int32))
    assert read_labels(tmp_path / "other.png").all()
    with pytest.raises(GagaError, match=associated.cameras[0].name):
        truth_picture(tmp_path, associated.cameras[0].name, 64)
    assert split_view.compared_photo(associated) is None or associated.active_view is not None
