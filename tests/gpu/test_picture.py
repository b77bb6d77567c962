"""The drawn picture is the CPU rasterizer's: mean difference under 2/255, in practice under 1."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.color import depth_colors
from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras.colmap import read_colmap
from gaga_core.io.splats.ply import read_ply
from gaga_core.scene.bake import bake
from gaga_core.scene.scene import Placements, Scene, State
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import Mode, SplatLook, ViewState
from tests.gpu.conftest import Errors
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

pytestmark = pytest.mark.gl
BAR = 1.0  # the promise is 2
CAMERAS = orbit_cameras(3, width=192, height=144)


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3, 4])
def test_random_splats_against_cpu(mean_error: Errors, sh_degree: int) -> None:
    gaussians = random_gaussians(3000, seed=sh_degree, sh_degree=sh_degree)
    for camera in CAMERAS:
        assert mean_error(Scene.of(gaussians), gaussians, camera) < BAR


def test_a_shifted_principal_point_and_unequal_focal_lengths(mean_error: Errors) -> None:
    camera = CAMERAS[0]
    K = camera.K.copy()
    K[0, 2] += 31
    K[1, 2] -= 17
    K[1, 1] *= 0.7
    gaussians = random_gaussians(3000, sh_degree=1)
    assert mean_error(Scene.of(gaussians), gaussians, replace(camera, K=K)) < BAR


def test_inside_the_scene_where_splats_cross_the_near_plane(mean_error: Errors) -> None:
    gaussians = random_gaussians(3000, extent=4.0)
    camera = orbit_cameras(1, width=192, height=144, radius=0.5)[0]
    assert mean_error(Scene.of(gaussians), gaussians, camera) < BAR


def test_needles(mean_error: Errors) -> None:
    gaussians = random_gaussians(1000)
    logs = gaussians.log_scales.copy()
    logs[:, 0], logs[:, 1:] = np.log(0.5), np.log(1e-4)
    needles = replace(gaussians, log_scales=logs)
    assert mean_error(Scene.of(needles), needles, CAMERAS[0]) < BAR


def test_splats_that_are_not_finite_are_left_out(mean_error: Errors) -> None:
    gaussians = random_gaussians(2000, sh_degree=1)
    broken = {
        name: getattr(gaussians, name).copy()
        for name in ("means", "quats", "log_scales", "logit_opacities")
    }
    broken["means"][:50] = np.nan
    broken["quats"][50:100] = 0
    broken["log_scales"][100:150, 1] = np.inf
    broken["logit_opacities"][150:200] = np.nan
    sound = gaussians.take(np.arange(200, 2000))
    assert mean_error(Scene.of(replace(gaussians, **broken)), sound, CAMERAS[0]) < BAR


def _fine(sh_degree: int = 1) -> Gaussians:
    """Splats of which most are smaller than a pixel: there the two looks differ."""
    gaussians = random_gaussians(4000, sh_degree=sh_degree)
    return replace(gaussians, log_scales=gaussians.log_scales - np.float32(2.2))


@pytest.mark.parametrize("comments", [(), ("SplatRenderMode: mip",)], ids=["classic", "mip"])
def test_both_looks_against_cpu(mean_error: Errors, comments: tuple[str, ...]) -> None:
    gaussians = replace(_fine(), comments=comments)
    assert mean_error(Scene.of(gaussians), gaussians, CAMERAS[0]) < 0.5 * BAR


def test_the_mip_look_keeps_the_brightness_at_half_the_size(viewport: Viewport) -> None:
    """The classic look does not: splats under a pixel are widened and keep their opacity."""
    gaussians = replace(_fine(0), sh=np.full((4000, 1, 3), 1.7, np.float32))
    camera = CAMERAS[0]
    light = {}
    for look in (SplatLook.CLASSIC, SplatLook.ANTIALIASED):
        view = ViewState(background=(0, 0, 0), look=look)
        for scale in (1, 3):
            small = camera.resized(camera.width * scale, camera.height * scale)
            viewport.draw(Scene.of(gaussians), small, view, wait=True)
            light[look, scale] = float(viewport.read_pixels().mean())
    classic, mip = (
        light[look, 1] / light[look, 3] for look in (SplatLook.CLASSIC, SplatLook.ANTIALIASED)
    )
    assert classic > 1.5
    assert 0.7 < mip < 1.1


def test_the_view_overrides_the_look_of_the_file(viewport: Viewport) -> None:
    pictures = []
    for comments in ((), ("antialiased 1",)):
        scene = Scene.of(replace(_fine(), comments=comments))
        for look in SplatLook:
            viewport.draw(scene, CAMERAS[0], ViewState(look=look), wait=True)
            pictures.append(viewport.read_pixels())
    auto, classic, mip, auto_of_mip, classic_of_mip, mip_of_mip = pictures
    assert np.array_equal(auto, classic)
    assert np.array_equal(auto_of_mip, mip_of_mip)
    assert np.array_equal(classic, classic_of_mip)
    assert np.array_equal(mip, mip_of_mip)
    assert not np.array_equal(classic, mip)


def _edited(sh_degree: int) -> Scene:
    """Objects moved, turned, enlarged, stretched, recolored, faded, hidden and deleted."""
    synthetic = objects_scene(sh_degree=sh_degree)
    scene = Scene.of(synthetic.gaussians, synthetic.labels)
    table = Placements.identity(5)
    angle = 0.9
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    table.matrix[1] = np.c_[turn, [0.2, -0.1, 0.4]]
    table.matrix[2] = np.c_[1.4 * turn.T, [0.0, 0.3, 0.1]]
    table.matrix[3] = np.c_[turn @ np.diag([1.5, 1.0, 0.6]), [0.0, 0.0, 0.2]]
    table.color[2] = [[0.2, 0.7, 0, 0.1], [0, 0.4, 0.3, 0], [0.5, 0, 0.5, 0.2]]
    table.color[4, :, 3] = [0.3, -0.2, 0.1]
    table.opacity[4] = 0.35
    scene.placements = table
    scene.placement = np.where(scene.labels <= 4, scene.labels, 0).astype(np.int32)
    scene.state[scene.labels == 5] = State.HIDDEN
    scene.state[scene.labels == 6] = State.DELETED
    return scene


@pytest.mark.parametrize("sh_degree", [0, 3])
def test_edited_objects_against_cpu(mean_error: Errors, sh_degree: int) -> None:
    scene = _edited(sh_degree)
    baked = bake(scene)
    for camera in CAMERAS:
        assert mean_error(scene, baked, camera) < BAR


def test_a_rigid_move_is_the_opposite_move_of_the_camera(mean_error: Errors) -> None:
    """Without any baking: turning the scene, SH and all, is turning the camera back."""
    gaussians = random_gaussians(2000, sh_degree=3)
    camera = CAMERAS[1]
    other = np.linalg.inv(CAMERAS[2].cam_from_world) @ camera.cam_from_world
    scene = Scene.of(gaussians)
    table = Placements.identity(2)
    table.matrix[1] = other[:3]
    scene.placements = table
    scene.placement = np.ones(len(scene), np.int32)
    frame_camera = replace(camera, cam_from_world=CAMERAS[2].cam_from_world)
    moved_back = replace(camera, cam_from_world=frame_camera.cam_from_world @ other)
    viewport_error = mean_error(Scene.of(gaussians), gaussians, moved_back)
    assert viewport_error < BAR
    assert mean_error(scene, bake(scene), frame_camera) < BAR


def test_depth_mode_orders_by_depth(viewport: Viewport) -> None:
    """Of two walls the nearer one is lighter, and the colors do not depend on the splats'."""
    camera = CAMERAS[0]
    means = np.array([camera.unproject(48, 72, 2.0), camera.unproject(144, 72, 6.0)], np.float32)
    gaussians = Gaussians(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
        log_scales=np.log(np.array([[0.3] * 3, [0.9] * 3], np.float32)),
        logit_opacities=np.full(2, 6, np.float32),
        sh=np.zeros((2, 1, 3), np.float32),
    )
    viewport.draw(Scene.of(gaussians), camera, ViewState(mode=Mode.DEPTH), wait=True)
    near, far = viewport.read_pixels()[72, [48, 144]].astype(int)
    assert near.sum() > far.sum() + 200
    # The map that films of the CPU show, too.
    ends = depth_colors(np.array([[2.0, 6.0]], np.float32), (float(np.log(2)), float(np.log(6))))
    for shown, want in zip((near, far), 255 * ends[0], strict=True):
        np.testing.assert_allclose(shown, want, atol=4)


