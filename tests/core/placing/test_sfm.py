"""Structure from motion: true poses, the same twice, ended with its stage, told when it fails."""

import os
import shutil
import signal
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from PIL import Image

from gaga_core.errors import GagaError, in_window, option
from gaga_core.placing.metrics import centres_of
from gaga_core.placing.photos import (
    VIEWS,
    PhotoSet,
    list_photos,
    prefix_of_view,
    prepare_photos,
    turn_of_view,
)
from gaga_core.placing.sfm import SfmConfig
from gaga_core.placing.worker import similar_pairs
from gaga_core.progress import Progress, run_stage
from tests.captures.placing import off_after_alignment
from tests.conftest import real_scene
from tests.core.conftest import ROOM_SFM, PlacedRoom, run_sfm
from tests.core.placing.photo_scenes import FOCAL, panorama, write_photos


def test_the_true_poses_and_focal_length_are_found(placed_room: PlacedRoom) -> None:
    facts = placed_room.facts
    assert facts.names == tuple(camera.name for camera in placed_room.cameras)
    true = np.array([camera.position for camera in placed_room.cameras])
    assert off_after_alignment(centres_of(facts), true) < 0.01
    assert facts.focal.mean() == pytest.approx(FOCAL, rel=0.02)
    assert len(facts.points) > 300


def test_the_same_photos_and_seed_give_the_same_model(
    placed_room: PlacedRoom, tmp_path: Path
) -> None:
    """On more threads: the mapping again, from the same matches."""
    work = tmp_path / "work"
    shutil.copytree(placed_room.workspace, work)
    (work / "map.finished").unlink()
    again = run_stage(run_sfm(placed_room.photos, work, SfmConfig(threads=8)))
    assert np.array_equal(again.poses, placed_room.facts.poses)
    assert np.array_equal(again.track_lengths, placed_room.facts.track_lengths)


def test_views_of_a_panorama_stay_mounted_as_they_were_cut(tmp_path: Path) -> None:
    """Whatever the noise of features says; photos of another camera are placed with them."""
    eyes = np.array([[0, -1.5, 1.2], [0.5, -1.0, 1.3], [-0.4, -0.8, 1.1]])
    folder, workspace = tmp_path / "in", tmp_path / "work"
    write_photos(folder, 3)
    for i, eye in enumerate(eyes):
        xmp = b'<x xmlns:GPano="a" GPano:ProjectionType="equirectangular"/>'
        Image.fromarray(panorama(eye, 400)).save(folder / f"p{i}.jpg", xmp=xmp, quality=97)
    photos = prepared(folder, workspace)
    facts = run_stage(run_sfm(photos, workspace, ROOM_SFM))
    placed = dict(zip(facts.names, facts.poses, strict=True))
    assert {f"{i:03d}.jpg" for i in range(3)} < set(placed)
    views = [
        [placed[f"{prefix_of_view(k, 200)}p{i}.jpg"] for k in range(len(VIEWS))]
        for i in range(len(eyes))
    ]
    for mounted in views:
        for k, pose in enumerate(mounted):
            expected = turn_of_view(k).T @ mounted[0]
            np.testing.assert_allclose(pose[:3], expected[:3], atol=1e-5)
    found = np.array([-mounted[0][:, :3].T @ mounted[0][:, 3] for mounted in views])
    assert off_after_alignment(found, eyes) < 0.005
    cut = np.array(["view" in name for name in facts.names])
    np.testing.assert_array_equal(facts.focal[cut], 100.0)


def matched_again(room: PlacedRoom, work: Path) -> Path:
    """A copy of the room's workspace with its features, and no matches yet."""
    shutil.copytree(room.workspace, work)
    for step in ("match", "map"):
        (work / f"{step}.finished").unlink()
    with sqlite3.connect(work / "database.db") as database:
        for table in ("matches", "two_view_geometries"):
            database.execute(f"DELETE FROM {table}")
    database.close()
    return work


def prepared(folder: Path, workspace: Path) -> PhotoSet:
    workspace.mkdir()
    stage = prepare_photos(
        list_photos(folder), workspace / "photos", root=folder, longest_side=1600
    )
    return run_stage(stage)


