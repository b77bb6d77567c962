"""The preset "robust": what one bad mask did is undone, and every Gaussian gets a label."""

from functools import partial

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.grouping.gate import ViewMasks, open_bounds
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.grouping.robust.label_masks import (
    decide_masks,
    divided_labels,
    fill_unseen,
    voting_labels,
)
from gaga_core.grouping.robust.surface_points import PointTables
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import masks_of, true_map
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=5, n_cameras=8, seed=4)


def _robust(scene: Synthetic, masks: MaskSet) -> Association:
    config = AssociateConfig.of("robust")
    return run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose(), config))


def test_perfect_masks_give_the_true_groups_to_every_gaussian(scene: Synthetic) -> None:
    result = _robust(scene, masks_of(scene, scene.cameras))
    assert result.bank.n_groups == 6
    assert (result.labels > 0).all()
    table = np.zeros((6, 7), np.int64)
    np.add.at(table, (scene.labels, result.labels), 1)
    assert len(set(table.argmax(axis=1))) == 6
    assert table.max(axis=1).sum() > 0.97 * len(scene.labels)


def test_a_group_that_one_view_made_up_is_dissolved(scene: Synthetic) -> None:
    """Each object is cut in two in one of the views; a group of its own must not outlive that."""
    maps: dict[str, IntArray] = {}
    for i, camera in enumerate(scene.cameras):
        labels = true_map(scene, camera)
        if i < 5:
            rows, columns = np.nonzero(labels == i + 1)
            right = columns > np.median(columns)
            labels[rows[right], columns[right]] = 70 + i
        maps[camera.name] = labels
    masks = MaskSet({name: partial(maps.__getitem__, name) for name in maps})
    paper = run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose()))
    robust = _robust(scene, masks)
    assert paper.bank.n_groups > 6
    assert robust.bank.n_groups == 6
    assert (robust.views_per_group[1:] >= 2).all()
    for i in range(1, 5):
        groups = robust.mask_groups[f"00{i}.png"]
        assert groups[i + 1] == groups[70 + i]  # both halves are the object again


def test_log_has_one_decision_a_mask_and_says_what_the_tables_say(scene: Synthetic) -> None:
    masks = masks_of(scene, scene.cameras)
    result = _robust(scene, masks)
    decided = [(d.view, d.mask) for d in result.bank.log]
    there = {
        (c.name, int(m))
        for c in scene.cameras
        for m in np.unique(masks.load(c.name, c.width, c.height))
        if m > 0
    }
    assert len(decided) == len(set(decided))
    assert set(decided) == there
    for decision in result.bank.log:
        assert result.mask_groups[decision.view][decision.mask] == decision.group
        assert 0 <= decision.runner_up_overlap <= decision.overlap <= 1


def test_hidden_gaussians_take_their_object(scene: Synthetic) -> None:
    """Splats too faint to be drawn, inside the balls: the gate's votes or neighbours label them."""
    inner = np.flatnonzero(scene.labels > 0)[::7]
    gaussians = scene.gaussians.take(np.concatenate([np.arange(len(scene.gaussians)), inner]))
    for k in range(1, 6):
        centre = scene.gaussians.means[scene.labels == k].mean(axis=0)
        rows = len(scene.gaussians) + np.flatnonzero(scene.labels[inner] == k)
        gaussians.means[rows] = centre + 0.3 * (gaussians.means[rows] - centre)
    gaussians.logit_opacities[len(scene.gaussians) :] = -9
    masks = masks_of(scene, scene.cameras)
    config = AssociateConfig.of("robust")
    result = run_stage(associate_stage(gaussians, scene.cameras, masks, choose(), config))
    owner = np.array(
        [
            np.bincount(result.labels[: len(scene.labels)][scene.labels == k]).argmax()
            for k in range(1, 6)
        ]
    )
    hidden = result.labels[len(scene.gaussians) :]
    assert (result.confidence[len(scene.gaussians) :] == 0).all()
    assert (hidden > 0).all()
    assert (hidden == owner[scene.labels[inner] - 1]).mean() > 0.9


def test_the_gates_vote_goes_before_the_neighbours() -> None:
    """Left and right half of a picture are groups 1 and 2; most splats stand in the left one."""
    scene = objects_scene(n_objects=1, per_object=20)
    camera = Camera(np.array([[50.0, 0, 50], [0, 50, 50], [0, 0, 1]]), np.eye(4), 100, 100, "a.png")
    picture = np.full((100, 100), 1, np.int32)
    picture[:, 50:] = 2
    gaussians = scene.gaussians.take(np.arange(12))
    gaussians.means[:10] = [-0.02, 0, 2]
    gaussians.means[10] = [0.02, 0, 2]  # in the right half, beside ten of the left one
    gaussians.means[11] = [-0.02, 0, -2]  # behind the camera: neighbours only
    labels = np.array([1] * 10 + [0, 0], np.int32)
    groups = {"a.png": np.array([0, 1, 2], np.int32)}
    masks = MaskSet({"a.png": lambda: picture})
    bounds = {"a.png": open_bounds(ViewMasks.of(picture))}
    filled = run_stage(fill_unseen(gaussians, [camera], masks, bounds, groups, 2, labels))
    assert filled.tolist() == [1] * 10 + [2, 1]


def test_masks_take_the_group_of_most_of_their_points() -> None:
    log = tuple(Decision("a", mask, 9, True, 0.5, 0, 0.0, 40) for mask in (3, 8, 9))
    table = csr_matrix([[0, 0, 0], [0, 1, 3], [0, 0, 0], [0, 0, 5]])
    bank = MemoryBank(np.ones(6, np.int32), 9, log, preset="robust")
    tables = PointTables(table, np.array([0, 4]))
    decided = decide_masks(bank, ["a"], tables, [np.array([0, 3, 8, 9], np.int32)])
    assert decided.n_groups == 2
    assert decided.preset == "robust"
    assert (decided.group == -1).all()
    assert [(d.mask, d.group, d.is_new) for d in decided.log] == [
        (3, 2, True),
        (8, 0, False),
        (9, 2, False),
    ]
    first = decided.log[0]
    assert (first.overlap, first.runner_up, first.runner_up_overlap) == (0.75, 1, 0.25)
    assert first.n_gaussians == 40


def test_a_merged_mask_is_silent_until_its_pixels_are_told_apart() -> None:
    masks = ViewMasks.of(np.array([[1, 1, 1, 2]], np.int32))
    table = csr_matrix([[0, 0, 0, 0], [0, 4, 3, 0], [0, 0, 0, 5]])
    merged = np.array([1])
    assert voting_labels(masks, table, merged).tolist() == [[0, 0, 0, 3]]
    shown = np.array([[1, 2, 3, 1]], np.int32)  # group 3 has no point in mask 1
    assert voting_labels(masks, table, merged, shown).tolist() == [[1, 2, 0, 3]]
    assert divided_labels(masks, table, merged, shown).tolist() == [[1, 2, 0, 0]]
