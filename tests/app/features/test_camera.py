"""The camera: bookmarks, the view cube, its path with keyframes, films and pictures."""

import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import DoubleArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.video import VideoConfig
from gaga_core.pipeline.film import FilmConfig, Split
from gaga_core.scene import edits
from gaga_studio.features import camera as bookmarks
from gaga_studio.features import camera as camera_path
from gaga_studio.features import export, split_view
from gaga_studio.features.commands import run, run_one
from gaga_studio.session.camera_rig import CameraRig
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, PhotoCompareMode, RenderRequests, ViewState
from gaga_studio.ui.viewport import gizmo

_POINTS = np.array([[0.2, 0.1, 0.0], [-0.3, 0.2, 0.1], [0.0, -0.2, 0.3]])


def _seen(session: Session) -> DoubleArray:
    pixels, _ = session.rig.camera(800, 600).project(session.rig.radius * _POINTS)
    return pixels


def _land(session: Session) -> None:
    while session.rig.is_moving:
        session.tick(0.1)


@pytest.mark.parametrize("flat", [False, True])
def test_a_bookmark_shows_the_same_again(session: Session, flat: bool) -> None:
    session.rig.camera(800, 600)
    session.rig.orbit(80, -40)
    session.rig.set_orthographic(flat)
    before, was_unsaved = _seen(session), session.unsaved
    bookmarks.add_bookmark(session, "door")
    assert session.unsaved
    assert not was_unsaved
    session.rig.set_orthographic(not flat)
    session.rig.orbit(200, 100)
    session.rig.zoom(3)
    assert np.abs(_seen(session) - before).max() > 5
    bookmarks.recall_bookmark(session, 0)
    _land(session)
    np.testing.assert_allclose(_seen(session), before, atol=1e-3)
    assert session.rig.pose.is_orthographic is flat


def test_keys_set_and_recall(session: Session) -> None:
    assert "No bookmark" in _hint_of(session, "camera.bookmark_4")
    run("camera.set_bookmark_4", session)
    here = _seen(session)
    session.rig.orbit(90, 0)
    run("camera.set_bookmark_5", session)
    run("camera.bookmark_4", session)
    _land(session)
    np.testing.assert_allclose(_seen(session), here, atol=1e-3)
    session.rig.zoom(2)
    there = _seen(session)
    run("camera.set_bookmark_4", session)  # moves the one that is there
    assert [mark.key for mark in bookmarks.bookmarks(session)] == [4, 5]
    session.rig.orbit(10, 0)
    run("camera.bookmark_4", session)
    _land(session)
    np.testing.assert_allclose(_seen(session), there, atol=1e-3)


def _hint_of(session: Session, command_id: str) -> str:
    assert not run(command_id, session)
    return session.hint


def test_the_list_is_edited_and_saved_with_the_project(
    session: Session, new_session: Callable[[], Session], scene_folder: Path
) -> None:
    for name in ("a", "b", "c"):
        bookmarks.add_bookmark(session, name)
    bookmarks.move_bookmark(session, 2, -1)
    bookmarks.move_bookmark(session, 0, -1)
    bookmarks.rename_bookmark(session, 0, "  front door ")
    bookmarks.rename_bookmark(session, 1, " ")
    bookmarks.remove_bookmark(session, 2)
    bookmarks.add_bookmark(session)
    assert [mark.name for mark in bookmarks.bookmarks(session)] == ["front door", "c", "View 3"]
    session.save()
    assert session.jobs.wait()
    assert not session.unsaved
    again = new_session()
    again.open(scene_folder)
    assert again.jobs.wait()
    assert bookmarks.bookmarks(again) == bookmarks.bookmarks(session)
    assert not again.unsaved


def test_a_mark_made_while_saving_is_unsaved(session: Session) -> None:
    bookmarks.add_bookmark(session)
    session.save()
    bookmarks.add_bookmark(session)
    assert session.jobs.wait()
    assert session.unsaved


