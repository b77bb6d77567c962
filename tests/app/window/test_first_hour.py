"""What an hour of use found: strokes, the turntable, comparing versions, files that are dropped."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import ImVec2, imgui

from gaga_core.scene import edits
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import State
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import split_view
from gaga_studio.features.camera import bookmarks, path_of
from gaga_studio.session.view import PhotoCompareMode, Side, ToolName
from tests.app.window.driver import KEY, Driver, drive
from tests.app.window.typist import Hand

pytestmark = pytest.mark.window


def _drop(d: Driver, *paths: Path) -> None:
    hand = d.on_main(Hand)
    for _ in hand.drop(paths):
        d.frames(2)
    hand.close()
    d.settle()


def _stroke(d: Driver, places: Sequence[tuple[float, float]]) -> None:
    d.move_to(*places[0])
    d.engine.mouse_down(0)
    left, top = d.corner
    for u, v in places[1:]:
        d.engine.mouse_move_to_pos(ImVec2(left + u, top + v))
    d.engine.mouse_up(0)
    d.settle()


def test_an_object_is_painted_the_scene_turned_compared_and_added_to(
    display: str, grouped_copy: Path, tmp_path: Path
) -> None:
    other = Path(shutil.copy(grouped_copy / "point_cloud.ply", tmp_path / "other.ply"))

    def walk(d: Driver) -> None:
        _a_stroke_takes_the_object_that_is_seen(d)
        _the_turntable_waits_and_stays_between_the_photos(d)
        _undo_takes_back_what_is_done_to_views(d)
        _two_versions_are_compared(d)
        _splats_and_folders_are_dropped_onto_a_scene(d, other, grouped_copy)
        _a_notice_parts_no_name(d, tmp_path / "bad.splat")

    drive(walk, path=grouped_copy)


def _a_stroke_takes_the_object_that_is_seen(d: Driver) -> None:
    d.session.tool = ToolName.BRUSH
    camera = d.session.rig.camera(*d.size)
    table, means = d.session.objects(), world_means(d.scene)
    middles = {int(g): means[group_indices(d.scene, [int(g)])].mean(axis=0) for g in table.ids}
    depth = {g: float(camera.project(at[None])[1][0]) for g, at in middles.items()}
    nearest = min((g for g in depth if table.counts[table.row(g)] < 400), key=depth.__getitem__)
    u, v = d.project(middles[nearest])
    d.session.view.brush_radius = 6.0  # less than half of the object
    _stroke(d, [(u - 4, v), (u, v), (u + 4, v)])
    assert d.session.selected_groups() == (nearest,)
    n = d.history.cursor
    _stroke(d, [(3, 3), (9, 3)])
    assert d.session.selected_groups() == (nearest,), "a stroke over nothing keeps it"
    assert d.history.cursor == n
    d.keys(KEY.escape)


def _the_turntable_waits_and_stays_between_the_photos(d: Driver) -> None:
    pose = d.session.rig.pose
    d.menu("Camera/###Turntable")
    assert not d.session.view.playback.is_playing
    assert d.session.rig.pose == pose
    assert not d.engine.get_window_by_ref("//Camera path").hidden, "the path is seen"
    _stays_between_the_photos(d)
    d.move_to(0.5 * d.size[0], 0.5 * d.size[1])
    d.engine.mouse_wheel_y(-20)
    d.settle()
    assert d.session.rig.pose.distance > 2 * pose.distance, "far behind all photos"
    d.menu("Camera/###Turntable")
    _stays_between_the_photos(d)
    d.keys(KEY.home)
    d.settle()


def _stays_between_the_photos(d: Driver) -> None:
    path = path_of(d.session)
    eyes = np.array([path.shot(t).eye for t in np.linspace(0, path.seconds, 65)])
    places = np.array([camera.position for camera in d.session.cameras])
    edge = 0.1 * np.ptp(places, axis=0).max()  # a curve through keyframes on the edge
    assert len(path.keyframes) == 16
    assert (eyes[:, :2] >= places[:, :2].min(axis=0) - edge).all()
    assert (eyes[:, :2] <= places[:, :2].max(axis=0) + edge).all()


def _undo_takes_back_what_is_done_to_views(d: Driver) -> None:
    turned, n = path_of(d.session), d.history.cursor
    d.keys(KEY.k)
    made_by_hand = path_of(d.session)
    d.menu("Camera/###Turntable")
    d.menu("Camera/###Remove all keyframes")
    d.keys(KEY.mod_ctrl, KEY.z)
    d.keys(KEY.mod_ctrl, KEY.z)
    assert path_of(d.session) == made_by_hand
    d.keys(KEY.mod_ctrl, KEY.z)
    assert path_of(d.session) == turned
    d.keys(KEY.mod_ctrl, KEY.b)
    d.focus("Bookmarks")
    kept = bookmarks(d.session)
    d.click("Bookmarks/**/Remove")
    assert bookmarks(d.session) == ()
    d.keys(KEY.mod_ctrl, KEY.z)
    assert bookmarks(d.session) == kept
    d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.z)
    assert bookmarks(d.session) == ()
    assert d.history.cursor == n, "no edit was undone for it"
    d.focus("History")
    done, undone = d.session.need().view_steps()
    assert (done[-2:], undone) == (["Add bookmark View 1", "Remove bookmark View 1"], [])
    d.engine.set_ref(d.engine.window_info("//History/Entries").window)
    d.engine.item_click("**/###Add bookmark View 1")
    d.frames(4)
    assert bookmarks(d.session) == kept, "History goes back to before it was removed"
    d.engine.item_click("**/###Remove bookmark View 1")
    d.frames(4)
    assert bookmarks(d.session) == ()
    d.focus("Camera path")


def _two_versions_are_compared(d: Driver) -> None:
    d.keys(KEY.delete)
    n_deleted = int(d.scene.has(State.DELETED).sum())
    assert n_deleted > 0
    d.resize(1280, 720)
    d.focus("History")
    after = d.pixels()
    entries = d.engine.window_info("//History/Entries").window
    d.engine.set_ref(entries)
    d.engine.item_click("**/###As opened", 1)
    d.frames(4)
    d.click("$FOCUSED/###Compare")
    assert d.session.view.sides == (Side.VERSION, Side.PICTURE)
    assert split_view.name_of_version(d.session) == "As opened"
    assert int(d.scene.has(State.DELETED).sum()) == n_deleted, "nothing was undone"
    with d.looking():
        left = d.studio.left
        assert left is not None
        before = d.on_main(left.read_pixels).astype(int)
    assert (np.abs(before - after).max(axis=2) > 40).sum() > 100, "it is there on the left"
    shown = split_view.scene_of_version(d.session)
    d.keys(KEY.mod_ctrl, KEY.z)
    assert split_view.scene_of_version(d.session) is shown, "it is not drawn again, from black"
    d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.z)
    at = d.history.cursor
    d.on_main(lambda: split_view.compare_version(d.session, at))
    d.keys(KEY.mod_ctrl, KEY.z)
    d.on_main(lambda: d.session.need().do(edits.hide(d.scene, np.arange(9))))  # in its place
    d.until(lambda: d.session.view.compare is PhotoCompareMode.OFF, "what is gone is not compared")
    assert any("no longer in the history" in notice.text for notice in d.session.notices)
    d.keys(KEY.escape)
    d.keys(KEY.escape)
    assert d.session.selected_groups() == ()
    assert d.session.view.compare is PhotoCompareMode.OFF, "after the selection"


def _splats_and_folders_are_dropped_onto_a_scene(d: Driver, other: Path, folder: Path) -> None:
    n, title = len(d.scene), d.session.title
    _drop(d, other, other)
    question = d.session.pending_question
    _drop(d, other)
    assert d.session.pending_question is question, "nothing happens behind a question"
    assert d.session.title.startswith(title.rstrip("* "))
    d.click("Question/###Add")
    d.until(lambda: len(d.scene) == 3 * n, "both are added")
    d.keys(KEY.mod_ctrl, KEY.z)
    d.keys(KEY.mod_ctrl, KEY.z)
    assert d.session.title.startswith(title.rstrip("* "))
    _drop(d, other)
    d.click("Question/###Open")
    d.settle()
    if d.session.pending_question is not None:
        d.click("Question/###Discard")
        d.settle()
    assert d.session.document is not None
    assert d.session.document.name == "other.ply"
    _drop(d, folder)
    assert d.session.document.name == folder.name


def _a_notice_parts_no_name(d: Driver, wrong: Path) -> None:
    """Lines end at spaces, never after the dot of ".splat", however narrow the picture is."""
    wrong.write_bytes(b"splat" * 7)
    n = len(d.scene)
    _drop(d, wrong)
    d.click("Question/###Open")
    d.settle()
    assert len(d.scene) == n, "what was open stays open"
    text, draw, parted = d.session.notices[-1].text, imgui.text_unformatted, list[str]()
    assert ".splat" in text

    def look(lines: str) -> None:
        draw(lines)
        if "truncated" in lines:
            high = imgui.get_item_rect_size().y
            seen.append(round(high / imgui.get_text_line_height()) - lines.count("\n") - 1)
            parted.append(lines.replace("\n", " "))

    for width in range(640, 1000, 24):
        d.resize(width, 600)
        seen: list[int] = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(imgui, "text_unformatted", look)
            d.frames(2)
        assert seen
        assert not any(seen), width
    assert set(parted) == {text}
