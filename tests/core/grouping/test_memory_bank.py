"""The memory bank: one pass over a view is the paper's mask-by-mask procedure, to the letter."""

from itertools import pairwise

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.grouping.gate import GateConfig, ViewMasks, depth_bounds, gaussians_of_masks
from gaga_core.grouping.memory_bank import (
    Decision,
    DecisionLog,
    MemoryBank,
    Overlaps,
    add_view,
    two_best,
    views_per_group,
)
from tests.core.grouping import bank_reference
from tests.core.grouping.bank_reference import View
from tests.scenes import orbit_cameras


def _random_views(seed: int, n_views: int = 6) -> list[View]:
    """Blocky masks with gaps in their ids, depth maps that let some Gaussians through."""
    rng = np.random.default_rng(seed)
    views = []
    for camera in orbit_cameras(n_views, width=32, height=24):
        ids = rng.choice(np.arange(1, 60), 12, replace=False) * (rng.random(12) > 0.2)
        labels = rng.choice(ids, (4, 4)).repeat(6, 0).repeat(8, 1).astype(np.int32)
        depth = np.maximum(rng.normal(3.2, 0.5, labels.shape), 0).astype(np.float32)
        alpha = rng.uniform(0.2, 1, labels.shape).astype(np.float32)
        depth[labels == ids.max()] = 0.0  # one mask without any depth
        views.append(View(camera, labels, depth, alpha))
    return views


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("threshold", [0.1, 0.45])
@pytest.mark.parametrize(
    "config", [GateConfig(), GateConfig(iqr_floor=0.2, guard_near=True, alpha_min=0.7)]
)
def test_one_pass_equals_mask_by_mask(seed: int, threshold: float, config: GateConfig) -> None:
    rng = np.random.default_rng(100 + seed)
    means = rng.uniform(-1.3, 1.3, (160, 3)).astype(np.float32)
    views = _random_views(seed)
    groups, log = bank_reference.associate(means, views, threshold, config)

    bank = MemoryBank.empty(len(means))
    for view in views:
        masks = ViewMasks.of(view.labels)
        bounds = depth_bounds(masks, view.depth, view.alpha, config)
        mask_of = gaussians_of_masks(means, view.camera, masks, bounds)
        bank, _ = add_view(bank, view.camera.name, masks.ids, mask_of, threshold)

    assert list(bank.log) == log
    assert bank.n_groups == len(groups)
    for k, group in enumerate(groups):
        assert set(np.flatnonzero(bank.group == k + 1)) == group
    assert any(d.is_new for d in log)
    assert any(d.group and not d.is_new for d in log)
    assert any(d.group == 0 for d in log)


def _mask_of(*sets: range | list[int], n: int = 100) -> IntArray:
    mask_of = np.zeros(n, np.int32)
    for m, members in enumerate(sets):
        mask_of[list(members)] = m + 1
    return mask_of


def test_greatest_overlaps_are_those_of_a_table_of_all_pairs() -> None:
    """Few Gaussians a mask, so that many counts are equal: then the lower group comes first."""
    rng = np.random.default_rng(0)
    mask_of = rng.integers(0, 300, 2000).astype(np.int32)
    group = (rng.integers(0, 12, 2000) * 7 - 1).astype(np.int32)  # -1 = free, ids with gaps
    mask_of[mask_of == 40] = 0
    table = np.zeros((301, group.max() + 1), np.int64)
    np.add.at(table, (mask_of, np.maximum(group, 0)), 1)
    first, second = two_best(table[1:])
    found, row = Overlaps.of(mask_of, group, 300), np.arange(300)
    assert np.array_equal(found.groups[1:], np.stack([first, second], axis=1))
    expected = np.stack([table[1:][row, first], table[1:][row, second]], axis=1)
    assert np.array_equal(found.counts[1:], np.where(found.groups[1:] > 0, expected, 0))
    assert np.array_equal(found.sizes[1:], table[1:].sum(axis=1))


