"""The camera: from photo to photo, bookmarks, its path with keyframes and their preview."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.scene.camera_path import (
    Bookmark,
    CameraPath,
    Keyframe,
    Shot,
    carried_bookmarks,
    carried_path,
    load_path,
    save_path,
    turntable,
)
from gaga_core.scene.objects import group_indices
from gaga_core.scene.orientation import upright_basis
from gaga_core.scene.project import require_other_file
from gaga_core.scene.selection.bounds import object_box, subject_box
from gaga_studio.features.base import Command, ask, first_of, needs, no_photos, no_scene
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.settings import RANGES


def go_to_view(session: Session, index: int) -> None:
    """Fly to the camera of a photo (its place in ``session.cameras``)."""
    session.active_view = index
    session.rig.go_to(session.cameras[index])


def view_index(session: Session, name: str) -> int | None:
    """Return the index of the photo ``name`` in ``session.cameras``; None if there is none."""
    names = [camera.name for camera in session.cameras]
    return names.index(name) if name in names else None


def next_view(session: Session, step: int) -> None:
    """Fly to the next (1) or previous (-1) photo, cyclically."""
    if session.cameras:
        at = session.active_view if session.active_view is not None else -step
        go_to_view(session, (at + step) % len(session.cameras))


def frame_all(session: Session) -> None:
    """Show everything that is visible, without a far background."""
    _frame(session, None)


def show_start(session: Session) -> None:
    """Fly to the view in which the scene was opened."""
    session.active_view = session.show_start(animated=True)


def frame_selected(session: Session) -> None:
    """Show the selection; everything when nothing is selected."""
    indices = session.selected_indices()
    _frame(session, indices if len(indices) else None)


def frame_group(session: Session, group: int) -> None:
    """Show one object, from a side where it is not hidden."""
    scene = session.need().scene
    indices = group_indices(scene, group)
    if len(indices):
        session.rig.focus_clearly(scene, indices)


def focus_at(session: Session, u: float, v: float, width: int, height: int) -> bool:
    """Make the surface at a pixel the pivot of the camera (double click)."""
    found = session.pick(u, v, width, height)
    if found is not None:
        session.rig.set_pivot(found.point)
    return found is not None


def _frame(session: Session, indices: IntArray | None) -> None:
    scene = session.need().scene
    if indices is None:
        lo, hi = subject_box(scene, session.cameras)
    elif len(indices):
        lo, hi = object_box(scene, indices)
    else:
        return
    session.rig.focus((lo + hi) / 2, float(np.linalg.norm(hi - lo)) / 2)


def up_of(session: Session) -> tuple[float, float, float]:
    """Which way is up in the open scene, unit (3,)."""
    x, y, z = session.rig.up / np.linalg.norm(session.rig.up)
    return float(x), float(y), float(z)


# --- bookmarks

BOOKMARK_KEYS = tuple(range(1, 10))


def bookmarks(session: Session) -> tuple[Bookmark, ...]:
    """Return the bookmarks of the open scene, in their order."""
    document = session.document
    if document is None:
        return ()
    marks, world = document.project.bookmarks, document.world
    key = (marks, world.tobytes())
    return document.read.once("bookmarks", key, lambda: carried_bookmarks(marks, world))


def add_bookmark(session: Session, name: str = "", key: int = 0) -> None:
    """Keep the present view at the end of the list."""
    marks = bookmarks(session)
    mark = Bookmark(name or _fresh_name(marks), session.rig.shot(), key)
    _keep_bookmarks(session, (*marks, mark), f"Add bookmark {mark.name}")
    _say_kept(session, mark)


def _say_kept(session: Session, mark: Bookmark) -> None:
    where = f": Ctrl+{mark.key}" if mark.key else ""
    session.hint = f"Kept {mark.name} as a bookmark{where}"


def recall_bookmark(session: Session, index: int) -> None:
    """Fly to a bookmark by its place in the list."""
    session.view.playback.is_playing = False
    session.active_view = None
    session.rig.go_to_shot(bookmarks(session)[index].shot)


def recall_commands(session: Session) -> tuple[Command, ...]:
    """Return a command for each bookmark, called as it is, in their order."""
    return tuple(
        Command(
            f"camera.recall {index}",
            mark.name,
            partial(recall_bookmark, index=index),
            f"Ctrl+{mark.key}" if mark.key else "",
        )
        for index, mark in enumerate(bookmarks(session))
    )


def bookmark_index(session: Session, key: int) -> int | None:
    """Return the index of the bookmark that has a key 1..9; None if none has it."""
    return next((i for i, mark in enumerate(bookmarks(session)) if mark.key == key), None)


def set_bookmark_key(session: Session, key: int) -> None:
    """Keep the present view under a key 1..9: its bookmark moves here, or a new one is made."""
    index, name = bookmark_index(session, key), f"View {key}"
    if index is not None:
        update_bookmark(session, index)
        _say_kept(session, bookmarks(session)[index])
    else:
        is_taken = any(mark.name == name for mark in bookmarks(session))
        add_bookmark(session, "" if is_taken else name, key)


def recall_bookmark_key(session: Session, key: int) -> bool:
    """Fly to the bookmark with this key; False if there is none."""
    index = bookmark_index(session, key)
    if index is not None:
        recall_bookmark(session, index)
    return index is not None


def update_bookmark(session: Session, index: int) -> None:
    """Replace the view of a bookmark by the present one."""
    mark = bookmarks(session)[index]
    _change(session, index, replace(mark, shot=session.rig.shot()), f"Update bookmark {mark.name}")


def rename_bookmark(session: Session, index: int, name: str) -> None:
    """Give a bookmark another name; an empty one changes nothing."""
    mark = bookmarks(session)[index]
    if name.strip() and name.strip() != mark.name:
        title = f"Rename bookmark {mark.name} to {name.strip()}"
        _change(session, index, replace(mark, name=name.strip()), title)


def remove_bookmark(session: Session, index: int) -> None:
    """Forget a bookmark."""
    marks = bookmarks(session)
    title = f"Remove bookmark {marks[index].name}"
    _keep_bookmarks(session, (*marks[:index], *marks[index + 1 :]), title)


def move_bookmark(session: Session, index: int, by: int) -> None:
    """Move a bookmark up (-1) or down (1) in the list."""
    marks = list(bookmarks(session))
    to = index + by
    if 0 <= to < len(marks):
        marks.insert(to, marks.pop(index))
        _keep_bookmarks(session, tuple(marks), f"Move bookmark {marks[to].name}")


def _change(session: Session, index: int, mark: Bookmark, title: str) -> None:
    marks = bookmarks(session)
    _keep_bookmarks(session, (*marks[:index], mark, *marks[index + 1 :]), title)


def _keep_bookmarks(session: Session, marks: tuple[Bookmark, ...], title: str) -> None:
    document = session.need()
    kept = document.project.bookmarks
    known = {now.shot: was.shot for now, was in zip(bookmarks(session), kept, strict=True)}
    marks = tuple(replace(mark, shot=document.as_opened(mark.shot, known)) for mark in marks)
    document.keep_views(title, bookmarks=marks)


def _fresh_name(marks: tuple[Bookmark, ...]) -> str:
    names, n = {mark.name for mark in marks}, len(marks) + 1
    while f"View {n}" in names:
        n += 1
    return f"View {n}"


# --- the path

KEYFRAME_SECONDS = 2.0  # from one keyframe to the next, by default
TURN_SECONDS = 8.0
_ROUND_OFF = 1e-6  # radians, and shares of the distance: below a thousandth of a pixel


def path_of(session: Session) -> CameraPath:
    """Return the path of the open scene; without keyframes when nothing is open."""
    document = session.document
    if document is None:
        return CameraPath()
    film, world = document.project.film, document.world
    key = (film, world.tobytes())
    return document.read.once("camera path", key, lambda: carried_path(film, world))


# --- keyframes


def add_keyframe(session: Session) -> None:
    """Add the present view as a keyframe after the chosen one, or at the end.

    Not a second time in a row: it would be a stop that nobody asked for.
    """
    path, chosen = path_of(session), session.view.playback.chosen
    at, shot = min(chosen + 1, len(path.keyframes)), session.rig.shot()
    if at and _is_same(path.keyframes[at - 1].shot, shot):
        session.hint = f"This view is keyframe {at} already"
        return
    key = Keyframe(shot, KEYFRAME_SECONDS)
    _with_keys(session, (*path.keyframes[:at], key, *path.keyframes[at:]), "Add keyframe")
    choose_keyframe(session, at, goes=False)
    session.hint = f"Keyframe {at + 1} added"


def _is_same(a: Shot, b: Shot) -> bool:
    """Whether two shots are one view; what moved along with the scene differs by round-off."""
    seen = np.array([(*s.eye, *s.turn.ravel(), s.fov_x, s.fov_y, s.distance) for s in (a, b)])
    seen[:, [0, 1, 2, -1]] /= a.distance
    is_close = bool(np.abs(seen[0] - seen[1]).max() < _ROUND_OFF)
    return is_close and a.is_orthographic == b.is_orthographic


def update_keyframe(session: Session, index: int) -> None:
    """Replace the view of a keyframe by the present one."""
    keys = list(path_of(session).keyframes)
    keys[index] = replace(keys[index], shot=session.rig.shot())
    _with_keys(session, tuple(keys), f"Update keyframe {index + 1}")


def remove_keyframe(session: Session, index: int) -> None:
    """Remove a keyframe."""
    keys = path_of(session).keyframes
    _with_keys(session, (*keys[:index], *keys[index + 1 :]), f"Remove keyframe {index + 1}")
    playback = session.view.playback
    playback.chosen = max(min(playback.chosen, len(keys) - 2), 0)


def move_keyframe(session: Session, index: int, by: int) -> None:
    """Move a keyframe earlier (-1) or later (1); the times between the places stay."""
    keys = list(path_of(session).keyframes)
    to = index + by
    if 0 <= to < len(keys):
        a, b = keys[index], keys[to]
        keys[index], keys[to] = replace(a, shot=b.shot), replace(b, shot=a.shot)
        _with_keys(session, tuple(keys), f"Move keyframe {index + 1}")
        choose_keyframe(session, to, goes=False)


def set_seconds(session: Session, index: int, seconds: float) -> None:
    """Set the time from the keyframe before to this one."""
    keys = list(path_of(session).keyframes)
    keys[index] = replace(keys[index], seconds=min(max(seconds, 0.05), 600.0))
    _with_keys(session, tuple(keys), f"Set the seconds of keyframe {index + 1}", is_drag=True)


def set_total_seconds(session: Session, seconds: float) -> None:
    """Stretch all times so that the whole path takes ``seconds``."""
    path = path_of(session)
    if path.seconds > 0 and seconds > 0:
        factor = seconds / path.seconds
        keys = tuple(replace(k, seconds=max(k.seconds * factor, 1e-3)) for k in path.keyframes)
        _with_keys(session, keys, "Set the seconds of the path", is_drag=True)


def set_closed_path(session: Session, closed: bool) -> None:
    """Close the path from the last keyframe to the first, or open it."""
    title = "Close the path" if closed else "Leave the path open"
    _keep_path(session, replace(path_of(session), is_closed=closed), title)


def set_even_speed(session: Session, even: bool) -> None:
    """Use one speed along the path, or the times of the keyframes."""
    title = "Even speed" if even else "Speed by keyframes"
    _keep_path(session, replace(path_of(session), even_speed=even), title)


def clear_path(session: Session) -> None:
    """Remove every keyframe."""
    _with_keys(session, (), "Remove all keyframes")
    session.view.playback.chosen = 0


def make_turntable(session: Session, seconds: float = TURN_SECONDS) -> None:
    """Replace the path by a circle around the pivot that stays between the photos."""
    places = np.array([camera.position for camera in session.cameras]).reshape(-1, 3)
    seen_from = places if len(places) else None
    shot, up = session.rig.shot(), session.rig.up
    path = turntable(shot, up, seconds, seen_from=seen_from, basis=upright_basis(up))
    _keep_path(session, path, "Turntable")
    session.view.playback.chosen = 0
    session.view.playback.at = 0.0
    session.view.playback.is_playing = False
    session.request = Request.CAMERA_PATH


@notifies
def save_path_file(session: Session, file: Path) -> None:
    """Write the path as JSON, for ``gaga render --path``."""
    require_other_file(session.need().project, file)
    session.notify(Level.INFO, f"Saved the path to {save_path(path_of(session), file)}.")


@notifies
def open_path_file(session: Session, file: Path) -> None:
    """Take the path of a JSON file in place of the present one."""
    _keep_path(session, load_path(file), f"Path of {file.name}")
    session.view.playback.chosen = 0


# --- preview


def toggle_playing(session: Session) -> None:
    """Play the path, from its start when it had ended; or stop."""
    playback, path = session.view.playback, path_of(session)
    playback.is_playing = not playback.is_playing and len(path.keyframes) > 1
    if playback.is_playing:
        playback.came_from = session.rig.goal, session.active_view
        if playback.at >= path.seconds - 1e-6:
            playback.at = 0.0


def stop_playing(session: Session) -> None:
    """End the preview and fly back to where the camera stood before it."""
    playback = session.view.playback
    playback.is_playing = False
    if playback.came_from is not None:
        pose, session.active_view = playback.came_from
        session.rig.return_to(pose)
        playback.came_from = None


def tick(session: Session, dt: float) -> None:
    """Advance the preview, once a frame. A camera that is moved by hand ends it."""
    playback, path = session.view.playback, path_of(session)
    if not playback.is_playing:
        return
    if len(path.keyframes) < 2:
        playback.is_playing = False
        return
    at = playback.at + dt
    if path.is_closed:
        at %= path.seconds
    playback.is_playing = at < path.seconds
    scrub(session, at)


def scrub(session: Session, seconds: float) -> None:
    """Show the path's view at a moment."""
    path = path_of(session)
    if not path.keyframes:
        return
    session.view.playback.at = min(max(seconds, 0.0), path.seconds)
    session.active_view = None
    session.rig.go_to_shot(path.shot(session.view.playback.at), animated=False)


