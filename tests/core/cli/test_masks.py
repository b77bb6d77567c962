"""``gaga masks`` as a person uses it."""

import json
from pathlib import Path

import numpy as np
import pytest

from gaga_core.cli.main import main
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import read_labels
from tests.app.folders import write_scene
from tests.core.cli.calls import Capture, answer, refusal


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene folder with photos."""
    root = tmp_path / "scene"
    write_scene(root)
    for camera in open_scene_folder(root).cameras:
        picture = np.zeros((camera.height, camera.width, 3), np.uint8)
        picture[:, camera.width // 2 :] = (200, 60, 60)
        write_rgb(root / "images" / f"{Path(camera.name).stem}.png", picture)
    return root


def test_regions_from_the_command(scene: Path, capsys: Capture) -> None:
    arguments = ["masks", str(scene), "--provider", "regions", "--name", "mine"]
    folder = open_scene_folder(scene)
    assert answer(capsys, *arguments)["views_made"] == len(folder.train)
    for name in folder.train:
        labels = read_labels(scene / "masks" / "mine" / f"{Path(name).stem}.png")
        assert labels.max() >= 2
    assert answer(capsys, *arguments)["views_kept"] == len(folder.train)
    again = answer(capsys, *arguments, "--redo", "--views", "all")
    assert again["views_made"] == len(folder.cameras)


def test_the_list_says_what_to_put_where(
    capsys: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_MODELS", str(tmp_path))
    assert main(["masks", "--list", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["providers"]}
    assert rows["regions"]["is_available"]
    assert rows["sam2.1-tiny"]["megabytes"] == 156
    assert str(tmp_path / "sam2.1-tiny") in rows["sam2.1-tiny"]["reason"]
    assert main(["masks", "--list"]) == 0
    shown = capsys.readouterr()
    assert "sam-hq-base" in shown.out
    assert "Apache-2.0" in shown.out
    assert str(tmp_path / "sam2.1-tiny") in shown.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "--provider"),
        (["SCENE"], "--list"),
        (["SCENE", "--provider", "sam2.1-tiny"], "There are no weights of SAM 2.1"),
        (["SCENE", "--provider", "nonsense"], "no mask provider"),
        (["SCENE", "--weights", "gone"], "gone does not exist"),
        (["SCENE", "--provider", "regions", "--views", "xyz"], "no view xyz"),
        (["SCENE", "--provider", "regions", "--detail", "-1"], "detail"),
    ],
)
def test_mistakes_are_one_sentence(
    arguments: list[str], said: str, scene: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_MODELS", str(scene / "none"))
    monkeypatch.setenv("HF_HUB_CACHE", str(scene / "none"))
    given = [str(scene) if a == "SCENE" else a for a in arguments]
    assert said in refusal(capsys, "masks", *given)
