"""Captures as people take them, at default settings: each is placed, or refused with the cause.

The figures of version 0.1.0 on the same pictures stand next to each.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from PIL import Image

from gaga_core.errors import GagaError
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.images import read_rgb
from gaga_core.pipeline.reconstruct import reconstruct_scene
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.placing.ladder import LadderConfig, Placement, place_stage
from gaga_core.placing.photos import PhotoSet, list_photos, prepare_photos
from gaga_core.placing.sfm import SfmConfig
from gaga_core.progress import run_stage
from tests.captures import scenes
from tests.captures.placing import placed
from tests.captures.turntables import TWELVE, photograph_turntable
from tests.conftest import real_scene
from tests.core.placing.photo_scenes import write_photos

_OFF = 0.05  # of the cameras' extent


@pytest.mark.capture
def test_half_of_the_photos_blurred(tmp_path: Path) -> None:
    """0.1.0: 2 of 16 placed, refused without a word about blur."""
    blurred = scenes.walk(tmp_path / "in", effect=scenes.motion_blurred(13), share=0.5)
    made = placed(tmp_path / "in", tmp_path / "scene")
    assert made.share >= 0.9
    assert made.off(scenes.demo_cameras(16)) < _OFF
    assert set(made.sfm["blurred"]) == set(blurred)
    assert "8 of 16 photos are blurred" in made.notes
    assert len(made.sfm["attempts"]) > 1
    assert all(attempt["reason"] for attempt in made.sfm["attempts"][1:])


@pytest.mark.capture
def test_few_photos_far_apart(tmp_path: Path) -> None:
    """0.1.0: 12 of 16 placed."""
    scenes.walk(tmp_path / "in")
    made = placed(tmp_path / "in", tmp_path / "scene")
    assert made.share >= 0.9
    assert made.off(scenes.demo_cameras(16)) < _OFF


@pytest.mark.capture
def test_half_of_the_photos_out_of_focus(tmp_path: Path) -> None:
    """0.1.0: 2 of 16 placed. Here the sharp half carries; what is out is named with the cause."""
    blurred = scenes.walk(tmp_path / "in", effect=scenes.out_of_focus(2.5), share=0.5)
    made = placed(tmp_path / "in", tmp_path / "scene")
    assert made.share > 0.5
    assert made.off(scenes.demo_cameras(16)) < _OFF
    assert f"{len(blurred)} of 16 photos are blurred" in made.notes


@pytest.mark.capture
def test_another_exposure_in_each_photo(tmp_path: Path) -> None:
    """0.1.0: 2 of 16 placed, refused."""
    scenes.walk(tmp_path / "in", effect=scenes.exposed(0.35, 1.8))
    made = placed(tmp_path / "in", tmp_path / "scene")
    assert made.share >= 0.9
    assert made.off(scenes.demo_cameras(16)) < _OFF
    assert made.sfm["blurred"] == []


@pytest.mark.capture
def test_an_object_on_featureless_white(tmp_path: Path) -> None:
    """0.1.0: 2 of 24 placed, refused."""
    true = scenes.on_white(tmp_path / "in")
    made = placed(tmp_path / "in", tmp_path / "scene")
    assert made.share >= 0.9
    assert made.off(true) < _OFF


@pytest.mark.capture
def test_two_scenes_in_one_folder(tmp_path: Path) -> None:
    """0.1.0: half placed passed, the other half was dropped with a warning."""
    scenes.two_scenes(tmp_path / "in")
    first = placed(tmp_path / "in", tmp_path / "scene")
    assert first.sfm["registered"] == first.sfm["photos"] == 12
    assert "photos show another scene" in first.notes
    assert "--scene 2" in first.notes
    second = placed(tmp_path / "in", tmp_path / "other", ReconstructConfig(only="sfm", scene=2))
    assert {camera.name[0] for camera in first.cameras} == {"b"}
    assert {camera.name[0] for camera in second.cameras} == {"a"}
    assert second.sfm["registered"] >= 10
    with pytest.raises(GagaError, match=r"--scene 3.*2 scenes only"):
        placed(tmp_path / "in", tmp_path / "none", ReconstructConfig(only="sfm", scene=3))


@pytest.mark.capture
def test_two_arcs_with_a_gap_between(tmp_path: Path) -> None:
    """0.1.0 took the arcs for two scenes and kept one of them without a word.

    They are joined, or one is right and what the other needs is said; never a wrong whole.
    """
    true = scenes.two_arcs(tmp_path / "in")
    made = placed(tmp_path / "in", tmp_path / "scene")
    assert made.off(true) < _OFF
    assert made.share == 1 or (made.share >= 0.5 and "Add photos in between" in made.notes)


@pytest.mark.capture
def test_a_room_of_equal_walls(tmp_path: Path) -> None:
    """0.1.0 placed all of them, more than a radius off, with a warning about doubled details."""
    scenes.equal_walls(tmp_path / "in")
    with pytest.raises(
        GagaError, match=r"Similar-looking objects are at several places.*contradict"
    ):
        placed(tmp_path / "in", tmp_path / "scene")


@pytest.mark.capture
def test_a_film_that_rests(tmp_path: Path) -> None:
    """Frames come from where the camera moved."""
    film = scenes.pan_film(tmp_path / "pan.mp4")
    made = placed(film, tmp_path / "scene")
    assert made.share >= 0.9
    assert 12 <= made.sfm["photos"] <= 40


@pytest.mark.capture
@pytest.mark.parametrize("shaky", [False, True])
def test_a_film_of_the_garden(tmp_path: Path, shaky: bool) -> None:
    """Its first 96 photos at 6 frames a second, and the same from an unsteady hand."""
    pictures = scenes.photos_of(real_scene("garden") / "images", 96)
    film = scenes.film(
        tmp_path / "garden.mp4", scenes.shaken(pictures) if shaky else pictures, fps=6.0
    )
    made = placed(film, tmp_path / "scene")
    assert made.share >= 0.9


@pytest.mark.capture
@pytest.mark.parametrize("given", ["nothing", "turntable", "masks"])
def test_an_object_on_a_turntable(tmp_path: Path, given: str) -> None:
    """0.1.0: no model, and no word about the background."""
    photos, masks = tmp_path / "in", tmp_path / "masks"
    true = scenes.turntable(photos, masks)
    config = ReconstructConfig(only="sfm", turntable=given == "turntable")
    if given == "masks":
        config = ReconstructConfig(only="sfm", foreground=str(masks))
    made = placed(photos, tmp_path / "scene", config)
    assert made.share >= 0.9
    assert made.off(true) < _OFF
    assert ("The camera stood still" in made.notes) == (given != "masks")


@pytest.mark.capture
@pytest.mark.parametrize("kind", TWELVE)
def test_a_scanned_object_on_a_turntable(tmp_path: Path, kind: str) -> None:
    """Placed without being asked; the masks hold the object, and little but what turns along."""
    photos, masks, spec = tmp_path / "in", tmp_path / "masks", TWELVE[kind]
    true = photograph_turntable(spec, real_scene("ycb_meshes"), photos, masks)
    made = placed(photos, tmp_path / "scene")
    assert made.share >= 0.9
    assert made.off(true) < _OFF
    kept, share = [], []
    for camera in made.cameras:
        stem = Path(camera.name).stem
        found = read_rgb(tmp_path / "scene" / "foreground" / f"{stem}.png")[..., 0] > 0
        size = found.shape[::-1]
        truth = np.asarray(Image.open(masks / f"{stem}.png").resize(size)) > 127
        kept.append((found & truth).sum() / truth.sum())
        share.append(found.mean())
    assert np.mean(kept) > 0.95
    assert np.mean(share) < 0.5


@pytest.mark.capture
def test_copies_of_photos_are_left_out(tmp_path: Path) -> None:
    """0.1.0: the copies counted as photos; 6 of 18 placed, refused."""
    names = scenes.with_copies(tmp_path / "in")
    made = placed(tmp_path / "in", tmp_path / "scene")
    assert "6 photos are a smaller or recompressed copy of another and left out" in made.notes
    assert not {Path(camera.name).stem for camera in made.cameras} & {Path(n).stem for n in names}
    assert made.share >= 0.9


def test_poses_of_another_scene(tmp_path: Path) -> None:
    """0.1.0: trained without a word."""
    scene = tmp_path / "scene"
    scenes.walk(scene / "images")
    cameras = scenes.demo_cameras(16)
    turned = [
        replace(c, cam_from_world=o.cam_from_world)
        for c, o in zip(cameras, cameras[5:] + cameras[:5], strict=True)
    ]
    write_colmap(scene / "sparse" / "0", turned, np.zeros((1, 3)), np.zeros((1, 3), np.uint8))
    with pytest.raises(GagaError, match="contradict the given poses"):
        run_stage(reconstruct_scene(None, scene, ReconstructConfig(iterations=1, max_side=64)))
    assert not (scene / "point_cloud.ply").exists()


# --- A person cancels in the middle of every attempt, and the next run goes on from there.


_SFM = SfmConfig(feature_side=320, n_features=1500, doubled=False)
_ALL = LadderConfig(enough=1.01)  # so that every attempt is made


def prepared(folder: Path, workspace: Path) -> PhotoSet:
    workspace.mkdir()
    stage = prepare_photos(list_photos(folder), workspace / "photos", root=folder, longest_side=320)
    return run_stage(stage)


def cancelled_at(photos: PhotoSet, workspace: Path, words: str) -> None:
    """Close the stage at the first progress that says ``words``."""
    stage = place_stage(photos, workspace, _SFM, ladder=_ALL)
    seen = next(step for step in stage if words in step.message)
    stage.close()
    assert words in seen.message


def outcome(best: Placement) -> tuple[str, tuple[str, ...], int]:
    return best.title, best.facts.names, len(best.facts.points)


@pytest.mark.capture
def test_cancel_in_every_attempt(tmp_path: Path) -> None:
    write_photos(tmp_path / "in", 6)
    photos = prepared(tmp_path / "in", tmp_path / "whole")
    whole = run_stage(place_stage(photos, tmp_path / "whole", _SFM, ladder=_ALL))
    assert len(whole.attempts) == 3
    workspace = tmp_path / "stopped"
    photos = prepared(tmp_path / "in", workspace)
    for words in ("photos", "attempt 2 of 3", "attempt 3 of 3", "photos placed"):
        cancelled_at(photos, workspace, words)
        assert psutil.Process().children(recursive=True) == []
    again = run_stage(place_stage(photos, workspace, _SFM, ladder=_ALL))
    assert outcome(again.best) == outcome(whole.best)
    assert [a["placed"] for a in again.attempts] == [a["placed"] for a in whole.attempts]