def choose_keyframe(session: Session, index: int, *, goes: bool = True) -> None:
    """Make a keyframe the chosen one, and fly there."""
    path = path_of(session)
    session.view.playback.chosen = index
    session.view.playback.is_playing = False
    if index < len(path.keyframes):
        session.view.playback.at = path.times()[index]
        if goes:
            session.active_view = None
            session.rig.go_to_shot(path.keyframes[index].shot)


def _with_keys(
    session: Session, keys: tuple[Keyframe, ...], title: str, *, is_drag: bool = False
) -> None:
    _keep_path(session, replace(path_of(session), keyframes=keys), title, is_drag=is_drag)


def _keep_path(session: Session, path: CameraPath, title: str, *, is_drag: bool = False) -> None:
    document = session.need()
    shown, kept = path_of(session).keyframes, document.project.film.keyframes
    known = {now.shot: was.shot for now, was in zip(shown, kept, strict=True)}
    keys = tuple(replace(k, shot=document.as_opened(k.shot, known)) for k in path.keyframes)
    document.keep_views(title, film=replace(path, keyframes=keys), is_drag=is_drag)
    session.view.playback.at = min(session.view.playback.at, path.seconds)


# --- commands


def _speed(factor: float) -> Callable[[Session], None]:
    low, high = RANGES["fly_speed"]

    def run(session: Session) -> None:
        speed = min(max(session.settings.fly_speed * factor, low), high)
        session.change_settings(replace(session.settings, fly_speed=speed))
        session.hint = f"Fly speed {speed:.2g}×"

    return run


