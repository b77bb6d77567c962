"""What a benchmark trains itself: splats of the training views alone."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from gaga_core.errors import GagaError
from gaga_core.evaluate.benchmark.run import run_benchmark, trained_splats
from gaga_core.evaluate.benchmark.tables import BenchmarkReport
from gaga_core.evaluate.published import sparse_views
from gaga_core.evaluate.settings import BenchmarkConfig
from gaga_core.io.datasets import open_dataset
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.datasets import (
    gaga_replica,
    semantic_nerf,
)


def test_missing_splats_are_trained_on_the_training_views_alone(tmp_path: Path) -> None:
    """The test photos cannot even be read; those of few views are trained on these alone."""
    names = gaga_replica(tmp_path / "data" / "office_0")
    shutil.rmtree(tmp_path / "data" / "office_0" / "point_cloud")
    train = [name for name in names.values() if name.startswith("train")]
    for name in set(names.values()) - set(train):
        (tmp_path / "data" / "office_0" / "images" / name).write_bytes(b"not a picture")
    settings = ReconstructConfig(quality="draft", iterations=3, max_side=64, max_splats=1000)
    config = BenchmarkConfig(
        preset="paper", lift="none", shares=(0.5,), train=settings, retrain_sparse=True
    )
    data = open_dataset("replica", tmp_path / "data")
    report = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert report.failed == {}
    out = tmp_path / "out" / "office_0"
    assert json.loads((out / "splats" / "splats.json").read_text())["views"] == train
    few = json.loads((out / "splats_50" / "splats.json").read_text())["views"]
    assert few == list(sparse_views(train, 0.5, config.seed))
    assert any("iterations (published: 30,000)" in s for s in report.made())
    assert "trained again on those views alone" in "\n".join(report.tables()[2].notes)
    written = (out / "splats" / "point_cloud.ply").stat().st_mtime_ns
    again = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert [scene.n_reused for scene in again.scenes] == [2]
    assert (out / "splats" / "point_cloud.ply").stat().st_mtime_ns == written
    given = tmp_path / "data" / "office_0" / "point_cloud" / "iteration_3"
    given.mkdir(parents=True)
    shutil.copy(out / "splats" / "point_cloud.ply", given)
    for n_reused in (0, 2):
        data = open_dataset("replica", tmp_path / "data")
        report = run_stage(run_benchmark(data, tmp_path / "out", config))
        assert [scene.n_reused for scene in report.scenes] == [n_reused]
    os.utime(data.scenes[0].folder.image_paths[train[0]], (1, 1))  # another photo, for all we know
    report = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert [scene.n_reused for scene in report.scenes] == [0]
    bare = replace(data.scenes[0].folder, image_paths={})
    with pytest.raises(GagaError, match="4 of its 4 training photos are missing"):
        run_stage(trained_splats(bare, settings, tmp_path / "none", choose("cpu")))


def test_masks_and_photos_of_test_views_take_no_part(
    report: BenchmarkReport, replica: Path, tmp_path: Path
) -> None:
    """They cannot even be read, and every figure is the same."""
    shutil.copytree(replica / "office_0", tmp_path / "data" / "office_0")
    for folder in ("raw_sam_mask", "images"):
        for path in (tmp_path / "data" / "office_0" / folder).glob("test_*"):
            path.write_bytes(b"not a picture")
    config = BenchmarkConfig(preset="paper", lift="vote")
    data = open_dataset("replica", tmp_path / "data")
    (scene,) = run_stage(run_benchmark(data, tmp_path / "out", config)).scenes
    assert scene.runs[0].scores == report.scenes[0].runs[0].scores
    assert scene.runs[0].n_groups == report.scenes[0].runs[0].n_groups


def test_poses_without_points_are_trained_from_random_ones(tmp_path: Path) -> None:
    """Semantic-NeRF's Replica has a trajectory and no COLMAP model."""
    semantic_nerf(tmp_path / "data" / "room_0")
    shutil.rmtree(tmp_path / "data" / "room_0" / "point_cloud")
    settings = ReconstructConfig(quality="draft", iterations=3, max_side=64, max_splats=1000)
    config = BenchmarkConfig(preset="paper", lift="none", train=settings)
    data = open_dataset("replica", tmp_path / "data")
    report = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert report.failed == {}
    made = json.loads((tmp_path / "out" / "room_0" / "splats" / "splats.json").read_text())
    assert made["views"] == ["rgb_10.png", "rgb_15.png", "rgb_20.png", "rgb_25.png"]
