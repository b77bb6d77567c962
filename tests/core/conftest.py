"""Fixtures of the core's tests that are costly to make."""

import json
import multiprocessing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gaga_core.camera import Camera
from gaga_core.placing.metrics import SfmFacts
from gaga_core.placing.photos import PhotoSet, list_photos, prepare_photos, read_photo_set
from gaga_core.placing.sfm import SfmConfig, require_overlap, run_matching, run_step
from gaga_core.progress import Stage, run_stage
from tests.core.placing.photo_scenes import walk_cameras, write_photos
from tests.made import made_once


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
    """Made once in a test run, by whichever process asks first: tests copy what they change."""

    def make(root: Path) -> None:
        write_photos(root / "in", 8)
        workspace = root / "work"
        workspace.mkdir()
        listed = list_photos(root / "in")
        stage = prepare_photos(listed, workspace / "photos", root=root / "in", longest_side=320)
        photos = run_stage(stage)
        run_stage(run_sfm(photos, workspace, ROOM_SFM))
        (root / "photos.json").write_text(json.dumps(photos.to_json()))

    root = made_once(tmp_path_factory, "room", make)
    facts = SfmFacts.load(root / "work" / "facts.npz")
    photos = read_photo_set(root / "photos.json")
    return PlacedRoom(photos, walk_cameras(8), root / "work", facts)


@pytest.fixture(scope="session")
def programs() -> Any:
    """Starts processes, with the core and torch imported already where the system can fork."""
    can_fork = "forkserver" in multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if can_fork else "spawn")
    context.set_forkserver_preload(["pytest", "torch", "tests.core.scene.two_writers"])
    return context
