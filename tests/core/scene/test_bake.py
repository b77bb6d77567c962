"""Baking: the plain splats look like the placed ones from everywhere."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.color import sh_basis, sh_rotation
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.bake import bake, bake_stage
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from tests.core.scene.edits.edit_walk import random_affine, walk_scene
from tests.scenes import orbit_cameras, random_gaussians


def _rotation(rng: np.random.Generator) -> DoubleArray:
    return quats_to_matrices(rng.normal(size=(1, 4)))[0]


def _directions(rng: np.random.Generator, n: int = 200) -> DoubleArray:
    d: DoubleArray = rng.normal(size=(n, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return d


def _covariances(g: Gaussians) -> DoubleArray:
    half = quats_to_matrices(g.quats) * np.exp(g.log_scales.astype(np.float64))[:, None, :]
    return half @ half.transpose(0, 2, 1)


def _placed(scene: Scene, splats: LongArray, matrix: DoubleArray) -> Scene:
    History(scene).do(edits.transform(scene, splats, matrix))
    return scene


@pytest.mark.parametrize("degree", range(5))
def test_rotated_coefficients_have_the_color_of_rotated_directions(degree: int) -> None:
    rng = np.random.default_rng(degree)
    for mirror in (1.0, -1.0):
        turn = mirror * _rotation(rng)
        sh = rng.normal(size=((degree + 1) ** 2, 3))
        d = _directions(rng)
        turned = sh_rotation(turn, degree) @ sh
        assert (
            np.abs(sh_basis(d @ turn.T, degree) @ turned - sh_basis(d, degree) @ sh).max() < 1e-10
        )


def test_sh_rotation_is_a_group() -> None:
    rng = np.random.default_rng(0)
    a, b = _rotation(rng), _rotation(rng)
    assert np.allclose(sh_rotation(np.eye(3), 4), np.eye(25), atol=1e-12)
    assert np.allclose(sh_rotation(a, 4) @ sh_rotation(b, 4), sh_rotation(a @ b, 4), atol=1e-12)
    assert np.allclose(sh_rotation(a, 4).T, sh_rotation(a.T, 4), atol=1e-12)


@pytest.mark.parametrize("degree", [0, 3])
def test_moving_the_scene_is_moving_the_camera_back(degree: int) -> None:
    g = random_gaussians(300, seed=2, sh_degree=degree)
    rng = np.random.default_rng(4)
    world = np.column_stack([_rotation(rng), [0.4, -0.3, 0.2]])
    scene = _placed(Scene.of(g), np.arange(300), world)
    moved = bake(scene)
    rigid = np.vstack([world, [0, 0, 0, 1]])
    raster = choose("reference")
    camera = orbit_cameras(1, width=64, height=48)[0]
    beside = replace(camera, cam_from_world=camera.cam_from_world @ np.linalg.inv(rigid))
    before = raster.render(g, camera)
    after = raster.render(moved, beside)
    assert before.alpha.mean() > 0.2
    assert np.abs(before.image - after.image).mean() < 1e-4
    assert np.abs(before.alpha - after.alpha).mean() < 1e-4
    assert np.abs(raster.render(g, beside).image - after.image).mean() > 0.02


@pytest.mark.parametrize("kind", ["similar", "stretched", "mirrored", "any"])
def test_covariances_follow_the_map(kind: str) -> None:
    rng = np.random.default_rng(7)
    linear = {
        "similar": 1.7 * _rotation(rng),
        "stretched": _rotation(rng) @ np.diag([0.5, 1.0, 3.0]),
        "mirrored": np.diag([-1.0, 1.0, 1.0]),
        "any": random_affine(rng)[:, :3],
    }[kind]
    g = random_gaussians(200, seed=1)
    flat = np.where(np.arange(3) == 2, -9, g.log_scales).astype(np.float32)  # thin disks
    g = replace(g, log_scales=flat)
    offset = np.array([1.0, 2.0, 3.0])
    scene = _placed(Scene.of(g), np.arange(200), np.column_stack([linear, offset]))
    baked = bake(scene)
    want = linear @ _covariances(g) @ linear.T
    error = np.abs(_covariances(baked) - want).max(axis=(1, 2)) / np.abs(want).max(axis=(1, 2))
    assert error.max() < 1e-4
    assert np.allclose(baked.means, g.means @ linear.T + offset, atol=1e-5)
    thin = np.sqrt(np.linalg.eigvalsh(want)[:, 0].clip(0))
    assert np.allclose(np.exp(baked.log_scales).min(axis=1), thin, rtol=0.02)


def test_color_and_opacity_follow_the_placement() -> None:
    rng = np.random.default_rng(3)
    g = random_gaussians(100, seed=3, sh_degree=3)
    affine = random_affine(rng)
    scene = Scene.of(g)
    History(scene).do(edits.recolor(scene, np.arange(100), affine, 0.5))
    baked = bake(scene)
    basis = sh_basis(_directions(rng, 20), 3)
    before = 0.5 + np.einsum("ds,nsc->ndc", basis, g.sh)
    after = 0.5 + np.einsum("ds,nsc->ndc", basis, baked.sh)
    assert np.allclose(after, before @ affine[:, :3].T + affine[:, 3], atol=1e-4)
    assert np.allclose(baked.opacities, 0.5 * g.opacities, atol=1e-5)
    for unchanged in ("means", "quats", "log_scales"):
        assert np.array_equal(getattr(baked, unchanged), getattr(g, unchanged))


def test_opacity_factors_end_in_finite_logits() -> None:
    scene = walk_scene(20)
    scene.gaussians.logit_opacities[:3] = [np.inf, -np.inf, 200]
    for factor in (0.0, 1e9):
        edit = edits.recolor(scene, np.arange(20), np.eye(3, 4), factor)
        assert edit is not None
        edit.apply(scene)
        assert np.isfinite(bake(scene).logit_opacities).all()
        edit.revert(scene)


def test_splats_without_an_edit_keep_their_bits() -> None:
    scene = walk_scene(300, sh_degree=3)
    g = scene.gaussians
    chosen = np.flatnonzero(scene.labels == 4)
    _placed(scene, chosen, random_affine(np.random.default_rng(0)))
    History(scene).do(edits.hide(scene, np.arange(10)))
    shown = np.flatnonzero(scene.visible)
    baked, rest = bake(scene), ~np.isin(shown, chosen)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        column, original = getattr(baked, name), getattr(g, name)[shown]
        assert column[rest].tobytes() == original[rest].tobytes()
        assert column.flags.c_contiguous
    assert np.array_equal(baked.extra["tag"], g.extra["tag"][shown])
    some = bake(scene, indices=np.array([50, 20]))
    assert np.array_equal(some.extra["tag"], g.extra["tag"][[20, 50]])


def test_a_pure_move_touches_positions_only_and_never_the_scene() -> None:
    scene = walk_scene(100, sh_degree=2)
    g = scene.gaussians
    copy = g.take(np.arange(100))
    _placed(scene, np.arange(100), np.column_stack([np.eye(3), [1, 2, 3]]))
    baked = bake(scene)
    assert np.allclose(baked.means, g.means + np.array([1, 2, 3]))
    for name in ("quats", "log_scales", "logit_opacities", "sh"):
        assert np.array_equal(getattr(baked, name), getattr(g, name))
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert np.array_equal(getattr(g, name), getattr(copy, name))


def test_a_bake_works_on_the_scene_as_it_was_asked_for() -> None:
    scene = walk_scene(100)
    stage = bake_stage(scene)
    next(stage)
    _placed(scene, np.arange(100), random_affine(np.random.default_rng(1)))
    assert np.array_equal(run_stage(stage).means, scene.gaussians.means)


def test_normals_turn_with_the_splats() -> None:
    rng = np.random.default_rng(0)
    g = random_gaussians(50)
    normals = _directions(rng, 50).astype(np.float32)
    extra = {name: normals[:, i].copy() for i, name in enumerate(("nx", "ny", "nz"))}
    turn = _rotation(rng)
    scene = Scene.of(replace(g, extra=extra))
    _placed(scene, np.arange(50), np.column_stack([turn, np.zeros(3)]))
    baked = bake(scene).extra
    turned = np.stack([baked["nx"], baked["ny"], baked["nz"]], axis=1)
    assert np.allclose(turned, normals @ turn.T, atol=1e-6)