def test_orthographic_shows_near_and_far_alike_and_the_pivot_as_before() -> None:
    rig = CameraRig()
    rig.frame_scene(np.full(3, -1.0), np.full(3, 1.0))
    right, forward = rig.sideways, rig.camera(800, 600).forward
    ends = np.stack([-0.3 * right, 0.3 * right])

    def length(depth: float) -> float:
        pixels, _ = rig.camera(800, 600).project(rig.pivot + ends + depth * forward)
        return float(np.linalg.norm(pixels[1] - pixels[0]))

    before = length(0.0)
    assert length(-1) / length(1) > 1.5
    rig.set_orthographic(True)
    assert length(0.0) == pytest.approx(before, rel=1e-9)
    assert length(-1) / length(1) == pytest.approx(1.0, abs=0.01)
    zoomed = length(0.0)
    rig.zoom(2)
    assert length(0.0) > 1.2 * zoomed


@pytest.mark.parametrize("axis", ["front", "back", "left", "right", "top", "bottom"])
def test_the_cube_s_faces_are_the_axis_views(axis: str) -> None:
    side = {name.lower(): normal for name, normal in gizmo._SIDES}[axis]
    by_name, by_cube = CameraRig(), CameraRig()
    for rig in (by_name, by_cube):
        rig.frame_scene(np.full(3, -1.0), np.full(3, 1.0))
    by_cube.look_along("front")
    by_cube.update(1)
    by_name.look_along(axis)
    by_cube.look_from(side)
    by_name.update(1)
    by_cube.update(1)
    a, b = (rig.camera(800, 600).cam_from_world for rig in (by_name, by_cube))
    np.testing.assert_allclose(a, b, atol=1e-9)
    # From there the middle of the cube's picture is this face.
    assert gizmo.hit(by_cube.cube, 0, 0) == side
    assert gizmo.name_of(side) == axis


def test_a_click_on_the_cube_hits_what_looks_at_the_eye() -> None:
    rig = CameraRig()
    rig.frame_scene(np.full(3, -1.0), np.full(3, 1.0))
    rng = np.random.default_rng(0)
    for _ in range(200):
        side = (0, 0, 0)
        while side == (0, 0, 0):
            x, y, z = (int(v) for v in rng.integers(-1, 2, 3))
            side = (x, y, z)
        rig.look_from(side)
        rig.update(1)
        assert gizmo.hit(rig.cube, 0, 0) == side  # a corner is in the middle, too
        rig.orbit(float(rng.uniform(-300, 300)), float(rng.uniform(-100, 100)))
        u, v = rng.uniform(-2, 2, 2)
        found = gizmo.hit(rig.cube, float(u), float(v))
        if found is not None:
            assert (rig.cube @ np.array(found))[2] < 0.7
        assert gizmo.hit(rig.cube, 1.9, 1.9) is None


def test_the_photo_lies_exactly_over_the_picture(session: Session) -> None:
    run("camera.swipe", session)
    assert session.view.compare is PhotoCompareMode.SWIPE
    _land(session)
    assert split_view.photo_in_view(session) == session.active_view is not None
    photo = split_view.compared_photo(session)
    assert photo is not None
    view = session.rig.camera(900, 400)
    place = split_view.place_photo(photo, view)
    for u, v in ((0, 0), (photo.width, 0), (photo.width / 3, photo.height)):
        pixels, _ = view.project(photo.unproject(u, v, 2.0)[None])
        x = place.x + u / photo.width * place.width
        y = place.y + v / photo.height * place.height
        np.testing.assert_allclose(pixels[0], [x, y], atol=1e-6)
    session.rig.orbit(20, 0)
    assert split_view.compared_photo(session) is None
    assert split_view.photo_in_view(session) is None, "the strip frames none"
    run("camera.swipe", session)
    assert session.view.compare.value == "off"
    run("camera.hold_photo", session)
    assert session.view.holds_photo
    assert split_view.compared_photo(session) is not None


