"""Masks of renderings lifted and merged: what a model that knows the truth, or errs, leads to."""

import numpy as np
import pytest

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.pipeline.click import Lifted, model_clicks_stage
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene.selection.click import Click
from tests.color_oracle import ColorOracle, clicked_things
from tests.scenes import Synthetic, objects_scene

_UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(5, 220, n_cameras=8)


def _lift(scene: Synthetic, oracle: ColorOracle, *clicks: Click) -> Lifted:
    camera = scene.cameras[0].resized(320, 240)
    stage = model_clicks_stage(scene.gaussians, camera, clicks, oracle, choose("cpu"), up=_UP)
    return run_stage(stage)


def _on(scene: Synthetic, ball: int, *, is_on: bool = True) -> Click:
    """A click where the first view shows a ball."""
    camera = scene.cameras[0].resized(320, 240)
    centre = scene.gaussians.means[scene.labels == ball].mean(axis=0).astype(np.float64)
    u, v = camera.project(centre[None])[0][0].tolist()
    depth = choose("cpu").render(scene.gaussians, camera).median_depth[int(v), int(u)]
    x, y, z = camera.unproject(u, v, float(depth)).tolist()
    return Click((x, y, z), is_on)


def _iou(scene: Synthetic, lifted: Lifted, *balls: int) -> float:
    chosen = np.zeros(len(scene.labels), np.bool_)
    chosen[lifted.splats] = True
    true = np.isin(scene.labels, balls)
    return float((chosen & true).sum() / (chosen | true).sum())


def _nearest(scene: Synthetic) -> list[int]:
    """Balls, the nearest to the first view first."""
    middles = [scene.gaussians.means[scene.labels == k].mean(axis=0) for k in range(1, 6)]
    depth = scene.cameras[0].project(np.array(middles, np.float64))[1]
    return [int(k) + 1 for k in np.argsort(depth)]


def test_true_masks_give_the_true_object_from_all_sides(scene: Synthetic) -> None:
    ball = _nearest(scene)[0]
    oracle = ColorOracle(scene, clicked_things)
    lifted = _lift(scene, oracle, _on(scene, ball))
    assert _iou(scene, lifted, ball) > 0.9
    assert 4 <= lifted.n_views <= 8
    behind = scene.gaussians.means[lifted.splats] - scene.cameras[0].position
    depth = behind @ scene.cameras[0].forward
    assert np.ptp(depth) > 0.45  # the ball's far side is there, too: 0.56 across


def test_views_that_disagree_have_no_vote(scene: Synthetic) -> None:
    """Three of four views mark the floor: their masks fit nothing that is chosen."""
    ball = _nearest(scene)[0]

    def errs(things: IntArray, points: FloatArray, is_on: BoolArray) -> BoolArray:
        wrong = oracle.n_asked > 1 and oracle.n_asked % 4
        return things == 0 if wrong else clicked_things(things, points, is_on)

    oracle = ColorOracle(scene, errs)
    lifted = _lift(scene, oracle, _on(scene, ball))
    assert 2 <= lifted.n_views <= 3
    assert _iou(scene, lifted, ball) > 0.6


def test_ragged_masks_are_outvoted(scene: Synthetic) -> None:
    ball, rng = _nearest(scene)[0], np.random.default_rng(0)

    def ragged(things: IntArray, points: FloatArray, is_on: BoolArray) -> BoolArray:
        luck = rng.random(things.shape)
        return np.asarray((clicked_things(things, points, is_on) & (luck > 0.15)) | (luck > 0.99))

    assert _iou(scene, _lift(scene, ColorOracle(scene, ragged), _on(scene, ball)), ball) > 0.85


def test_clicks_off_the_thing_reach_every_view(scene: Synthetic) -> None:
    """The model takes all balls for one unless it is told."""
    one, two, *_ = _nearest(scene)

    def all_balls(things: IntArray, points: FloatArray, is_on: BoolArray) -> BoolArray:
        columns, rows = points[~is_on].astype(np.int64).T
        return np.asarray((things > 0) & ~np.isin(things, things[rows, columns]))

    oracle = ColorOracle(scene, all_balls)
    both = _lift(scene, oracle, _on(scene, one))
    assert len(np.intersect1d(both.splats, np.flatnonzero(scene.labels == two))) > 150
    told = _lift(scene, oracle, _on(scene, one), _on(scene, two, is_on=False))
    left = len(np.intersect1d(told.splats, np.flatnonzero(scene.labels == two)))
    assert left < 110  # where the click shows; views behind the ball do not see it


def test_a_model_that_finds_nothing_is_told(scene: Synthetic) -> None:
    def nothing(things: IntArray, points: FloatArray, is_on: BoolArray) -> BoolArray:
        return np.zeros(things.shape, np.bool_)

    with pytest.raises(GagaError, match="finds nothing there"):
        _lift(scene, ColorOracle(scene, nothing), _on(scene, _nearest(scene)[0]))
