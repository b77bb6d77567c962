"""Given poses are held against the photos."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gaga_core.geometry import look_at
from gaga_core.placing.pose_check import check_poses_stage
from gaga_core.progress import run_stage
from tests.core.conftest import PlacedRoom


def test_poses_of_other_photos_are_refused(placed_room: PlacedRoom, tmp_path: Path) -> None:
    folder = placed_room.workspace.parent / "in"
    photos = {camera.name: folder / camera.name for camera in placed_room.cameras}
    work = tmp_path / "work"
    assert run_stage(check_poses_stage(placed_room.cameras, photos, work)) == ()
    assert not work.exists()
    rng = np.random.default_rng(0)
    wrong = []
    for camera in placed_room.cameras:
        eye = np.array([rng.uniform(-2, 2), rng.uniform(-4, -2), rng.uniform(0.3, 3)])
        pose = look_at(eye, np.array([0, 0.4, 0.8]), np.array([0, 0, 1.0]))
        wrong.append(replace(camera, cam_from_world=pose))
    (verdict,) = run_stage(check_poses_stage(wrong, photos, work))
    assert verdict.level == "error"
    assert "contradict the given poses" in verdict.text
