"""Given poses are held against the photos."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.geometry import look_at
from gaga_core.placing import pose_check
from gaga_core.placing.checks import Verdict
from gaga_core.placing.metrics import SfmFacts
from gaga_core.placing.pose_check import PoseCheckConfig, check_poses_stage, judge_poses
from gaga_core.progress import run_stage
from tests.core.conftest import PlacedRoom


def test_poses_of_other_photos_are_refused(
    placed_room: PlacedRoom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = placed_room.workspace.parent / "in"
    photos = {camera.name: folder / camera.name for camera in placed_room.cameras}
    rng = np.random.default_rng(0)
    wrong = []
    for camera in placed_room.cameras:
        eye = np.array([rng.uniform(-2, 2), rng.uniform(-4, -2), rng.uniform(0.3, 3)])
        pose = look_at(eye, np.array([0, 0.4, 0.8]), np.array([0, 0, 1.0]))
        wrong.append(replace(camera, cam_from_world=pose))
    judged: list[SfmFacts] = []

    def judge(facts: SfmFacts, config: PoseCheckConfig) -> tuple[Verdict, ...]:
        judged.append(facts)
        return judge_poses(facts, config)

    monkeypatch.setattr(pose_check, "judge_poses", judge)
    (verdict,) = run_stage(check_poses_stage(wrong, photos, tmp_path / "work"))
    assert not (tmp_path / "work").exists()
    assert verdict.level == "error"
    assert "contradict the given poses" in verdict.text
    poses = {camera.name: camera.cam_from_world[:3] for camera in placed_room.cameras}
    right = replace(judged[0], poses=np.array([poses[name] for name in judged[0].names]))
    assert judge_poses(right, PoseCheckConfig()) == ()
