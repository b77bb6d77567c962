"""Objects of regions: balls on a floor come out whole from masks that cut each of them in two."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats, quats_to_matrices
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.grouping.surfaces.objects import HierarchyConfig
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.training.optimizer import concatenate
from tests.scenes import Synthetic, objects_scene

_BALLS = 6


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(_BALLS, 900, n_cameras=12)


@pytest.fixture(scope="module")
def found(scene: Synthetic) -> Association:
    return _found(scene.gaussians, scene.cameras, _masks(scene))


def _masks(scene: Synthetic) -> dict[str, IntArray]:
    """True maps in which every thing is cut at its middle column, another one in each view."""
    cut = {}
    for i, camera in enumerate(scene.cameras):
        true = choose("cpu").label_splat(scene.gaussians, camera, scene.labels + 1).labels
        columns = np.broadcast_to(np.arange(camera.width), true.shape)
        middle = np.zeros(_BALLS + 2)
        for k in np.unique(true):
            middle[k] = np.quantile(columns[true == k], 0.3 + 0.4 * (i % 3) / 2)
        right = (columns > middle[true]) & (true > 1)
        cut[camera.name] = np.where(true > 0, 2 * true + right, 0).astype(np.int32)
    return cut


def _found(
    gaussians: Gaussians,
    cameras: tuple[Camera, ...],
    maps: dict[str, IntArray],
    config: HierarchyConfig | None = None,
    *,
    are_regions: bool = True,
    further: dict[str, list[IntArray]] | None = None,
) -> Association:
    masks = MaskSet(
        {name: partial(maps.__getitem__, name) for name in maps},
        are_regions=are_regions,
        further={name: partial((further or {}).__getitem__, name) for name in further or {}},
    )
    robust = AssociateConfig.of("robust")
    robust = replace(robust, hierarchy=config or robust.hierarchy)
    return run_stage(associate_stage(gaussians, cameras, masks, choose("cpu"), robust))


def _best_ious(truth: IntArray, labels: IntArray) -> list[float]:
    """Of each ball with the group that covers it best."""
    found = []
    for ball in range(1, _BALLS + 1):
        own = truth == ball
        groups = np.unique(labels[own])
        ious = [(own & (labels == g)).sum() / (own | (labels == g)).sum() for g in groups if g > 0]
        found.append(float(max(ious, default=0.0)))
    return found


def _rotated(scene: Synthetic, rotation: DoubleArray, scale: float) -> Synthetic:
    """The scene turned and scaled, seen by the same views."""
    g = scene.gaussians
    axes = rotation @ quats_to_matrices(g.quats)
    moved = replace(
        g,
        means=(scale * g.means @ rotation.T).astype(np.float32),
        quats=matrices_to_quats(axes).astype(np.float32),
        log_scales=(g.log_scales + np.log(scale)).astype(np.float32),
    )
    cameras = []
    for camera in scene.cameras:
        pose = camera.cam_from_world.copy()
        pose[:3, :3] = pose[:3, :3] @ rotation.T
        pose[:3, 3] *= scale
        cameras.append(replace(camera, cam_from_world=pose))
    return Synthetic(moved, scene.labels, tuple(cameras))


def _agreement(one: IntArray, other: IntArray) -> float:
    """Share of the Gaussians in pairs of groups that are each other's best match."""
    table = np.zeros((one.max() + 1, other.max() + 1))
    np.add.at(table, (one, other), 1)
    mutual = (table == table.max(axis=0)) & (table == table.max(axis=1)[:, None])
    return float(table[mutual].sum() / len(one))


def test_each_ball_is_one_object(scene: Synthetic, found: Association) -> None:
    ious = _best_ious(scene.labels, found.labels)
    assert min(ious) > 0.85
    of_balls = np.unique(found.labels[scene.labels > 0])
    assert len(of_balls) <= _BALLS + 2  # floor and rest take some of their lowest splats


def test_a_few_large_splats_are_no_object(scene: Synthetic) -> None:
    """Trainings of few photos leave the sky to a handful of splats: nobody edits these."""
    g = scene.gaussians
    means = g.means[:3].copy()
    means[:] = g.means.mean(axis=0) + np.array([[0, 0, 1.5], [0.1, 0, 1.5], [0, 0.1, 1.5]])
    sky = replace(g.take(np.arange(3)), means=means, log_scales=np.full((3, 3), -1.5, np.float32))
    all_splats = concatenate(g, sky)
    labels = np.r_[scene.labels, np.full(3, _BALLS + 1, np.int32)]
    engine = choose("cpu")
    maps = {
        camera.name: engine.label_splat(all_splats, camera, labels + 1).labels
        for camera in scene.cameras
    }

    found = _found(all_splats, scene.cameras, maps, HierarchyConfig(background=False))
    assert found.bank.levels is not None
    assert set(found.labels[-3:].tolist()) == {found.bank.levels.background}


