"""Weights, votes and label maps of the CPU rasterizer are one linear operator."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.splats.ply import read_ply
from gaga_core.raster.cpu import rasterizer
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.raster.reference import ReferenceRasterizer
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

CPU, REFERENCE = CpuRasterizer(), ReferenceRasterizer()


def test_weights_match_the_reference() -> None:
    gaussians = random_gaussians(300, seed=1)
    camera = orbit_cameras(3, width=61, height=47)[1]
    pixels = np.random.default_rng(0).integers(0, 61 * 47, 400)  # in any order, some twice
    got, want = CPU.weights(gaussians, camera, pixels), REFERENCE.weights(gaussians, camera, pixels)
    np.testing.assert_array_equal(got.indptr, want.indptr)
    np.testing.assert_array_equal(got.indices, want.indices)
    np.testing.assert_allclose(got.weights, want.weights, atol=1e-5)


def test_rows_of_weights_sum_to_alpha_and_fall_in_depth_order() -> None:
    scene = objects_scene(3, 150)
    camera = scene.cameras[2].resized(70, 53)
    rows = CPU.weights(scene.gaussians, camera, np.arange(70 * 53))
    owner = np.repeat(np.arange(70 * 53), np.diff(rows.indptr))
    sums = np.bincount(owner, rows.weights, 70 * 53).reshape(53, 70)
    np.testing.assert_allclose(sums, CPU.render(scene.gaussians, camera).alpha, atol=1e-5)
    depth = camera.project(scene.gaussians.means.astype(np.float64))[1][rows.indices]
    assert (np.diff(depth)[np.diff(owner) == 0] > -1e-6).all()


def test_small_weights_can_be_left_out() -> None:
    scene = objects_scene(3, 150)
    camera = scene.cameras[2].resized(70, 53)
    pixels = np.arange(5, 70 * 53, 7)
    everything = CPU.weights(scene.gaussians, camera, pixels)
    large = CPU.weights(scene.gaussians, camera, pixels, w_min=1 / 255)
    keep = everything.weights > np.float32(1 / 255)
    np.testing.assert_array_equal(large.indices, everything.indices[keep])
    np.testing.assert_array_equal(large.weights, everything.weights[keep])


@pytest.mark.parametrize("batch", [1 << 23, 1000])
def test_vote_is_the_transpose_product_of_the_weights(
    batch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And adds to what is there; negative labels are ignored; batches change nothing."""
    monkeypatch.setattr(rasterizer, "_BATCH", batch)
    scene = objects_scene(4, 150)
    camera = scene.cameras[0].resized(75, 52)
    rng = np.random.default_rng(0)
    labels = np.repeat(np.repeat(rng.integers(-1, 7, (13, 15)), 4, 0), 5, 1).astype(np.int32)
    labels[20:30] = rng.integers(-1, 7, (10, 75))
    histogram = np.ones((len(scene.gaussians), 7), np.float32)
    CPU.vote(scene.gaussians, camera, labels, histogram)
    rows = CPU.weights(scene.gaussians, camera, np.flatnonzero(labels.ravel() >= 0))
    owner = np.repeat(labels[labels >= 0], np.diff(rows.indptr))
    want = np.ones_like(histogram)
    np.add.at(want, (rows.indices, owner), rows.weights)
    np.testing.assert_allclose(histogram, want, rtol=1e-4)


def test_vote_matches_the_reference() -> None:
    gaussians = random_gaussians(200, seed=2)
    camera = orbit_cameras(3, width=61, height=47)[1]
    labels = np.random.default_rng(0).integers(-1, 300, (47, 61)).astype(np.int32)
    got, want = np.zeros((200, 300), np.float32), np.zeros((200, 300), np.float32)
    CPU.vote(gaussians, camera, labels, got)
    REFERENCE.vote(gaussians, camera, labels, want)
    np.testing.assert_allclose(got, want, atol=1e-5)