def test_the_difference_of_a_picture_with_itself_is_nothing(
    session: Session, tmp_path: Path
) -> None:
    from gaga_core.io.images import write_rgb
    from gaga_core.raster import choose

    assert session.scene is not None
    camera = session.cameras[0]
    image = choose().render(session.scene.gaussians, camera).image
    write_rgb(tmp_path / "same.png", image)
    _, mean = split_view.difference(session.scene, camera, tmp_path / "same.png", side=4096)
    assert mean < 0.5 / 255
    write_rgb(tmp_path / "other.png", np.clip(image, 0, 1) * 0.5 + 0.5)
    heat, mean = split_view.difference(session.scene, camera, tmp_path / "other.png", side=4096)
    assert mean == pytest.approx(float(0.5 - 0.5 * np.clip(image, 0, 1).mean()), abs=1 / 255)
    assert heat.shape == (camera.height, camera.width, 3)


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


def test_a_view_is_not_added_twice_in_a_row(walked: Session) -> None:
    """A second K made a stop; also where keyframes went along with a scene that was moved."""
    eyes, scene = _eyes(walked), walked.need().scene
    turn = np.array([[0.6, -0.8, 0, 3], [0.8, 0.6, 0, -7], [0, 0, 1, 0.1]])
    for place in (0, 2, 1):
        camera_path.choose_keyframe(walked, place)
        while walked.rig.update(10.0):
            pass
        camera_path.add_keyframe(walked)
        assert walked.hint == f"This view is keyframe {place + 1} already"
        assert len(_eyes(walked)) == len(eyes)
        walked.need().do(edits.move_scene(scene, turn, "Turn"))
        scene = walked.need().scene
    walked.rig.orbit(0.01, 0)
    camera_path.add_keyframe(walked)
    assert walked.hint == "Keyframe 3 added"
    assert len(_eyes(walked)) == len(eyes) + 1


def test_a_bookmark_says_that_it_is_kept_and_those_that_were_made_are_listed(
    walked: Session,
) -> None:
    assert bookmarks.recall_commands(walked) == ()
    for wanted in ("camera.add_bookmark", "camera.set_bookmark_4", "camera.set_bookmark_4"):
        assert run(wanted, walked)
        assert bookmarks.bookmarks(walked)[-1].name in walked.hint
    assert walked.hint.endswith("Ctrl+4")
    listed = bookmarks.recall_commands(walked)
    assert [one.title for one in listed] == [mark.name for mark in bookmarks.bookmarks(walked)]
    assert [one.shortcut for one in listed] == ["", "Ctrl+4"]
    walked.rig.orbit(90, 20)
    assert run_one(listed[0], walked)
    assert walked.rig.is_moving


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


def test_a_preview_that_is_ended_gives_the_camera_back(walked: Session) -> None:
    before, photo = walked.rig.eye, walked.active_view
    camera_path.toggle_playing(walked)
    for _ in range(4):
        camera_path.tick(walked, 0.25)
    assert np.abs(walked.rig.eye - before).max() > 1e-3
    camera_path.stop_playing(walked)
    _land(walked)
    np.testing.assert_allclose(walked.rig.eye, before, atol=1e-9)
    assert walked.active_view == photo
    assert not walked.view.playback.is_playing


def test_a_turntable_plays_round_and_round(session: Session) -> None:
    session.rig.zoom(-3)  # out of what the photos surround
    pivot, distance = session.rig.pivot, session.rig.pose.distance
    camera_path.make_turntable(session, 4.0)
    camera_path.toggle_playing(session)
    farthest = max(float(np.linalg.norm(c.position - pivot)) for c in session.cameras)
    turned, away = list[float](), list[float]()
    for _ in range(30):
        camera_path.tick(session, 0.3)
        x, y, _ = session.rig.eye - pivot
        turned.append(float(np.arctan2(y, x)))
        away.append(float(np.linalg.norm(session.rig.eye - pivot)))
        np.testing.assert_allclose(session.rig.pivot, pivot, atol=1e-2 * distance)
    assert abs(np.unwrap(turned)[-1] - turned[0]) > 4 * np.pi
    assert np.ptp(away) < 1e-3 * distance, "a circle"
    assert max(away) < 1.01 * farthest < distance, "between the photos"
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
    expected = export.film_seconds(walked, _SMALL)
    assert 0 < expected < 120
    twice = replace(_SMALL.video, fps=2 * _SMALL.video.fps)
    assert export.film_seconds(walked, replace(_SMALL, video=twice)) > expected
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


