"""New views join an associated scene: as if they had come last, without the former ones."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.grouping.add_views import FormerGroups, add_views_stage
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import permuted, true_map
from tests.scenes import Synthetic, objects_scene

_FIRST = 7  # views of 10 that are associated first


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=5, n_cameras=10, seed=4)


def _masks(scene: Synthetic, views: Sequence[Camera], *, hides: int = 0) -> MaskSet:
    """True masks under random ids; of the first views without those of one object."""
    maps = {}
    for i, camera in enumerate(scene.cameras):
        labels = true_map(scene, camera)
        if i < _FIRST:
            labels[labels == hides] = 0
        maps[camera.name] = permuted(labels, i)
    return MaskSet({c.name: partial(maps.__getitem__, c.name) for c in views})


def _config(preset: str) -> AssociateConfig:
    """The preset as it is with many views: with few, surfaces find an object that has no masks."""
    return replace(AssociateConfig.of(preset), surfaces=None)


def _associate(scene: Synthetic, masks: MaskSet, preset: str) -> Association:
    config = _config(preset)
    return run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose(), config))


def _add(scene: Synthetic, masks: MaskSet, first: Association) -> Association:
    assert first.weight is not None
    former = FormerGroups(first.bank, first.labels, first.confidence, first.weight)
    config = _config(first.bank.preset)
    return run_stage(
        add_views_stage(scene.gaussians, scene.cameras, masks, former, choose(), config)
    )


def test_the_paper_s_bank_is_the_one_of_all_views(scene: Synthetic) -> None:
    whole = _associate(scene, _masks(scene, scene.cameras), "paper")
    first = _associate(scene, _masks(scene, scene.cameras[:_FIRST]), "paper")
    added = _add(scene, _masks(scene, scene.cameras), first)
    assert added.bank.log == whole.bank.log
    assert np.array_equal(added.bank.group, whole.bank.group)
    assert (added.labels == whole.labels).mean() > 0.99


def test_robust_groups_take_new_masks_and_find_new_objects(scene: Synthetic) -> None:
    whole = _associate(scene, _masks(scene, scene.cameras), "robust")
    first = _associate(scene, _masks(scene, scene.cameras[:_FIRST], hides=3), "robust")
    added = _add(scene, _masks(scene, scene.cameras, hides=3), first)
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
    new = {c.name for c in scene.cameras[_FIRST:]}
    assert {d.view for d in added.bank.log if d.is_new and d.group > first.bank.n_groups} <= new


def test_nothing_to_add_is_said(scene: Synthetic) -> None:
    masks = _masks(scene, scene.cameras[:2])
    first = _associate(scene, masks, "paper")
    with pytest.raises(GagaError, match="took part already"):
        _add(scene, masks, first)
    name = scene.cameras[2].name  # a photo in which nothing was found
    empty = np.zeros((scene.cameras[2].height, scene.cameras[2].width), np.int32)
    blank = MaskSet({**masks.loaders, name: lambda: empty})
    with pytest.raises(GagaError, match="took part already"):
        _add(scene, blank, first)
    regions = MaskSet(_masks(scene, scene.cameras[:3]).loaders, are_regions=True)
    with pytest.raises(GagaError, match="levels of detail"):
        _add(scene, regions, first)
