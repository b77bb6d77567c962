"""The benchmark over miniature data sets: figures by another way, resuming, failures."""

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import IntArray
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.evaluate.benchmark.run import run_benchmark, trained_splats
from gaga_core.evaluate.benchmark.tables import BenchmarkReport, InstanceScores
from gaga_core.evaluate.published import sparse_views
from gaga_core.evaluate.settings import BenchmarkConfig
from gaga_core.io.datasets import open_dataset
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.datasets import (
    gaga_replica,
    mipnerf360,
    semantic_nerf,
    tiny,
    write_map,
)

Capture = pytest.CaptureFixture[str]
VOTED = BenchmarkConfig(preset="paper", lift="vote")


def algorithm_1(true: Sequence[IntArray], predicted: Sequence[IntArray]) -> tuple[float, ...]:
    """IoU, precision, recall of the supplement, written out; pairs by trying all of them."""
    true_ids = sorted(set(np.unique(np.stack(true)).tolist()))
    ids = sorted(set(np.unique(np.stack(predicted)).tolist()))
    iou = np.zeros((len(true_ids), max(len(true_ids), len(ids))))
    for i, t in enumerate(true_ids):
        for j, p in enumerate(ids):
            values = [
                float(((a == t) & (b == p)).sum() / ((a == t) | (b == p)).sum())
                for a, b in zip(true, predicted, strict=True)
                if (a == t).any()
            ]
            iou[i, j] = float(np.mean(values))
    best = max(
        (
            iou[np.arange(len(true_ids)), list(columns)]
            for columns in permutations(range(iou.shape[1]), len(true_ids))
        ),
        key=lambda paired: float(paired.sum()),
    )
    hits = int((best > 0.5).sum())
    return float(best.mean()), hits / len(ids), hits / len(true_ids)


def test_figures_are_those_of_the_written_maps(report: BenchmarkReport) -> None:
    assert report.failed == {}
    assert [scene.scene for scene in report.scenes] == ["office_0", "room_0"]
    office = report.scenes[0]
    folder = Path(report.out) / "office_0" / "views_all" / "groups"
    maps = [read_labels(path) for path in sorted(folder.iterdir())]
    assert len(maps) == 4
    assert max(int(m.max()) for m in maps) <= 7, "all pairings of few ids can be tried"
    run = office.run(1.0)
    assert run is not None
    assert isinstance(run.scores, InstanceScores)
    score = run.scores.with_void
    truth = [tiny().labels[k] for k in (1, 3, 5, 7)]
    assert (score.iou, score.precision, score.recall) == pytest.approx(algorithm_1(truth, maps))
    assert run.n_views == 4
    assert score.iou > 0.5


def test_the_same_scene_in_two_layouts_scores_the_same(report: BenchmarkReport) -> None:
    office, room = report.scenes
    for a, b in zip(office.runs, room.runs, strict=True):
        assert a.scores == b.scores
        assert a.n_groups == b.n_groups


def test_a_benchmark_that_was_stopped_goes_on(replica: Path, tmp_path: Path) -> None:
    data = open_dataset("replica", replica)
    config = replace(VOTED, shares=(0.5,))
    stage = run_benchmark(data, tmp_path, config)
    for step in stage:
        if "room_0" in step.message:
            break
    stage.close()
    assert (tmp_path / "office_0.json").is_file()
    assert not (tmp_path / "room_0.json").exists()
    assert not list(tmp_path.rglob(".gaga-*"))
    written = (tmp_path / "office_0.json").stat().st_mtime_ns
    again = run_stage(run_benchmark(data, tmp_path, config))
    assert [scene.n_reused for scene in again.scenes] == [2, 0]
    assert (tmp_path / "office_0.json").stat().st_mtime_ns == written
    third = run_stage(run_benchmark(data, tmp_path, config))
    assert [scene.n_reused for scene in third.scenes] == [2, 2]
    assert [scene.runs for scene in third.scenes] == [scene.runs for scene in again.scenes]


def test_other_settings_or_masks_are_run_anew(replica: Path, tmp_path: Path) -> None:
    shutil.copytree(replica / "office_0", tmp_path / "data" / "office_0")

    def reused(config: BenchmarkConfig) -> int:
        data = open_dataset("replica", tmp_path / "data")
        return run_stage(run_benchmark(data, tmp_path / "out", config)).scenes[0].n_reused

    plain = VOTED
    assert [reused(plain), reused(plain)] == [0, 1]
    assert reused(replace(VOTED, redo=True)) == 0
    assert reused(replace(VOTED, shares=(0.5,))) == 1  # the sparse run is added
    assert reused(plain) == 1
    first = sorted((tmp_path / "data" / "office_0" / "raw_sam_mask").iterdir())[0]
    write_map(first, np.zeros((60, 80), np.int32))
    assert reused(plain) == 0
    assert reused(BenchmarkConfig(preset="robust")) == 0
    (tmp_path / "out" / "office_0.json").write_text("{")
    assert reused(plain) == 0


def test_a_scene_that_fails_is_named_and_the_others_go_on(replica: Path, tmp_path: Path) -> None:
    shutil.copytree(replica, tmp_path / "data")
    shutil.rmtree(tmp_path / "data" / "office_0" / "sparse")
    (tmp_path / "data" / "room_0" / "raw_other_mask").mkdir()
    data = open_dataset("replica", tmp_path / "data", ["office_0", "room_0", "room_7"])
    config = replace(VOTED, masks="raw_sam_mask")
    report = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert [scene.scene for scene in report.scenes] == ["room_0"]
    assert "no COLMAP model" in report.failed["office_0"]
    assert "no scene room_7" in report.failed["room_7"]
    first = report.tables()[0].table()
    assert [row[-1] for row in first if row[0] in report.failed] == ["failed", "failed"]
    assert first[-1][0] == "mean of 1 of 3 scenes"
    unsure = run_stage(run_benchmark(data, tmp_path / "out", VOTED))
    assert "several mask folders: raw_other_mask, raw_sam_mask" in unsure.failed["room_0"]
    wrong = replace(VOTED, masks="raw_sma_mask")
    unsure = run_stage(run_benchmark(data, tmp_path / "out", wrong))
    assert "There: raw_other_mask, raw_sam_mask" in unsure.failed["room_0"]
    assert unsure.tables()[0].table()


