"""Decimation: fewer splats, the same look, and never across objects."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.export.export import export_objects_stage, export_scene_stage, least_psnr
from gaga_core.export.options import ExportOptions
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.splat_files import read_splats
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene.reduce import decimate_stage, picture_loss_stage
from gaga_core.scene.scene import Scene
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def balls() -> Synthetic:
    return objects_scene(4, 500, n_cameras=3)


def _decimated(scene: Synthetic, share: float) -> tuple[Gaussians, float]:
    fewer, _ = run_stage(decimate_stage(scene.gaussians, share, scene.labels))
    loss = picture_loss_stage(scene.gaussians, fewer, scene.cameras, CpuRasterizer())
    return fewer, run_stage(loss)


def test_a_quarter_of_the_splats_looks_better_than_any_quarter_of_them(balls: Synthetic) -> None:
    fewer, psnr = _decimated(balls, 0.25)
    assert len(fewer) == round(0.25 * len(balls.gaussians))
    some = np.random.default_rng(0).permutation(len(balls.gaussians))[: len(fewer)]
    chosen = balls.gaussians.take(some)
    sample = run_stage(picture_loss_stage(balls.gaussians, chosen, balls.cameras, CpuRasterizer()))
    assert psnr > 22
    assert psnr > sample + 4
    assert _decimated(balls, 0.5)[1] > psnr, "the more is kept, the less is lost"


def test_objects_do_not_mix_and_everything_else_is_as_asked(balls: Synthetic) -> None:
    """No color between two objects, even where there is one splat left of each."""
    labels = balls.labels
    fewer, rows = run_stage(decimate_stage(balls.gaussians, 1e-9, labels))
    assert len(fewer) == len(np.unique(labels))
    assert sorted(labels[rows]) == list(np.unique(labels))
    for group in np.unique(labels):
        mean = balls.gaussians.means[labels == group].mean(axis=0)
        assert np.linalg.norm(fewer.means - mean, axis=1).min() < 0.05
    same, _ = run_stage(decimate_stage(balls.gaussians, 1.0))
    assert same is balls.gaussians
    loss = picture_loss_stage(same, same, balls.cameras[:1], CpuRasterizer())
    assert run_stage(loss) == 99
    with pytest.raises(ValueError, match="share"):
        run_stage(decimate_stage(balls.gaussians, 0.0))


def test_splats_that_are_not_finite_stay_and_hurt_nobody(balls: Synthetic) -> None:
    means = balls.gaussians.means.copy()
    means[:3] = [[np.nan, 0, 0], [np.inf, 0, 0], [0, -np.inf, 0]]
    fewer, _ = run_stage(decimate_stage(replace(balls.gaussians, means=means), 0.25))
    assert np.isnan(fewer.means[:, 0]).sum() == 1
    assert (~np.isfinite(fewer.means).all(axis=1)).sum() == 3


def test_an_export_says_what_its_decimation_loses(balls: Synthetic, tmp_path: Path) -> None:
    scene = Scene.of(balls.gaussians, balls.labels)
    options = ExportOptions(decimate=0.25)
    made = run_stage(export_scene_stage(scene, tmp_path / "s.ply", groups=True, options=options))
    back = read_splats(tmp_path / "s.ply")
    assert made.n_splats == len(back) == round(0.25 * len(scene))
    assert made.psnr is not None
    assert 20 < made.psnr < 60
    before = np.bincount(balls.labels) / len(scene)
    after = np.bincount(back.extra["group"]) / len(back)
    assert np.abs(before - after).max() < 0.15, "a column of groups survives"
    manifest = run_stage(export_objects_stage(scene, tmp_path / "o", [1, 2], options=options))
    rows = json.loads(manifest.read_text(encoding="utf-8"))["groups"]
    assert [row["count"] for row in rows] == [125, 125]
    assert least_psnr(manifest) == min(row["psnr"] for row in rows)
    plain = run_stage(export_objects_stage(scene, tmp_path / "p", [1]))
    assert least_psnr(plain) is None
