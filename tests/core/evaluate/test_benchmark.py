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

from gaga_core.arrays import BoolArray, IntArray
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.evaluate.benchmark.prompts import Answers, FindConfig, Question
from gaga_core.evaluate.benchmark.run import BenchmarkConfig, run_benchmark
from gaga_core.evaluate.benchmark.splats import trained_splats
from gaga_core.evaluate.benchmark_tables import BenchmarkReport, InstanceScores, PromptScores
from gaga_core.evaluate.protocol import PUBLISHED_RULE, departures
from gaga_core.evaluate.published import INSTANCE
from gaga_core.evaluate.published import PROMPTS as PUBLISHED
from gaga_core.evaluate.sparse import sparse_views
from gaga_core.grouping.bank_file import read_groups
from gaga_core.grouping.votes import VOID_BELOW, splat_groups
from gaga_core.io.datasets.catalog import DATASETS, open_dataset
from gaga_core.io.masks import read_labels
from gaga_core.io.scene_folder import read_model, select_views
from gaga_core.pipeline.reconstruct import ReconstructConfig
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.raster import choose
from tests.datasets import (
    PROMPTS,
    gaga_replica,
    lerf_mask,
    mipnerf360,
    ovs3d,
    semantic_nerf,
    tiny,
    write_map,
)

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def replica(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("replica")
    gaga_replica(root / "office_0")
    semantic_nerf(root / "room_0")
    return root


@pytest.fixture(scope="module")
def report(replica: Path, tmp_path_factory: pytest.TempPathFactory) -> BenchmarkReport:
    out = tmp_path_factory.mktemp("out")
    config = BenchmarkConfig(preset="paper", lift="vote", shares=(0.5,))
    return run_stage(run_benchmark(open_dataset("replica", replica), out, config))


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
    few = [np.where(m > 7, np.int32(7), m) for m in maps]  # all pairings of few ids can be tried
    truth = [tiny().labels[k] for k in (1, 3, 5, 7)]
    if all(np.array_equal(a, b) for a, b in zip(few, maps, strict=True)):
        run = office.run(1.0)
        assert run is not None
        assert isinstance(run.scores, InstanceScores)
        score = run.scores.with_void
        assert (score.iou, score.precision, score.recall) == pytest.approx(algorithm_1(truth, maps))
        assert run.n_views == 4
        assert score.iou > 0.5
    else:
        pytest.fail("the miniature scene has too many groups to try all pairings")


def test_the_same_scene_in_two_layouts_scores_the_same(report: BenchmarkReport) -> None:
    office, room = report.scenes
    for a, b in zip(office.runs, room.runs, strict=True):
        assert a.scores == b.scores
        assert a.n_groups == b.n_groups


def test_tables_tell_ours_and_the_published_figures(report: BenchmarkReport) -> None:
    first, void_free, sparse, apart = (table.table() for table in report.tables())
    for row, bare, scene in zip(first[1:3], void_free[1:3], report.scenes, strict=True):
        scores = scene.runs[0].scores
        assert isinstance(scores, InstanceScores)
        for cells, score in ((row, scores.with_void), (bare, scores.without_void)):
            figures = (score.iou, score.precision, score.recall)
            assert cells[1:4] == [f"{100 * value:.2f}" for value in figures]
    values = [[float(cell) for cell in row[1:4]] for row in first[1:3]]
    assert first[3][0] == "mean of 2 scenes"
    assert [float(cell) for cell in first[3][1:4]] == pytest.approx(np.mean(values, 0), abs=0.006)
    assert len(first) == 4  # two of eight scenes: the published means stand apart
    assert {row[0]: row[1:] for row in apart[1:]}["Gaga, SAM"] == ["46.21", "39.53", "50.62"]
    assert len(apart) == 1 + len(INSTANCE["replica"])
    assert len(void_free) == 4
    assert [row[0] for row in sparse] == ["train views", "100%", "50%"]
    whole, half = (float(row[2]) for row in sparse[1:])
    assert whole == float(first[3][1])
    assert sparse[2][3] == f"{100 * (whole - half) / whole:.1f} %"
    run = report.scenes[0].run(0.5)
    assert run is not None
    assert run.n_views == 2
    saved = json.loads((Path(report.out) / "office_0.json").read_text())
    assert [entry["share"] for entry in saved["runs"]] == [1.0, 0.5]
    assert report.to_json()["means"] == {
        "1.0": pytest.approx(whole / 100, abs=1e-4),
        "0.5": pytest.approx(half / 100, abs=1e-4),
    }


def test_each_table_names_how_identities_were_made(replica: Path, tmp_path: Path) -> None:
    """Preset paper trains them as published; the groups alone are scored with "none"."""
    assert BenchmarkConfig(preset="paper").lifted_by == "paper"
    assert BenchmarkConfig(preset="robust").lifted_by == "vote"
    with pytest.raises(GagaError, match="no lift"):
        BenchmarkConfig(lift="magic")  # type: ignore[arg-type]
    config = BenchmarkConfig(preset="paper", lift="none")
    data = open_dataset("replica", replica, ("office_0",))
    bare = run_stage(run_benchmark(data, tmp_path, config))
    assert bare.tables()[0].table()[0][0] == "Replica, paper, groups"
    root = Path(bare.out) / "office_0" / "views_all"
    gaussians = run_stage(read_model(data.scenes[0].folder))
    own = replace(data.scenes[0].folder, root=root)
    labels = read_groups(own, len(gaussians))[0]
    for camera in select_views(own, "test"):
        written = read_labels(root / "groups" / Path(camera.name).with_suffix(".png").name)
        assert np.array_equal(written, splat_groups(choose(), gaussians, camera, labels))


def test_a_benchmark_that_was_stopped_goes_on(replica: Path, tmp_path: Path) -> None:
    data = open_dataset("replica", replica)
    config = BenchmarkConfig(preset="paper", lift="vote", shares=(0.5,))
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

    plain = BenchmarkConfig(preset="paper", lift="vote")
    assert [reused(plain), reused(plain)] == [0, 1]
    assert reused(BenchmarkConfig(preset="paper", lift="vote", redo=True)) == 0
    assert (
        reused(BenchmarkConfig(preset="paper", lift="vote", shares=(0.5,))) == 1
    )  # the sparse run is added
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
    config = BenchmarkConfig(preset="paper", lift="vote", masks="raw_sam_mask")
    report = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert [scene.scene for scene in report.scenes] == ["room_0"]
    assert "no COLMAP model" in report.failed["office_0"]
    assert "no scene room_7" in report.failed["room_7"]
    first = report.tables()[0].table()
    assert [row[-1] for row in first if row[0] in report.failed] == ["failed", "failed"]
    assert first[-1][0] == "mean of 1 of 3 scenes"
    unsure = run_stage(
        run_benchmark(data, tmp_path / "out", BenchmarkConfig(preset="paper", lift="vote"))
    )
    assert "several mask folders: raw_other_mask, raw_sam_mask" in unsure.failed["room_0"]
    wrong = BenchmarkConfig(preset="paper", lift="vote", masks="raw_sma_mask")
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


def oracle(question: Question, phrases: Sequence[str]) -> Stage[Answers]:
    """The group with most of the true pixels of a phrase, in the first test view."""
    yield Progress("Ask", 0, 1)
    camera = question.views[0]
    k = int(Path(camera.name).stem.rsplit("_", 1)[-1])
    answers = {}
    for wanted, phrase in PROMPTS.items():
        groups = read_labels(question.maps[camera.name])[tiny().labels[k] == wanted]
        if phrase in phrases and phrase != "old ball":
            answers[phrase] = [int(np.bincount(groups[groups > 0]).argmax())]
    return answers


def binary_iou(a: BoolArray, b: BoolArray) -> float:
    return float((a & b).sum() / (a | b).sum()) if (a | b).any() else 1.0


def test_prompts_are_scored_by_phrase_and_unanswered_ones_count_as_nothing(tmp_path: Path) -> None:
    lerf_mask(tmp_path / "data" / "figurines")
    data = open_dataset("lerf-mask", tmp_path / "data")
    config = BenchmarkConfig(preset="paper", lift="vote")
    report = run_stage(run_benchmark(data, tmp_path / "out", config, find=oracle))
    assert report.failed == {}
    assert report.departures() == [f"queries: given, not {PUBLISHED_RULE}"]
    run = report.scenes[0].runs[0]
    assert isinstance(run.scores, PromptScores)
    assert run.missing == ("0/old ball", "2/old ball")
    by_prompt = []
    for wanted, text in PROMPTS.items():
        values = []
        for key, k in (("0", 2), ("2", 6)):
            file = tmp_path / "out/figurines/views_all/prompts" / key / f"{text}.png"
            if file.is_file():
                mask = np.asarray(Image.open(file)) > 128
                values.append(binary_iou(mask, tiny().labels[k] == wanted))
            else:
                values.append(0.0)
        by_prompt.append(float(np.mean(values)))
        assert run.scores.by_prompt[text][0] == pytest.approx(by_prompt[-1])
    assert run.scores.miou == pytest.approx(np.mean(by_prompt))
    assert by_prompt[0] > 0.5
    assert by_prompt[2] == 0
    heads, scene, mean = report.tables()[0].table()
    assert heads[1:] == ["mIoU", "mBIoU", "missing"]  # not asked as published: the figures apart
    assert scene[1:3] == mean[1:3]
    assert report.tables()[1].table()[1] == ["figurines", "92.3", "90.8"]
    same = replace(
        report.scenes[0],
        conditions=replace(report.scenes[0].conditions, queries=f"{PUBLISHED_RULE}, first view"),
    )
    (table,) = replace(report, scenes=(same,)).tables()
    heads, scene, mean = table.table()
    assert heads[1:] == ["mIoU", "mBIoU", "published mIoU", "published mBIoU", "missing"]
    assert scene[3:] == [*(f"{v:.1f}" for v in PUBLISHED["lerf-mask"]["figurines"]), "2"]
    assert mean[3:5] == scene[3:5]


def test_a_pixel_is_a_prompts_where_a_group_is_probable_enough(tmp_path: Path) -> None:
    """The published rule: probability over 0.2, not the most probable group."""
    lerf_mask(tmp_path / "data" / "figurines")
    data = open_dataset("lerf-mask", tmp_path / "data")
    asked: list[Question] = []

    def find(question: Question, phrases: Sequence[str]) -> Stage[Answers]:
        asked.append(question)
        yield Progress("Ask", 0, 1)
        return {"red ball": [1, 2]}

    config = BenchmarkConfig(preset="paper", lift="vote")
    run_stage(run_benchmark(data, tmp_path / "out", config, find=find))
    field, camera = asked[0].field, asked[0].views[0]
    assert field is not None
    frame = choose("cpu").render(asked[0].scene.gaussians, camera, channels=field.encodings)
    scores = frame.image.astype(np.float64) @ field.weight.T + field.bias
    chance = np.exp(scores - scores.max(axis=2, keepdims=True))
    chance /= chance.sum(axis=2, keepdims=True)
    wanted = (chance[..., [1, 2]].max(axis=2) > 0.2) & (frame.alpha >= VOID_BELOW)
    mask = np.asarray(Image.open(tmp_path / "out/figurines/views_all/prompts/0/red ball.png")) > 128
    assert (mask != wanted).mean() < 0.001
    labels = read_labels(asked[0].maps[camera.name])
    assert (mask & ~np.isin(labels, [1, 2])).any()


@pytest.mark.parametrize("who", ["words", "index", "detector", "boxes"])
def test_prompts_are_answered_by_words_an_index_or_a_detector(who: str, tmp_path: Path) -> None:
    """Random weights mean nothing, so only the way through is tested."""
    from tests.core.query.tiny_query_models import write_clip, write_grounding_dino

    find = FindConfig()
    if who == "index":
        find = FindConfig(embedder=write_clip(tmp_path / "clip"))
    if who == "detector":
        find = FindConfig(detector=write_grounding_dino(tmp_path / "dino"))
    if who == "boxes":
        from tests.core.segmentation.tiny_models import save_tiny

        save_tiny("sam2", tmp_path / "sam2")
        dino = write_grounding_dino(tmp_path / "dino")
        find = FindConfig(detector=dino, segmenter=str(tmp_path / "sam2"))
    lerf_mask(tmp_path / "data" / "figurines")
    data = open_dataset("lerf-mask", tmp_path / "data")
    config = BenchmarkConfig(preset="paper", lift="vote", find=find)
    report = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert report.failed == {}
    run = report.scenes[0].runs[0]
    assert isinstance(run.scores, PromptScores)
    assert set(run.scores.by_prompt) == set(PROMPTS.values())
    assert (report.departures() == []) == (who == "boxes")
    assert any(f"Queries: {find.words}." in table.notes for table in report.tables())
    again = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert again.scenes[0].n_reused == 1
    assert again.scenes[0].runs[0] == run
    if who != "words":
        other = run_stage(
            run_benchmark(data, tmp_path / "out", BenchmarkConfig(preset="paper", lift="vote"))
        )
        assert other.scenes[0].n_reused == 0


def test_true_masks_as_predictions_are_perfect_on_3d_ovs(tmp_path: Path, capsys: Capture) -> None:
    ovs3d(tmp_path / "data" / "bed")
    ovs3d(tmp_path / "data" / "lawn")
    shutil.copytree(tmp_path / "data" / "bed" / "segmentations", tmp_path / "pred" / "bed")
    shutil.copy(
        tmp_path / "pred/bed/00/red ball.png", tmp_path / "pred" / "bed" / "00" / "red_ball.png"
    )
    arguments = ["benchmark", "3d-ovs", str(tmp_path / "data"), "--pred", str(tmp_path / "pred")]
    assert main([*arguments, "--out", str(tmp_path / "out"), "--json"]) == 0
    said = capsys.readouterr()
    values = json.loads(said.out)
    assert values["tables"][0][1] == ["bed", "100.0", "97.4", "0"]
    assert values["tables"][0][2] == ["lawn", "0.0", "97.1", "6"]
    assert values["tables"][0][3] == ["mean of 2 scenes", "50.0", "97.2", "6"]
    assert "lawn: 6 predictions are missing and count as 0" in said.err
    assert "bed: 1 predictions answer no prompt of the data set (00/red_ball, ...)" in said.err


def test_the_command_prints_the_table_and_refuses_nonsense(
    replica: Path, tmp_path: Path, capsys: Capture
) -> None:
    base = [
        "benchmark",
        "replica",
        str(replica),
        "--preset",
        "paper",
        "--lift",
        "vote",
        "--out",
        str(tmp_path),
    ]
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
    report = run_stage(
        run_benchmark(data, tmp_path / "out", BenchmarkConfig(preset="paper", lift="vote"))
    )
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
    again = run_stage(
        run_benchmark(data, tmp_path / "out", BenchmarkConfig(preset="paper", lift="vote"))
    )
    assert [scene.n_reused for scene in again.scenes] == [1, 1]
    with pytest.raises(GagaError, match="no preset"):
        BenchmarkConfig(preset="magic")


def test_a_scene_without_masks_gets_regions(tmp_path: Path) -> None:
    gaga_replica(tmp_path / "data" / "office_0", masks=False)
    data = open_dataset("replica", tmp_path / "data")
    config = BenchmarkConfig(preset="paper", lift="vote")
    report = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert report.failed == {}
    assert report.scenes[0].masks == "regions"
    assert any("not SAM ViT-H's or EntitySeg's" in reason for reason in report.departures())
    made = tmp_path / "out" / "office_0" / "masks" / "regions"
    assert len(list(made.glob("train_rgb_*.png"))) == 4
    assert not (tmp_path / "data" / "office_0" / "masks").exists()
    again = run_stage(run_benchmark(data, tmp_path / "out", config))
    assert again.scenes[0].n_reused == 1


def test_published_figures_stand_next_to_ours_only_when_measured_alike(
    report: BenchmarkReport,
) -> None:
    """All scenes, the publisher's split and truth, masks of its segmenters: else apart."""
    office = report.scenes[0]
    names = DATASETS["replica"].scenes
    whole = replace(report, scenes=tuple(replace(office, scene=name) for name in names))
    assert whole.departures() == []
    title = "published (comparison on Replica): Gaga, SAM"
    first = [row[0] for row in whole.tables()[0].table()]
    assert title in first
    assert "published, SAM" in whole.tables()[-1].table()[0]
    usual = office.conditions
    changes = {
        "split.json": replace(usual, split="split.json"),
        "instance-filt (raw)": replace(usual, truth="instance-filt (raw)"),
        "regions": replace(usual, masks="regions"),
        "samples": replace(usual, masks="samples (made elsewhere)"),
        "raw_sam_mask": replace(usual, masks="raw_sam_mask (regions (no model))"),
        "SAM 2.1": replace(usual, masks="sam (SAM 2.1 Hiera tiny)"),
        "SAM-HQ": replace(usual, masks="sam (SAM-HQ ViT-H)"),
        "ViT-B": replace(usual, masks="sam (SAM ViT-B)"),
        "sam_vit_l": replace(usual, masks="own (sam (sam_vit_l_0b3195.pth))"),
        "32 points": replace(usual, masks="sam (SAM ViT-H, 32 points a side, predicted IoU 0.88)"),
    }
    of_paper = "mine (SAM ViT-H, 64 points a side, predicted IoU 0.7)"
    for masks in (of_paper, "raw_sam_mask (made elsewhere)", "raw_entityseg_mask (made elsewhere)"):
        assert departures("replica", "office_0", replace(usual, masks=masks)) == ()
    for value, conditions in changes.items():
        other = replace(office, conditions=conditions)
        one = replace(whole, scenes=(other, *whole.scenes[1:]))
        assert title not in [row[0] for row in one.tables()[0].table()]
        assert "published, SAM" not in one.tables()[2].table()[0]
        assert any(value in note for note in one.tables()[-1].notes)
        assert "Gaga, SAM" in [row[0] for row in one.tables()[-1].table()]
    fewer = replace(whole, scenes=whole.scenes[1:])
    assert title not in [row[0] for row in fewer.tables()[0].table()]


def test_every_table_says_how_it_was_made(report: BenchmarkReport) -> None:
    for table in report.tables()[:3]:
        said = "\n".join(table.notes)
        assert "Split: names train_* and test_* (office_0)." in said
        assert "Truth: semantic_instance." in said
        assert "Masks: raw_sam_mask (made elsewhere)." in said
        assert "Counted" in said
        assert "Scenes: 2 of the 8 of the data set, without office_1" in said
        assert "Splats: as found" in said
    assert "splats of all training views are used" in "\n".join(report.tables()[2].notes)


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
    assert any("trained here on the training views alone" in s for s in report.made())
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
