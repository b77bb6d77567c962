"""Moving a mask to another group by hand: what stays, what follows, and that nothing else does."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.associate import AssociateConfig, Association, BankSnapshot, associate_stage
from gaga_core.grouping.bank_file import bank_arrays, bank_of, load_bank, save_bank
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.grouping.repair.reassociate import NEW, NONE, Move, Repair, reassociate_stage
from gaga_core.grouping.repair.view_evidence import Evidence
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.raster.base import Frame
from tests.core.grouping.true_masks import true_map
from tests.scenes import Synthetic, objects_scene

PRESETS = ("paper", "released", "robust")
_FLOOR = 6


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=5, n_cameras=8, seed=4)


def _maps(scene: Synthetic) -> dict[str, IntArray]:
    """True masks; ball 1 is two masks, 1 and 71, in every second view from the third on."""
    maps = {}
    for i, camera in enumerate(scene.cameras):
        labels = true_map(scene, camera)
        if i % 2 == 0 and i > 1:
            rows, columns = np.nonzero(labels == 1)
            right = columns > np.median(columns)
            labels[rows[right], columns[right]] = 71
        maps[camera.name] = labels
    return maps


def _mask_set(maps: dict[str, IntArray]) -> MaskSet:
    return MaskSet({name: partial(maps.__getitem__, name) for name in maps})


@pytest.fixture(scope="module", params=PRESETS)
def made(request: pytest.FixtureRequest, scene: Synthetic) -> tuple[Association, Evidence]:
    config = AssociateConfig.of(request.param)
    masks = _mask_set(_maps(scene))
    stage = associate_stage(scene.gaussians, scene.cameras, masks, choose(), config)
    return run_stage(stage), Evidence.of(scene.gaussians, scene.cameras, masks, config)


def _moved(
    made: tuple[Association, Evidence], move: Move, bank: MemoryBank | None = None
) -> Repair:
    found, evidence = made
    stage = reassociate_stage(
        evidence, bank or found.bank, found.labels, found.confidence, move, choose()
    )
    return run_stage(stage)


def _decision(bank: MemoryBank, view: str, mask: int) -> Decision:
    return next(d for d in bank.log if (d.view, d.mask) == (view, mask))


def test_a_mask_that_goes_where_it_is_changes_nothing(made: tuple[Association, Evidence]) -> None:
    found, _ = made
    for view, mask in (("000.png", 3), ("005.png", 2)):
        group = _decision(found.bank, view, mask).group
        repair = _moved(made, Move(view, mask, group))
        assert repair.n_masks == repair.n_splats == 0
        assert (repair.bank.group == found.bank.group).all()
        plain = [replace(d, by_hand=False) for d in repair.bank.log]
        assert plain == list(found.bank.log)
        assert (repair.labels == found.labels).all()
        assert (repair.confidence == found.confidence).all()
        assert _decision(repair.bank, view, mask).by_hand


def test_the_mask_is_where_it_was_put_and_other_objects_stay(
    made: tuple[Association, Evidence],
) -> None:
    found, _ = made
    view = found.bank.log[-1].view
    source, target = (_decision(found.bank, view, m).group for m in (2, 3))
    repair = _moved(made, Move(view, 2, target))
    assert _decision(repair.bank, view, 2).group == target == repair.group
    assert repair.n_masks >= 1
    others = ~np.isin(found.labels, [source, target])
    assert (repair.labels[others] == found.labels[others]).all()
    assert (repair.confidence[others] == found.confidence[others]).all()
    assert np.isin(repair.labels[~others], [0, source, target]).mean() > 0.97


def test_a_group_of_its_own_has_an_id_that_was_never_used(
    made: tuple[Association, Evidence], scene: Synthetic
) -> None:
    found, evidence = made
    first = found.bank.log[0].view
    repair = _moved(made, Move(first, 4, NEW))
    assert repair.group > max(d.group for d in found.bank.log)
    assert _decision(repair.bank, first, 4).group == repair.group
    # What the mask shows is ball 4, and its masks of all other views follow it.
    masks = [d for d in repair.bank.log if d.mask == 4]
    assert [d.group for d in masks] == [repair.group] * len(evidence.views)
    ball = repair.labels == repair.group
    assert (ball & (scene.labels == 4)).sum() / (ball | (scene.labels == 4)).sum() > 0.8


def test_in_no_group_a_mask_votes_for_none(made: tuple[Association, Evidence]) -> None:
    view = made[0].bank.log[-1].view
    repair = _moved(made, Move(view, 5, NONE))
    assert _decision(repair.bank, view, 5).group == repair.group == 0


def test_decisions_by_hand_outlive_later_repairs(made: tuple[Association, Evidence]) -> None:
    found, _ = made
    last, first = found.bank.log[-1].view, found.bank.log[0].view
    target = _decision(found.bank, last, 3).group
    once = _moved(made, Move(last, 2, target))
    twice = _moved(made, Move(first, 5, NEW), once.bank)
    assert _decision(twice.bank, last, 2).group == target
    assert {(d.view, d.mask) for d in twice.bank.log if d.by_hand} == {(last, 2), (first, 5)}


def test_paper_keeps_everything_before_the_view(scene: Synthetic) -> None:
    config = AssociateConfig.of("paper")
    masks = _mask_set(_maps(scene))
    found = run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose(), config))
    evidence = Evidence.of(scene.gaussians, scene.cameras, masks, config)
    move = Move("004.png", 71, NEW)
    log = list(found.bank.log)
    early = log.index(_decision(found.bank, "001.png", 5))
    other = _decision(found.bank, "001.png", 3).group
    log[early] = replace(log[early], group=other)  # not what would be decided again
    bank = replace(found.bank, log=tuple(log))
    stage = reassociate_stage(evidence, bank, found.labels, found.confidence, move, choose())
    seen = []
    try:
        while True:
            step = next(stage)
            if isinstance(step.payload, BankSnapshot):
                seen.append(step.payload.view)
    except StopIteration as end:
        repair: Repair = end.value
    assert seen == ["004.png", "005.png", "006.png", "007.png"]
    n = sum(d.view < "004.png" for d in bank.log)
    assert repair.bank.log[:n] == bank.log[:n]
    assert repair.bank.log[n:] != bank.log[n:]


def test_groups_that_a_person_made_are_left_alone(
    made: tuple[Association, Evidence],
) -> None:
    found, evidence = made
    last = found.bank.log[-1].view
    source, target = (_decision(found.bank, last, m).group for m in (2, 3))
    labels = found.labels.copy()
    own = np.flatnonzero(labels == source)[::3]
    labels[own] = 900
    stage = reassociate_stage(
        evidence, found.bank, labels, found.confidence, Move(last, 2, target), choose()
    )
    assert (run_stage(stage).labels[own] == 900).all()


def test_views_are_drawn_once(made: tuple[Association, Evidence]) -> None:
    found, evidence = made
    last = found.bank.log[-1].view
    _moved(made, Move(last, 2, NEW))
    kept = {name: bounds.copy() for name, bounds in evidence.bounds.items()}
    assert set(kept) == {camera.name for camera in evidence.views}

    class Blind:
        """Draws no depth: everything that a repair needs of it is known."""

        name, vote, label_splat = "blind", choose().vote, choose().label_splat

        def render(self, *_: object, **__: object) -> Frame:
            raise AssertionError("a view was drawn again")

    stage = reassociate_stage(
        evidence,
        found.bank,
        found.labels,
        found.confidence,
        Move(last, 3, NEW),
        Blind(),  # type: ignore[arg-type]
    )
    run_stage(stage)


def test_views_in_the_order_of_names_are_repaired_as_the_preset_says(
    made: tuple[Association, Evidence], tmp_path: Path
) -> None:
    found, evidence = made
    log = tuple(sorted(found.bank.log, key=lambda d: d.view))
    save_bank(tmp_path / "bank.npz", replace(found.bank, log=log))
    bank = load_bank(tmp_path / "bank.npz")
    assert AssociateConfig.of(bank.preset) == evidence.config
    last = bank.log[-1].view
    redone = _moved(made, Move(last, 2, NEW), bank).bank
    assert redone.preset == bank.preset
    if bank.preset == "robust":  # overlaps are shares of points: those that stay are kept
        assert [d.overlap for d in redone.log if d.view < last] == [
            d.overlap for d in bank.log if d.view < last
        ]


def test_an_older_bank_tells_its_preset_by_the_order_of_its_views(
    made: tuple[Association, Evidence],
) -> None:
    found, evidence = made
    arrays = bank_arrays(found.bank)
    del arrays["preset"]
    older = "robust" if evidence.config.preset == "robust" else "paper"  # there were these two
    assert bank_of(arrays).preset == older
    with pytest.raises(ValueError, match="preset"):
        bank_of({**arrays, "preset": np.array("other")})


def test_an_unknown_mask_is_a_plain_sentence(made: tuple[Association, Evidence]) -> None:
    with pytest.raises(GagaError, match=r"no mask 400 of 000\.png"):
        _moved(made, Move("000.png", 400, NEW))
