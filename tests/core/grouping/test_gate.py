"""The depth gate: strict bounds, quartiles, dense ids."""

import numpy as np
import pytest

from gaga_core.camera import Camera
from gaga_core.grouping.gate import (
    GateConfig,
    ViewMasks,
    depth_bounds,
    gaussians_of_masks,
    open_bounds,
)
from tests.scenes import orbit_cameras

_K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
_CAMERA = Camera(_K, np.eye(4), 8, 6, "a.png")


def test_bounds_are_d_min_and_q3_plus_f_iqr() -> None:
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 30, (40, 50)).astype(np.int32) * 3
    depth = rng.uniform(0.5, 9, labels.shape).astype(np.float32)
    alpha = rng.uniform(0, 1, labels.shape).astype(np.float32)
    masks = ViewMasks.of(labels)
    bounds = depth_bounds(masks, depth, alpha, GateConfig(iqr_factor=1.5))
    assert len(masks) == 29
    for m, original in enumerate(masks.ids):
        values = depth[(labels == original) & (alpha >= 0.5)].astype(np.float64)
        if m == 0:
            assert bounds[0, 0] > bounds[0, 1]
            continue
        q1, q3 = np.quantile(values, [0.25, 0.75])
        assert bounds[m, 0] == values.min()
        assert bounds[m, 1] == q3 + 1.5 * (q3 - q1)


def test_bounds_are_strict() -> None:
    labels = np.ones((6, 8), np.int32)
    masks = ViewMasks.of(labels)
    bounds = np.array([[np.inf, -np.inf], [2.0, 3.0]])
    means = np.array([[0, 0, z] for z in (2.0, 2.001, 2.999, 3.0)], np.float32)
    assert gaussians_of_masks(means, _CAMERA, masks, bounds).tolist() == [0, 1, 1, 0]


def test_flat_mask_loses_its_gaussians_by_the_paper_and_keeps_them_when_guarded() -> None:
    masks = ViewMasks.of(np.ones((6, 8), np.int32))
    depth, alpha = np.full((6, 8), 2, np.float32), np.ones((6, 8), np.float32)
    means = np.array([[0, 0, 1.99], [0, 0, 2.0], [0, 0, 2.01]], np.float32)
    paper = depth_bounds(masks, depth, alpha, GateConfig())
    guarded = depth_bounds(masks, depth, alpha, GateConfig(iqr_floor=0.02, guard_near=True))
    assert gaussians_of_masks(means, _CAMERA, masks, paper).tolist() == [0, 0, 0]
    assert gaussians_of_masks(means, _CAMERA, masks, guarded).tolist() == [1, 1, 1]


def test_centre_falls_in_the_pixel_that_contains_it() -> None:
    labels = np.arange(48, dtype=np.int32).reshape(6, 8)
    masks = ViewMasks.of(labels)
    pixels = np.array(
        [[0.0, 0.0], [0.875, 0], [1.0, 0], [7.875, 5.875], [8.0, 3], [-0.125, 3], [3, 6]]
    )
    means = np.c_[(pixels - [4, 3]) / 8 * 4, np.full(len(pixels), 4)]  # exact in float32
    got = gaussians_of_masks(means.astype(np.float32), _CAMERA, masks, open_bounds(masks))
    assert got.tolist() == [0, 0, 1, 47, 0, 0, 0]


def test_behind_camera_far_away_and_nan_belong_to_no_mask() -> None:
    masks = ViewMasks.of(np.ones((6, 8), np.int32))
    means = np.array(
        [[0, 0, -2], [0, 0, 0.005], [1e30, 0, 1], [np.nan, 0, 1], [0, 0, np.nan], [0, 0, 1]],
        np.float32,
    )
    got = gaussians_of_masks(means, _CAMERA, masks, open_bounds(masks))
    assert got.tolist() == [0, 0, 0, 0, 0, 1]


def test_mask_without_valid_depth_accepts_nothing() -> None:
    labels = np.ones((6, 8), np.int32)
    labels[3:] = 2
    depth = np.full((6, 8), 2, np.float32)
    alpha = np.ones((6, 8), np.float32)
    alpha[3:] = 0.4
    bounds = depth_bounds(ViewMasks.of(labels), depth, alpha, GateConfig())
    assert bounds[2].tolist() == [np.inf, -np.inf]


@pytest.mark.parametrize("top", [300, 70_000, 5_000_000])
def test_dense_ids_come_back_to_the_file_ids(top: int) -> None:
    rng = np.random.default_rng(top)
    labels = rng.choice([0, 4, 255, 256, top], (9, 7)).astype(np.int32)
    masks = ViewMasks.of(labels)
    assert (masks.ids[masks.labels] == labels).all()
    assert masks.labels.max() == len(masks)


def test_result_does_not_depend_on_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    means = rng.uniform(-1, 1, (200_000, 3)).astype(np.float32)
    camera = orbit_cameras(1)[0]
    masks = ViewMasks.of(rng.integers(0, 9, (camera.height, camera.width)).astype(np.int32))
    many = gaussians_of_masks(means, camera, masks, open_bounds(masks))
    monkeypatch.setenv("GAGA_THREADS", "1")
    assert (gaussians_of_masks(means, camera, masks, open_bounds(masks)) == many).all()


@pytest.mark.parametrize("bad", [{"iqr_factor": -1.0}, {"alpha_min": 0.0}, {"iqr_floor": -0.1}])
def test_config_is_checked(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"iqr|alpha"):
        GateConfig(**bad)  # type: ignore[arg-type]