def test_first_view_opens_a_group_per_mask() -> None:
    bank, groups = add_view(
        MemoryBank.empty(100), "a", np.array([0, 7, 9], np.int32), _mask_of(range(3), [5, 6]), 0.1
    )
    assert groups.tolist() == [0, 1, 2]
    assert [d.mask for d in bank.log] == [7, 9]
    assert bank.group[[0, 2, 5, 6, 50]].tolist() == [1, 1, 2, 2, -1]


def test_threshold_is_inclusive_and_relative_to_the_mask() -> None:
    ids = np.array([0, 1], np.int32)
    bank, _ = add_view(MemoryBank.empty(100), "a", ids, _mask_of(range(90)), 0.1)
    at, _ = add_view(bank, "b", ids, _mask_of([89, *range(91, 100)]), 0.1)  # 1 of 10
    assert (at.log[-1].group, at.log[-1].overlap) == (1, 0.1)
    below, _ = add_view(bank, "b", ids, _mask_of([89, *range(90, 100)]), 0.1)  # 1 of 11
    assert below.log[-1].is_new


def test_ownership_is_exclusive_also_for_a_new_group() -> None:
    ids = np.array([0, 1], np.int32)
    bank, _ = add_view(MemoryBank.empty(100), "a", ids, _mask_of(range(10)), 0.5)
    bank, _ = add_view(bank, "b", ids, _mask_of(range(8, 20)), 0.5)
    assert bank.n_groups == 2
    assert (bank.group[:10] == 1).all()
    assert (bank.group[10:20] == 2).all()


def test_two_masks_of_a_view_may_join_one_group() -> None:
    bank, _ = add_view(
        MemoryBank.empty(100), "a", np.array([0, 1], np.int32), _mask_of(range(20)), 0.1
    )
    bank, groups = add_view(
        bank, "b", np.array([0, 1, 2], np.int32), _mask_of(range(10), range(10, 30)), 0.1
    )
    assert groups.tolist() == [0, 1, 1]
    assert (bank.group[:30] == 1).all()
    assert views_per_group(bank).tolist() == [0, 2]


def test_tie_goes_to_the_older_group_and_the_other_is_runner_up() -> None:
    bank, _ = add_view(
        MemoryBank.empty(100), "a", np.array([0, 1, 2], np.int32), _mask_of([0, 1], [2, 3]), 0.1
    )
    bank, _ = add_view(bank, "b", np.array([0, 1], np.int32), _mask_of([0, 1, 2, 3]), 0.1)
    decision = bank.log[-1]
    assert (decision.group, decision.overlap) == (1, 0.5)
    assert (decision.runner_up, decision.runner_up_overlap) == (2, 0.5)


def test_mask_without_gaussians_gets_no_group_and_wastes_no_id() -> None:
    bank, groups = add_view(
        MemoryBank.empty(10), "a", np.array([0, 1, 2], np.int32), _mask_of([], [4], n=10), 0.1
    )
    assert groups.tolist() == [0, 0, 1]
    assert bank.n_groups == 1
    assert bank.log[0].group == 0
    assert not bank.log[0].is_new


def test_bank_before_is_not_changed() -> None:
    before = MemoryBank.empty(10)
    add_view(before, "a", np.array([0, 1], np.int32), _mask_of([1, 2], n=10), 0.1)
    assert (before.group == -1).all()
    assert before.log == ()


def test_logs_share_entries_and_stay_as_they_were() -> None:
    """Whatever continues a log, even two of its ends, each reads as a tuple would."""
    rng = np.random.default_rng(0)
    decisions = [Decision("a", k, k, True, 0.0, 0, 0.0, 1) for k in range(200)]
    logs, tuples = [DecisionLog.of(())], [tuple[Decision, ...]()]
    for k in range(60):
        at = int(rng.integers(len(logs)))
        more = decisions[3 * k : 3 * k + int(rng.integers(4))]
        logs.append(logs[at].plus(more))
        tuples.append(tuples[at] + tuple(more))
    assert [tuple(log) for log in logs] == tuples
    assert [log[-1:] for log in logs] == [entries[-1:] for entries in tuples]
    assert any(log._entries is other._entries for log, other in pairwise(logs))
    with pytest.raises(IndexError):
        logs[0][0]
