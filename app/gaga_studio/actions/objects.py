"""Edits of the selection beyond moving and coloring: grow, separate, mirror, grade, keep, record.

Each is one entry of the history; what a user can mend becomes a notice.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.scene import edits
from gaga_core.scene.arrange import ground_map, mirror_map
from gaga_core.scene.confidence import uncertain
from gaga_core.scene.edits import Edit, How
from gaga_core.scene.grade import Grade, grade_affine
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra
from gaga_studio.session.document import NOTHING_SELECTED, Document
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session

_AXES = "xyz"


def grow(session: Session) -> bool:
    """Add the neighbours of the selection to it: one step of its own spacing."""
    return _change_selection(session, "Grow the selection", _grown)


def shrink(session: Session) -> bool:
    """Take the edge of the selection away: one step of its own spacing."""
    return _change_selection(session, "Shrink the selection", _shrunk)


def grow_by_identity(session: Session, likeness: float = 0.9) -> bool:
    """Add every splat whose identity encoding is like the selection's."""

    def grown(scene: Scene, splats: IntArray) -> IntArray:
        from gaga_core.scene.selection.neighbourhood import grown_by_identity

        names = [name for name in scene.gaussians.extra if name.startswith("obj_dc_")]
        if not names:
            raise GagaError("The splats have no identity encodings. Run gaga lift on the scene.")
        columns = [scene.gaussians.extra[name] for name in names]
        encodings = np.stack(columns, axis=1).astype(np.float32)
        return grown_by_identity(scene, splats, encodings, likeness)

    return _change_selection(session, "Select what is alike", grown)


def separate(session: Session) -> bool:
    """Make the selected splats an object of their own."""
    return _edit(session, "Separate", edits.separate)


def split(session: Session) -> bool:
    """Take the selected object apart where its parts do not touch."""

    def run() -> bool:
        document = session.need()
        groups = document.read.selected_groups()
        if len(groups) != 1:
            raise GagaError("Select one object to split it.")
        name = document.name_of(groups[0])
        edit = edits.split(document.settled().scene, groups[0], title=f"Split {name}")
        if edit is None:
            raise GagaError(f"{name} is in one piece. Paint a part of it and use Separate.")
        return document.do(edit)

    return session.attempt(run)


def assign(session: Session, group: int, splats: IntArray | None = None) -> bool:
    """Give the selected splats (or ``splats`` (K,)) to an object.

    Whole objects are merged into it, so that the memory bank knows their masks as the object's.
    """

    def run() -> bool:
        document = session.need()
        scene = document.settled().scene
        chosen = _selected(document) if splats is None else splats
        title = f"Assign to {document.name_of(group)}"
        whole = _whole(scene, chosen)
        if group and whole:
            return document.do(edits.merge_groups(scene, (group, *whole), title))
        return document.do(edits.set_labels(scene, chosen, group, title))

    return session.attempt(run)


def lock(session: Session) -> bool:
    """Protect the selected splats from being selected."""
    return _edit(session, "Lock", edits.lock)


def unlock_all(session: Session) -> bool:
    """Let everything be selected again."""

    def run() -> bool:
        document = session.need()
        scene = document.settled().scene
        return document.do(edits.unlock(scene, np.ones(len(scene), np.bool_), "Unlock all"))

    return session.attempt(run)


def mirror(session: Session, axis: int) -> bool:
    """Mirror the selection in the plane through its middle, across world axis 0, 1 or 2."""

    def build(scene: Scene, splats: IntArray, title: str) -> Edit | None:
        centre = session.need().selected_centre()
        about = np.zeros(3) if centre is None else centre
        return edits.transform(scene, splats, mirror_map(axis, about), title)

    return _edit(session, f"Mirror {_AXES[axis].upper()}", build)


def preview_grade(session: Session, grade: Grade) -> None:
    """Show the selection graded while a slider is dragged."""

    def run() -> bool:
        document = session.need()
        title, splats = document.title_for("Grade"), _selected(document)
        document.history.preview_with(lambda base: _graded(base, splats, title, grade))
        return True

    session.attempt(run)


def apply_grade(session: Session, grade: Grade) -> bool:
    """Grade the colors of the selection."""
    return _edit(session, "Grade", lambda s, splats, title: _graded(s, splats, title, grade))


def align_to_ground(session: Session, points: DoubleArray) -> bool:
    """Turn and lift everything so that the plane of three ``points`` (3, 3) is the ground.

    What is hidden or locked comes along, and so does the camera (see `CameraRig.follow`).
    """

    def run() -> bool:
        document = session.need()
        moved = ground_map(points, session.rig.up, session.rig.seen_from)
        scene = document.settled().scene
        edit = edits.transform(scene, algebra.whole(scene), moved, "Align to ground")
        return document.do(edit, turned=moved)

    return session.attempt(run)


