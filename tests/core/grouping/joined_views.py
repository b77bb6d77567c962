"""Groups of a scene's first views, and what joins them: shared by the tests of adding views."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from gaga_core.camera import Camera
from gaga_core.grouping.add_views import FormerGroups, add_views_stage
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import permuted, true_map
from tests.scenes import Synthetic

FIRST = 7  # views of 10 that are associated first


def true_masks(scene: Synthetic, views: Sequence[Camera], *, hides: int = 0) -> MaskSet:
    """True masks under random ids; of the first views without those of one object."""
    maps = {}
    for i, camera in enumerate(scene.cameras):
        labels = true_map(scene, camera)
        if i < FIRST:
            labels[labels == hides] = 0
        maps[camera.name] = permuted(labels, i)
    return MaskSet({c.name: partial(maps.__getitem__, c.name) for c in views})


def config_of(preset: str) -> AssociateConfig:
    """The preset as it is with many views: with few, surfaces find an object that has no masks."""
    return replace(AssociateConfig.of(preset), surfaces=None)


def associate(scene: Synthetic, masks: MaskSet, preset: str) -> Association:
    config = config_of(preset)
    return run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose(), config))


def add(scene: Synthetic, masks: MaskSet, first: Association) -> Association:
    assert first.weight is not None
    former = FormerGroups(first.bank, first.labels, first.confidence, first.weight)
    config = config_of(first.bank.preset)
    return run_stage(
        add_views_stage(scene.gaussians, scene.cameras, masks, former, choose(), config)
    )
