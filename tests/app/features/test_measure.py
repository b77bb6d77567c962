"""The tool Measure: true lengths and angles, and a scale from one of them."""

import numpy as np
import pytest

from gaga_core.scene.frame import scale_of
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import measure
from gaga_studio.features.commands import run
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from tests.app.looks import scene_of, snapshot

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
