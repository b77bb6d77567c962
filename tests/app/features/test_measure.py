"""Measure: true lengths and angles, a scale from one of them; three clicks that lay the ground."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.frame import scale_of
from gaga_core.scene.objects import group_indices
from gaga_core.scene.project import open_path_stage, save_project
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import camera as bookmarks
from gaga_studio.features import camera as camera_path
from gaga_studio.features import files, measure, objects, selection
from gaga_studio.features.commands import command, for_shortcut, run
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.ui.chrome.status import status_text
from tests.app.looks import objects_of, scene_of, snapshot
from tests.app.tools.hand import H, Hand, W
from tests.scenes import random_gaussians

_CORNERS = ((0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.3, 0.4, 0.0))


def test_lengths_angle_and_heights_are_those_of_the_points(associated: Session) -> None:
    session = associated
    assert run("tool.measure", session)
    for corner in _CORNERS:
        measure.add(session, corner)
    found = measure.reading(session)
    np.testing.assert_allclose(found.lengths, (0.3, 0.4), atol=1e-9)
    assert found.angle == pytest.approx(90.0)
    np.testing.assert_allclose(found.heights, np.array(_CORNERS) @ session.rig.up, atol=1e-9)
    assert measure.length(session, 0.3) == "0.3 units"
    # Each number says which it is, and heights above what.
    assert measure.way_texts(session) == ("1 to 2: 0.3 units", "2 to 3: 0.4 units")
    assert [text.split(":")[0] for text in measure.height_texts(session)] == [
        f"Point {i}" for i in (1, 2, 3)
    ]
    assert "above the origin" in measure.HEIGHTS
    assert run("tool.remove_corner", session)
    assert len(measure.clicked(session).points) == 2
    measure.add(session, None)
    assert "no surface" in session.hint
    measure.add(session, _CORNERS[2])
    measure.add(session, _CORNERS[1])
    assert len(measure.clicked(session).points) == 1, "after three points they begin again"
    assert run("edit.cancel", session)
    assert (session.tool, measure.clicked(session).points) == (ToolName.PICK, ())


def test_a_known_length_sets_the_scale_of_everything_and_the_picture_stays(
    associated: Session,
) -> None:
    session = associated
    scene, start = scene_of(session), snapshot(scene_of(session))
    measure.begin(session)
    assert not measure.set_scale(session, 1.0)
    assert "two points" in session.notices[-1].text
    for corner in _CORNERS[:2]:
        measure.add(session, corner)
    assert run("tool.set_scale", session)
    assert len(measure.clicked(session).points) == 2, "what was measured is the known length"
    n = len(session.need().history.entries())
    points = world_means(scene)[::40].astype(np.float64)
    pixels = session.rig.camera(640, 480).project(points)[0]
    photos = [camera.project(points)[0] for camera in session.cameras]
    assert measure.set_scale(session, 2.4)
    session.tick(0.0)
    session.tick(10.0)
    assert [e.title for e in session.need().history.entries()[n:]] == ["Set scale"]
    assert scale_of(scene.frame.world) == pytest.approx(8.0)
    assert measure.reading(session).lengths == pytest.approx((2.4,))
    assert measure.length(session, 2.4) == "2.40 m"
    assert not measure.set_scale(session, 2.4), "Enter in the field, and then the button"
    assert len(session.need().history.entries()) == n + 1
    grown = world_means(scene)[::40].astype(np.float64)
    np.testing.assert_allclose(grown, 8 * points, atol=1e-4)
    np.testing.assert_allclose(session.rig.camera(640, 480).project(grown)[0], pixels, atol=0.1)
    for camera, before in zip(session.cameras, photos, strict=True):
        np.testing.assert_allclose(camera.project(grown)[0], before, atol=0.05)
    session.undo()
    session.tick(0.0)
    session.tick(10.0)
    assert snapshot(scene) == start
    assert measure.reading(session).lengths == pytest.approx((0.3,))
    np.testing.assert_allclose(session.rig.camera(640, 480).project(points)[0], pixels, atol=0.1)


def test_a_length_of_nothing_changes_nothing(associated: Session) -> None:
    start = snapshot(scene_of(associated))
    for corner in _CORNERS[:2]:
        measure.add(associated, corner)
    for metres in (0.0, -1.0, float("nan")):
        assert not measure.set_scale(associated, metres)
    assert snapshot(scene_of(associated)) == start


def test_the_clicked_point_becomes_the_origin(associated: Session) -> None:
    associated.view.pointed = (0.2, -0.1, 0.05)
    before = world_means(scene_of(associated)).astype(np.float64)
    assert run("tool.origin_here", associated)
    np.testing.assert_allclose(
        world_means(scene_of(associated)), before - [0.2, -0.1, 0.05], atol=1e-6
    )
    assert not run("tool.origin_here", associated)


_TILT = np.radians(25.0)


def _means(session: Session) -> DoubleArray:
    return world_means(scene_of(session)).astype(np.float64)


def _tilt(session: Session) -> None:
    """Put the whole scene, floor and all, on a slope far from where it stood."""
    c, s = np.cos(_TILT), np.sin(_TILT)
    turn = np.array([[1, 0, 0, 0.3], [0, c, -s, 0.2], [0, s, c, 2.0]])
    scene = scene_of(session)
    assert session.need().do(edits.transform(scene, np.arange(len(scene)), turn))
    session.rig.pose = session.rig._carried(session.rig.pose, np.vstack([turn, [0, 0, 0, 1]]))


def _floor(session: Session) -> np.ndarray:
    return np.flatnonzero(scene_of(session).gaussians.means[:, 2] < -0.299)


def _balls(session: Session) -> list[int]:
    """Objects without the floor."""
    labels = scene_of(session).labels
    on_floor = np.isin(np.arange(len(labels)), _floor(session))
    return [group for group in objects_of(session) if on_floor[labels == group].mean() < 0.1]


def _spots(session: Session) -> list[tuple[float, float]]:
    """Pixels of three places of the bare floor, far apart."""
    pixels, _ = session.rig.camera(W, H).project(_means(session)[_floor(session)])
    middles = np.floor(pixels) + 0.5
    found: list[tuple[float, float]] = []
    for near in ((100, 240), (540, 240), (320, 420)):
        for at in middles[np.argsort(np.hypot(*(middles - near).T))]:
            hit = session.pick(float(at[0]), float(at[1]), W, H)
            if hit is None or hit.weights.sum() < 0.8:
                continue
            if np.isin(hit.splat, _floor(session)):
                found.append((float(at[0]), float(at[1])))
                break
    assert len(found) == 3
    return found


def _slope(session: Session) -> float:
    """Sine of the angle between the floor and level."""
    points = _means(session)[_floor(session)]
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    return float(np.linalg.norm(np.cross(normal, session.rig.up)))


def test_three_clicks_lay_the_floor_level_as_one_undoable_edit(associated: Session) -> None:
    session = associated
    _tilt(session)
    scene = scene_of(session)
    hidden, locked = _balls(session)[:2]
    objects.set_hidden(session, hidden, True)
    objects.set_locked(session, locked, True)
    session.tool = ToolName.LASSO
    assert run("tool.ground", session)
    hand, before = Hand(session), snapshot(scene)
    n, apart = len(session.need().history.entries()), _distances(session)
    for clicked, (u, v) in enumerate(_spots(session)):
        assert f"{clicked + 1} of 3" in status_text(session, hand.controller.tool(session))
        assert snapshot(scene) == before
        hand.click(u, v)
    entries = session.need().history.entries()
    assert [entry.title for entry in entries[n:]] == ["Align to ground"]
    assert session.tool is ToolName.LASSO
    assert _slope(session) < 0.05 < np.sin(_TILT) / 4  # splats are as thick as that
    height = _means(session)[_floor(session)] @ session.rig.up
    assert np.abs(height.mean()) < 0.06
    np.testing.assert_allclose(_distances(session), apart, atol=1e-5)
    assert session.unsaved
    assert "level now" in session.notices[-1].text
    session.undo()
    assert snapshot(scene) == before


def test_photos_bookmarks_and_path_follow_the_ground_and_come_back(associated: Session) -> None:
    session = associated
    bookmarks.add_bookmark(session, "here")
    camera_path.add_keyframe(session)
    points = _means(session)[::50]
    seen = [camera.project(points)[0] for camera in session.cameras]
    shot, key = bookmarks.bookmarks(session)[0].shot, camera_path.path_of(session).keyframes[0].shot
    (point,) = points[:1]
    turned = np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]])
    laid = np.array([point, point + turned @ [1.0, 0, 0.3], point + turned @ [0, 1.0, 0]])
    assert measure.align(session, laid)
    moved = _means(session)[::50]
    assert not np.allclose(moved, points, atol=1e-2)
    for camera, before in zip(session.cameras, seen, strict=True):
        np.testing.assert_allclose(camera.project(moved)[0], before, atol=0.05)  # pixels
    for now, then in (
        (bookmarks.bookmarks(session)[0].shot, shot),
        (camera_path.path_of(session).keyframes[0].shot, key),
    ):
        now_seen = now.camera(640, 480).project(moved)[0]
        np.testing.assert_allclose(now_seen, then.camera(640, 480).project(points)[0], atol=0.05)
    bookmarks.add_bookmark(session, "there")  # kept in the frame of the file, read where it is
    np.testing.assert_allclose(
        bookmarks.bookmarks(session)[1].shot.eye, session.rig.shot().eye, atol=1e-9
    )
    session.undo()  # the bookmark
    session.undo()
    assert bookmarks.bookmarks(session)[0].shot == shot
    assert camera_path.path_of(session).keyframes[0].shot == key
    again = [camera.project(points)[0] for camera in session.cameras]
    np.testing.assert_array_equal(again, seen)


def _distances(session: Session) -> DoubleArray:
    """How far splats of every group, the hidden and the locked one too, are from the first."""
    scene = scene_of(session)
    firsts = [group_indices(scene, int(group))[0] for group in np.unique(scene.labels)]
    means = _means(session)[firsts]
    result: DoubleArray = np.linalg.norm(means - means[0], axis=1)
    return result


def test_the_camera_goes_along_and_comes_back(associated: Session) -> None:
    session = associated
    _tilt(session)
    session.tick(1.0)
    run("tool.ground", session)
    hand = Hand(session)
    floor = _means(session)[_floor(session)]
    before = session.rig.camera(W, H).project(floor)[0]
    for u, v in _spots(session):
        hand.click(u, v)
    for go, back in (("", "edit.undo"), ("edit.redo", "edit.undo")):
        assert not go or run(go, session)
        session.tick(0.0)
        now = session.rig.camera(W, H).project(_means(session)[_floor(session)])[0]
        np.testing.assert_allclose(now, before, atol=0.1)
        session.tick(1.0)
        assert abs(session.rig.pose.roll) < 1e-9
        assert _seen(session) > 0.5
        before = session.rig.camera(W, H).project(_means(session)[_floor(session)])[0]
        assert run(back, session)
        session.tick(0.0)
        now = session.rig.camera(W, H).project(_means(session)[_floor(session)])[0]
        np.testing.assert_allclose(now, before, atol=0.1)
        session.tick(1.0)
        assert _seen(session) > 0.5
        before = session.rig.camera(W, H).project(_means(session)[_floor(session)])[0]


def _seen(session: Session) -> float:
    """Share of the floor that is in the picture."""
    pixels, depth = session.rig.camera(W, H).project(_means(session)[_floor(session)])
    inside = np.all((pixels > 0) & (pixels < [W, H]), axis=1)
    return float(np.mean(inside & (depth > 0)))


def test_the_points_stand_in_space_while_the_camera_orbits(associated: Session) -> None:
    session = associated
    _tilt(session)
    run("tool.ground", session)
    hand = Hand(session)
    for number in range(3):
        at = _spots(session)[number]
        hand.click(*at)
        before, points = session.rig.eye, measure.clicked(session).points
        hand.drag(np.array([300.0, 200.0]), np.array([330.0, 190.0]))
        session.tick(1.0)
        assert not np.array_equal(before, session.rig.eye)
        assert measure.clicked(session).points == points
    assert session.tool is ToolName.PICK
    assert _slope(session) < 0.05


def test_points_nearly_on_a_line_are_taken_back_and_nothing_is_changed(
    associated: Session,
) -> None:
    session = associated
    run("tool.ground", session)
    hand, before = Hand(session), snapshot(scene_of(session))
    for u, v in (_spots(session)[0],) * 3:
        hand.click(u, v)
    assert session.notices[-1].level is Level.ERROR
    assert "nearly on a line" in session.notices[-1].text
    assert measure.clicked(session).points == ()
    assert session.tool is ToolName.GROUND
    assert snapshot(scene_of(session)) == before
    assert not session.need().history.entries()


def test_a_click_on_nothing_says_so_and_keeps_the_points(associated: Session) -> None:
    session = associated
    run("tool.ground", session)
    hand = Hand(session)
    hand.click(*_spots(session)[0])
    hand.click(2, 2)
    said = status_text(session, hand.controller.tool(session))
    assert said == "There is no surface here. Click three points on the ground: 2 of 3."
    assert len(measure.clicked(session).points) == 1
    second = _spots(session)[1]
    scene_of(session).placements.opacity[:] = 0.05
    hand.click(*second)
    assert len(measure.clicked(session).points) == 1, "a haze is no surface"
    scene_of(session).placements.opacity[:] = 1.0
    hand.click(*second)
    assert "no surface" not in status_text(session, hand.controller.tool(session))


def test_backspace_takes_one_back_and_never_deletes(associated: Session) -> None:
    session = associated
    selection.select_groups(session, (objects_of(session)[0],))
    run("tool.ground", session)
    hand, before = Hand(session), snapshot(scene_of(session))
    for u, v in _spots(session)[:2]:
        hand.click(u, v)
    for left in (1, 0, 0):
        back, n = for_shortcut("Backspace", session), len(measure.clicked(session).points)
        assert back is not None
        assert run(back.id, session) is (n > left)
        assert len(measure.clicked(session).points) == left
    assert "No point" in session.hint
    assert snapshot(scene_of(session)) == before
    hand.click(*_spots(session)[0])
    hand.play(right=True)
    hand.play(right=False)
    assert measure.clicked(session).points == ()
    assert session.request is None


@pytest.mark.parametrize("former", [ToolName.PICK, ToolName.MOVE])
def test_escape_leaves_the_tool_for_the_former_one(associated: Session, former: ToolName) -> None:
    session = associated
    session.tool = former
    run("tool.ground", session)
    run("tool.ground", session)  # twice is no tool of its own
    hand = Hand(session)
    hand.click(*_spots(session)[0])
    assert run("edit.cancel", session)
    assert session.tool is former
    assert measure.clicked(session).points == ()
    assert command("tool.remove_corner").enabled(session)
    run("tool.ground", session)
    assert measure.clicked(session).points == ()


def test_splats_of_several_files_are_laid_down_as_one(
    associated: Session, tmp_path_factory: pytest.TempPathFactory
) -> None:
    session = associated
    file = tmp_path_factory.mktemp("more") / "chair.ply"
    write_splats(file, random_gaussians(50, extent=0.1))
    files.add_splats(session, file)
    assert session.jobs.wait()
    _tilt(session)
    run("tool.ground", session)
    hand = Hand(session)
    before = _means(session)
    for u, v in _spots(session):
        hand.click(u, v)
    after = _means(session)
    moved = session.need().world[:3]
    np.testing.assert_allclose(before @ moved[:, :3].T + moved[:, 3], after, atol=1e-5)


def test_another_scene_begins_without_points(associated: Session) -> None:
    run("tool.ground", associated)
    hand = Hand(associated)
    hand.click(*_spots(associated)[0])
    associated.close()
    assert associated.document is None
    assert measure.clicked(associated).points == ()


def test_a_scene_that_was_laid_level_is_level_when_it_is_opened_again(
    associated: Session, tmp_path: Path
) -> None:
    """The photos are a little askew to the ground; the camera's up is the ground's."""
    session = associated
    up = session.rig.up
    slope = np.array([[0, 0, 0.0], [1, 0, 0.12], [0, 1, 0.05]])
    assert measure.align(session, slope)
    normal = np.cross(slope[1] - slope[0], slope[2] - slope[0])
    turned = session.need().world[:3, :3] @ (normal / np.linalg.norm(normal))
    np.testing.assert_allclose(turned, up, atol=1e-9)
    saved = save_project(session.need().settled(), tmp_path / "level.gaga")
    session.take(run_stage(open_path_stage(saved)))
    np.testing.assert_allclose(session.rig.up, up, atol=1e-9)
