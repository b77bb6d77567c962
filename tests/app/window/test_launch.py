"""What starting the program imports."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.app.folders import write_scene


def run(*arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(
        [sys.executable, *arguments],
        env=env | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_needs_no_display_and_no_heavy_import(option: str) -> None:
    done = run("-X", "importtime", "-m", "gaga_studio", option)
    assert done.returncode == 0
    assert "gaga-studio" in done.stdout
    for heavy in ("numpy", "imgui_bundle", "numba", "torch"):
        assert f"| {heavy}\n" not in done.stderr.replace("|   ", "| ")


def test_opening_editing_and_saving_import_neither_torch_nor_transformers(tmp_path: Path) -> None:
    write_scene(tmp_path / "scene", n_objects=2)
    code = f"""
import sys
from pathlib import Path
import gaga_studio.studio
from gaga_studio.features.find import association
from gaga_studio.session.session import Session
session = Session()
session.open(Path({str(tmp_path / "scene")!r}))
session.jobs.wait()
session.tick(0.1)
assert session.scene is not None
association.associate(session)
session.jobs.wait()
session.tick(0.1)
session.save()
session.jobs.wait()
loaded = [name for name in ("torch", "transformers", "pycolmap") if name in sys.modules]
assert not loaded, loaded
"""
    done = run("-c", code, GAGA_HOME=str(tmp_path / "home"))
    assert done.returncode == 0, done.stderr
