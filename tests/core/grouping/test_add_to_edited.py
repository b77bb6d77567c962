"""New views join groups that were edited: what a person did stays, ids do, and votes count on."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.grouping.add_views import EditedGroups, add_to_edited_stage
from gaga_core.grouping.associate import Association, BankSnapshot
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.joined_views import FIRST, add, associate, config_of, true_masks
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=5, n_cameras=10, seed=4)


def _first(scene: Synthetic, preset: str) -> Association:
    return associate(scene, true_masks(scene, scene.cameras[:FIRST], hides=3), preset)


def _moved(bank: MemoryBank, to: IntArray) -> MemoryBank:
    log = tuple(
        replace(d, group=int(to[d.group]), runner_up=int(to[d.runner_up])) for d in bank.log
    )
    group = np.where(bank.group > 0, to[np.maximum(bank.group, 0)], bank.group).astype(np.int32)
    return replace(bank, group=group, log=log, n_groups=int(to.max()))


def _add(
    scene: Synthetic, edited: EditedGroups, seen: list[BankSnapshot] | None = None
) -> Association:
    stage = add_to_edited_stage(
        scene.gaussians,
        scene.cameras,
        true_masks(scene, scene.cameras, hides=3),
        edited,
        choose(),
        config_of(edited.bank.preset),
    )

    def watch(payload: object) -> None:
        if seen is not None and isinstance(payload, BankSnapshot):
            seen.append(payload)

    return run_stage(stage, lambda step: watch(step.payload))


@pytest.mark.parametrize("preset", ["robust", "paper"])
def test_ids_with_gaps_make_no_difference(scene: Synthetic, preset: str) -> None:
    first = _first(scene, preset)
    plain = add(scene, true_masks(scene, scene.cameras, hides=3), first)
    n, free = first.bank.n_groups, 5000
    to = np.append(0, 1000 + 7 * np.arange(n)).astype(np.int32)
    edited = EditedGroups(_moved(first.bank, to), to[first.labels], first.confidence, free)
    seen: list[BankSnapshot] = []
    found = _add(scene, edited, seen)
    whole = np.append(to, free + np.arange(plain.bank.n_groups - n)).astype(np.int32)
    assert (found.labels == whole[plain.labels]).mean() > 0.995
    assert [d.group for d in found.bank.log] == [int(whole[d.group]) for d in plain.bank.log]
    assert found.bank.n_groups == whole.max()
    for view, groups in plain.mask_groups.items():
        assert np.array_equal(found.mask_groups[view], whole[groups])
    for snapshot in seen:
        assert set(np.unique(snapshot.bank.group)) <= {-1, *whole.tolist()}


def test_what_a_person_did_stays(scene: Synthetic) -> None:
    first = _first(scene, "robust")
    ball = [int(np.bincount(first.labels[scene.labels == k]).argmax()) for k in range(6)]
    merged = np.arange(first.bank.n_groups + 1, dtype=np.int32)
    merged[ball[2]] = ball[1]
    bank = _moved(first.bank, merged)
    labels = merged[first.labels]
    by_hand = np.flatnonzero(labels == ball[4])[::3]
    labels[by_hand] = 900  # a group of its own
    edited = EditedGroups(bank, labels, first.confidence, 901)
    assert np.flatnonzero(edited.by_hand).tolist() == by_hand.tolist()
    found = _add(scene, edited)
    assert (found.labels[by_hand] == 900).all()
    both = found.labels[np.isin(scene.labels, (1, 2)) & (found.confidence > 0)]
    assert (both == ball[1]).mean() > 0.9, "what was merged is one"
    new = found.labels[(scene.labels == 3) & (found.confidence > 0)]
    assert (new >= 901).mean() > 0.85, "what no former mask showed is new"
    again = EditedGroups(found.bank, found.labels, found.confidence, 2000)
    assert set(by_hand.tolist()) <= set(np.flatnonzero(again.by_hand).tolist())
