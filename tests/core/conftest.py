"""Fixtures of the core's tests that are costly to make."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from gaga_core.camera import Camera
from gaga_core.placing.metrics import SfmFacts
from gaga_core.placing.photos import PhotoSet, list_photos, prepare_photos
from gaga_core.placing.sfm import SfmConfig, require_overlap, run_matching, run_step
from gaga_core.progress import Stage, run_stage
from tests.core.reconstruct.photo_scenes import write_photos


@dataclass(frozen=True, eq=False)
class PlacedRoom:
    """Photos of the corner of a room, placed by structure from motion."""

    photos: PhotoSet
    cameras: tuple[Camera, ...]  # true
    workspace: Path
    facts: SfmFacts


ROOM_SFM = SfmConfig(feature_side=320, n_features=1500, threads=2)


def run_sfm(photos: PhotoSet, workspace: Path, config: SfmConfig) -> Stage[SfmFacts]:
    """One attempt to place ``photos``, which lie in workspace/photos."""
    yield from run_matching(photos, workspace, config)
    require_overlap(workspace, len(photos.photos))
    yield from run_step("map", photos, workspace, config)
    return SfmFacts.load(workspace / "facts.npz")


@pytest.fixture(scope="session")
def placed_room(tmp_path_factory: pytest.TempPathFactory) -> PlacedRoom:
    root = tmp_path_factory.mktemp("room")
    cameras = write_photos(root / "in", 8)
    workspace = root / "work"
    workspace.mkdir()
    photos = run_stage(
        prepare_photos(
            list_photos(root / "in"), workspace / "photos", root=root / "in", longest_side=320
        )
    )
    facts = run_stage(run_sfm(photos, workspace, ROOM_SFM))
    return PlacedRoom(photos, cameras, workspace, facts)