def test_print_does_not_split(scene: Synthetic) -> None:
    """All views part each ball and the floor where one half has another color."""
    means = scene.gaussians.means
    middle = np.array([means[scene.labels == k, 0].mean() for k in range(_BALLS + 1)])
    printed = 2 * scene.labels + (means[:, 0] > middle[scene.labels]) + 1
    engine = choose("cpu")
    maps = {
        camera.name: engine.label_splat(scene.gaussians, camera, printed.astype(np.int32)).labels
        for camera in scene.cameras
    }
    found = _found(scene.gaussians, scene.cameras, maps)
    assert min(_best_ious(scene.labels, found.labels)) > 0.85
    floor = np.bincount(found.labels[scene.labels == 0])
    assert floor.max() > 0.9 * floor.sum()


def test_other_levels_of_detail_of_the_masks_count(scene: Synthetic) -> None:
    maps = _masks(scene)
    everything = {name: np.ones_like(labels) for name, labels in maps.items()}
    half = {name: np.ascontiguousarray(labels[::2, ::2]) for name, labels in maps.items()}
    finer = {name: [maps[name], half[name]] for name in maps}
    found = _found(scene.gaussians, scene.cameras, everything, further=finer)
    assert min(_best_ious(scene.labels, found.labels)) > 0.85
    alone = _found(scene.gaussians, scene.cameras, everything)
    assert not np.array_equal(found.labels, alone.labels)


def test_silhouettes_say_what_is_whole() -> None:
    """What stands before a background that was left out is one object, whatever its parts look
    like: one ball on another, each in two halves."""
    scene = objects_scene(2, 1500, n_cameras=12)
    is_ball, means = scene.labels > 0, scene.gaussians.means.copy()
    lower, upper = scene.labels == 1, scene.labels == 2
    means[upper] += means[lower].mean(axis=0) - means[upper].mean(axis=0) + np.array([0, 0, 0.5])
    two = replace(scene.gaussians, means=means).take(is_ball)
    scene = Synthetic(two, scene.labels[is_ball], scene.cameras)
    found = _with_outlines(scene, {})
    whole = np.bincount(found)
    assert whole.max() > 0.97 * whole.sum()


