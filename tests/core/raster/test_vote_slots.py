"""Votes of many labels in a few slots of each Gaussian: the sums of a table, while they fit."""

import numpy as np
import pytest

from gaga_core.arrays import FloatArray
from gaga_core.raster import choose
from gaga_core.raster.reference import ReferenceRasterizer
from gaga_core.raster.vote_slots import VoteSlots
from tests.scenes import orbit_cameras, random_gaussians


def _table(slots: VoteSlots, n_labels: int) -> FloatArray:
    """The same sums as a table."""
    table = np.zeros((len(slots), n_labels), np.float32)
    rows, columns = np.nonzero(slots.labels >= 0)
    table[rows, slots.labels[rows, columns]] = slots.weights[rows, columns]
    return table


def test_slots_hold_what_a_table_holds_bit_for_bit() -> None:
    gaussians = random_gaussians(300, seed=3)
    table, slots = np.zeros((300, 12), np.float32), VoteSlots.empty(300)
    rng = np.random.default_rng(1)
    for camera in orbit_cameras(3, width=48, height=40):
        labels = rng.integers(-1, 12, (5, 6)).repeat(8, 0).repeat(8, 1).astype(np.int32)
        choose("cpu").vote(gaussians, camera, labels, table)
        choose("cpu").vote(gaussians, camera, labels, slots)
    assert (table > 0).sum(axis=1).max() > 5
    assert np.array_equal(_table(slots, 12), table)
    assert not slots.lost.any()
    label, best, total = slots.winners()
    assert np.array_equal(label, np.where(table.any(axis=1), table.argmax(axis=1), -1))
    assert np.array_equal(best, table.max(axis=1))
    np.testing.assert_allclose(total, table.sum(axis=1), rtol=1e-6)


def test_the_backends_agree() -> None:
    gaussians, camera = random_gaussians(40, seed=5), orbit_cameras(1, width=20, height=16)[0]
    labels = (np.arange(320, dtype=np.int32) // 40).reshape(16, 20)
    found = []
    for engine in (choose("cpu"), ReferenceRasterizer()):
        slots = VoteSlots.empty(40)
        engine.vote(gaussians, camera, labels, slots)
        found.append(_table(slots, 8))
    np.testing.assert_allclose(found[0], found[1], atol=1e-4)


def test_what_finds_no_slot_is_lost_but_counted_and_large_sums_stay() -> None:
    slots = VoteSlots.empty(1, n_slots=2)
    row = np.zeros(1, np.int32)
    for label, weight in ((7, 5.0), (3, 1.0), (4, 0.5), (9, 2.0), (7, 1.0), (4, 0.25)):
        slots.add(row, np.array([label], np.int32), np.array([[weight]], np.float32))
    labels, best, total = slots.winners()
    assert (labels[0], best[0], total[0]) == (7, 6.0, 9.75)
    assert slots.lost[0] == pytest.approx(1.75)  # of 3, that 9 replaced, and of 4 twice
    slots.add_one(row, np.array([9], np.int32))
    assert sorted(slots.weights[0].tolist()) == [3.0, 6.0]


def test_of_equal_sums_the_lower_label_wins() -> None:
    slots = VoteSlots.empty(2)
    for label in (5, 2):
        slots.add_one(np.array([1], np.int32), np.array([label], np.int32))
    assert slots.winners()[0].tolist() == [-1, 2]
