"""The camera's path in the window: keyframes, preview, films and pictures."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.video import VideoConfig
from gaga_core.pipeline.film import FilmConfig, Split
from gaga_studio.features import camera as camera_path
from gaga_studio.features import export
from gaga_studio.features.commands import run
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, RenderRequests, ViewState

_SMALL = FilmConfig(video=VideoConfig(64, 48, fps=5))


@pytest.fixture
def walked(session: Session) -> Session:
    """Three keyframes around the scene, the last one chosen."""
    for _ in range(3):
        camera_path.add_keyframe(session)
        session.rig.orbit(60, 5)
    return session


def _eyes(session: Session) -> list[tuple[float, float, float]]:
    return [key.shot.eye for key in camera_path.path_of(session).keyframes]


def test_keyframes_are_added_moved_and_removed(walked: Session) -> None:
    a, b, c = _eyes(walked)
    assert walked.unsaved
    camera_path.choose_keyframe(walked, 0)
    camera_path.add_keyframe(walked)  # behind the chosen one
    assert [_eyes(walked)[i] for i in (0, 2, 3)] == [a, b, c]
    camera_path.remove_keyframe(walked, 1)
    assert _eyes(walked) == [a, b, c]
    camera_path.set_seconds(walked, 1, 5)
    camera_path.move_keyframe(walked, 1, -1)
    assert _eyes(walked) == [b, a, c]
    assert [k.seconds for k in camera_path.path_of(walked).keyframes] == [2, 5, 2]
    camera_path.move_keyframe(walked, 0, -1)
    assert _eyes(walked) == [b, a, c]
    camera_path.set_total_seconds(walked, 14)
    assert camera_path.path_of(walked).seconds == pytest.approx(14)
    camera_path.clear_path(walked)
    assert camera_path.path_of(walked).keyframes == ()


def test_the_preview_plays_to_the_end_and_begins_again(walked: Session) -> None:
    camera_path.toggle_playing(walked)
    assert walked.view.playback.is_playing
    steps = 0
    while walked.view.playback.is_playing:
        camera_path.tick(walked, 0.25)
        steps += 1
        assert steps < 50
    assert steps == 16
    at_end = walked.rig.shot()
    last = camera_path.path_of(walked).keyframes[-1].shot
    np.testing.assert_allclose(at_end.eye, last.eye, atol=1e-6)
    camera_path.toggle_playing(walked)
    camera_path.tick(walked, 0.0)
    np.testing.assert_allclose(walked.rig.shot().eye, _eyes(walked)[0], atol=1e-6)
    camera_path.toggle_playing(walked)
    assert not walked.view.playback.is_playing


def test_a_turntable_plays_round_and_round(session: Session) -> None:
    pivot, distance = session.rig.pivot, session.rig.pose.distance
    camera_path.make_turntable(session, 4.0)
    for _ in range(30):
        camera_path.tick(session, 0.3)
        assert np.linalg.norm(session.rig.eye - pivot) == pytest.approx(distance, rel=1e-3)
        np.testing.assert_allclose(session.rig.pivot, pivot, atol=1e-2 * distance)
    assert session.view.playback.is_playing


def test_the_path_is_saved_with_the_project_and_as_a_file(
    walked: Session, new_session: Callable[[], Session], scene_folder: Path, tmp_path: Path
) -> None:
    camera_path.set_closed_path(walked, True)
    camera_path.set_even_speed(walked, True)
    walked.save()
    assert walked.jobs.wait()
    again = new_session()
    again.open(scene_folder)
    assert again.jobs.wait()
    assert camera_path.path_of(again) == camera_path.path_of(walked)
    camera_path.save_path_file(walked, tmp_path / "p.json")
    camera_path.clear_path(again)
    camera_path.open_path_file(again, tmp_path / "p.json")
    assert camera_path.path_of(again) == camera_path.path_of(walked)
    camera_path.open_path_file(again, tmp_path / "none.json")
    assert again.notices[-1].level == "error"
    assert camera_path.path_of(again) == camera_path.path_of(walked)


def test_a_film_is_a_job_that_can_be_cancelled(walked: Session, tmp_path: Path) -> None:
    target = tmp_path / "out" / "film.mp4"
    assert export.export_film(walked, target, _SMALL)
    assert walked.jobs.wait()
    assert target.stat().st_size > 500
    assert str(target) in walked.notices[-1].text
    before = replace(_SMALL, split=Split("rgb", 0.5))
    walked.need().select(np.arange(100, dtype=np.int32))
    assert run("object.hide", walked)
    assert export.export_film(walked, tmp_path / "before" / "b.mp4", before, before=True)
    assert walked.jobs.wait()
    assert (tmp_path / "before" / "b.mp4").is_file(), walked.notices
    long = FilmConfig(video=VideoConfig(320, 240, fps=120))
    assert export.export_film(walked, tmp_path / "long.mp4", long)
    walked.jobs.cancel()
    assert walked.jobs.wait()
    assert [p.name for p in tmp_path.glob("*.mp4")] == []
    assert not list(tmp_path.glob(".*"))
    assert not export.export_film(walked, tmp_path / "film.avi", _SMALL)
    assert walked.notices[-1].level == "error"


@pytest.mark.parametrize("mode", [Mode.COLOR, Mode.GROUPS, Mode.DEPTH])
def test_pictures_at_any_size(session: Session, tmp_path: Path, mode: Mode) -> None:
    session.view.mode = mode
    assert export.save_picture(session, tmp_path / "a.png", (301, 200), transparent=True)
    assert session.jobs.wait()
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (301, 200)
        alpha = np.asarray(picture)[..., 3]
    assert alpha.max() > 200
    assert not export.save_picture(session, tmp_path / "a.jpg", (30, 20), transparent=True)
    assert not export.save_picture(session, tmp_path / "a.png", (90_000, 20))


def test_what_only_the_window_draws_says_so_without_one(session: Session, tmp_path: Path) -> None:
    session.view.mode = Mode.RINGS
    assert not export.save_picture(session, tmp_path / "a.png", (64, 48))
    assert "rings" in session.notices[-1].text


def _disc(camera: Camera, view: ViewState) -> UInt8Array:
    """A half transparent orange over the background, on the left half."""
    picture = np.empty((camera.height, camera.width, 3))
    picture[:] = view.background
    half = picture[:, : camera.width // 2]
    half[:] = 0.5 * half + 0.5 * np.array([1.0, 0.6, 0.2])
    return (picture * 255 + 0.5).astype(np.uint8)


def test_the_window_draws_for_a_job_and_alpha_comes_of_two_grounds(
    walked: Session, tmp_path: Path
) -> None:
    requests = walked.render_requests = RenderRequests(max_side=4096, is_fast=True)
    served = 0
    export.save_picture(walked, tmp_path / "a.png", (40, 20), transparent=True)
    while walked.jobs.running is not None:
        served += requests.serve(_disc)
        walked.jobs.poll()
    assert served == 2
    with Image.open(tmp_path / "a.png") as picture:
        pixels = np.asarray(picture).astype(int)
    assert np.abs(pixels[0, 0] - [255, 153, 51, 127.5]).max() <= 2
    assert pixels[0, -1, 3] == 0
    export.export_film(walked, tmp_path / "a.mp4", _SMALL)
    while walked.jobs.running is not None:
        served += requests.serve(_disc)
        walked.jobs.poll()
    assert served == 2 + len(camera_path.path_of(walked).frame_times(5))
    assert (tmp_path / "a.mp4").is_file()


def test_a_window_that_closes_leaves_no_job_waiting() -> None:
    requests, said = RenderRequests(max_side=64, is_fast=True), []
    camera = Camera(np.eye(3), np.eye(4), 4, 4)

    def work() -> None:
        try:
            requests.paint(camera, ViewState())
        except GagaError as error:
            said.append(str(error))

    worker = threading.Thread(target=work)
    worker.start()
    while not requests.is_wanted:
        pass
    requests.close()
    worker.join(5)
    assert not worker.is_alive()
    assert len(said) == 1
