"""Edits made of cleaning: tints that revert, several objects in turn, the script's operation."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import LongArray
from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.progress import run_stage
from gaga_core.scene.bake import bake
from gaga_core.scene.cleanup import (
    DROPPED,
    TAKEN_IN,
    clean_object,
    clean_objects_stage,
    cleaned_copy,
    cleaned_edit,
    cleaning_tint,
    delete_cleaned,
    isolate_cleaned,
    whole_objects,
)
from gaga_core.scene.edits import hide, isolate, lock, select
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene, State
from tests.app.looks import snapshot
from tests.scenes import objects_scene


def floating(groups: tuple[int, ...] = (1, 3), n: int = 15) -> tuple[Scene, LongArray]:
    """Balls of which some have floaters high above them; their rows."""
    made = objects_scene(4, 300)
    rows = np.concatenate([np.flatnonzero(made.labels == g)[:n] for g in groups])
    means = made.gaussians.means.copy()
    rng = np.random.default_rng(0)
    means[rows] += rng.uniform([-1, -1, 2], [1, 1, 3], (len(rows), 3)).astype(np.float32)
    return Scene.of(replace(made.gaussians, means=means), made.labels), rows


def test_the_tint_colors_what_comes_and_goes_and_reverts() -> None:
    scene, rows = floating()
    scene.labels[group_indices(scene, 2)[:5]] = 0  # to be taken in again
    History(scene).do(select(scene, group_indices(scene, 1)[:7]))
    for group in (1, 2):
        preview = clean_object(scene, group)
        before = snapshot(scene)
        tint = cleaning_tint(scene, preview)
        assert tint is not None
        tint.apply(scene)
        shown = np.clip(0.5 + 0.28209479177387814 * bake(scene).sh[:, 0], 0, 1)
        np.testing.assert_allclose(
            shown[preview.remove], np.tile(DROPPED, (len(preview.remove), 1)), atol=1e-5
        )
        np.testing.assert_allclose(
            shown[preview.add], np.tile(TAKEN_IN, (len(preview.add), 1)), atol=1e-5
        )
        rest = np.setdiff1d(np.arange(len(scene)), np.r_[preview.remove, preview.add])
        assert np.ptp(shown[rest], axis=1).max() < 1e-5, "all else is gray"
        tint.revert(scene)
        assert snapshot(scene) == before
    assert len(clean_object(scene, 1).remove) > 10
    assert len(clean_object(scene, 2).add) > 0
    assert len(rows) == 30


def test_objects_are_cleaned_in_turn_and_the_scene_is_not() -> None:
    scene, rows = floating()
    before = snapshot(scene)
    revision = scene.revision.total()
    labels = run_stage(clean_objects_stage(scene, (1, 3)))
    assert snapshot(scene) == before
    assert scene.revision.total() == revision
    assert (labels[rows] == 0).mean() > 0.9
    # What the first gave to the second is seen by the second: the same as one edit after another.
    history = History(scene)
    for group in (1, 3):
        history.do(cleaned_edit(scene, clean_object(scene, group), "Clean"))
    np.testing.assert_array_equal(labels, scene.labels)


def test_an_isolated_object_stays_alone_when_it_is_cleaned() -> None:
    scene, rows = floating()
    history = History(scene)
    history.do(isolate(scene, group_indices(scene, 1)))
    history.do(cleaned_edit(scene, clean_object(scene, 1), "Clean"))
    assert (scene.labels[scene.visible] == 1).all()
    assert not scene.visible[rows[:15]].any()  # its floaters are hidden, too
    history.undo()
    assert scene.visible[rows[:15]].all()


@pytest.mark.parametrize("build", [isolate_cleaned, delete_cleaned])
def test_cleaned_acts_are_one_entry(build: type) -> None:
    scene, rows = floating()
    history = History(scene)
    history.do(select(scene, group_indices(scene, 1)))
    before = snapshot(scene)
    labels = run_stage(clean_objects_stage(scene, (1,)))
    history.do(build(scene, (1,), labels, "Act"))
    assert history.cursor == 2
    mine = rows[:15]
    strays = mine[scene.labels[mine] == 0]
    assert len(strays) > 10
    if build is isolate_cleaned:
        assert set(scene.labels[scene.visible]) == {1}
        assert not scene.visible[strays].any()
    else:
        assert scene.has(State.DELETED)[strays].all()
        assert len(group_indices(scene, 1)) == 0
    history.undo()
    assert snapshot(scene) == before


def test_a_copy_is_cleaned_and_selected() -> None:
    scene, rows = floating()
    before = snapshot(scene)
    labels = run_stage(clean_objects_stage(scene, (1,)))
    copy = cleaned_copy(scene, (1,), labels)
    assert snapshot(scene) == before
    np.testing.assert_array_equal(copy.has(State.SELECTED), copy.labels == 1)
    assert not copy.has(State.SELECTED)[rows[copy.labels[rows] == 0]].any()


def test_whole_objects() -> None:
    scene, _ = floating()
    history = History(scene)
    assert whole_objects(scene) == ()
    both = np.concatenate([group_indices(scene, 2), group_indices(scene, 4)])
    history.do(select(scene, both))
    assert whole_objects(scene) == (2, 4)
    history.do(select(scene, both[1:]))
    assert whole_objects(scene) == ()
    history.do(hide(scene, both[:1]))
    assert whole_objects(scene) == (2, 4), "what is hidden need not be chosen"
    history.undo()
    history.do(lock(scene, both[:1]))
    assert whole_objects(scene) == (2, 4), "what is locked cannot be chosen"
    history.do(select(scene, np.flatnonzero(scene.labels == 0)[:1], "add"))
    assert whole_objects(scene) == (), "a loose splat is no object"


def test_the_script_cleans() -> None:
    scene, rows = floating()
    wanted = run_stage(clean_objects_stage(scene, (1, 3)))
    assert run_script(scene, [{"op": "clean", "groups": [1, 3]}]) == ("Clean",)
    np.testing.assert_array_equal(scene.labels, wanted)
    assert (scene.labels[rows] == 0).mean() > 0.9
    with pytest.raises(GagaError, match="no object is selected"):
        run_script(scene, [{"op": "clean"}])
