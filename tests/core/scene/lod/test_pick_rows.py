"""A click in a large scene looks at few splats and finds the same."""

import numpy as np

from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.lod.edited import PickBoxes
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.by_screen import pick
from tests.core.scene.lod.conftest import Built
from tests.scenes import orbit_cameras

CAMERAS = orbit_cameras(3, width=160, height=120, radius=1.9)


def check(built: Built, scene: Scene, seed: int) -> float:
    """Compare clicks at random pixels; the share of splats that they looked at."""
    boxes = PickBoxes(built.tree, scene)
    rng = np.random.default_rng(seed)
    shares = []
    for camera in CAMERAS:
        for u, v in rng.uniform((0, 0), (160, 120), (5, 2)):
            rows = boxes.rows_at(camera, u, v, len(scene))
            shares.append(len(rows) / len(scene))
            whole, found = pick(scene, camera, u, v), pick(scene, camera, u, v, rows=rows)
            assert (whole is None) == (found is None)
            if whole is not None and found is not None:
                assert np.array_equal(whole.indices, found.indices)
                assert np.array_equal(whole.weights, found.weights)
                assert (whole.group, whole.splat) == (found.group, found.splat)
                assert whole.depth == found.depth
    return float(np.mean(shares))


def test_clicks_are_those_among_all_splats(built: Built) -> None:
    scene = Scene.of(built.gaussians, (np.arange(len(built.gaussians)) % 7).astype(np.int32))
    assert check(built, scene, 0) < 0.6


def test_clicks_follow_what_was_moved_hidden_and_added(built: Built) -> None:
    scene = Scene.of(built.gaussians, (built.gaussians.means[:, 0] > 0).astype(np.int32))
    history = History(scene)
    matrix = np.eye(3, 4)
    matrix[:, 3] = (0.2, 0.5, 0.3)
    some = np.flatnonzero(scene.labels == 1)
    history.do(edits.transform(scene, some, matrix))
    history.do(edits.hide(scene, some[::3]))
    history.do(edits.duplicate(scene, some[:500]))
    check(built, scene, 1)


def test_boxes_are_those_of_the_scene_that_was_given(built: Built) -> None:
    """Though they are looked up later, maybe by another thread."""
    scene = Scene.of(built.gaussians)
    boxes = PickBoxes(built.tree, scene)
    matrix = np.eye(3, 4)
    matrix[2, 3] = 9.0
    History(scene).do(edits.transform(scene, np.arange(len(scene)), matrix))
    assert np.array_equal(boxes.boxes, built.tree.boxes)
    assert PickBoxes(built.tree, scene).boxes[-1, 2] > 7
