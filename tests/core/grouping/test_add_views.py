"""New views join an associated scene: as if they had come last, without the former ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.grouping import add_views
from gaga_core.grouping.add_views import FormerGroups
from gaga_core.grouping.gate import GateConfig
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.grouping.robust.consensus import ConsensusConfig
from gaga_core.grouping.views import GatedViews
from gaga_core.grouping.votes import VoteSums
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.joined_views import FIRST, add, associate, true_masks
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=5, n_cameras=10, seed=4)


@pytest.mark.parametrize("preset", ["paper", "released"])
def test_a_published_bank_is_the_one_of_all_views(scene: Synthetic, preset: str) -> None:
    whole = associate(scene, true_masks(scene, scene.cameras), preset)
    first = associate(scene, true_masks(scene, scene.cameras[:FIRST]), preset)
    added = add(scene, true_masks(scene, scene.cameras), first)
    assert added.bank.log == whole.bank.log
    assert np.array_equal(added.bank.group, whole.bank.group)
    assert np.array_equal(added.bank.shared, whole.bank.shared)
    assert (added.labels == whole.labels).mean() > 0.99


def test_robust_groups_take_new_masks_and_find_new_objects(scene: Synthetic) -> None:
    whole = associate(scene, true_masks(scene, scene.cameras), "robust")
    first = associate(scene, true_masks(scene, scene.cameras[:FIRST], hides=3), "robust")
    added = add(scene, true_masks(scene, scene.cameras, hides=3), first)
    assert added.bank.log[: len(first.bank.log)] == first.bank.log
    assert added.bank.n_groups == first.bank.n_groups + 1 == whole.bank.n_groups
    drawn = added.confidence > 0
    for k in range(1, 6):  # every ball is one group, the new one a new group
        own = added.labels[drawn & (scene.labels == k)]
        group = int(np.bincount(own).argmax())
        assert (own == group).mean() > 0.9
        assert (group > first.bank.n_groups) == (k == 3)
        of_group = scene.labels[drawn & (added.labels == group)]
        assert (of_group == k).mean() > 0.95
    new = {c.name for c in scene.cameras[FIRST:]}
    assert {d.view for d in added.bank.log if d.is_new and d.group > first.bank.n_groups} <= new


def test_nothing_to_add_is_said(scene: Synthetic) -> None:
    masks = true_masks(scene, scene.cameras[:2])
    first = associate(scene, masks, "paper")
    with pytest.raises(GagaError, match="are used already"):
        add(scene, masks, first)
    name = scene.cameras[2].name  # a photo in which nothing was found
    empty = np.zeros((scene.cameras[2].height, scene.cameras[2].width), np.int32)
    blank = MaskSet({**masks.loaders, name: lambda: empty})
    with pytest.raises(GagaError, match="are used already"):
        add(scene, blank, first)
    regions = MaskSet(true_masks(scene, scene.cameras[:3]).loaders, are_regions=True)
    with pytest.raises(GagaError, match="levels of detail"):
        add(scene, regions, first)


def test_what_few_views_see_needs_few_votes_to_be_known(scene: Synthetic) -> None:
    """One of ten new views sees the scene, so some four of forty former ones did: the weight of
    most of one view is enough. Where all new views see it, forty former ones must say more."""
    seeing = scene.cameras[0]
    away = np.diag([-1.0, 1.0, -1.0, 1.0])  # half a turn
    turned = replace(seeing, cam_from_world=away @ seeing.cam_from_world)
    weight = np.zeros((len(scene.gaussians), 1), np.float32)
    whole = np.zeros((seeing.height, seeing.width), np.int32)
    choose("cpu").vote(scene.gaussians, seeing, whole, weight)
    log = tuple(Decision(f"former {i}", 1, 1, i == 0, 1.0, 0, 0.0, 9) for i in range(40))
    labels = np.ones(len(weight), np.int32)
    former = FormerGroups(
        MemoryBank(labels, 1, log, preset="robust"),
        labels,
        np.ones(len(weight), np.float32),
        0.8 * weight[:, 0],
    )

    def known(views: list[Camera]) -> float:
        gated = GatedViews(scene.gaussians, views, MaskSet({}), GateConfig(), "median")
        seen = run_stage(add_views._seen_labels(gated, former, choose("cpu")))
        return float((seen[weight[:, 0] > 0] > 0).mean())

    assert known([seeing] + [turned] * 9) == 1
    assert known([seeing] * 10) == 0


def test_a_mask_is_of_several_things_if_it_shows_smaller_ones_not_the_floor_at_its_rim() -> None:
    """Floor 1 and boxes 2 to 5: the floor's mask, a box with floor at its rim, two boxes in one
    mask, a box that shows little of another."""
    pixels = csr_matrix(
        [
            [0, 0, 0, 0, 0, 0],
            [0, 800, 50, 50, 50, 50],
            [0, 90, 200, 0, 0, 0],
            [0, 0, 0, 100, 60, 0],
            [0, 0, 0, 0, 10, 200],
        ]
    )
    assert add_views._of_several(pixels, ConsensusConfig()).tolist() == [1, 3]


@pytest.mark.parametrize("histogram_bytes", [1 << 20, 1])
def test_where_two_labels_meet_votes_add_up_as_those_of_all_views_at_once(
    histogram_bytes: int,
) -> None:
    """Former views know the winner's votes and the sum alone; two labels vote for each splat."""
    rng = np.random.default_rng(0)
    before, later = rng.random((2, 200, 2)).astype(np.float32)
    former_labels = (before.argmax(axis=1) + 1).astype(np.int32)
    best, weight = before.max(axis=1), before.sum(axis=1)
    bank = MemoryBank(former_labels, 2, (), preset="robust")
    former = FormerGroups(bank, former_labels, best / weight, weight)
    sums = VoteSums.started(former_labels, best, 2, histogram_bytes)
    rows, columns = np.arange(200, dtype=np.int32), np.arange(2, dtype=np.int32)
    if isinstance(sums.sums, np.ndarray):
        sums.sums[:] += later
    else:
        sums.sums.add(rows, columns, later)
    votes = add_views._with_rivals(sums, former, best)
    found = add_views._with_former(former, votes, best)
    whole = before + later
    assert (former_labels != whole.argmax(axis=1) + 1).sum() > 20
    assert np.array_equal(found.labels, whole.argmax(axis=1) + 1)
    np.testing.assert_allclose(found.weight, whole.sum(axis=1), rtol=1e-5)
    share = whole.max(axis=1) / whole.sum(axis=1)
    np.testing.assert_allclose(found.confidence, share, rtol=1e-5)
