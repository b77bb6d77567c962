"""Pixels that are right, wrong, missing or void, whatever the ids are called."""

import numpy as np
import pytest

from gaga_core.evaluate.photo_film import Verdict, error_map


def _maps(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = np.kron(rng.integers(0, 5, (4, 6)), np.ones((8, 8), int)).astype(np.int32)
    return truth, rng.permutation(np.arange(1, 60))[:5].astype(np.int32)


@pytest.mark.parametrize("seed", range(4))
def test_truth_under_other_names_is_right_everywhere(seed: int) -> None:
    truth, names = _maps(seed)
    found = error_map(names[truth], truth)  # what is void has a group, too: that is no error
    assert np.array_equal(found.verdicts, np.where(truth > 0, Verdict.RIGHT, Verdict.VOID))
    assert found.share_right == 1.0
    assert found.group_of == {int(t): int(names[t]) for t in np.unique(truth[truth > 0])}


@pytest.mark.parametrize("seed", range(4))
def test_each_damage_is_named(seed: int) -> None:
    truth, names = _maps(seed)
    groups = names[truth]
    places = np.argwhere(truth > 0)
    missing, wrong = places[:5], places[-5:]
    groups[tuple(missing.T)] = 0
    groups[tuple(wrong.T)] = 77
    found = error_map(groups, truth)
    assert (found.verdicts[tuple(missing.T)] == Verdict.MISSING).all()
    assert (found.verdicts[tuple(wrong.T)] == Verdict.WRONG).all()
    n = (truth > 0).sum()
    assert found.share_right == pytest.approx((n - 10) / n)


def test_one_group_stands_for_one_object() -> None:
    truth = np.repeat([[1, 1, 2]], 3, axis=0).astype(np.int32)
    found = error_map(np.full_like(truth, 9), truth)
    assert found.group_of == {1: 9}
    assert found.share_right == pytest.approx(2 / 3)


def test_a_view_without_objects_has_no_errors() -> None:
    empty = np.zeros((3, 4), np.int32)
    assert error_map(empty + 3, empty).share_right == 1.0
    assert error_map(empty, empty).group_of == {}
