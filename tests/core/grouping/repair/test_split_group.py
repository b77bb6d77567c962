"""A group that holds two things is taken apart by the masks that joined it."""

from functools import partial
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.grouping.repair.split_group import split_bank, split_group_stage, two_sides
from gaga_core.grouping.repair.view_evidence import Evidence
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import true_map
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=5, n_cameras=8, seed=4)


def _masks(scene: Synthetic, *, merged: tuple[int, ...]) -> MaskSet:
    """True masks, balls 1 and 2 being one mask in some views."""
    maps: dict[str, IntArray] = {}
    for i, camera in enumerate(scene.cameras):
        labels = true_map(scene, camera)
        if i in merged:
            labels[labels == 2] = 1
        maps[camera.name] = labels
    return MaskSet({name: partial(maps.__getitem__, name) for name in maps})


@pytest.mark.parametrize("preset", ["paper", "robust"])
def test_a_group_that_a_merged_mask_opened_falls_into_its_two_things(
    scene: Synthetic, preset: str
) -> None:
    masks, config = _masks(scene, merged=(0, 5)), AssociateConfig.of(preset)
    found = run_stage(
        associate_stage(scene.gaussians, scene.cameras, masks, choose(), AssociateConfig())
    )
    group = next(d.group for d in found.bank.log if d.mask == 1)
    assert {d.group for d in found.bank.log if d.mask == 2} == {group}  # both are in it
    log = [d for d in found.bank.log if d.group == group]
    rows = np.flatnonzero(found.labels == group).astype(np.int32)
    evidence = Evidence.of(scene.gaussians, scene.cameras, masks, config)
    split = run_stage(split_group_stage(evidence, log, rows, choose()))
    second = np.isin(rows, split.rows)
    truth = scene.labels[rows] == scene.labels[rows[second]][0]
    assert (second == truth).mean() > 0.95
    ids = {mask for _, mask in split.masks}
    assert len(ids) == 1  # of one ball alone
    assert all(view not in ("000.png", "005.png") for view, _ in split.masks)
    bank = split_bank(found.bank, split, group, 40)
    moved = {(d.view, d.mask) for d in bank.log if d.group == 40}
    assert moved == set(split.masks)
    assert bank.n_groups == 40
    assert sum(d.is_new for d in bank.log if d.group == 40) == 1
    assert (
        (bank.group == 40)
        == np.isin(np.arange(len(bank.group)), split.rows) & (found.bank.group == group)
    ).all()


def test_one_thing_stays_one(scene: Synthetic) -> None:
    masks, config = _masks(scene, merged=()), AssociateConfig.of("paper")
    found = run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose(), config))
    evidence = Evidence.of(scene.gaussians, scene.cameras, masks, config)
    log = [d for d in found.bank.log if d.group == 3]
    rows = np.flatnonzero(found.labels == 3).astype(np.int32)
    with pytest.raises(GagaError, match="in one piece"):
        run_stage(split_group_stage(evidence, log, rows, choose(), name="mug"))
    with pytest.raises(GagaError, match="too few masks"):
        run_stage(split_group_stage(evidence, log[:1], rows, choose()))


def test_merged_masks_are_silent() -> None:
    """Four masks of the left half, three of the right one, two of both."""
    covers = np.zeros((9, 100), np.bool_)
    covers[:4, :60], covers[4:7, 60:], covers[7:] = True, True, True
    sees = covers.copy()
    side = two_sides(covers, sees)
    assert side is not None
    assert (side[:4] == side[0]).all()
    assert (side[4:7] == -side[0]).all()
    assert (side[7:] == 0).all()


@pytest.mark.parametrize("sizes", [(3, 4), (2, 3, 4), (3, 3, 2, 5)])
def test_the_order_of_masks_does_not_move_the_cut(sizes: tuple[int, ...]) -> None:
    """Of three things or more, any cut between two of them is a second eigenvector."""
    thing = np.repeat(np.arange(len(sizes)), sizes)
    covers = thing[:, None] == np.repeat(np.arange(len(sizes)), 30)
    first = two_sides(covers, covers)
    assert first is not None
    for seed in range(20):
        order = np.random.default_rng(seed).permutation(len(thing))
        side = two_sides(covers[order], covers[order])
        assert side is not None
        np.testing.assert_array_equal(side * side[order == 0], (first * first[0])[order])


def test_what_a_view_does_not_see_does_not_tell_its_masks_apart() -> None:
    """A thing seen from two sides that share a rim is one thing."""
    covers = np.zeros((6, 100), np.bool_)
    covers[:3, :60], covers[3:, 40:] = True, True
    assert two_sides(covers, covers.copy()) is None


def test_masks_that_show_one_thing_have_no_sides() -> None:
    """Any cut of them is as good as any other: the eigenvector says nothing, whatever it is."""
    for seed in range(20):
        covers = np.random.default_rng(seed).random((8, 400)) > 0.05
        assert two_sides(covers, np.ones_like(covers)) is None


@pytest.mark.parametrize("sizes", [(3, 3), (4, 3), (2, 2, 2), (3, 3, 3, 3)])
def test_sides_do_not_follow_the_choice_of_eigenvectors(
    sizes: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another LAPACK gives other signs, another basis where eigenvalues are equal, and noise."""
    thing = np.repeat(np.arange(len(sizes)), sizes)
    covers = thing[:, None] == np.repeat(np.arange(len(sizes)), 30)
    covers[0, 30:40] = True  # a mask of both
    eigh, here = np.linalg.eigh, two_sides(covers, np.ones_like(covers))
    assert here is not None
    for seed in range(10):
        rng = np.random.default_rng(seed)

        def other(matrix: DoubleArray, rng: np.random.Generator = rng) -> Any:
            values, vectors = eigh(matrix + rng.normal(0, 1e-15, matrix.shape))
            vectors = vectors * rng.choice([-1.0, 1.0], len(values))
            for start in np.flatnonzero(np.diff(values, prepend=-np.inf) > 1e-9):
                same = np.flatnonzero(np.abs(values - values[start]) < 1e-9)
                turn = np.linalg.qr(rng.normal(size=(len(same), len(same))))[0]
                vectors[:, same] = vectors[:, same] @ turn
            return values, vectors

        monkeypatch.setattr(np.linalg, "eigh", other)
        there = two_sides(covers, np.ones_like(covers))
        assert there is not None
        np.testing.assert_array_equal(there, here)
