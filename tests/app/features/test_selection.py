"""Selecting by numbers, the sphere, and grades: each one entry, each with a way back."""

import numpy as np
import pytest

from gaga_core import api
from gaga_core.api import SceneObject
from gaga_core.edit_script import run_script
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.by_value import column, shown_colors
from gaga_core.scene.tint import Grade, mean_color
from gaga_studio.features import selection, transform
from gaga_studio.features.commands import run
from gaga_studio.features.transform import GradeSliders
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.gestures import KeyState
from gaga_studio.tools.move import MoveTool
from tests.app.tools.hand import Hand


def _scene(session: Session) -> Scene:
    assert session.scene is not None
    return session.scene


@pytest.fixture
def selected(associated: Session) -> Session:
    table = associated.objects()
    selection.select_groups(associated, (int(table.ids[1 + table.counts[1:].argmax()]),))
    return associated


def test_a_range_selects_what_its_bars_show(associated: Session) -> None:
    histograms = selection.Histograms()
    found = histograms.of(associated, "opacity")
    assert histograms.of(associated, "opacity") is found  # kept while nothing changed
    low, high = float(found.edges[10]), float(found.edges[40])
    assert selection.by_range(associated, "opacity", low, high)
    values = column(_scene(associated), "opacity")
    want = np.flatnonzero((values >= low) & (values <= high))
    assert associated.selected_indices().tolist() == want.tolist()
    again = histograms.of(associated, "opacity")
    assert again is not found
    assert again.chosen.sum() == len(want)
    assert again.chosen[10:40].sum() >= 0.99 * len(want)


def test_the_color_of_the_selection_finds_it_again(selected: Session) -> None:
    chosen = selected.selected_indices()
    rgb = transform.selected_color(selected).tolist()
    selection.select_none(selected)
    assert selection.by_color(selected, rgb, 0.3)
    found = selected.selected_indices()
    assert len(np.intersect1d(found, chosen)) > 0
    assert np.abs(shown_colors(_scene(selected))[found] - rgb).max() <= 0.3 + 1e-6


def test_a_script_and_the_window_mean_the_same_color_of_an_object(selected: Session) -> None:
    """The swatch is the color from outside; scripts took that of splats inside, too."""
    document, scene = selected.need(), _scene(selected)
    chosen, means = selected.selected_indices(), scene.gaussians.means
    out = np.linalg.norm(means[chosen] - means[chosen].mean(axis=0), axis=1)
    scene.gaussians.sh[chosen, 0] = np.where(out < np.median(out), -1.5, 1.0)[:, None]
    group = int(scene.labels[chosen[0]])
    thing = SceneObject(api.Scene(document.project), group)
    np.testing.assert_allclose(thing.color, transform.selected_color(selected), atol=1e-6)
    assert np.abs(thing.color - mean_color(scene, thing.indices)).max() > 0.02
    views = document.project.training_views
    run_script(
        scene, [{"op": "recolor", "color": [0.1, 0.2, 0.8]}], document.history, lambda: views
    )
    np.testing.assert_allclose(transform.selected_color(selected), (0.1, 0.2, 0.8), atol=0.01)


def test_panels_show_the_object_that_most_of_the_selection_is_of(associated: Session) -> None:
    """A click takes a few splats of what stands next to the object."""
    document, labels = associated.need(), _scene(associated).labels
    few, most = np.flatnonzero(labels == 1)[:5], np.flatnonzero(labels == 3)
    document.focus = 0
    document.select(np.sort(np.concatenate([few, most])), "set", "Click an object")
    assert associated.selected_groups() == (1, 3)
    assert associated.focus == 3


def test_a_crop_keeps_the_box_and_undo_brings_the_rest_back(selected: Session) -> None:
    box = selected.need().selected_box()
    assert box is not None
    before = _scene(selected).state.copy()
    assert selection.crop(selected, *box)
    scene = _scene(selected)
    kept = ~scene.has(State.DELETED)
    inside = ((world_means(scene) >= box[0]) & (world_means(scene) <= box[1])).all(axis=1)
    assert not kept[~inside].any()
    assert 0 < kept.sum() < len(scene)
    selected.undo()
    assert np.array_equal(_scene(selected).state, before)


