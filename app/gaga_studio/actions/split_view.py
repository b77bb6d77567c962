"""Two pictures of the same view side by side: photo, picture, groups, truth, errors, before."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.evaluate.photo_film import TRUTH
from gaga_core.masks import resize_labels
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.splats import spread
from gaga_core.scene.scene import Revision, Scene
from gaga_studio.actions import photo_compare
from gaga_studio.actions.unchanged import watch
from gaga_studio.session import stages
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import NO_GROUPS, Session
from gaga_studio.session.view_state import Mode, PhotoCompareMode, Side, ViewState

if TYPE_CHECKING:
    from gaga_core.grouping.associate import Association

AT_A_PHOTO = frozenset({Side.PHOTO, Side.TRUTH, Side.ERRORS})  # only at the camera of a photo
LEFT = tuple(Side)
RIGHT = (Side.PICTURE, Side.GROUPS, Side.TRUTH, Side.ERRORS)


def show(session: Session, left: Side, right: Side) -> bool:
    """Show two sides with a line between them, or stop when they are shown already."""
    view = session.view
    if view.compare is PhotoCompareMode.SWIPE and view.sides == (left, right):
        view.compare = PhotoCompareMode.OFF
        return True
    view.compare, view.sides = PhotoCompareMode.SWIPE, (left, right)
    if AT_A_PHOTO & {left, right} and photo_compare.compared(session) is None:
        photo_compare.go_to_a_photo(session)
    if left is Side.PRESET and other_labels(session) is None:
        return associate_other(session)
    return True


def is_shown(session: Session, left: Side, right: Side) -> bool:
    """Return whether the view is split into these sides."""
    view = session.view
    return view.compare is PhotoCompareMode.SWIPE and view.sides == (left, right)


def why_not(session: Session, side: Side) -> str:
    """Why a side cannot be shown; "" when it can."""
    document = session.document
    if document is None:
        return "No scene is open."
    if side in AT_A_PHOTO and not session.cameras:
        return "This scene has no photos."
    if side in (Side.TRUTH, Side.ERRORS) and truth_folder(session) is None:
        return f"There are no true maps: put them into {TRUTH.as_posix()} of the scene folder."
    if side in (Side.GROUPS, Side.ERRORS) and not document.read.has_groups():
        return NO_GROUPS
    if side is Side.BEFORE and not _contents(document.history):
        return "Nothing has been edited yet."
    if side is Side.PRESET and (document.scene.bank is None or len(session.masks) == 0):
        return "There are no masks and groups to compare. Use Find objects first."
    return ""


# --- what the graphics card draws


def right_view(session: Session, view: ViewState) -> ViewState:
    """Return ``view`` as the whole picture shows it: the right side."""
    if view.compare is PhotoCompareMode.SWIPE and view.sides[1] is Side.GROUPS:
        return replace(view, mode=Mode.GROUPS)
    return view


def left_drawn(
    session: Session, view: ViewState
) -> tuple[Scene, ViewState, IntArray | None] | None:
    """Return scene, view and labels (N,) of a left side that is drawn; None if it is none."""
    document = session.document
    if document is None or view.compare is not PhotoCompareMode.SWIPE:
        return None
    side = view.sides[0]
    if side is Side.PICTURE:
        return document.scene, replace(view, mode=Mode.COLOR), None
    if side is Side.GROUPS:
        return document.scene, replace(view, mode=Mode.GROUPS), None
    if side is Side.BEFORE:
        scene = before(session)
        return (scene, view, None) if scene is not None else None
    if side is Side.PRESET:
        labels = other_labels(session)
        found = (document.scene, replace(view, mode=Mode.GROUPS), labels)
        return found if labels is not None else None
    return None


def before(session: Session) -> Scene | None:
    """Return the scene before the last edit that is no selection; None without one.

    The same value as long as nothing is edited.
    """
    document = session.document
    if document is None:
        return None
    history = document.history
    key = (history.state_id, history.cursor)
    return document.read.once("before", key, lambda: _undone(history.base, history))


def _undone(scene: Scene, history: History) -> Scene | None:
    """A copy of the scene with its last edit undone; columns that it did not change are shared."""
    contents = _contents(history)
    if not contents:
        return None
    trial = replace(scene, revision=Revision())
    copied = History(trial)
    copied.resume(history.record())
    copied.go_to(contents[-1])
    return trial


def _contents(history: History) -> list[int]:
    """Places of the edits that are done and no selections."""
    entries = history.entries()[: history.cursor]
    return [at for at, entry in enumerate(entries) if not entry.is_selection]


# --- another preset


def other_preset(session: Session) -> str:
    """Return the preset that the groups of the scene are not from."""
    bank = session.scene.bank if session.scene is not None else None
    return "robust" if bank is not None and bank.preset == "paper" else "paper"


def other_labels(session: Session) -> IntArray | None:
    """Return the groups (N,) of the other preset, under the ids of those here; None if unknown."""
    document = session.document
    if document is None or document.other_groups is None:
        return None
    bank, labels = document.other_groups
    if bank is not document.scene.bank:
        return None
    scene = document.scene
    key = (bank, scene.revision.splats, scene.revision.labels)
    return document.read.once("other", key, lambda: spread(scene, _renamed(labels, scene)))


@notifies
def associate_other(session: Session) -> bool:
    """Associate with the other preset, as a job; its groups are compared, not taken."""
    document = session.need()
    bank, preset = document.scene.bank, other_preset(session)
    is_same = watch(
        session,
        document,
        lambda: document.scene.bank is bank,
        "The objects changed while this ran, so nothing is compared. Try it again.",
    )

    def done(found: "Association") -> None:
        if is_same() and bank is not None:
            document.other_groups = bank, found.labels

    config = session.find_options.association(preset)
    stage = stages.associate_project_stage(document.settled(), session.masks, config)
    return session.jobs.start(_job_title(preset), stage, on_done=done)


def missing_text(session: Session) -> str:
    """Say why the groups of the other preset are not shown, while they are not known."""
    preset, running = other_preset(session), session.jobs.running
    if running is not None and running.title == _job_title(preset):
        return f"The groups of the preset {preset} are on the way"
    return f"Groups of {preset} not known: close this split, open it again"


def _job_title(preset: str) -> str:
    return f"Associate with {preset}"


def _renamed(labels: IntArray, scene: Scene) -> IntArray:
    """The other groups (M,), each under the id of the group here that it shares most with.

    Of several that share most with the same one, the largest gets its id; the rest get new ids.
    """
    here = scene.labels[: len(labels)]
    n, top = int(labels.max(initial=0)) + 1, int(scene.labels.max(initial=0))
    shared = np.zeros((n, top + 1), np.int64)
    np.add.at(shared, (labels, here), 1)
    shared[:, 0] = 0
    names, taken = np.zeros(n, np.int32), set[int]()
    for group in np.argsort(-shared.max(axis=1, initial=0), kind="stable"):
        best = int(shared[group].argmax())
        if group == 0:
            continue
        if shared[group, best] > 0 and best not in taken:
            names[group] = best
            taken.add(best)
        else:
            top += 1
            names[group] = top
    result: IntArray = names[labels]
    return result


# --- truth and errors, as pictures of a photo's view; slow enough to want a thread


def truth_folder(session: Session) -> Path | None:
    """Return the folder of the true maps of the open scene; None when there is none."""
    folder = session.project.folder if session.project is not None else None
    path = folder.root / TRUTH if folder is not None else None
    return path if path is not None and path.is_dir() else None


def errors_of(
    scene: Scene, camera: Camera, photo: Path, truth: Path, side: int
) -> tuple[UInt8Array, float]:
    """Return the photo (H, W, 3) with wrong and missing pixels marked, and the share that is right.

    The groups are drawn by the best rasterizer here at the photo's exact camera.
    """
    from gaga_core.evaluate.photo_film import error_picture, true_labels
    from gaga_core.grouping.votes import splat_groups
    from gaga_core.io.images import read_rgb
    from gaga_core.raster import choose
    from gaga_core.scene.bake import bake

    seen = read_rgb(photo, side)
    height, width = seen.shape[:2]
    labels = resize_labels(true_labels(truth, camera.name, side), width, height)
    shown = np.flatnonzero(scene.visible)
    gaussians = bake(scene, indices=shown)
    view = camera.resized(width, height)
    return error_picture(seen, splat_groups(choose(), gaussians, view, scene.labels[shown]), labels)
