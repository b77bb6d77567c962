"""``gaga query`` as a person or a script uses it."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.cli.main import main
from gaga_core.pipeline.search import INDEX_FILE
from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage, save_project
from tests.app.folders import write_scene
from tests.core.cli.calls import Capture, answer, refusal
from tests.core.query.tiny_query_models import write_clip, write_grounding_dino


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene folder with groups, and names in a saved project."""
    root = tmp_path / "scene"
    made = write_scene(root, masks=False)
    (root / "gaga").mkdir()
    confidence = np.ones(len(made.labels), np.float32)
    np.savez(root / "gaga" / "labels.npz", labels=made.labels, confidence=confidence)
    project = run_stage(open_path_stage(root))
    project.scene.names = {1: "beach ball", 2: "globe"}
    save_project(project)
    return root


def test_a_lone_file_with_a_group_column_is_asked_too(
    scene: Path, tmp_path: Path, capsys: Capture
) -> None:
    lone = tmp_path / "lone.ply"
    assert main(["export", str(scene), "--out", str(lone), "--groups"]) == 0
    found = answer(capsys, "query", str(lone), "largest")
    assert isinstance(found["groups"], list)
    assert len(found["groups"]) == 5
    nowhere = answer(capsys, "query", str(lone), "leftmost")
    assert "Places need a view." in str(nowhere["sentence"])
    assert "needs the views" in refusal(capsys, "query", str(lone), "red", "--in-view", "000")


def test_names_places_and_sizes_without_any_model(scene: Path, capsys: Capture) -> None:
    found = answer(capsys, "query", str(scene), "globes")
    groups = found["groups"]
    assert isinstance(groups, list)
    assert groups[0]["group"] == 2
    assert groups[0]["name"] == "globe"
    assert found["sentence"] == "1 object called “globes”."
    assert found["not_understood"] == []
    left = answer(capsys, "query", str(scene), "leftmost", "--top", "2")
    assert isinstance(left["groups"], list)
    assert len(left["groups"]) == 2
    assert "as seen from" in str(left["sentence"])
    by_view = {
        str(answer(capsys, "query", str(scene), "leftmost", "--in-view", f"{k:03d}")["groups"])
        for k in (0, 4)
    }
    assert len(by_view) == 2  # from the other side another one is leftmost


def test_a_person_reads_the_sentence_and_the_groups(scene: Path, capsys: Capture) -> None:
    assert main(["query", str(scene), "beach ball"]) == 0
    captured = capsys.readouterr()
    assert captured.err.strip() == "1 object called “beach ball”."
    assert captured.out.split() == ["1", "1.00", "beach", "ball"]


def test_an_index_is_made_kept_and_told_when_stale(
    scene: Path, tmp_path: Path, capsys: Capture
) -> None:
    model = str(write_clip(tmp_path / "clip"))
    found = answer(capsys, "query", str(scene), "chair", "--index-with", model)
    assert found["not_understood"] == []
    assert (scene / "gaga" / INDEX_FILE).is_file()
    again = answer(capsys, "query", str(scene), "chair")  # the text is known: no model
    assert again["groups"] == found["groups"]
    assert "--index-with" in refusal(capsys, "query", str(scene), "fox")
    project = run_stage(open_path_stage(scene))
    project.scene.labels = np.where(project.scene.labels == 3, 0, project.scene.labels)
    project.scene.labels[:9] = 1
    save_project(project)
    assert main(["query", str(scene), "chair"]) == 0
    assert "1 group changed" in capsys.readouterr().err


def test_groups_are_named_and_saved(scene: Path, tmp_path: Path, capsys: Capture) -> None:
    model = str(write_clip(tmp_path / "clip"))
    values = answer(capsys, "query", str(scene), "--name-groups", "--index-with", model)
    named = values["named"]
    assert isinstance(named, dict)
    assert not {"1", "2"} & set(named)
    names = run_stage(open_path_stage(scene)).scene.names
    assert names == {1: "beach ball", 2: "globe", **{int(g): n for g, n in named.items()}}


def test_a_detector_looks_in_the_named_view(scene: Path, tmp_path: Path, capsys: Capture) -> None:
    model = str(write_grounding_dino(tmp_path / "dino"))
    found = answer(capsys, "query", str(scene), "a chair", "--detector", model, "--in-view", "000")
    assert "“a chair” in 000.png" in str(found["sentence"])


def test_what_is_missing_is_told_in_one_sentence(
    scene: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_MODELS", str(tmp_path / "none"))
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    assert "Say what to look for" in refusal(capsys, "query", str(scene))
    assert "Name it with --in-view" in refusal(
        capsys, "query", str(scene), "red", "--detector", "x"
    )
    assert "no view 99" in refusal(capsys, "query", str(scene), "red", "--in-view", "99")
    assert "Names come from an index" in refusal(capsys, "query", str(scene), "--name-groups")
    unknown = refusal(capsys, "query", str(scene), "red", "--index-with", "yolo")
    assert "clip-base" in unknown
    write_scene(tmp_path / "bare", masks=False)
    assert "Associate the masks first" in refusal(capsys, "query", str(tmp_path / "bare"), "red")
    damaged = scene / "gaga" / INDEX_FILE
    damaged.write_bytes(b"no index")
    assert "damaged" in refusal(capsys, "query", str(scene), "red")
