"""The worked examples of CONTRIBUTING.md work when they are followed."""

import re
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.segment import segment_scene
from gaga_core.progress import run_stage
from gaga_core.segmentation.base import Provider
from gaga_studio.features.base import Command
from gaga_studio.features.commands import new_session
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.tools.base import Tool, ViewportPoint
from tests.docs.pages import ROOT
from tests.scenes import random_gaussians

_PAGE = ROOT / "CONTRIBUTING.md"


@pytest.fixture
def names() -> Callable[..., dict[str, Any]]:
    """Runs the blocks whose first line names one of these files, one after the other."""
    text = _PAGE.read_text(encoding="utf-8")
    blocks = [
        textwrap.dedent(block)
        for block in re.findall(r"^ *```python\n(.*?)^ *```", text, re.M | re.S)
    ]
    assert all(block.startswith("# ") for block in blocks)

    def run(*files: str) -> dict[str, Any]:
        found: dict[str, Any] = {"__name__": "contributed"}
        for file in files:
            (block,) = [b for b in blocks if b.startswith(f"# {file}\n")]
            exec(compile(block, file, "exec"), found)  # noqa: S102  it is ours
        return found

    return run


@pytest.fixture
def session(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    monkeypatch.setenv("GAGA_HOME", str(workplace / "home"))
    made = new_session(Settings())
    made.open(workplace / "SCENE")
    assert made.jobs.wait()
    assert made.scene is not None
    return made


def test_the_command_selects_and_is_undone_at_once(
    names: Callable[..., dict[str, Any]], session: Session
) -> None:
    found = names("app/gaga_studio/features/selection.py")
    command = found["FAINT"]
    assert isinstance(command, Command)
    assert command.enabled(session) == ""
    scene = session.need().scene
    scene.gaussians.logit_opacities[:5] = -6.0
    command.run(session)
    assert session.selected_indices().tolist() == [0, 1, 2, 3, 4]
    session.undo()
    assert len(session.selected_indices()) == 0
    session.shut_down()


def test_the_tool_selects_the_color_that_is_clicked(
    names: Callable[..., dict[str, Any]], session: Session
) -> None:
    tool: Tool = names("app/gaga_studio/tools/same_color.py")["SameColorTool"]()
    camera = session.cameras[0]
    session.rig.go_to(camera, animated=False)
    tool.click(session, ViewportPoint(80.5, 60.5, 160, 120))
    chosen = session.selected_indices()
    assert 0 < len(chosen) < len(session.need().scene)
    labels = session.need().scene.labels[chosen]
    assert (labels == np.bincount(labels).argmax()).mean() > 0.9, "one ball, or the floor"
    assert tool.hint(session)
    session.shut_down()


def test_the_form_of_files_is_read_as_it_was_written(
    names: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    found = names("gaga_core/io/xyz.py")
    gaussians = random_gaussians(9)
    run_stage(found["write_xyz_stage"](tmp_path / "a.xyz", gaussians))
    again = run_stage(found["read_xyz_stage"](tmp_path / "a.xyz"))
    np.testing.assert_allclose(again.means, gaussians.means, rtol=1e-6)
    np.testing.assert_allclose(again.sh[:, 0], gaussians.sh[:, 0], atol=1e-5)
    (tmp_path / "b.xyz").write_text("1 2 three")
    with pytest.raises(found["GagaError"], match="damaged"):
        run_stage(found["read_xyz_stage"](tmp_path / "b.xyz"))


def test_the_provider_makes_masks_that_become_objects(
    names: Callable[..., dict[str, Any]], workplace: Path
) -> None:
    provider: Provider = names("gaga_core/segmentation/brightness.py")["BrightnessProvider"]()
    folder = open_scene_folder(workplace / "SCENE")
    report = run_stage(segment_scene(folder, provider))
    assert report.n_masks > len(folder.train)
    found = run_stage(associate_scene(open_scene_folder(folder.root), "brightness"))
    assert found.bank.n_groups > 0
