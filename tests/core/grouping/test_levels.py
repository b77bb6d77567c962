"""Levels of detail: each refines the one before, and ids stay with the largest part."""

from itertools import pairwise

import numpy as np
import pytest

from gaga_core.arrays import MOST_GROUP
from gaga_core.grouping.bank_file import bank_arrays, bank_of
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import Decision, MemoryBank, at_level


def _levels() -> Levels:
    rng = np.random.default_rng(0)
    fine = rng.integers(0, 24, 500)
    nested = np.stack([fine // 12, fine // 6, fine // 2, fine]) * 7 + 3
    return Levels.of(nested, 1, (fine >= 18).astype(np.int64))


def test_every_level_is_a_partition_that_the_next_one_refines() -> None:
    labels = _levels().labels
    for coarse, fine in pairwise(labels):
        assert set(np.unique(coarse)) == set(range(1, coarse.max() + 1))
        for group in np.unique(fine):
            assert len(np.unique(coarse[fine == group])) == 1


def test_the_largest_part_keeps_the_id() -> None:
    labels = _levels().labels
    for coarse, fine in pairwise(labels):
        for group in np.unique(coarse):
            parts, sizes = np.unique(fine[coarse == group], return_counts=True)
            assert group in parts[sizes == sizes.max()]


def test_clusters_that_are_not_nested_are_refused() -> None:
    with pytest.raises(ValueError, match="level 1 does not refine"):
        Levels.of(np.array([[0, 0, 1, 1], [0, 1, 1, 2]]), 0, np.zeros(4, np.int64))


def test_detail_chooses_a_level() -> None:
    levels = _levels()
    assert levels.chosen == 1
    found = [levels.at(d) for d in (-1.0, 0.0, 0.2, 0.3, 0.5, 0.6, 0.76, 1.0, 2.0)]
    assert found == [0, 0, 0, 1, 1, 1, 2, 3, 3]
    assert levels.choose(0.76).chosen == 2


def test_a_bank_keeps_its_levels_on_disk_and_older_banks_have_none() -> None:
    levels = _levels()
    bank = MemoryBank(levels.labels[1], int(levels.labels[1].max()), preset="robust", levels=levels)
    again = bank_of(bank_arrays(bank)).levels
    assert again is not None
    assert np.array_equal(again.labels, levels.labels)
    assert (again.chosen, again.background) == (levels.chosen, levels.background)
    older = MemoryBank(levels.labels[1], bank.n_groups, preset="robust")
    assert not any(name.startswith("levels") for name in bank_arrays(older))
    assert bank_of(bank_arrays(older)).levels is None


def test_levels_of_other_gaussians_are_refused() -> None:
    levels = _levels()
    arrays = bank_arrays(MemoryBank(levels.labels[1], 4, preset="robust", levels=levels))
    with pytest.raises(ValueError, match="levels"):
        bank_of(arrays | {"levels": levels.labels[:, 1:]})


def test_levels_around_groups_keep_their_ids() -> None:
    """Also ids with gaps, and those of a level that was chosen: the largest names what joins."""
    rng = np.random.default_rng(1)
    fine = rng.integers(0, 24, 500)
    nested = np.stack([fine // 12, fine // 6, fine // 2, fine]) + 5
    labels = np.array([9, 2, 5, 4], np.int32)[fine // 6]
    nested[:, :20], labels[:20] = -1, 0
    levels = Levels.around(nested, labels, 1)
    assert np.array_equal(levels.labels[1], labels)
    for coarse, finer in pairwise(levels.labels):
        for group in np.unique(finer):
            assert len(np.unique(coarse[finer == group])) == 1
        for group in np.unique(coarse):
            parts, sizes = np.unique(finer[coarse == group], return_counts=True)
            assert group in parts[sizes == sizes.max()]
    assert [len(np.unique(level[level > 0])) for level in levels.labels] == [2, 4, 12, 24]
    with pytest.raises(ValueError, match="does not refine"):
        Levels.around(np.array([[0, 1, 0], [0, 0, 1]]), np.array([1, 1, 2], np.int32), 1)
    with pytest.raises(ValueError, match="does not refine"):
        Levels.around(np.array([[0, 0, 1], [0, 1, 1]]), np.array([1, 1, 2], np.int32), 0)


@pytest.mark.parametrize("top", [24, MOST_GROUP])
def test_masks_go_where_most_of_their_group_goes_whatever_the_ids(top: int) -> None:
    levels, rng = _levels(), np.random.default_rng(1)
    group = rng.integers(-1, 24, 500).astype(np.int32)
    labels = rng.integers(0, 5, 500).astype(np.int32)  # ties among them: the lower label wins
    group[group == 23], labels[labels == 4] = top, top
    levels = Levels(np.stack([labels, levels.labels[1]]), 1)
    log = [Decision("a", i, int(g), True, 1.0, 0, 0.0, 5) for i, g in enumerate({*range(24), top})]
    found = at_level(MemoryBank(group, top, log, preset="paper", levels=levels), 0)
    for before, after in zip(log, found.log, strict=True):
        own = labels[(group == before.group) & (labels > 0)] if before.group else []
        names, counts = np.unique(own, return_counts=True)
        assert after.group == (names[counts.argmax()] if len(names) else 0)