def _toggle_orthographic(session: Session) -> None:
    session.rig.set_orthographic(not session.rig.pose.is_orthographic)


def _toggle_flying(session: Session) -> None:
    session.rig.is_flying = not session.rig.is_flying


def _recall(key: int) -> Command:
    def name(session: Session) -> str:
        index = bookmark_index(session, key)
        return f"Bookmark {key}" if index is None else bookmarks(session)[index].name

    return Command(
        RECALL[key - 1],
        f"Go to bookmark {key}",
        lambda session: recall_bookmark_key(session, key),
        f"Ctrl+{key}",
        enabled=needs(
            lambda session: bookmark_index(session, key) is not None,
            f"No bookmark has the key {key} yet.",
        ),
        describe=name,
    )


def _set(key: int) -> Command:
    return Command(
        SET[key - 1],
        f"Set bookmark {key}",
        lambda session: set_bookmark_key(session, key),
        f"Ctrl+Shift+{key}",
        enabled=no_scene,
    )


def _axis(axis: str) -> Command:
    return Command(
        f"view.{axis}", f"From the {axis}", lambda s: s.rig.look_along(axis), enabled=no_scene
    )


RECALL = tuple(f"camera.bookmark_{key}" for key in BOOKMARK_KEYS)
SET = tuple(f"camera.set_bookmark_{key}" for key in BOOKMARK_KEYS)
no_keyframe = needs(
    lambda session: session.need().project.film.keyframes,
    "The camera's path has no keyframes. Add one first.",
)
no_path = first_of(
    no_keyframe,
    needs(
        lambda session: len(session.need().project.film.keyframes) > 1,
        "The camera's path has one keyframe only. Add another one.",
    ),
)


