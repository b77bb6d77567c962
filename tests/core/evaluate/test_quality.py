"""Agreement of groups with the masks that made them, and confidence of splats."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.evaluate.quality import compared, quality_stage
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.grouping.repair.view_evidence import Evidence
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import confidence_histogram, uncertain
from gaga_core.scene.scene import Scene
from tests.core.grouping.true_masks import masks_of
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=5, n_cameras=6, seed=4)


@pytest.fixture(scope="module")
def found(scene: Synthetic) -> Association:
    config = AssociateConfig.of("robust")
    masks = masks_of(scene, scene.cameras)
    return run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose(), config))


def _evidence(scene: Synthetic) -> Evidence:
    masks = masks_of(scene, scene.cameras)
    return Evidence.of(scene.gaussians, scene.cameras, masks, AssociateConfig.of("robust"))


def test_agreement_is_the_iou_of_plain_loops() -> None:
    rng = np.random.default_rng(0)
    own, shown = rng.integers(0, 5, (2, 30, 40)).astype(np.int32)
    own[own == 3] = 0  # a group without a mask here says nothing
    result = compared("a", own, shown)
    assert set(result) == {1, 2, 4}
    for group, one in result.items():
        a, b = own == group, shown == group
        assert one.agreement == pytest.approx((a & b).sum() / (a | b).sum())
        assert (one.n_mask, one.n_shown) == (a.sum(), b.sum())


def test_true_groups_agree_and_a_spoilt_one_is_found(scene: Synthetic, found: Association) -> None:
    evidence = _evidence(scene)

    def measure(labels: np.ndarray) -> dict[int, float]:
        stage = quality_stage(evidence, found.bank, labels, found.confidence, choose())
        result = run_stage(stage)
        assert all(len(one.views) == len(scene.cameras) for one in result.groups.values())
        for one in result.groups.values():
            values = [view.agreement for view in one.views]
            assert values == sorted(values)
            assert one.agreement == pytest.approx(np.mean(values))
        return {group: one.agreement for group, one in result.groups.items()}

    good = measure(found.labels)
    assert len(good) == 6
    assert min(good.values()) > 0.7
    spoilt = found.labels.copy()
    half = np.flatnonzero(spoilt == 2)[::2]
    spoilt[half] = 3
    bad = measure(spoilt)
    assert bad[2] < good[2] - 0.2
    assert bad[1] == pytest.approx(good[1], abs=0.05)


def test_small_pictures_say_the_same(scene: Synthetic, found: Association) -> None:
    evidence = _evidence(scene)
    large, small = (
        run_stage(quality_stage(evidence, found.bank, found.labels, None, choose(), side=side))
        for side in (160, 120)
    )
    ids = np.array(sorted(large.groups), np.int32)
    np.testing.assert_allclose(large.agreement(ids), small.agreement(ids), atol=0.1)
    assert large.agreement(np.array([99], np.int32)).tolist() == [-1.0]


def test_uncertain_splats_are_those_below(scene: Synthetic, found: Association) -> None:
    opened = Scene.of(scene.gaussians)
    rows = np.flatnonzero(scene.labels == 2).astype(np.int32)
    assert confidence_histogram(opened, rows) is None
    with pytest.raises(GagaError, match="not known"):
        uncertain(opened, rows, 0.5)
    history = History(opened)
    history.do(edits.set_grouping(opened, found.labels, found.bank, confidence=found.confidence))
    histogram = confidence_histogram(opened, rows)
    assert histogram is not None
    mean, counts = histogram
    assert counts.sum() == len(rows)
    column = opened.confidence_of()
    assert column is not None
    assert mean == pytest.approx(column[rows].mean() / 255)
    chosen = uncertain(opened, rows, 0.5)
    assert set(chosen) == {i for i in rows if column[i] / 255 < 0.5}
    assert len(uncertain(opened, rows, 0.0)) == 0
    history.do(edits.lock(opened, rows))
    assert len(uncertain(opened, rows, 1.0)) == 0
    copied = replace(opened)
    assert copied.confidence is opened.confidence