def select_uncertain(session: Session) -> bool:
    """Select the splats of doubtful group: of the selected objects, or of everything."""

    def run() -> bool:
        document = session.need()
        scene, groups = document.settled().scene, document.read.selected_groups()
        among = group_indices(scene, groups) if groups else algebra.everything(scene)
        found = uncertain(scene, among, document.sure_below)
        if len(found) == 0:
            session.notify(Level.INFO, f"No splat is below {100 * document.sure_below:.0f} %.")
            return False
        return document.select(found, "set", "Select uncertain")

    return session.attempt(run)


def delete_floaters(session: Session) -> bool:
    """Delete splats that stand alone, of the selection or of everything."""

    def run() -> bool:
        from gaga_core.scene.selection.components import floaters

        document = session.need()
        scene = document.settled().scene
        chosen = document.read.selected_indices()
        among = chosen if len(chosen) else algebra.everything(scene)
        found = floaters(scene, among)
        if len(found) == 0:
            session.notify(Level.INFO, "No splat stands alone here.")
            return False
        return document.do(edits.delete(scene, found, f"Delete {len(found):,} floaters"))

    return session.attempt(run)


def keep(session: Session, name: str) -> bool:
    """Keep the selection under a name."""

    def run() -> bool:
        document = session.need()
        splats = _selected(document)
        return document.do(edits.keep_set(document.settled().scene, name, splats))

    return session.attempt(run)


def keep_next(session: Session) -> bool:
    """Keep the selection under the next free name: "set 3"."""
    kept = session.scene.sets if session.scene is not None else {}
    n = next(i for i in range(1, len(kept) + 2) if f"set {i}" not in kept)
    return keep(session, f"set {n}")


def take_kept(session: Session, name: str, how: How = "set") -> bool:
    """Select what is kept under a name."""

    def run() -> bool:
        document = session.need()
        rows = edits.kept_indices(document.settled().scene, name)
        return document.select(rows, how, f"Select {name}")

    return session.attempt(run)


def forget(session: Session, name: str) -> bool:
    """Forget a kept selection."""

    def run() -> bool:
        document = session.need()
        return document.do(edits.forget_set(document.settled().scene, name))

    return session.attempt(run)


def save_script(session: Session, path: Path) -> bool:
    """Write every edit since the scene was opened as a script for ``gaga edit``."""

    def run() -> bool:
        document = session.need()
        document.settled()
        recorded = document.history.recorded()
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps(recorded, indent=1), encoding="utf-8")
        session.notify(Level.INFO, f"Recorded {len(recorded)} edits in {path}.")
        return True

    return session.attempt(run)


def _graded(scene: Scene, splats: IntArray, title: str, grade: Grade) -> Edit | None:
    return edits.recolor(scene, splats, grade_affine(grade), grade.opacity, title)


def _grown(scene: Scene, splats: IntArray) -> IntArray:
    # Imported when first asked for: search trees are a part of the launch time.
    from gaga_core.scene.selection.neighbourhood import grown, spacing

    return grown(scene, splats, spacing(scene, splats))


def _shrunk(scene: Scene, splats: IntArray) -> IntArray:
    from gaga_core.scene.selection.neighbourhood import shrunk, spacing

    return shrunk(scene, splats, spacing(scene, splats))


def _change_selection(
    session: Session, title: str, change: Callable[[Scene, IntArray], IntArray]
) -> bool:
    def run() -> bool:
        document = session.need()
        splats = _selected(document)
        return document.select(change(document.settled().scene, splats), "set", title)

    return session.attempt(run)


def _edit(
    session: Session, verb: str, build: Callable[[Scene, IntArray, str], Edit | None]
) -> bool:
    def run() -> bool:
        document = session.need()
        title, splats = document.title_for(verb), _selected(document)
        return document.do(build(document.settled().scene, splats, title))

    return session.attempt(run)


def _whole(scene: Scene, splats: IntArray) -> tuple[int, ...]:
    """The objects that ``splats`` (K,) are, if they are whole objects and nothing else."""
    groups = np.unique(scene.labels[splats])
    is_whole = len(groups) > 0 and groups[0] > 0
    is_whole = is_whole and len(group_indices(scene, groups.tolist())) == len(splats)
    return tuple(int(group) for group in groups) if is_whole else ()


def _selected(document: Document) -> IntArray:
    splats = document.read.selected_indices()
    if len(splats) == 0:
        raise GagaError(NOTHING_SELECTED)
    return splats