def no_photo_files(session: Session) -> str:
    """Needs photos that are on the disk."""
    folder = session.project.folder if session.project is not None else None
    if folder is not None and folder.image_paths:
        return ""
    return no_photos(session) or "The photos of this scene are not here."


COMMANDS: tuple[Command, ...] = (
    Command("view.frame_selected", "Focus the selection", frame_selected, "F", enabled=no_scene),
    Command(
        "view.frame_all",
        "Show the whole scene",
        frame_all,
        "Shift+F",
        enabled=no_scene,
    ),
    Command("view.home", "Back to the first view", show_start, "Home", enabled=no_scene),
    *(_axis(axis) for axis in ("front", "back", "left", "right", "top", "bottom")),
    Command("view.next_photo", "Next photo", lambda s: next_view(s, 1), "Right", enabled=no_photos),
    Command(
        "view.previous_photo",
        "Previous photo",
        lambda s: next_view(s, -1),
        "Left",
        enabled=no_photos,
    ),
    Command(
        "view.fly", "Fly", _toggle_flying, "V", enabled=no_scene, is_on=lambda s: s.rig.is_flying
    ),
    Command(
        "view.ortho",
        "Orthographic",
        _toggle_orthographic,
        "5",
        enabled=no_scene,
        is_on=lambda session: session.rig.pose.is_orthographic,
    ),
    Command("camera.faster", "Fly faster", _speed(1.25)),
    Command("camera.slower", "Fly slower", _speed(1 / 1.25)),
    Command("camera.add_bookmark", "Bookmark this view", add_bookmark, "Ctrl+B", enabled=no_scene),
    *(_recall(key) for key in BOOKMARK_KEYS),
    *(_set(key) for key in BOOKMARK_KEYS),
    Command("camera.add_keyframe", "Add keyframe", add_keyframe, "K", enabled=no_scene),
    Command("camera.turntable", "Turntable", make_turntable, enabled=no_scene),
    Command(
        "camera.play",
        "Play the path",
        toggle_playing,
        "Shift+K",
        enabled=no_path,
        is_on=lambda session: session.view.playback.is_playing,
    ),
    Command("camera.clear_path", "Remove all keyframes", clear_path, enabled=no_keyframe),
    ask("camera.open_path", "Open path…", Request.OPEN_PATH, enabled=no_scene),
    ask("camera.save_path", "Save path…", Request.SAVE_PATH, enabled=no_keyframe),
)