def test_groups_mode_shows_palette_hues(viewport: Viewport) -> None:
    synthetic = objects_scene()
    scene = Scene.of(synthetic.gaussians, synthetic.labels)
    view = ViewState(mode=Mode.GROUPS)
    viewport.draw(scene, CAMERAS[0], view, wait=True)
    before = viewport.read_pixels().astype(int)
    scene.labels = np.where(scene.labels == 1, 12, scene.labels).astype(np.int32)
    scene.revision.labels += 1
    viewport.draw(scene, CAMERAS[0], view, wait=True)
    changed = np.abs(viewport.read_pixels() - before).max(axis=2) > 20
    u, v = CAMERAS[0].project(np.array([[0.9, 0.0, 0.0]]))[0][0]
    assert changed[int(v), int(u)]
    assert 0.001 < changed.mean() < 0.2


def test_table_of_real_objects_against_cpu(mean_error: Errors, ycb_table: Path) -> None:
    gaussians = read_ply(ycb_table / "point_cloud.ply")
    views = read_colmap(ycb_table / "sparse" / "0").cameras
    for camera in (views[0], views[31]):
        assert mean_error(Scene.of(gaussians), gaussians, camera) < BAR


def test_the_same_pictures_under_opengl_4_1() -> None:
    """What macOS offers at most: no compute, GLSL 4.10."""
    environment = {
        **os.environ,
        "MESA_GL_VERSION_OVERRIDE": "4.1",
        "MESA_GLSL_VERSION_OVERRIDE": "410",
        "GAGA_EXPECTED_GL": "410",
    }
    chosen = "against_cpu and (random or edited or version)"
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-k",
        chosen,
        __file__,
    ]
    root = Path(__file__).resolve().parents[2]
    run = subprocess.run(
        command, env=environment, cwd=root, capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr


def test_version_of_the_context_compared_against_cpu(gl: Any) -> None:
    """The run above must not quietly get another context."""
    expected = os.environ.get("GAGA_EXPECTED_GL")
    assert gl.version_code == int(expected) if expected else gl.version_code >= 330