@pytest.mark.parametrize("seed", range(3))
def test_undo_of_views_and_edits_goes_back_and_forth(session: Session, seed: int) -> None:
    """A random walk of bookmarks, keyframes, edits, undo and redo, against what there was."""
    rng = np.random.default_rng(seed)
    document = session.need()

    def now() -> tuple[object, ...]:
        history = document.history
        return document.project.film, document.project.bookmarks, history.state_id

    been, at, saved = [now()], 0, now()
    for number in range(120):
        step = rng.integers(7)
        if number % 30 == 20:
            document.save_state.saved(document.save_state.content(document.history.state_id))
            saved = now()
        if step < 2 and at > 0:
            assert document.undo_title
            session.undo()
            at -= 1
        elif step < 3 and at + 1 < len(been):
            assert document.redo_title
            session.redo()
            at += 1
        elif step >= 3:
            if step == 3:
                session.edit(partial(edits.rename, group=1, name=f"name {number}"))
            elif step == 4:
                bookmarks.add_bookmark(session, f"view {number}")
            elif step == 5 and bookmarks.bookmarks(session):
                bookmarks.remove_bookmark(session, 0)
            else:
                session.rig.orbit(10, 0)
                camera_path.add_keyframe(session)
            del been[at + 1 :]
            been.append(now())
            at += 1
        assert now() == been[at]
        assert document.unsaved == (now() != saved), "only what differs from the file is unsaved"
    while at > 0:
        session.undo()
        at -= 1
        assert now() == been[at]
    assert not document.undo_title


@pytest.mark.parametrize("n_selections", [1, 3])
@pytest.mark.parametrize("selected_before", [False, True])
@pytest.mark.parametrize("edited_after", [False, True])
def test_what_was_undone_of_the_views_is_redone_after_a_selection(
    session: Session, n_selections: int, selected_before: bool, edited_after: bool
) -> None:
    """As edits are; it was hidden until the selection was undone."""
    document = session.need()
    session.edit(partial(edits.rename, group=1, name="ball"))
    if selected_before:
        session.need().select(np.arange(5, dtype=np.int32), "set", "Select")
    camera_path.add_keyframe(session)
    if edited_after:
        session.edit(partial(edits.rename, group=1, name="cup"))
        session.undo()
    session.undo()
    if selected_before:
        session.undo()
    assert not camera_path.path_of(session).keyframes
    for n in range(n_selections):
        document.select(np.arange(10 + n, dtype=np.int32), "set", "Select more")
    assert document.redo_title == "Add keyframe"
    session.redo()
    assert len(camera_path.path_of(session).keyframes) == 1
    assert len(session.selected_indices()) == 9 + n_selections
    if edited_after:
        session.redo()
        assert session.need().scene.names == {1: "cup"}
        session.undo()
    assert document.undo_title == "Add keyframe"
    session.undo()
    assert not camera_path.path_of(session).keyframes
    assert document.undo_title.startswith("Select"), "the newest first"


def test_a_dragged_time_is_one_step(session: Session) -> None:
    for _ in range(2):
        camera_path.add_keyframe(session)
        session.rig.orbit(10, 0)
    before = camera_path.path_of(session)
    for seconds in (2.5, 3.0, 3.5):
        camera_path.set_seconds(session, 1, seconds)
    session.undo()
    assert camera_path.path_of(session) == before
    session.redo()
    assert camera_path.path_of(session).keyframes[1].seconds == 3.5