def test_photos_without_overlap_are_told(tmp_path: Path) -> None:
    for i in range(3):
        write_photos(tmp_path / "in" / str(i), 1, seed=i + 1)
    photos = prepared(tmp_path / "in", tmp_path / "work")
    with pytest.raises(GagaError, match="No two of the 3 photos show the same"):
        run_stage(run_sfm(photos, tmp_path / "work", ROOM_SFM))


def test_closing_the_stage_ends_the_process_and_the_next_run_goes_on(
    placed_room: PlacedRoom, tmp_path: Path
) -> None:
    work = matched_again(placed_room, tmp_path / "work")
    stage = run_sfm(placed_room.photos, work, ROOM_SFM)
    me = psutil.Process()
    before = set(me.children(recursive=True))
    for step in stage:
        if step.stage == "Match photos":
            break
    started = set(me.children(recursive=True)) - before
    assert started
    stage.close()
    assert not [child for child in started if child.is_running()]
    told: list[Progress] = []
    facts = run_stage(run_sfm(placed_room.photos, work, ROOM_SFM), told.append)
    assert {step.stage for step in told} == {"Match photos", "Place photos"}
    assert facts.names == placed_room.facts.names
    told.clear()
    run_stage(run_sfm(placed_room.photos, work, ROOM_SFM), told.append)
    assert told == []  # finished steps are not run again


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
def test_a_crash_of_the_process_is_a_sentence(placed_room: PlacedRoom, tmp_path: Path) -> None:
    work = tmp_path / "work"
    shutil.copytree(placed_room.workspace / "photos", work / "photos")
    me = psutil.Process()
    before = set(me.children())
    stage = run_sfm(placed_room.photos, work, ROOM_SFM)
    next(stage)
    (child,) = set(me.children()) - before
    os.kill(child.pid, signal.SIGKILL)
    with pytest.raises(GagaError, match="Find features failed") as caught:
        run_stage(stage)
    assert "Traceback" not in str(caught.value)


def test_photos_that_look_alike_are_paired() -> None:
    """Features of three places, interleaved: partners come from the same place."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 200, (3, 40, 128))
    photos = [places[i % 3] + rng.normal(0, 4, (40, 128)) for i in range(30)]
    pairs = similar_pairs(photos, 6)
    assert all(i < j for i, j in pairs)
    partners = [[j if i == k else i for i, j in pairs if k in (i, j)] for k in range(30)]
    assert min(len(found) for found in partners) >= 6
    assert all(i % 3 == j % 3 for i, j in pairs if j - i > 1)  # next ones are pairs in any case
    assert similar_pairs(photos, 6) == pairs


@pytest.mark.slow
def test_sceaux_is_placed_in_full(tmp_path: Path) -> None:
    folder = real_scene("sceaux") / "images"
    photos = prepared(folder, tmp_path / "work")
    facts = run_stage(run_sfm(photos, tmp_path / "work", SfmConfig.of("draft")))
    assert len(facts.names) == len(list_photos(folder)) == 11
    assert facts.seen_errors.mean() < 1


def test_pairs_of_photos_that_look_alike_are_enough(
    placed_room: PlacedRoom, tmp_path: Path
) -> None:
    work = matched_again(placed_room, tmp_path / "work")
    config = SfmConfig(feature_side=320, n_features=1500, pairs="similar", neighbours=4)
    facts = run_stage(run_sfm(placed_room.photos, work, config))
    assert len(facts.names) == 8
    assert len((work / "pairs.txt").read_text().splitlines()) < 28


def test_the_last_digits_of_a_model_are_dropped(
    placed_room: PlacedRoom,
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    from gaga_core.placing.worker import _round

    def numbers(model: Any) -> list[float]:
        poses = [frame.rig_from_world for _, frame in sorted(model.frames.items())]
        found = [x for pose in poses for x in (*pose.rotation.quat, *pose.translation)]
        return [*found, *(x for _, p in sorted(model.points3D.items()) for x in p.xyz)]

    models = [pycolmap.Reconstruction(placed_room.workspace / "model") for _ in range(2)]
    for point in models[1].points3D.values():
        point.xyz = point.xyz + 1e-14
    assert numbers(models[0]) != numbers(models[1])
    for model in models:
        _round(model)
    assert numbers(models[0]) == numbers(models[1])


def test_the_window_names_its_own_controls() -> None:
    said = f"Try {option('--quality', 'full')}, or {option('--focal')}."
    assert in_window(said) == "Try Quality: Best in Settings, or Focal length, pixels in Settings."
