"""The Python and the commands of the README run as they stand, and its links lead somewhere."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from gaga_core.cli.main import main
from gaga_core.color import rgb_from_dc
from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.scene.project import Project, save_project
from gaga_core.scene.scene import Scene
from tests.app.folders import write_scene
from tests.scenes import objects_scene

_README = Path(__file__).resolve().parents[2] / "README.md"


def _blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", _README.read_text(encoding="utf-8"), re.M | re.S)


def test_the_readme_is_short_and_holds_one_block() -> None:
    assert len(_README.read_text(encoding="utf-8").splitlines()) <= 100
    (block,) = _blocks()
    assert len(block.splitlines()) <= 6


def test_the_block_opens_recolors_deletes_and_exports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = objects_scene(4, 120, n_cameras=2)
    write_ply(tmp_path / "scene.ply", made.gaussians)
    scene = Scene.of(made.gaussians, made.labels)
    save_project(Project(scene, tmp_path / "scene.ply"), tmp_path / "SCENE")
    monkeypatch.chdir(tmp_path)
    (block,) = _blocks()
    exec(compile(block, "README.md", "exec"), {})  # noqa: S102  it is ours
    result = read_ply(tmp_path / "edited.ply")
    assert len(result.means) == int((made.labels != 4).sum()), "object 4 is deleted"
    red = rgb_from_dc(result.sh[:, 0]).mean(axis=0)
    assert red.shape == (3,)
    recolored = made.labels[made.labels != 4] == 3
    mean = rgb_from_dc(result.sh[:, 0])[recolored].mean(axis=0)
    np.testing.assert_allclose(mean, [0.9, 0.1, 0.1], atol=0.05)


def test_the_commands_run_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_scene(tmp_path / "SCENE", masks=False, n_objects=3)
    monkeypatch.chdir(tmp_path)
    text = _README.read_text(encoding="utf-8")
    (block,) = re.findall(r"^```sh\n(.*?)^```", text, re.M | re.S)
    for line in block.splitlines():
        name, *arguments = shlex.split(line)
        assert name == "gaga"
        assert main(arguments) == 0, line
    assert list((tmp_path / "renders").glob("*.png"))
    assert (tmp_path / "objects" / "groups.json").is_file()


def test_every_link_leads_to_a_file() -> None:
    links = re.findall(r"\]\(([^)]+)\)", _README.read_text(encoding="utf-8"))
    assert len(links) > 10
    assert not [link for link in links if not (_README.parent / link).exists()]
