"""What was typed is what happens, however slow the frames are: real X11 events, real window."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode, ToolName
from gaga_studio.studio import Studio
from gaga_studio.system.window import WindowOptions
from tests.app.window.typist import strokes, type_into

pytestmark = pytest.mark.window
SCRIPT = [
    # Ctrl+A with Ctrl let go first: the A that is still down does not fly.
    ("Control_L", True), ("a", True), ("Control_L", False), ("a", False),
    # Two tools, the second before the first is let go: the second stays.
    ("r", True), ("b", True), ("r", False), ("b", False),
    # A letter, then a chord before it is let go: M, then Ctrl+Z; never Ctrl+M.
    ("m", True), ("Control_L", True), ("m", False), ("z", True), ("z", False), ("Control_L", False),
    *strokes("Control_L+a"),
    # What is typed into the list of commands reaches no tool and no camera.
    *strokes("Control_L+p l a s s o Return"),
    *strokes("m"),
]  # fmt: skip


def _typed(scene: Path, tmp_path: Path, frame_s: float) -> dict[str, Any]:
    folder = tmp_path / f"typed {frame_s}"
    shutil.copytree(scene, folder)
    session = Session(Settings(first_steps_done=True))
    studio = Studio(folder, session=session, options=WindowOptions(size=(800, 500)))

    def see(studio: Studio) -> dict[str, Any]:
        assert session.history is not None
        return {
            "tool": session.tool,
            "mode": session.view.mode,
            "selected": len(session.selected_indices()),
            "history": [entry.title for entry in session.history.entries()],
            "pose": session.rig.camera(64, 64).cam_from_world.round(9).tolist(),
        }

    seen: dict[str, Any] = type_into(studio, SCRIPT, frame_s=frame_s, see=see)
    return seen


@pytest.mark.parametrize("frame_s", [0.005, 0.2, pytest.param(1.5, marks=pytest.mark.slow)])
def test_a_typed_script_gives_the_same_result_at_any_frame_rate(
    display: str, grouped_scene: Path, tmp_path: Path, frame_s: float
) -> None:
    session = Session(Settings(first_steps_done=True))
    session.open(grouped_scene)
    assert session.jobs.wait()
    assert session.scene is not None
    still = session.rig.camera(64, 64).cam_from_world.round(9).tolist()
    n_splats = len(session.scene)
    session.shut_down()
    seen = _typed(grouped_scene, tmp_path, frame_s)
    assert seen["tool"] is ToolName.LASSO
    assert seen["mode"] is list(Mode)[2]
    assert seen["selected"] == n_splats
    assert seen["history"] == ["Select all"]
    assert np.array_equal(seen["pose"], still)