def test_a_box_around_everything_or_the_selection_holds_all_of_it(session: Session) -> None:
    """It held the middle 90 % along each axis, and *Crop* deleted the rest at once."""
    everything = np.flatnonzero(_scene(session).visible)
    assert not selection.crop(session, *selection.box_around(session))
    some = everything[::7].astype(np.int32)
    session.need().select(some, "set", "Select")
    selection.in_box(session, *selection.box_around(session))
    assert np.isin(some, session.selected_indices()).all()


def test_a_flat_box_still_has_a_volume() -> None:
    matrix = selection.box_matrix(np.array([0, 0, 0.0]), np.array([2, 1, 0.0]))
    assert np.linalg.det(matrix[:3, :3]) > 0


def test_many_drags_of_a_grade_are_one_entry(selected: Session) -> None:
    before = shown_colors(_scene(selected))
    grading = GradeSliders()
    n = len(selected.need().history.entries())
    for saturation in (0.8, 0.4, 0.0):
        grading.follow(selected)
        for step in (0.1, 0.0):
            grading.show(selected, Grade(saturation=saturation + step))
        grading.keep(selected)
    assert len(selected.need().history.entries()) == n + 1
    chosen = selected.selected_indices()
    assert np.ptp(shown_colors(_scene(selected))[chosen], axis=1).max() < 1e-5
    grading.follow(selected)
    assert grading.value == Grade(saturation=0.0)
    grading.reset(selected)
    assert len([e for e in selected.need().history.entries() if e.done]) == n
    assert np.array_equal(shown_colors(_scene(selected)), before)


def test_a_drag_of_a_grade_that_is_given_up_leaves_the_one_before(selected: Session) -> None:
    grading = GradeSliders()
    grading.show(selected, Grade(saturation=0.5))
    grading.keep(selected)
    before, document = shown_colors(_scene(selected)), selected.need()
    state = document.history.state_id
    for step in (0.4, 0.2):
        grading.show(selected, Grade(saturation=step))
        assert selected.is_dragging
    selected.cancel_preview()
    grading.follow(selected)
    assert grading.value == Grade(saturation=0.5)
    assert document.history.state_id == state
    assert np.array_equal(shown_colors(_scene(selected)), before)
    n = len(document.history.entries())
    grading.show(selected, Grade(saturation=0.1))
    grading.keep(selected)
    assert len(document.history.entries()) == n, "it replaces the same entry"


def test_a_grade_starts_again_after_another_edit(selected: Session) -> None:
    grading = GradeSliders()
    grading.show(selected, Grade(saturation=0.5))
    grading.keep(selected)
    n = len(selected.need().history.entries())
    transform.duplicate(selected)
    grading.follow(selected)
    assert grading.value == Grade()
    grading.show(selected, Grade(brightness=0.1))
    grading.keep(selected)
    assert len(selected.need().history.entries()) == n + 2


def test_a_ball_takes_what_is_near_the_point_that_was_pressed(associated: Session) -> None:
    associated.tool = ToolName.SPHERE
    hand = Hand(associated)
    found = associated.pick(320, 240, 640, 480)
    assert found is not None
    hand.play(u=320, v=240)
    hand.play(left=True)
    hand.play(u=380, v=240)
    assert hand.controller.overlay is not None
    assert associated.is_previewing
    hand.play(left=False)
    chosen = associated.selected_indices()
    far = np.linalg.norm(world_means(_scene(associated)) - found.point, axis=1)
    assert len(chosen) > 0
    assert far[chosen].max() < np.delete(far, chosen).min()
    focal = associated.rig.camera(640, 480).K[0, 0]
    assert far[chosen].max() == pytest.approx(60 * found.depth / focal, rel=0.2)
    hand.click(2, 2, KeyState())


def test_handles_stand_at_the_pivot_and_along_the_objects_axes(selected: Session) -> None:
    tool = MoveTool(ToolName.ROTATE)
    middle = tool.handles(selected)
    assert middle is not None
    assert np.array_equal(middle[:3, :3], np.eye(3))
    run("tool.set_pivot", selected)
    at = tool.handles(selected)
    assert at is not None
    assert np.allclose(at[:3, 3], selected.rig.pose.pivot)
    run("tool.reset_pivot", selected)
    turned = np.array([[0, -1.0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0]])
    transform.move(selected, turned)
    run("tool.local_axes", selected)
    own = tool.handles(selected)
    assert own is not None
    assert np.allclose(own[:3, :3], turned[:, :3], atol=1e-6)
