"""Regions of the picture against a slow loop, and the algebra of selections."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.geometry import look_at
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra
from gaga_core.scene.selection.by_screen import rectangle, screen
from tests.core.scene.edits.edit_walk import random_affine, walk_scene
from tests.scenes import objects_scene, orbit_cameras


def _scene() -> Scene:
    scene = walk_scene(300)
    rng = np.random.default_rng(3)
    for edit in (
        edits.transform(scene, np.flatnonzero(scene.labels == 2), random_affine(rng)),
        edits.hide(scene, np.arange(0, 30)),
        edits.delete(scene, np.arange(30, 60)),
        edits.lock(scene, np.arange(60, 90)),
        edits.select(scene, np.arange(80, 150)),
    ):
        History(scene).do(edit)
    return scene


@pytest.mark.parametrize("is_among_them", [False, True])  # then some splats are behind
def test_a_rectangle_takes_the_centres_drawn_in_it(is_among_them: bool) -> None:
    scene = _scene()
    camera = orbit_cameras(3)[1]
    if is_among_them:
        pose = look_at(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
        camera = replace(camera, cam_from_world=pose)
    means = algebra.world_means(scene).astype(np.float64)
    want = []
    for i in range(90, 300):
        x, y, z = (camera.cam_from_world @ [*means[i], 1])[:3]
        if z > 0.01:
            u = camera.K[0, 0] * x / z + camera.K[0, 2]
            v = camera.K[1, 1] * y / z + camera.K[1, 2]
            if 40 <= u <= 110 and 30 <= v <= 80:
                want.append(i)
    assert 2 < len(want) < 150
    for corners in ((40, 30, 110, 80), (110, 30, 40, 80), (40, 80, 110, 30)):
        mask = rectangle(corners, camera.width, camera.height)
        assert screen(scene, camera).inside(mask).tolist() == want
    with pytest.raises(ValueError, match="mask"):
        screen(scene, camera).inside(mask[:-1])


def test_visible_surface_only_leaves_the_back_out() -> None:
    synthetic = objects_scene(3, 600)
    scene = Scene.of(synthetic.gaussians, synthetic.labels)
    camera = synthetic.cameras[0]
    median = choose("cpu").render(scene.gaussians, camera).median_depth
    whole = np.ones((camera.height, camera.width), np.bool_)
    through = screen(scene, camera).inside(whole)
    surface = screen(scene, camera, median).inside(whole)
    assert set(surface) < set(through)
    ball = np.flatnonzero(synthetic.labels == 1)
    centre = scene.gaussians.means[ball].mean(axis=0)
    facing = (scene.gaussians.means[ball] - centre) @ (camera.position - centre)
    near, far = ball[facing > 0.35], ball[facing < -0.35]
    assert np.isin(near, surface).mean() > 0.9
    assert np.isin(far, surface).mean() < 0.1


def test_groups_inside_by_share() -> None:
    scene = Scene.of(walk_scene(300).gaussians, np.repeat([0, 1, 2], 100).astype(np.int32))
    splats = np.concatenate([np.arange(100), np.arange(100, 160), np.arange(200, 240)])
    assert algebra.groups_inside(scene, splats.astype(np.int32)).tolist() == [1]
    assert algebra.groups_inside(scene, splats.astype(np.int32), 0.4).tolist() == [1, 2]


def test_all_none_and_invert() -> None:
    scene = _scene()
    able = set(range(90, 300))
    assert set(algebra.everything(scene).tolist()) == able
    assert set(algebra.inverted(scene).tolist()) == able - set(range(90, 150))
    assert len(algebra.nothing()) == 0
