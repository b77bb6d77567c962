"""Captures as people take them, at default settings: each is placed, or refused with the cause.

The figures of version 0.1.0 on the same pictures stand next to each.
"""

from pathlib import Path

import pytest

from gaga_core.errors import GagaError
from tests.captures import scenes
from tests.captures.placing import placed
from tests.conftest import real_scene

_OFF = 0.05  # of the cameras' extent


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
    scenes.on_white(tmp_path / "in")
    made = placed(tmp_path / "in", tmp_path / "scene")
    assert made.share >= 0.9


@pytest.mark.capture
def test_two_scenes_in_one_folder(tmp_path: Path) -> None:
    """0.1.0: half placed passed, the other half was dropped with a warning."""
    scenes.two_scenes(tmp_path / "in")
    first = placed(tmp_path / "in", tmp_path / "scene")
    assert first.sfm["registered"] == first.sfm["photos"] == 12
    assert "photos show another scene" in first.notes
    assert "--scene 2" in first.notes
    second = placed(tmp_path / "in", tmp_path / "other", number=2)
    assert {camera.name[0] for camera in first.cameras} == {"b"}
    assert {camera.name[0] for camera in second.cameras} == {"a"}
    assert second.sfm["registered"] >= 10
    with pytest.raises(GagaError, match=r"--scene 3.*2 scenes only"):
        placed(tmp_path / "in", tmp_path / "none", number=3)


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