@pytest.mark.parametrize("n_labels", [2, 30, 700])
def test_label_splat_is_the_argmax_of_one_channel_per_label(n_labels: int) -> None:
    gaussians = random_gaussians(500, seed=3)
    camera = orbit_cameras(3, width=61, height=47)[1]
    labels = np.random.default_rng(0).integers(0, n_labels, 500).astype(np.int32)
    one_hot = np.eye(n_labels, dtype=np.float32)[labels]
    image = CPU.render(gaussians, camera, channels=one_hot).image
    got = CPU.label_splat(gaussians, camera, labels)
    np.testing.assert_allclose(got.confidence, image.max(axis=2), atol=1e-5)
    clear = np.diff(np.partition(image, -2, axis=2)[..., -2:], axis=2)[..., 0] > 1e-5
    empty = image.max(axis=2) == 0
    np.testing.assert_array_equal(got.labels[clear], image.argmax(axis=2)[clear])
    assert clear.mean() > 0.5
    assert not got.labels[empty].any()


def test_label_ids_may_be_huge() -> None:
    gaussians = random_gaussians(200, seed=4)
    camera = orbit_cameras(3, width=61, height=47)[1]
    small = np.random.default_rng(0).integers(0, 5, 200).astype(np.int32)
    ids = np.array([0, 3, 70_000, 1_000_000_000, 2**31 - 1], np.int32)
    want, got = (CPU.label_splat(gaussians, camera, x) for x in (small, ids[small]))
    np.testing.assert_array_equal(got.labels, ids[want.labels])
    np.testing.assert_array_equal(got.confidence, want.confidence)


@pytest.mark.parametrize("order", [(4, 2), (2, 4)])
def test_equal_weights_give_the_smaller_label(order: tuple[int, int]) -> None:
    """Opacity 1/5 before 1/4, centred on a pixel: both weigh exactly 1/5 there."""
    camera = Camera(np.array([[30, 0, 8.5], [0, 30, 8.5], [0, 0, 1.0]]), np.eye(4), 17, 17)
    pair = Gaussians(
        means=np.array([[0, 0, 1], [0, 0, 2]], np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
        log_scales=np.full((2, 3), -2, np.float32),
        logit_opacities=np.log(np.array([1 / 4, 1 / 3])).astype(np.float32),
        sh=np.zeros((2, 1, 3), np.float32),
    )
    first, second = CPU.weights(pair, camera, np.array([8 * 17 + 8])).weights
    assert first == second
    frame = CPU.label_splat(pair, camera, np.array(order, np.int32))
    assert frame.labels[8, 8] == 2


def test_labels_of_objects_show_where_they_stand() -> None:
    """The projected centre of each ball in front shows its own label."""
    scene = objects_scene()
    camera = scene.cameras[0]
    frame = CPU.label_splat(scene.gaussians, camera, scene.labels)
    centres = np.array([scene.gaussians.means[scene.labels == k].mean(0) for k in range(1, 7)])
    pixels, depth = camera.project(centres.astype(np.float64))
    nearest = int(depth.argmin())
    u, v = pixels[nearest].astype(int)
    assert frame.labels[v, u] == nearest + 1
    assert frame.confidence[v, u] > 0.9


def true_labels(folder: Path, camera: Camera) -> IntArray:
    return read_labels(folder / "gt" / "instance" / Path(camera.name).with_suffix(".png").name)


def test_true_masks_voted_into_a_real_scene_come_back(ycb_table: Path) -> None:
    """Votes of the true masks of 8 views, splatted into another view, give its true mask."""
    gaussians = read_ply(ycb_table / "point_cloud.ply")
    views = open_scene_folder(ycb_table).cameras
    histogram = np.zeros((len(gaussians), 17), np.float32)
    for camera in views[0:64:8]:
        CPU.vote(gaussians, camera, true_labels(ycb_table, camera), histogram)
    labels = histogram.argmax(axis=1).astype(np.int32)
    frame = CPU.label_splat(gaussians, views[5], labels)
    assert (frame.labels == true_labels(ycb_table, views[5])).mean() > 0.97
