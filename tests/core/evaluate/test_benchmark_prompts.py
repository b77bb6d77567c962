"""The benchmark of prompts: phrases are answered, scored, and counted where nobody answers."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import BoolArray
from gaga_core.cli.main import main
from gaga_core.evaluate.benchmark.prompts import Answers, Question, words_of
from gaga_core.evaluate.benchmark.run import run_benchmark
from gaga_core.evaluate.benchmark.tables import PromptScores
from gaga_core.evaluate.published import PROMPTS as PUBLISHED
from gaga_core.evaluate.published import PUBLISHED_RULE
from gaga_core.evaluate.settings import BenchmarkConfig, FindConfig
from gaga_core.grouping.votes import VOID_BELOW
from gaga_core.io.datasets import open_dataset
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.raster import choose
from tests.datasets import (
    PROMPTS,
    lerf_mask,
    ovs3d,
    tiny,
)

Capture = pytest.CaptureFixture[str]


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
    # The threshold table: its published mIoU is next to ours, its mBIoU is not known.
    at = replace(report, scenes=(same,), changes="threshold 0.2", threshold=0.2)
    (table,) = at.tables()
    heads, scene, mean = table.table()
    assert scene[1:] == [*scene[1:3], "85.8", "", "2"]
    assert all(float(value) > 0 for value in scene[1:3])
    apart = replace(at, scenes=report.scenes).tables()[1].table()
    assert apart[0][1:] == ["mIoU"]
    assert apart[1:] == [["figurines", "85.8"], ["ramen", "51.3"], ["teatime", "71.7"]]
    other = replace(at, changes="inlier factor 2.0", threshold=None)
    assert other.departures() == ["settings: inlier factor 2.0"]


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
    assert any(f"Queries: {words_of(find)}." in table.notes for table in report.tables())
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
