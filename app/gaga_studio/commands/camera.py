"""Camera: projection, speed, bookmarks, photo against picture, the path and its film."""

from collections.abc import Callable
from dataclasses import replace

from gaga_studio.actions import bookmarks, camera_path, photo_compare, split_view
from gaga_studio.commands.availability import (
    busy,
    no_keyframe,
    no_path,
    no_photos,
    no_scene,
    not_filmable,
)
from gaga_studio.commands.base import Command, Reason, ask, switch
from gaga_studio.session.requests import Request
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import PhotoCompareMode, Side

_SLOWEST, _FASTEST = 0.1, 5.0  # of the preferences' slider
RECALL = tuple(f"camera.bookmark_{key}" for key in bookmarks.KEYS)
SET = tuple(f"camera.set_bookmark_{key}" for key in bookmarks.KEYS)


def _toggle_orthographic(session: Session) -> None:
    session.rig.set_orthographic(not session.rig.pose.is_orthographic)


def _speed(factor: float) -> Callable[[Session], None]:
    def run(session: Session) -> None:
        speed = min(max(session.settings.fly_speed * factor, _SLOWEST), _FASTEST)
        session.change_settings(replace(session.settings, fly_speed=speed))
        session.hint = f"Fly speed {speed:.2g}×"

    return run


def _compare(mode: PhotoCompareMode, name: str, title: str) -> Command:
    return Command(
        f"camera.{name}",
        title,
        lambda session: photo_compare.set_mode(session, mode),
        enabled=no_photos,
        is_on=lambda session: session.view.compare is mode,
    )


def _split(name: str, title: str, left: Side, right: Side) -> Command:
    return Command(
        f"camera.{name}",
        title,
        lambda session: split_view.show(session, left, right),
        enabled=lambda session: _no_split(session, left, right),
        is_on=lambda session: split_view.is_shown(session, left, right),
    )


def _no_split(session: Session, left: Side, right: Side) -> str:
    if split_view.is_shown(session, left, right):
        return ""
    reason = split_view.why_not(session, left) or split_view.why_not(session, right)
    is_job = left is Side.PRESET and split_view.other_labels(session) is None
    return reason or (busy(session) if is_job else "")


def _no_bookmark(key: int) -> Reason:
    def reason(session: Session) -> str:
        if bookmarks.index_of(session, key) is not None:
            return ""
        return no_scene(session) or f"No bookmark has the key {key} yet."

    return reason


def _name_of(key: int) -> Callable[[Session], str]:
    def describe(session: Session) -> str:
        index = bookmarks.index_of(session, key)
        return bookmarks.listed(session)[index].name if index is not None else f"Bookmark {key}"

    return describe


def _recall(key: int) -> Command:
    return Command(
        RECALL[key - 1],
        f"Go to bookmark {key}",
        lambda session: bookmarks.recall_key(session, key),
        f"Ctrl+{key}",
        enabled=_no_bookmark(key),
        describe=_name_of(key),
    )


def _set(key: int) -> Command:
    return Command(
        SET[key - 1],
        f"Set bookmark {key}",
        lambda session: bookmarks.set_key(session, key),
        f"Ctrl+Shift+{key}",
        enabled=no_scene,
    )


CAMERA_COMMANDS: tuple[Command, ...] = (
    Command(
        "view.ortho",
        "Orthographic",
        _toggle_orthographic,
        "5",
        enabled=no_scene,
        is_on=lambda session: session.rig.pose.is_orthographic,
    ),
    switch("view.cube", "View cube", "show_cube"),
    Command("camera.faster", "Fly faster", _speed(1.25)),
    Command("camera.slower", "Fly slower", _speed(1 / 1.25)),
    Command("camera.add_bookmark", "Bookmark this view", bookmarks.add, "Ctrl+B", enabled=no_scene),
    *(_recall(key) for key in bookmarks.KEYS),
    *(_set(key) for key in bookmarks.KEYS),
    _split("swipe", "Swipe between photo and picture", Side.PHOTO, Side.PICTURE),
    _split("split_groups", "Split: picture and groups", Side.PICTURE, Side.GROUPS),
    _split("split_photo_groups", "Split: photo and groups", Side.PHOTO, Side.GROUPS),
    _split("split_truth", "Split: truth and groups", Side.TRUTH, Side.GROUPS),
    _split("split_errors", "Split: groups and their errors", Side.GROUPS, Side.ERRORS),
    _split("split_before", "Split: before and after the last edit", Side.BEFORE, Side.PICTURE),
    _split("split_preset", "Split: the other preset and these groups", Side.PRESET, Side.GROUPS),
    _compare(PhotoCompareMode.DIFFERENCE, "difference", "Difference of photo and picture"),
    Command(
        "camera.hold_photo", "Photo while held", photo_compare.hold, "Shift+G", enabled=no_photos
    ),
    Command("camera.add_keyframe", "Add keyframe", camera_path.add_keyframe, "K", enabled=no_scene),
    Command("camera.turntable", "Turntable", camera_path.make_turntable, enabled=no_scene),
    Command(
        "camera.play",
        "Play the path",
        camera_path.toggle_playing,
        "Shift+K",
        enabled=no_path,
        is_on=lambda session: session.view.playback.is_playing,
    ),
    Command("camera.clear_path", "Remove all keyframes", camera_path.clear, enabled=no_keyframe),
    Command("camera.open_path", "Open path…", ask(Request.OPEN_PATH), enabled=no_scene),
    Command("camera.save_path", "Save path…", ask(Request.SAVE_PATH), enabled=no_keyframe),
    Command("camera.film", "Save film…", ask(Request.SAVE_FILM), enabled=not_filmable),
)