def test_what_has_a_silhouette_of_its_own_stays_apart(scene: Synthetic) -> None:
    maps = _masks(scene)
    apart = {name: np.where(labels > 0, labels // 2, 0) for name, labels in maps.items()}
    assert min(_best_ious(scene.labels, _with_outlines(scene, apart))) > 0.85


def test_an_outline_ends_at_what_its_objects_stand_on(scene: Synthetic) -> None:
    """A plate turns along with what stands on it, so both have one outline."""
    assert min(_best_ious(scene.labels, _with_outlines(scene, {}))) > 0.85


def _with_outlines(scene: Synthetic, outlines: dict[str, IntArray]) -> IntArray:
    """Labels (N,) where the coarsest regions are ``outlines``, or all that is seen is in one."""
    maps, config = _masks(scene), HierarchyConfig(silhouettes=True)
    whole = {name: (labels > 0).astype(np.int32) for name, labels in maps.items()} | outlines
    further = {name: [whole[name], maps[name], maps[name]] for name in maps}
    return _found(scene.gaussians, scene.cameras, maps, config, further=further).labels


def test_masks_of_a_model_are_not_touched(scene: Synthetic) -> None:
    maps = _masks(scene)
    with_hierarchy = _found(scene.gaussians, scene.cameras, maps, are_regions=False)
    assert with_hierarchy.bank.levels is None


def test_masks_of_a_model_that_contain_each_other_give_levels_around_its_groups(
    scene: Synthetic,
) -> None:
    """Balls, their halves by a plane, and pairs of balls: groups stay as they are without them."""
    engine, means = choose("cpu"), scene.gaussians.means
    ball = scene.labels > 0
    middle = np.array([means[scene.labels == k, 0].mean() for k in range(_BALLS + 1)])
    halves = np.where(ball, 2 * scene.labels + (means[:, 0] > middle[scene.labels]), 1)

    def maps(labels: IntArray) -> dict[str, IntArray]:
        labels = labels.astype(np.int32)
        return {
            camera.name: engine.label_splat(scene.gaussians, camera, labels).labels
            for camera in scene.cameras
        }

    whole, parts = maps(scene.labels + 1), maps(halves)
    further = {name: [parts[name]] * 6 for name in whole}
    alone = _found(scene.gaussians, scene.cameras, whole, are_regions=False)
    found = _found(scene.gaussians, scene.cameras, whole, are_regions=False, further=further)
    levels = found.bank.levels
    assert levels is not None
    assert np.array_equal(found.labels, alone.labels)
    assert np.array_equal(levels.labels[levels.chosen], alone.labels)
    assert len(np.unique(levels.labels[-1])) > len(np.unique(alone.labels))
    fine = HierarchyConfig(detail=1.0)
    chosen = _found(scene.gaussians, scene.cameras, whole, fine, are_regions=False, further=further)
    assert np.array_equal(chosen.labels, levels.labels[-1])
    assert not chosen.notes


def test_parts_that_masks_of_a_model_show_whole_stay_apart_in_finer_levels(
    scene: Synthetic,
) -> None:
    """The floor is one mask; a disc in its middle, as even as the rest, is one of its parts."""
    engine, means = choose("cpu"), scene.gaussians.means
    floor = scene.labels == 0
    disc = floor & (np.hypot(means[:, 0], means[:, 1]) < 0.35)

    def maps(labels: IntArray) -> dict[str, IntArray]:
        labels = labels.astype(np.int32)
        return {
            camera.name: engine.label_splat(scene.gaussians, camera, labels).labels
            for camera in scene.cameras
        }

    whole, parts = maps(scene.labels + 1), maps(scene.labels + 1 + disc * (_BALLS + 1))
    further = {name: [parts[name]] * 6 for name in whole}
    found = _found(scene.gaussians, scene.cameras, whole, are_regions=False, further=further)
    levels = found.bank.levels
    assert levels is not None
    for level, is_apart in ((0, False), (levels.chosen, False), (-1, True)):
        labels = levels.labels[level]
        inner, outer = (np.bincount(labels[rows]).argmax() for rows in (disc, floor & ~disc))
        assert (inner != outer) == is_apart


def test_levels_are_nested_and_the_chosen_one_is_the_banks(found: Association) -> None:
    levels = found.bank.levels
    assert levels is not None
    assert np.array_equal(levels.labels[levels.chosen], found.labels)
    assert np.array_equal(np.where(found.bank.group > 0, found.bank.group, 0), found.labels)
    for coarse, fine in zip(levels.labels[:-1], levels.labels[1:], strict=True):
        for group in np.unique(fine):
            assert len(np.unique(coarse[fine == group])) == 1
    assert levels.labels[0].max() < levels.labels[-1].max()


def test_the_finest_level_has_no_background(scene: Synthetic) -> None:
    """Two far balls, whatever they are at the level of objects."""
    ball = scene.gaussians.take(np.flatnonzero(scene.labels == 1))
    middle, splats, labels = ball.means.mean(axis=0), scene.gaussians, scene.labels
    for k, x in enumerate((4.0, -4.0)):
        means = (ball.means - middle + np.array([x, 0, 0])).astype(np.float32)
        splats = concatenate(splats, replace(ball, means=means))
        labels = np.r_[labels, np.full(len(ball), _BALLS + 1 + k, np.int32)]
    engine = choose("cpu")
    maps = {c.name: engine.label_splat(splats, c, labels + 1).labels for c in scene.cameras}
    levels = _found(splats, scene.cameras, maps).bank.levels
    assert levels is not None
    far = [labels == _BALLS + 1, labels == _BALLS + 2]
    one, other = (np.unique(levels.labels[-1][rows]) for rows in far)
    assert not np.intersect1d(one, other).size
    # Its largest piece keeps its id.
    assert (levels.labels[-1] == levels.background).sum() <= len(ball)


def test_each_mask_takes_the_group_that_it_shows(scene: Synthetic, found: Association) -> None:
    group_of = {g: b for b, g in _groups_of_balls(scene.labels, found.labels).items()}
    decided = [d for d in found.bank.log if d.mask >= 4]  # halves of balls
    right = [group_of.get(d.group) == d.mask // 2 - 1 for d in decided]
    assert np.mean(right) > 0.9


def _groups_of_balls(truth: IntArray, labels: IntArray) -> dict[int, int]:
    return {b: int(np.bincount(labels[truth == b]).argmax()) for b in range(1, _BALLS + 1)}


@pytest.mark.parametrize("scale", [0.2, 30.0])
def test_turning_and_scaling_the_world_changes_next_to_nothing(
    scene: Synthetic, found: Association, scale: float
) -> None:
    rotation = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    moved = _rotated(scene, rotation, scale)
    again = _found(moved.gaussians, moved.cameras, _masks(scene))
    assert min(_best_ious(scene.labels, again.labels)) > 0.85
    assert _agreement(found.labels, again.labels) > 0.93  # samples fall elsewhere


def test_the_order_of_the_views_changes_nothing(scene: Synthetic, found: Association) -> None:
    again = _found(scene.gaussians, scene.cameras[::-1], _masks(scene))
    assert np.array_equal(again.labels, found.labels)


@pytest.mark.parametrize(
    "change",
    [
        lambda: HierarchyConfig(detail=1.5),
        lambda: HierarchyConfig(surfels=3),
        lambda: AssociateConfig(hierarchy=HierarchyConfig()),
    ],
)
def test_config_is_checked(change: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match=r"detail|surfels|median"):
        change()
