"""A pick is the rasterizer's row of weights at one pixel, placements included."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.splats.ply import read_ply
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene.bake import bake
from gaga_core.scene.scene import Placements, Scene, State
from gaga_core.scene.selection.by_screen import Pick, pick
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

CPU = CpuRasterizer()


def edited_scene(seed: int = 0) -> Scene:
    """Splats moved, turned, stretched, mirrored, made fainter and denser; some hidden or gone."""
    rng = np.random.default_rng(seed)
    scene = Scene.of(random_gaussians(500, seed=seed), rng.integers(0, 6, 500).astype(np.int32))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    linears = [np.eye(3), turn, np.diag([1.5, 0.6, 1.0]), np.diag([-1.0, 1, 1]), 0.5 * np.eye(3)]
    matrix = np.zeros((5, 3, 4))
    matrix[:, :, :3] = linears
    matrix[1:, :, 3] = rng.normal(0, 0.2, (4, 3))
    opacity = np.array([1.0, 0.5, 1.0, 3.0, 0.9])
    scene.placements = Placements(matrix, Placements.identity(5).color, opacity)
    scene.placement = rng.integers(0, 5, 500).astype(np.int32)
    scene.state[rng.random(500) < 0.1] = State.HIDDEN
    scene.state[rng.random(500) < 0.1] = State.DELETED | State.SELECTED
    scene.state[rng.random(500) < 0.1] |= np.uint8(State.LOCKED | State.SELECTED)  # are drawn
    return scene


def assert_agrees(scene: Scene, drawn: Gaussians, camera: Camera, pixels: DoubleArray) -> None:
    """Each pick equals the row of weights of the ``drawn`` splats (the visible ones, baked)."""
    of_drawn = np.flatnonzero(scene.visible)
    flat = (pixels[:, 1].astype(int) * camera.width + pixels[:, 0].astype(int)).astype(np.int64)
    rows = CPU.weights(drawn, camera, flat)
    for i, (u, v) in enumerate(pixels):
        entries = slice(rows.indptr[i], rows.indptr[i + 1])
        weights = np.zeros(len(scene), np.float32)
        weights[of_drawn[rows.indices[entries]]] = rows.weights[entries]
        sums = np.bincount(scene.labels, weights=weights)
        got = pick(scene, camera, u, v)
        if got is None:
            # One splat at exactly 1/255 may count here and not there.
            assert weights.max() < 0.005
            continue
        picked = np.zeros(len(scene), np.float32)
        picked[got.indices] = got.weights
        np.testing.assert_allclose(picked, weights, atol=5e-3)
        assert np.abs(picked - weights).mean() < 1e-4
        assert sums[got.group] >= sums.max() - 5e-3
        assert got.weight == pytest.approx(picked[scene.labels == got.group].sum(), abs=1e-5)
        assert weights[got.splat] >= weights.max() - 5e-3


def random_pixels(camera: Camera, n: int, seed: int = 0) -> DoubleArray:
    rng = np.random.default_rng(seed)
    columns, rows = rng.integers(camera.width, size=n), rng.integers(camera.height, size=n)
    return np.stack([columns, rows], axis=1).astype(np.float64) + 0.5


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_pick_is_the_weights_of_the_baked_scene(seed: int) -> None:
    scene = edited_scene(seed)
    camera = orbit_cameras(4, width=97, height=64)[seed]
    assert_agrees(scene, bake(scene), camera, random_pixels(camera, 60))


def test_pick_finds_the_median_depth_and_the_point_there() -> None:
    synthetic = objects_scene()
    camera = synthetic.cameras[0]
    scene = Scene.of(synthetic.gaussians, synthetic.labels)
    frame = CPU.render(synthetic.gaussians, camera)
    for u, v in random_pixels(camera, 60):
        got = pick(scene, camera, u, v)
        if frame.alpha[int(v), int(u)] < 0.6:
            continue
        assert isinstance(got, Pick)
        assert got.depth == pytest.approx(frame.median_depth[int(v), int(u)], rel=1e-5)
        pixel, depth = camera.project(got.point[None])
        np.testing.assert_allclose(pixel[0], (u, v), atol=1e-6)
        assert depth[0] == pytest.approx(got.depth)


def test_an_empty_pixel_picks_nothing() -> None:
    camera = orbit_cameras(1)[0]
    assert pick(Scene.of(random_gaussians(0)), camera, 5.5, 5.5) is None
    away = objects_scene().gaussians
    assert pick(Scene.of(away), camera, -4000.5, 5.5) is None


def test_broken_splats_are_not_picked() -> None:
    synthetic = objects_scene(2, 100)
    g, camera = synthetic.gaussians, synthetic.cameras[0]
    columns: tuple[FloatArray, ...] = (g.means, g.quats, g.log_scales)
    for column in columns:
        column[::4, 0] = np.nan
    g.logit_opacities[1::4] = np.nan
    g.quats[2::4] = 0
    scene = Scene.of(g, synthetic.labels)
    for u, v in random_pixels(camera, 60):
        got = pick(scene, camera, u, v)
        assert got is None or (got.indices % 4 == 3).all()


def test_click_selects_the_group_of_greatest_weight_on_a_real_scene(ycb_table: Path) -> None:
    """100 random pixels of the test views, in groups of the cells of a grid."""
    gaussians = read_ply(ycb_table / "point_cloud.ply")
    folder = open_scene_folder(ycb_table)
    views = [c for c in folder.cameras if c.name in folder.test]
    cells = np.floor(gaussians.means / 0.05).astype(np.int64)
    _, member = np.unique(cells, axis=0, return_inverse=True)
    labels = member.ravel().astype(np.int32)
    scene = Scene.of(gaussians, labels)
    assert views
    clicks = 0
    for k in range(4):
        camera = views[k * len(views) // 4]
        pixels = random_pixels(camera, 25, seed=k)
        flat = (pixels[:, 1].astype(np.int64)) * camera.width + pixels[:, 0].astype(np.int64)
        rows = CPU.weights(gaussians, camera, flat)
        for i, (u, v) in enumerate(pixels):
            entries = slice(rows.indptr[i], rows.indptr[i + 1])
            sums = np.bincount(labels[rows.indices[entries]], weights=rows.weights[entries])
            got = pick(scene, camera, u, v)
            assert got is not None
            assert sums[got.group] >= sums.max() - 1e-5
            clicks += 1
    assert clicks == 100


def test_nothing_behind_a_full_pixel_is_picked() -> None:
    """A pixel ends at transmittance 1e-4: exactly the rasterizer's splats, in its order."""
    rng = np.random.default_rng(0)
    stack = random_gaussians(40, seed=1)
    stack.means[:] = rng.normal(0, 0.05, (40, 3))
    stack.log_scales[:] = -1.5
    stack.logit_opacities[:] = 1.5
    camera = orbit_cameras(1)[0]
    (pixel,), _ = camera.project(np.zeros((1, 3)))
    u, v = np.floor(pixel) + 0.5
    rows = CPU.weights(stack, camera, np.array([int(v) * camera.width + int(u)]))
    got = pick(Scene.of(stack), camera, u, v)
    assert got is not None
    assert len(rows.indices) < 40
    np.testing.assert_array_equal(got.indices, rows.indices)
    np.testing.assert_allclose(got.weights, rows.weights, atol=1e-5)
