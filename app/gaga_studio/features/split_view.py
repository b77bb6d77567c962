"""Two pictures of the same view side by side, and a photo compared with the picture."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.evaluate.photo_film import TRUTH
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.masks import resize_labels
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.splats import regrouped
from gaga_core.scene.frame import carried_camera
from gaga_core.scene.scene import Revision, Scene
from gaga_studio.features import camera as navigation
from gaga_studio.features.base import Command, busy, no_photos, watch, without_scene
from gaga_studio.features.find import association
from gaga_studio.features.find.association import FindState
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, PhotoCompareMode, Side, ViewState

if TYPE_CHECKING:
    from gaga_core.grouping.associate import Association

SIDE = 1024  # longest side of the difference, pixels
_GAIN = 4.0  # of the difference: a quarter of the range is white


@dataclass(frozen=True)
class PhotoPlacement:
    """Placement of a photo over the picture: its corner and size in pixels of the picture."""

    x: float
    y: float
    width: float
    height: float


def toggle_difference(session: Session) -> None:
    """Show the difference of photo and picture, or stop when it is shown; fly to a photo first."""
    view, difference = session.view, PhotoCompareMode.DIFFERENCE
    view.compare = PhotoCompareMode.OFF if view.compare is difference else difference
    if view.compare is difference and compared_photo(session) is None:
        go_to_a_photo(session)


def hold_photo(session: Session) -> None:
    """Lay the photo over the picture until the keys are released."""
    if compared_photo(session) is None:
        go_to_a_photo(session)
    session.view.holds_photo = True


def compared_photo(session: Session) -> Camera | None:
    """Return the camera of the photo that the view shows exactly; None elsewhere."""
    index = session.active_view
    if index is None or index >= len(session.cameras):
        return None
    if session.rig.is_moving:
        return None
    camera, scale = session.cameras[index], max(session.rig.radius, 1e-9)
    apart = np.abs(session.rig.cam_from_world - camera.cam_from_world)
    is_there = apart[:3, :3].max() < 1e-6 and apart[:3, 3].max() < 1e-6 * scale
    return camera if is_there else None


def photo_in_view(session: Session) -> int | None:
    """Return the photo from which the scene is seen, or to which the camera flies; else None."""
    is_there = session.rig.is_moving or compared_photo(session) is not None
    return session.active_view if is_there else None


def place_photo(photo: Camera, view: Camera) -> PhotoPlacement:
    """Return the placement of the photo in the picture of ``view``, which has the same pose.

    Exact for any principal point and for pixels that are not square.
    """
    sx, sy = view.K[0, 0] / photo.K[0, 0], view.K[1, 1] / photo.K[1, 1]
    x = float(view.K[0, 2] - sx * photo.K[0, 2])
    y = float(view.K[1, 2] - sy * photo.K[1, 2])
    return PhotoPlacement(x, y, float(sx * photo.width), float(sy * photo.height))


def difference(
    scene: Scene, camera: Camera, photo: Path, *, side: int = SIDE
) -> tuple[UInt8Array, float]:
    """Return |photo - picture| as a heat map (H, W, 3), and its mean, 0..1.

    The picture is of the whole scene as it is, drawn by the best rasterizer here at the photo's
    exact camera, over black; slow enough to want a thread.
    """
    from gaga_core.io.images import read_rgb
    from gaga_core.raster import choose
    from gaga_core.scene.bake import bake

    seen = read_rgb(photo, side)
    height, width = seen.shape[:2]
    frame = choose().render(bake(scene), camera.resized(width, height))
    apart = np.abs(np.clip(frame.image, 0, 1) - seen / np.float32(255))
    return _heat(apart.mean(axis=2) * _GAIN), float(apart.mean())


def snapshot(scene: Scene) -> Scene:
    """Return the scene as it is now: edits replace columns, they never write into them."""
    return replace(scene)


def content_mark(scene: Scene) -> str:
    """Return a key that changes when the picture does."""
    r = scene.revision
    return f"{r.splats} {r.state} {r.placement} {r.placements}"


def _heat(amount: FloatArray) -> UInt8Array:
    """Black, violet, red, yellow, white (H, W, 3) for 0..1 (H, W)."""
    stops = np.array([[0, 0, 0], [70, 20, 110], [200, 40, 60], [255, 190, 60], [255, 255, 255]])
    at = np.linspace(0, 1, len(stops))
    t = np.clip(amount, 0, 1)
    return np.stack([np.interp(t, at, stops[:, c]) for c in range(3)], axis=2).astype(np.uint8)


def go_to_a_photo(session: Session) -> None:
    """Go to the active photo, or the nearest one, at once."""
    index = session.active_view
    if index is None:
        eye = session.rig.eye
        index = int(np.argmin([np.linalg.norm(c.position - eye) for c in session.cameras]))
    navigation.go_to_view(session, index)
    session.rig.go_to(session.cameras[index], animated=False)


# --- two sides

AT_A_PHOTO = frozenset({Side.PHOTO, Side.TRUTH, Side.ERRORS})  # only at the camera of a photo
_CHANGED = "The objects changed meanwhile. Try again."
LEFT = tuple(Side)
RIGHT = (Side.PICTURE, Side.GROUPS, Side.TRUTH, Side.ERRORS)


def show(session: Session, left: Side, right: Side) -> bool:
    """Show two sides with a line between them, or stop when they are shown already."""
    view = session.view
    if view.compare is PhotoCompareMode.SWIPE and view.sides == (left, right):
        view.compare = PhotoCompareMode.OFF
        return True
    view.compare, view.sides = PhotoCompareMode.SWIPE, (left, right)
    if AT_A_PHOTO & {left, right} and compared_photo(session) is None:
        go_to_a_photo(session)
    if left is Side.PRESET and other_labels(session) is None:
        return associate_other(session)
    return True


def is_shown(session: Session, left: Side, right: Side) -> bool:
    """Return whether the view is split into these sides."""
    view = session.view
    return view.compare is PhotoCompareMode.SWIPE and view.sides == (left, right)


def why_not(session: Session, side: Side) -> str:
    """The reason why a side cannot be shown; "" when it can."""
    document = session.document
    if document is None:
        return without_scene(session)
    if side in AT_A_PHOTO and not session.cameras:
        return "This scene has no photos."
    if side in (Side.TRUTH, Side.ERRORS) and truth_folder(session) is None:
        return f"There are no true maps: put them into {TRUTH.as_posix()} of the scene folder."
    if side in (Side.GROUPS, Side.ERRORS) and not document.read.has_groups():
        return session.no_groups_text
    if side is Side.BEFORE and not _contents(document.history):
        return "Nothing was edited since the scene was opened."
    if side is Side.VERSION and version_is_gone(session):
        return "Right-click an entry of the History, then Compare."
    if side is Side.PRESET and (document.scene.bank is None or len(session.masks) == 0):
        return "There are no masks and groups to compare. Use Find objects first."
    return ""


# --- sides drawn by the graphics card


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
        scene = scene_before(session)
        return (scene, view, None) if scene is not None else None
    if side is Side.VERSION:
        scene = scene_of_version(session)
        return (scene, view, None) if scene is not None else None
    if side is Side.PRESET:
        labels = other_labels(session)
        found = (document.scene, replace(view, mode=Mode.GROUPS), labels)
        return found if labels is not None else None
    return None


def camera_in(other: Scene, scene: Scene, camera: Camera) -> Camera:
    """``camera`` of ``scene`` where it stands in ``other``, which was moved or scaled as a whole
    since then, or before: things are in the same place of both pictures."""
    if other.frame is scene.frame:
        return camera
    return carried_camera(camera, other.frame.world @ np.linalg.inv(scene.frame.world))


def scene_before(session: Session) -> Scene | None:
    """Return the scene before the last edit that is no selection; None without one.

    The same value as long as that edit is the last one.
    """
    document = session.document
    if document is None:
        return None
    history = document.history
    contents = _contents(history)
    if not contents:
        return None
    state = history.state_ids[contents[-1]]
    return document.read.once("before", state, lambda: _scene_at(history, contents[-1]))


def compare_version(session: Session, cursor: int) -> None:
    """Show the scene with ``cursor`` entries of the history done left of what is shown."""
    session.view.version = session.need().history.state_ids[cursor]
    session.view.compare = PhotoCompareMode.SWIPE
    session.view.sides = (Side.VERSION, Side.PICTURE)


def scene_of_version(session: Session) -> Scene | None:
    """Return the scene in the state of the history that is compared; None when it is gone.

    Always the same value: another one is black until it is drawn.
    """
    document, version = session.document, session.view.version
    if document is None or version_is_gone(session):
        return None
    history = document.history
    at = history.state_ids.index(version)
    return document.read.once("version", version, lambda: _scene_at(history, at))


def version_is_gone(session: Session) -> bool:
    """Whether the history has the compared version no longer: an edit after Undo dropped it, or
    the memory for undo is full."""
    document = session.document
    return document is not None and session.view.version not in document.history.state_ids


def end_without_version(session: Session) -> bool:
    """End comparing with a version that is gone, and say so; whether it was."""
    view = session.view
    is_shown = view.compare is PhotoCompareMode.SWIPE and Side.VERSION in view.sides
    if not is_shown or not version_is_gone(session):
        return False
    view.compare = PhotoCompareMode.OFF
    session.notify(Level.INFO, "The version that was compared is no longer in the history.")
    return True


def earlier_to(session: Session, width: int, height: int) -> float:
    """The column up to which the picture shows the scene as it was, which is only looked at; 0
    where it does not."""
    view = session.view
    left, right = view.sides
    earlier = {Side.BEFORE: scene_before, Side.VERSION: scene_of_version}.get(left)
    is_split = view.compare is PhotoCompareMode.SWIPE and not view.holds_photo
    if not is_split or earlier is None or earlier(session) is None:
        return 0.0
    if right not in AT_A_PHOTO:
        return view.swipe * width
    photo = compared_photo(session)
    if photo is None:
        return 0.0
    place = place_photo(photo, session.rig.camera(width, height))
    return place.x + view.swipe * place.width


def name_of_version(session: Session) -> str:
    """The last edit of the state that is compared, as the history calls it; "" when it is gone."""
    document, version = session.document, session.view.version
    if document is None or version_is_gone(session):
        return ""
    at = document.history.state_ids.index(version)
    return f"After {document.history.entries()[at - 1].title}" if at else "As opened"


def _scene_at(history: History, cursor: int) -> Scene:
    """A copy of the scene with ``cursor`` entries done; columns that are the same are shared."""
    trial = replace(history.base, revision=Revision())
    copied = History(trial)
    copied.resume(history.record())
    copied.go_to(cursor)
    return trial


def _contents(history: History) -> list[int]:
    """Places of the edits that are done and no selections."""
    entries = history.entries()[: history.cursor]
    return [at for at, entry in enumerate(entries) if not entry.is_selection]


# --- another preset


@dataclass
class OtherGroups:
    """Groups of the other preset, and the bank of the groups that they are compared with."""

    found: tuple[MemoryBank, str, IntArray] | None = None


def other_preset(session: Session) -> str:
    """Return a preset that the groups of the scene are not from: that of the settings, if it is."""
    bank = session.scene.bank if session.scene is not None else None
    here, chosen = "robust" if bank is None else bank.preset, session.settings.preset
    if chosen != here:
        return chosen
    return "paper" if here == "robust" else "robust"


def other_labels(session: Session) -> IntArray | None:
    """Return the groups (N,) of the other preset, under the ids of those here; None if unknown."""
    document = session.document
    found = document.feature(OtherGroups).found if document is not None else None
    if document is None or found is None:
        return None
    bank, preset, labels = found
    if bank is not document.scene.bank or preset != other_preset(session):
        return None
    scene = document.scene
    key = (bank, preset, scene.revision.splats, scene.revision.labels)
    return document.read.once("other", key, lambda: regrouped(scene, _renamed(labels, scene))[0])


@notifies
def associate_other(session: Session) -> bool:
    """Associate with the other preset, as a job; its groups are compared, not taken."""
    document = session.need()
    bank, preset = document.scene.bank, other_preset(session)
    is_same = watch(session, document, _CHANGED, lambda: document.scene.bank is bank)

    def done(found: "Association") -> None:
        if is_same() and bank is not None:
            document.feature(OtherGroups).found = bank, preset, found.labels

    config = session.feature(FindState).association(preset)
    rates = session.rates
    stage = association.associate_project_stage(document.settled(), session.masks, config, rates)
    return session.jobs.start(_job_title(preset), stage, on_done=done)


def missing_text(session: Session) -> str:
    """Say why the groups of the other preset are not shown, while they are not known."""
    preset, running = other_preset(session), session.jobs.running
    if running is not None and running.title == _job_title(preset):
        return f"The groups of the preset {preset} are being computed"
    return f"Groups of {preset} not known: close this split, open it again"


def found_text(session: Session) -> str:
    """Say which groups of the other preset are shown."""
    return f"Groups of {other_preset(session)}, labels by vote of the masks"


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


def _split(name: str, title: str, left: Side, right: Side) -> Command:
    def why_none(session: Session) -> str:
        if is_shown(session, left, right):
            return ""
        is_job = left is Side.PRESET and other_labels(session) is None
        reason = why_not(session, left) or why_not(session, right)
        return reason or (busy(session) if is_job else "")

    return Command(
        f"camera.{name}",
        title,
        lambda session: show(session, left, right),
        enabled=why_none,
        is_on=lambda session: is_shown(session, left, right),
    )


COMMANDS: tuple[Command, ...] = (
    _split("swipe", "Swipe between photo and picture", Side.PHOTO, Side.PICTURE),
    _split("split_groups", "Split: picture and groups", Side.PICTURE, Side.GROUPS),
    _split("split_photo_groups", "Split: photo and groups", Side.PHOTO, Side.GROUPS),
    _split("split_truth", "Split: truth and groups", Side.TRUTH, Side.GROUPS),
    _split("split_errors", "Split: groups and their errors", Side.GROUPS, Side.ERRORS),
    _split("split_before", "Split: before and after the last edit", Side.BEFORE, Side.PICTURE),
    _split("split_preset", "Split: the other preset and these groups", Side.PRESET, Side.GROUPS),
    Command(
        "camera.difference",
        "Difference of photo and picture",
        toggle_difference,
        enabled=no_photos,
        is_on=lambda session: session.view.compare is PhotoCompareMode.DIFFERENCE,
    ),
    Command("camera.hold_photo", "Photo while held", hold_photo, "Shift+G", enabled=no_photos),
)
