"""Objects under other objects: put them there, take them out, select and edit them together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import groups_under_selection, splats_under_selection
from gaga_studio.session.document import Document
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import Session

# --- which object lies under which


@notifies
def put_under(session: Session, parent: int, groups: Sequence[int]) -> bool:
    """Put objects under another one; what lies under them goes along."""
    document = session.need()
    scene = document.settled().scene
    what = document.name_of(groups[0]) if len(groups) == 1 else f"{len(groups)} objects"
    title = f"Put {what} under {document.name_of(parent)}"
    if not document.do(edits.set_parent(scene, groups, parent, title)):
        return False
    document.listing.reveal_group(scene.folders, groups[0])
    return True


@notifies
def take_out(session: Session) -> bool:
    """Take the selected objects out from under the object that each of them lies under."""
    document = session.need()
    scene = document.settled().scene
    groups = [group for group in session.selected_groups() if group in scene.folders.parent]
    what = document.name_of(groups[0]) if len(groups) == 1 else f"{len(groups)} objects"
    over = {scene.folders.parent[group] for group in groups}
    above = document.name_of(over.pop()) if len(over) == 1 else "what they lie under"
    return document.do(edits.leave_parent(scene, groups, f"Take {what} out from under {above}"))


def can_take_out(session: Session) -> bool:
    """Return whether a selected object lies under another one."""
    scene = session.scene
    return scene is not None and any(g in scene.folders.parent for g in session.selected_groups())


def has_children(session: Session) -> bool:
    """Return whether something lies under a selected object."""
    scene = session.scene
    return scene is not None and bool(scene.folders.under(*session.selected_groups()))


@notifies
def select_with_children(session: Session) -> bool:
    """Select the selected objects whole, and all that lies under them."""
    document = session.need()
    groups = session.selected_groups()
    under = document.scene.folders.under(*groups)
    if not groups:
        return False
    title = f"Select {_and_under(document.name_of(groups[0]), len(groups), len(under))}"
    return document.select(group_indices(document.scene, (*groups, *under)), "set", title)


def group_and_under(scene: Scene, group: int) -> IntArray:
    """Return the splats (K,) of an object and of all that lies under it, deleted ones left out."""
    return group_indices(scene, (group, *scene.folders.under(group)))


# --- edits of the selection that children go along with


@dataclass(frozen=True, eq=False)
class Along:
    """The selection and what goes along with it."""

    splats: IntArray  # (K,) both
    groups: tuple[int, ...]  # that go along


def along(session: Session, *, with_locked: bool = False) -> Along:
    """Return the selected splats, and those under objects that are selected whole.

    Without the latter when "Children go along" is off. Locked ones only ``with_locked``: isolating
    and exporting change nothing of them. Raises ``NothingSelectedError``.
    """
    document = session.need()
    chosen, scene = document.selected(), document.scene
    if not session.settings.children_go_along or not scene.folders.parent:
        return Along(chosen, ())
    revision = scene.revision
    key = (revision.splats, revision.state, revision.labels, scene.folders)

    def find() -> Along:
        splats = splats_under_selection(scene, with_locked=with_locked)
        moved = set(np.unique(scene.labels[splats]).tolist())
        groups = tuple(group for group in groups_under_selection(scene) if group in moved)
        return Along(np.sort(np.concatenate([chosen, splats])).astype(np.int32), groups)

    return document.read.once("along with locked" if with_locked else "along", key, find)


def locked_along(session: Session) -> IntArray:
    """Return the locked splats (K,) that isolating and exporting take along; none without any."""
    if len(session.selected_indices()) == 0:
        return np.zeros(0, np.int32)
    splats = along(session, with_locked=True).splats
    return np.setdiff1d(splats, along(session).splats, assume_unique=True)


def scene_along(session: Session, *, with_locked: bool = True) -> Scene:
    """Return the scene with what goes along selected, too: what exports read. Not for edits."""
    scene = session.need().scene
    if len(session.selected_indices()) == 0:
        return scene
    taken = along(session, with_locked=with_locked)
    if not taken.groups:
        return scene
    state = scene.state.copy()
    state[taken.splats] |= np.uint8(State.SELECTED)
    return replace(scene, state=state)


def edit_along(
    session: Session,
    verb: str,
    build: Callable[[Scene, IntArray, str], Edit | None],
    *,
    with_locked: bool = False,
) -> bool:
    """Apply the edit that ``build`` makes of the scene, `along`, and a title that names both."""
    document = session.need()
    scene = document.settled().scene
    taken = along(session, with_locked=with_locked)
    return document.do(build(scene, taken.splats, title_along(document, verb, taken.groups)))


def title_along(document: Document, verb: str, groups: Sequence[int]) -> str:
    """Return the title of an edit of the selection with ``groups``: "Delete pot and 2 under it"."""
    n_own = max(len(document.read.selected_groups()), 1)
    return _and_under(document.title_for(verb), n_own, len(groups))


def _and_under(text: str, n: int, n_under: int) -> str:
    if not n_under:
        return text
    return f"{text} and {n_under} under {'it' if n == 1 else 'them'}"
