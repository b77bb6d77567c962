"""Fewer splats as an edit: what may be merged, what stays, and how much is lost."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene import edits, reduce
from gaga_core.scene.bake import bake
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.splats import append_made, spread
from gaga_core.scene.orientation import pose_of
from gaga_core.scene.project import Project, save_project
from gaga_core.scene.reduce import (
    EXACT,
    LossCurve,
    estimate_stage,
    picture_loss_stage,
    reduce_stage,
    reduced_edit,
)
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import world_means
from tests.core.scene.edits.edit_walk import snapshot
from tests.core.scene.projects import assert_same, model_in, opened
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def balls() -> Synthetic:
    return objects_scene(4, 250, n_cameras=3, sh_degree=1)


@pytest.fixture
def scene(balls: Synthetic) -> Scene:
    """One ball turned, one hidden, half of one locked."""
    made = Scene.of(balls.gaussians, balls.labels)
    history = History(made)
    turn = np.array([[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0.25]])
    history.do(edits.transform(made, np.flatnonzero(balls.labels == 1), turn, "Move"))
    history.do(edits.hide(made, np.flatnonzero(balls.labels == 2)))
    history.do(edits.lock(made, np.flatnonzero(balls.labels == 3)[:125]))
    return made


def test_a_share_is_left_and_nothing_else_changes(scene: Scene, balls: Synthetic) -> None:
    """All of the scene: hidden and locked splats, other groups, and what found no partner, stay."""
    history, before, n = History(scene), snapshot(scene), len(scene)
    state = scene.state.copy()
    free = scene.visible & ~scene.has(State.LOCKED)
    was = bake(scene)
    found = run_stage(reduce_stage(scene, np.arange(n), 0.3, balls.cameras, CpuRasterizer()))
    assert history.do(reduced_edit(scene, found, "Reduce"))
    after = scene.visible & ~scene.has(State.LOCKED)
    assert found.n_after == np.count_nonzero(after) == round(0.3 * np.count_nonzero(free))
    kept = np.flatnonzero(~free[:n])
    assert np.array_equal(scene.state[kept], state[kept])
    assert not scene.has(State.SELECTED).any()
    gone = scene.has(State.DELETED)
    assert set(np.flatnonzero(gone)) == set(found.removed) <= set(np.flatnonzero(free))
    for group in (0, 1, 3, 4):
        assert (scene.labels[after] == group).any(), "objects keep their splats apart"
    loss = picture_loss_stage(was, bake(scene), balls.cameras[::3], CpuRasterizer())
    assert 15 < found.psnr < EXACT
    assert run_stage(loss) > found.psnr - 3, "with the locked half, about the same is lost"
    history.undo()
    assert snapshot(scene) == before
    history.redo()
    assert np.array_equal(scene.visible & ~scene.has(State.LOCKED), after)


def test_an_object_that_was_moved_and_reduced_is_reset_and_posed_as_one(balls: Synthetic) -> None:
    """Splats that had found no partner went back, the merged ones stayed where they were."""
    scene = Scene.of(balls.gaussians, balls.labels)
    history = History(scene)
    ball = np.flatnonzero(scene.labels == 1).astype(np.int32)
    turn = np.array([[0, -2, 0, 5], [2, 0, 0, 0], [0, 0, 2, 0.25]])
    history.do(edits.move_scene(scene, np.column_stack([np.eye(3), [1.0, 2, 3]]), "Move all"))
    history.do(edits.transform(scene, ball, turn, "Move"))
    before = pose_of(scene, ball, np.zeros(3))
    run_script(scene, [{"op": "reduce", "groups": [1, 2], "share": 0.5}], history)
    history.do(edits.move_scene(scene, np.column_stack([np.eye(3), [0.0, 0, 9]]), "Move all"))
    left = np.flatnonzero(scene.visible & (scene.labels == 1))
    assert left[0] < len(balls.gaussians) <= left[-1], "merged ones and others"
    for part in (left[:1], left[-1:]):
        pose = pose_of(scene, part.astype(np.int32), np.zeros(3))
        np.testing.assert_allclose(pose.turn, before.turn, atol=1e-12)
        np.testing.assert_allclose(pose.scale, before.scale)
    both = np.flatnonzero(scene.visible & np.isin(scene.labels, (1, 2)))
    history.do(edits.reset_placement(scene, both))
    for group in (1, 2):
        means = world_means(scene, both[scene.labels[both] == group]) - [1, 2, 12]
        distance, _ = cKDTree(balls.gaussians.means[balls.labels == group]).query(means)
        assert np.max(distance) < 0.1


def test_a_selection_stays_selected_and_is_merged_alone(scene: Scene) -> None:
    history = History(scene)
    ball = np.flatnonzero(scene.labels == 4)
    history.do(edits.select(scene, ball))
    assert run_script(scene, [{"op": "reduce", "share": 0.5}])[0].startswith(
        "Reduce splats of group 4 to 125 ("
    )
    chosen = np.flatnonzero(scene.has(State.SELECTED))
    assert len(chosen) == 125
    assert (scene.labels[chosen] == 4).all()
    made = chosen[chosen >= scene.n_opened]
    assert set(chosen) - set(made) < set(ball.tolist())
    np.testing.assert_allclose(
        scene.gaussians.means[made].mean(axis=0),
        scene.gaussians.means[ball].mean(axis=0),
        atol=0.05,
    )


def test_what_cannot_be_merged_is_one_sentence(scene: Scene) -> None:
    with pytest.raises(GagaError, match="hidden and locked"):
        run_script(scene, [{"op": "reduce", "groups": [2], "share": 0.5}])
    with pytest.raises(GagaError, match="above 0"):
        run_script(scene, [{"op": "reduce", "groups": [1], "share": 0}])
    assert run_script(scene, [{"op": "reduce", "groups": [1], "share": 1}]) == ()


def test_a_reduced_scene_is_saved_and_opened(tmp_path: Path) -> None:
    project = opened(model_in(tmp_path))
    scene = project.scene
    history = History(scene)
    run_script(scene, [{"op": "select_all"}, {"op": "reduce", "share": 0.6}], history)
    replayed = opened(project.model_path).scene
    run_script(replayed, json.loads(json.dumps(history.recorded())))
    assert scene.added[0].is_merged
    assert replayed.added == scene.added
    again = opened(save_project(project, tmp_path / "less.gaga"))
    assert isinstance(again, Project)
    assert_same(scene, again.scene)
    assert again.scene.added == scene.added


@pytest.mark.parametrize("is_part", [False, True])
def test_the_estimate_is_near_what_is_measured(
    balls: Synthetic, monkeypatch: pytest.MonkeyPatch, is_part: bool
) -> None:
    """Also of blocks of neighbours, as of large scenes."""
    made = Scene.of(balls.gaussians, balls.labels)
    whole, rasterizer = np.arange(len(made)), CpuRasterizer()
    if is_part:
        monkeypatch.setattr(reduce, "_N_ESTIMATED", 1200)
    curve = run_stage(estimate_stage(made, whole, balls.cameras, rasterizer))
    levels = [level for _, level in curve.points]
    assert levels == sorted(levels, reverse=True), "the fewer, the worse"
    for share in (0.6, 0.3):
        found = run_stage(reduce_stage(made, whole, share, balls.cameras, rasterizer))
        assert abs(curve.at(share) - found.psnr) < (3 if is_part else 1.5), (share, curve)


def test_a_curve_goes_through_its_points() -> None:
    curve = LossCurve(((0.5, 30.0), (0.25, 26.0), (0.1, 20.0)))
    assert [curve.at(share) for share, _ in curve.points] == [30.0, 26.0, 20.0]
    assert curve.at(0.05) == 20.0, "nothing is promised below"
    assert 33 < curve.at(0.95) < 35
    assert 26 < curve.at(0.35) < 30
    assert curve.at(1.0) == LossCurve(()).at(0.5) == EXACT


def test_objects_found_after_a_reduction_hold_what_became_of_their_splats(
    balls: Synthetic,
) -> None:
    """All of them stayed in no group: the association knows the rows of the file alone."""
    scene = Scene.of(balls.gaussians)
    n = len(scene)
    script = [{"op": "select_all"}, {"op": "reduce", "share": 0.1}, {"op": "select_none"}]
    run_script(scene, script)
    labels = spread(scene, balls.labels)
    truth = balls.labels[cKDTree(balls.gaussians.means).query(scene.gaussians.means[n:])[1]]
    assert np.array_equal(labels[n:], truth)
    assert len(np.unique(truth)) == 5
    ball = np.flatnonzero(labels == 4)
    History(scene).do(edits.delete(scene, ball))
    filled = scene.gaussians.take(ball[:9])
    History(scene).do(append_made(scene, filled, np.zeros(9, np.int32), "Fill"))
    assert 4 not in spread(scene, balls.labels)[-9:], "what fills a hole is not what was there"


def test_restoring_what_was_deleted_takes_back_what_was_merged(balls: Synthetic) -> None:
    """Both lay over one another."""
    scene = Scene.of(balls.gaussians, balls.labels)
    history, n = History(scene), len(scene)
    whole = np.arange(n, dtype=np.int32)
    found = run_stage(reduce_stage(scene, whole, 0.3, balls.cameras, CpuRasterizer()))
    assert history.do(reduced_edit(scene, found, "Reduce"))
    assert history.do(edits.delete(scene, np.flatnonzero(scene.visible)[:9]))
    assert edits.has_deleted(scene)
    assert history.do(edits.restore_originals(scene))
    assert np.flatnonzero(scene.visible).tolist() == list(range(n))
    assert not edits.has_deleted(scene)
    assert edits.restore_originals(scene) is None
