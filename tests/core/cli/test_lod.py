"""``gaga lod`` and what ``gaga info`` says of it."""

from pathlib import Path

import pytest

from gaga_core.io.ply import write_ply
from gaga_core.scene.lod.tree import FILE
from tests.core.cli.calls import Capture, answer
from tests.scenes import random_gaussians


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "hall.ply"
    write_ply(path, random_gaussians(6_000))
    return path


def test_lod_is_built_once_and_again_when_the_model_changed(model: Path, capsys: Capture) -> None:
    folder = model.with_suffix(".gaga") / "lod"
    assert answer(capsys, "info", str(model))["level_of_detail"] == "none"
    first = answer(capsys, "lod", str(model))
    assert first["folder"] == str(folder)
    assert first["built"] is True
    assert first["levels"] == [6_000, 1_500]
    assert answer(capsys, "lod", str(model))["built"] is False
    again = answer(capsys, "lod", str(model), "--again", "--sog", str(model.parent / "web"))
    assert again["built"] is True
    assert answer(capsys, "info", str(again["streamed_sog"]))["gaussians"] == 6_000
    assert str(folder) in str(answer(capsys, "info", str(model))["level_of_detail"])
    write_ply(model, random_gaussians(6_000, seed=2))
    assert answer(capsys, "info", str(model))["level_of_detail"] == "none"
    assert answer(capsys, "lod", str(model))["built"] is True
    (folder / FILE).write_text("{", encoding="utf-8")
    assert "damaged" in str(answer(capsys, "info", str(model))["level_of_detail"])