def test_given_predictions_are_scored_and_missing_ones_count_as_nothing(
    replica: Path, tmp_path: Path
) -> None:
    names = ("test_rgb_0000.png", "test_rgb_0001.png", "test_rgb_0002.png")
    for name, k in zip(names, (1, 3, 5), strict=True):
        write_map(tmp_path / "pred" / "office_0" / name, tiny().labels[k] * 3)
    config = BenchmarkConfig(pred=tmp_path / "pred")
    report = run_stage(run_benchmark(open_dataset("replica", replica), tmp_path / "out", config))
    office, room = (scene.runs[0] for scene in report.scenes)
    assert office.missing == ("test_rgb_0003.png",)
    assert room.missing == ("rgb_12.png", "rgb_17.png", "rgb_22.png", "rgb_27.png")
    assert isinstance(office.scores, InstanceScores)
    assert isinstance(room.scores, InstanceScores)
    # Every label is right in the three maps that are there, and 0 in the fourth if it shows there.
    ids = np.unique(np.stack([tiny().labels[k] for k in (1, 3, 5, 7)]))
    per_label = []
    for wanted in ids:
        shown = [bool((tiny().labels[k] == wanted).any()) for k in (1, 3, 5, 7)]
        per_label.append(sum(shown[:3]) / sum(shown))
    assert office.scores.with_void.iou == pytest.approx(np.mean(per_label))
    assert room.scores.with_void.iou == room.scores.with_void.recall == 0
    assert any("4 predictions are missing" in sentence for sentence in report.sentences())


def test_the_command_prints_the_table_and_refuses_nonsense(
    replica: Path, tmp_path: Path, capsys: Capture
) -> None:
    base = ["benchmark", "replica", str(replica), "--preset", "paper", "--lift", "vote"]
    base += ["--out", str(tmp_path)]
    assert main([*base, "--scenes", "office_0", "--sparse", "50"]) == 0
    assert "office_0" in capsys.readouterr().out
    assert main([*base, "--scenes", "office_0", "attic", "--sparse", "50"]) == 1
    said = capsys.readouterr()
    assert "no scene attic" in said.err
    assert "2 runs were finished before" in said.err
    assert main([*base, "--sparse", "half"]) == 1
    assert "percentages" in capsys.readouterr().err
    assert main([*base, "--sparse", "130"]) == 1
    assert "no share" in capsys.readouterr().err
    assert main([*base, "--pred", str(tmp_path / "nowhere")]) == 1
    assert main([*base, "--pred", str(tmp_path), "--sparse", "50"]) == 1
    assert "no train views" in capsys.readouterr().err
    assert main(["benchmark", "scannet", str(replica)]) == 1
    assert "no scene of ScanNet" in capsys.readouterr().err


def test_colmap_scenes_with_true_maps_are_scored_and_others_are_shown(tmp_path: Path) -> None:
    mipnerf360(tmp_path / "data" / "a", truth=True)
    mipnerf360(tmp_path / "data" / "b")
    data = open_dataset("mipnerf360", tmp_path / "data")
    report = run_stage(run_benchmark(data, tmp_path / "out", VOTED))
    assert report.failed == {}
    scored, shown = (scene.runs[0] for scene in report.scenes)
    assert isinstance(scored.scores, InstanceScores)
    assert shown.scores is None
    root = tmp_path / "out" / "b" / "views_all"
    with Image.open(root / "contact_sheet.png") as sheet:
        assert sheet.size == (3 * 400, 300)  # photo, picture and groups of the one test view
    assert (root / "film.mp4").stat().st_size > 1000
    assert report.to_json()["means"] == {"1.0": scored.headline}
    first, *_, last = (table.table() for table in report.tables())
    assert [row[0] for row in first[1:]] == ["a", "mean of 1 of 2 scenes"]
    assert [row[0] for row in last[1:]] == ["b"]
    again = run_stage(run_benchmark(data, tmp_path / "out", VOTED))
    assert [scene.n_reused for scene in again.scenes] == [1, 1]
    with pytest.raises(GagaError, match="no preset"):
        BenchmarkConfig(preset="magic")  # type: ignore[arg-type]


def test_a_scene_without_masks_gets_regions(tmp_path: Path) -> None:
    gaga_replica(tmp_path / "data" / "office_0", masks=False)
    data = open_dataset("replica", tmp_path / "data")
    report = run_stage(run_benchmark(data, tmp_path / "out", VOTED))
    assert report.failed == {}
    assert report.scenes[0].masks == "regions"
    assert any("not SAM ViT-H's or EntitySeg's" in reason for reason in report.departures())
    made = tmp_path / "out" / "office_0" / "masks" / "regions"
    assert len(list(made.glob("train_rgb_*.png"))) == 4
    assert not (tmp_path / "data" / "office_0" / "masks").exists()
    again = run_stage(run_benchmark(data, tmp_path / "out", VOTED))
    assert again.scenes[0].n_reused == 1


# --- What a benchmark trains itself: splats of the training views alone.


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
