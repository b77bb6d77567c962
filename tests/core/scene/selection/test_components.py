"""Connected parts, floaters, and the edits that take groups apart."""

import numpy as np
import pytest

from gaga_core.gaussians import Gaussians
from gaga_core.scene import edits
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.neighbourhood import components_of, floaters
from tests.core.scene.edits.edit_walk import snapshot


def _scene(*clouds: tuple[tuple[float, float, float], int], stray: int = 0) -> Scene:
    """Balls of radius 1 at places, with so many splats, and strays far from all."""
    rng = np.random.default_rng(0)
    balls = [rng.normal(0, 0.4, (n, 3)) + np.array(at) for at, n in clouds]
    far = rng.uniform(20, 60, (stray, 3)) * rng.choice([-1, 1], (stray, 3))
    means = np.concatenate([*balls, far]).astype(np.float32)
    n = len(means)
    mixed = rng.permutation(n)
    gaussians = Gaussians(
        means[mixed],
        np.ones((n, 4), np.float32),
        np.full((n, 3), -3, np.float32),
        np.zeros(n, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    return Scene.of(gaussians, np.ones(n, np.int32))


def test_balls_apart_are_parts_and_a_ball_is_one() -> None:
    scene = _scene(((0, 0, 0), 900), ((8, 0, 0), 500), ((0, 9, 0), 300))
    parts = components_of(scene, np.arange(1700, dtype=np.int32))
    assert [len(p) for p in parts] == [900, 500, 300]
    x = scene.gaussians.means[:, 0]
    assert (x[parts[1]] > 4).all()
    assert (x[parts[0]] < 4).all()
    assert sorted(np.concatenate(parts).tolist()) == list(range(1700))


def test_crumbs_go_with_the_nearest_part() -> None:
    scene = _scene(((0, 0, 0), 900), ((20, 0, 0), 500), ((26, 0, 0), 10))
    parts = components_of(scene, np.arange(1410, dtype=np.int32))
    assert [len(p) for p in parts] == [900, 510]
    assert components_of(scene, np.zeros(0, np.int32)) == ()


def test_strays_float_and_balls_of_any_density_do_not() -> None:
    scene = _scene(((0, 0, 0), 4000), ((4, 0, 0), 3000), stray=30)
    alone = floaters(scene, np.arange(len(scene), dtype=np.int32))
    far = np.linalg.norm(scene.gaussians.means, axis=1) > 15
    assert set(np.flatnonzero(far).tolist()) <= set(alone.tolist())
    assert np.count_nonzero(~far[alone]) < 0.02 * 7000
    some = floaters(scene, np.arange(len(scene), dtype=np.int32), strength=0.5)
    assert set(some.tolist()) < set(alone.tolist())
    with pytest.raises(ValueError, match="strength"):
        floaters(scene, alone, 0)


def test_splitting_and_separating_are_edits_with_a_way_back() -> None:
    scene = _scene(((0, 0, 0), 900), ((8, 0, 0), 500))
    scene.names = {1: "pair"}
    before = snapshot(scene)
    edit = edits.split(scene, 1)
    assert edit is not None
    edit.apply(scene)
    assert np.bincount(scene.labels).tolist() == [0, 900, 500]
    assert scene.names == {1: "pair", 2: "pair 2"}
    assert edits.split(scene, 1) is None
    edit.revert(scene)
    assert snapshot(scene) == before
    apart = edits.separate(scene, np.arange(40))
    assert apart is not None
    apart.apply(scene)
    assert np.flatnonzero(scene.labels == 2).tolist() == list(range(40))
    assert scene.names[2] == "pair part"
    assert edits.separate(scene, np.arange(40)) is None  # it is the whole group already
    apart.revert(scene)
    assert snapshot(scene) == before
