"""``gaga lod`` and what ``gaga info`` says of it."""

from pathlib import Path

import pytest

from gaga_core.io.splats.ply import write_ply
from gaga_core.io.splats.splat_files import read_splats
from gaga_core.pipeline.level_of_detail import build_project_lod_stage, open_project_lod
from gaga_core.progress import run_stage
from gaga_core.scene.lod.tree import FILE
from gaga_core.scene.project import Project, open_path_stage
from gaga_core.scene.scene import Scene
from tests.core.cli.calls import Capture, answer, refusal
from tests.gltf_files import write_gltf
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
    web = str(again["streamed_sog"])
    assert answer(capsys, "info", web)["gaussians"] == 6_000
    assert "read from" in refusal(capsys, "lod", web, "--sog", str(Path(web).parent))
    assert str(folder) in str(answer(capsys, "info", str(model))["level_of_detail"])
    write_ply(model, random_gaussians(6_000, seed=2))
    assert answer(capsys, "info", str(model))["level_of_detail"] == "none"
    assert answer(capsys, "lod", str(model))["built"] is True
    (folder / FILE).write_text("{", encoding="utf-8")
    assert "damaged" in str(answer(capsys, "info", str(model))["level_of_detail"])


def test_a_level_of_detail_of_a_gltf_is_found_when_that_is_opened(tmp_path: Path) -> None:
    """Also one that was built while nobody had looked at the files yet."""
    path = write_gltf(tmp_path / "hall.gltf", random_gaussians(3_000))
    run_stage(build_project_lod_stage(Project(Scene.of(read_splats(path)), path)))
    assert open_project_lod(run_stage(open_path_stage(path))) is not None
