"""Volumes, columns, colors, growing and shrinking: against slow definitions."""

import itertools

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.geometry import quats_to_matrices
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra, by_value, by_volume, neighbourhood
from tests.core.scene.edits.edit_walk import random_affine, walk_scene


def _scene() -> Scene:
    scene = walk_scene(400)
    rng = np.random.default_rng(5)
    recolored = np.column_stack([np.diag([0.2, 1.1, 0.5]), [0.3, -0.1, 0.2]])
    for build in (
        lambda: edits.transform(scene, np.flatnonzero(scene.labels == 2), random_affine(rng)),
        lambda: edits.recolor(scene, np.flatnonzero(scene.labels == 3), recolored, 0.5),
        lambda: edits.hide(scene, np.arange(0, 20)),
        lambda: edits.delete(scene, np.arange(20, 40)),
        lambda: edits.lock(scene, np.arange(40, 60)),
    ):
        History(scene).do(build())
    return scene


def test_a_sphere_takes_what_is_near_and_free() -> None:
    scene = _scene()
    means = algebra.world_means(scene)
    centre = means[100]
    far = np.linalg.norm(means - centre, axis=1)
    radius = float(np.median(far))
    inside = by_volume.in_sphere(scene, centre, radius)
    assert inside.tolist() == [i for i in range(60, 400) if far[i] <= radius]


def test_a_turned_box_takes_what_its_own_frame_holds() -> None:
    scene = _scene()
    turn = quats_to_matrices(np.array([[0.9, 0.1, -0.3, 0.2]]))[0]
    sides = np.array([3.0, 1.5, 2.0])
    matrix = np.eye(4)
    matrix[:3, :3] = turn * sides
    matrix[:3, 3] = [0.3, -0.2, 0.1]
    local = (algebra.world_means(scene) - matrix[:3, 3]) @ turn
    want = (np.abs(local) <= sides / 2).all(axis=1)
    want[:60] = False
    assert 20 < want.sum() < 300
    assert by_volume.in_box(scene, matrix).tolist() == np.flatnonzero(want).tolist()
    with pytest.raises(ValueError, match="no length"):
        by_volume.in_box(scene, np.diag([1.0, 0, 1, 1]))


@pytest.mark.parametrize("name", by_value.column_names(_scene()))
def test_a_range_of_a_column_takes_what_lies_in_it(name: str) -> None:
    scene = _scene()
    values = by_value.column(scene, name)
    assert values.shape == (400,)
    assert values.dtype == np.float32
    assert np.isfinite(values).all()
    low, high = (float(np.float32(x)) for x in np.percentile(values, [30, 70]))
    chosen = by_value.in_range(scene, name, low, high)
    assert chosen.tolist() == [i for i in range(60, 400) if low <= values[i] <= high]
    whole = by_value.histogram(scene, name, chosen)
    assert whole.counts.sum() == 340
    assert whole.chosen.sum() == len(chosen)
    assert (whole.chosen <= whole.counts).all()


def test_an_unknown_column_is_named() -> None:
    with pytest.raises(ValueError, match="'weight' is not one of opacity"):
        by_value.column(_scene(), "weight")


def test_columns_follow_what_was_edited() -> None:
    scene = _scene()
    plain = walk_scene(400)
    recolored, others = scene.labels == 3, scene.labels != 3
    for name in ("red", "opacity"):
        before, after = by_value.column(plain, name), by_value.column(scene, name)
        assert np.allclose(before[others], after[others], atol=1e-6)
        assert not np.isclose(before[recolored], after[recolored]).any()
    moved = scene.labels == 2
    assert not np.isclose(by_value.column(plain, "x"), by_value.column(scene, "x"))[moved].all()
    assert np.allclose(by_value.column(scene, "z"), algebra.world_means(scene)[:, 2])


def test_hue_and_saturation_are_those_of_colorsys() -> None:
    import colorsys

    scene = _scene()
    rgb = by_value.shown_colors(scene)
    want = np.array([colorsys.rgb_to_hsv(*map(float, c)) for c in rgb])
    hue = by_value.column(scene, "hue")
    assert np.abs((hue - want[:, 0] * 360 + 180) % 360 - 180).max() < 0.05
    assert np.abs(by_value.column(scene, "saturation") - want[:, 1]).max() < 1e-5


def test_like_a_color_grows_with_the_tolerance() -> None:
    scene = _scene()
    rgb = by_value.shown_colors(scene)[200]
    chosen = [set(by_value.like_color(scene, rgb, t).tolist()) for t in (0.0, 0.1, 0.4, 1.0)]
    assert 200 in chosen[0]
    assert all(a <= b for a, b in itertools.pairwise(chosen))
    assert len(chosen[3]) == 340


def test_growing_and_shrinking_are_by_distance() -> None:
    scene = _scene()
    means = algebra.world_means(scene)
    free = (scene.labels == 1) & algebra.selectable(scene)
    splats: IntArray = np.flatnonzero(free).astype(np.int32)
    reach = neighbourhood.spacing(scene, splats)
    assert reach > 0
    far = np.linalg.norm(means[:, None] - means[None, splats], axis=2).min(axis=1)
    want = [i for i in range(400) if i in set(splats.tolist()) or (i >= 60 and far[i] <= reach)]
    grown = neighbourhood.grown(scene, splats, reach)
    assert grown.tolist() == want
    assert len(grown) > len(splats)
    outside = np.setdiff1d(np.arange(40, 400), splats)
    far = np.linalg.norm(means[splats][:, None] - means[None, outside], axis=2).min(axis=1)
    shrunk = neighbourhood.shrunk(scene, splats, reach)
    assert shrunk.tolist() == splats[far > reach].tolist()
    everything = np.arange(40, 400, dtype=np.int32)
    assert neighbourhood.shrunk(scene, everything, reach).tolist() == everything.tolist()
    none = np.zeros(0, np.int32)
    assert neighbourhood.grown(scene, none, reach).tolist() == []
    assert neighbourhood.spacing(scene, none) == 0


def test_growing_by_identity_finds_the_rest_of_the_object() -> None:
    scene = _scene()
    rng = np.random.default_rng(0)
    codes = np.eye(16, dtype=np.float32)[scene.labels]
    encodings = codes * rng.uniform(0.5, 2, (400, 1)).astype(np.float32)
    encodings += rng.normal(0, 0.02, encodings.shape).astype(np.float32)
    encodings[399] = 0
    free = np.arange(60, 399)
    object_1 = free[scene.labels[60:399] == 1]
    seed = object_1[:5].astype(np.int32)
    grown = neighbourhood.grown_by_identity(scene, seed, encodings, 0.9)
    assert grown.tolist() == object_1.tolist()
    near = neighbourhood.grown_by_identity(scene, seed, encodings, 0.9, reach=0.3)
    assert set(seed.tolist()) <= set(near.tolist()) <= set(grown.tolist())
