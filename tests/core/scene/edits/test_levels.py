"""Split here and join here: one group goes a level finer or coarser, and undo takes it back."""

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.objects import join_here, split_here
from gaga_core.scene.scene import Scene
from tests.core.scene.edits.edit_walk import snapshot
from tests.scenes import random_gaussians

_LEAF = np.repeat(np.arange(8, dtype=np.int32), 30)  # in pairs, and those in pairs


def _scene() -> Scene:
    """Eight leaves of 30 splats, in pairs at the level that was chosen, in fours above it."""
    clusters = np.stack([_LEAF // 4, _LEAF // 2, _LEAF]).astype(np.int64)
    levels = Levels.of(clusters, 1, np.zeros(len(_LEAF), np.int64))
    labels: IntArray = levels.labels[1].copy()
    scene = Scene.of(random_gaussians(len(labels), seed=0), labels)
    top = int(levels.labels.max())
    scene.bank = MemoryBank(labels.copy(), top, preset="robust", levels=levels)
    return scene


def _do(scene: Scene, edit: Edit | None) -> None:
    assert edit is not None
    assert History(scene).do(edit)


def _same_partition(a: IntArray, b: IntArray) -> bool:
    pairs = np.unique(np.stack([a, b]), axis=1).shape[1]
    return bool(pairs == len(np.unique(a)) == len(np.unique(b)))


def test_a_group_goes_to_its_parts_and_back_and_others_stay() -> None:
    scene = _scene()
    before, group = scene.labels.copy(), int(scene.labels[0])
    scene.names[group] = "drill"
    _do(scene, split_here(scene, group))
    assert _same_partition(scene.labels[:60], _LEAF[:60])
    assert (scene.labels[60:] == before[60:]).all()
    assert (scene.labels == group).sum() == 30
    assert sorted(scene.names.values()) == ["drill", "drill 2"]
    assert scene.bank is not None
    assert scene.bank.levels is not None
    assert np.array_equal(scene.labels[:60], scene.bank.levels.labels[2][:60])  # the level's ids
    assert split_here(scene, group) is None  # a leaf
    _do(scene, join_here(scene, group))
    assert np.array_equal(scene.labels, before)


def test_a_group_joins_those_of_the_next_coarser_level_alone() -> None:
    scene = _scene()
    second = int(scene.labels[70])
    _do(scene, join_here(scene, second))
    assert (scene.labels[:120] == second).all()
    assert _same_partition(scene.labels[120:], _LEAF[120:] // 2)
    assert join_here(scene, second) is None


def test_groups_changed_by_hand_count_as_what_most_of_their_splats_are() -> None:
    scene = _scene()
    first, third = int(scene.labels[0]), int(scene.labels[130])
    scene.labels[60:65] = first  # a few splats of its neighbour are no part
    _do(scene, edits.merge_groups(scene, [first, third]))
    _do(scene, split_here(scene, first))
    assert _same_partition(scene.labels[[0, 30, 125, 155]], np.array([0, 0, 1, 1], np.int32))


def test_ids_of_new_groups_are_free() -> None:
    scene = _scene()
    assert scene.bank is not None
    assert scene.bank.levels is not None
    wanted = int(scene.bank.levels.labels[2][:60].max())
    scene.names[wanted] = "a name from before"
    _do(scene, split_here(scene, int(scene.labels[0])))
    assert wanted not in scene.labels


def test_scripts_split_and_join_and_undo_restores_every_bit() -> None:
    scene = _scene()
    start, history = snapshot(scene), History(scene)
    group = int(scene.labels[0])
    ops = [{"op": "split_here", "groups": [group]}, {"op": "join_here", "groups": [group]}]
    assert run_script(scene, ops * 2, history) == ("Split here", "Join here") * 2
    for _ in range(4):
        history.undo()
    assert snapshot(scene) == start
    with pytest.raises(GagaError, match="give one object"):
        run_script(scene, [{"op": "split_here", "groups": [1, 2]}])


def test_without_levels_both_say_what_to_do() -> None:
    scene = _scene()
    scene.bank = None
    for build in (split_here, join_here):
        with pytest.raises(GagaError, match="Find objects"):
            build(scene, 1)
