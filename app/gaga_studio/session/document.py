"""The open scene and what is done to it: edits, previews, selection, and what panels read of it."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.associate import Association
from gaga_core.scene import edits
from gaga_core.scene.cleanup import edits as cleanup_edits
from gaga_core.scene.edits import Edit, How
from gaga_core.scene.edits.append import names_of_added, spread
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import group_indices, group_name
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra
from gaga_core.scene.tint import mean_color, tint_affine
from gaga_studio.session import motion
from gaga_studio.session.save_state import Changes
from gaga_studio.session.scene_cache import Readings
from gaga_studio.session.search_state import Search

if TYPE_CHECKING:
    from gaga_core.evaluate.quality import Quality
    from gaga_core.grouping.repair.view_evidence import Evidence
    from gaga_core.scene.cleanup.clean import CleanPreview

NOTHING_SELECTED = "Nothing is selected. Click an object first."


class Document:
    """One open project. Edits of the selection raise ``GagaError`` when nothing is selected.

    Every edit returns whether it changed anything, and is one entry of the history.
    """

    def __init__(self, project: Project) -> None:
        self.project = project
        self.scene: Scene = project.scene
        self.history = History(self.scene)
        self.read = Readings(self.scene)
        self.changes = Changes()
        self._worlds = {0: np.eye(4)}  # how the whole scene was turned, by History.state_id
        self.focus = 0  # group shown in the inspector; 0 = none
        self.evidence: dict[tuple[str, str], Evidence] = {}  # by masks and preset; see `repairing`
        self.quality: dict[str, Quality] = {}  # by digest of the labels; see `quality`
        self.sure_below = 0.6  # confidence under which splats count as uncertain
        self.search = Search()
        self._cleaning: tuple[CleanPreview, Edit] | None = None  # and the edit that shows it

    @property
    def name(self) -> str:
        """Name of the folder or file."""
        folder = self.project.folder
        return folder.root.name if folder is not None else self.project.model_path.name

    @property
    def title(self) -> str:
        """The name, starred when there is something to save."""
        return f"{self.name}*" if self.unsaved else self.name

    @property
    def unsaved(self) -> bool:
        """Whether there are edits that are not on disk; a mere selection is none."""
        return self.changes.is_unsaved(self.history)

    # --- history

    @property
    def world(self) -> DoubleArray:
        """How the whole scene has been turned since it was opened (4, 4): what a camera follows.

        The same array as long as it was not turned again.
        """
        return self._worlds.get(self.history.state_id, self._worlds[0])

    def do(
        self, edit: Edit | None, *, is_content: bool = True, turned: DoubleArray | None = None
    ) -> bool:
        """Apply an edit; False when it is None. ``is_content``: something that a save keeps.

        ``turned`` (3, 4): the world map of an edit that moves the whole scene as one.
        """
        before, world = self.history.state_id, self.world
        done = self.history.do(edit)
        if turned is not None:
            world = np.vstack([turned, [0, 0, 0, 1]]) @ world
        self._note(before, is_content, world)
        self._keep_focus()
        return done

    def _note(self, before: int, is_content: bool, world: DoubleArray) -> None:
        """What is known of the present state, which was made from state ``before``."""
        self.changes.note(before, self.history.state_id, is_content)
        self._worlds.setdefault(self.history.state_id, world)

    def undo(self) -> str | None:
        """Take the newest edit back; its title, None if there is none."""
        title = self.history.undo()
        self._keep_focus()
        return title

    def redo(self) -> str | None:
        """Do the next undone edit again; its title, None if there is none."""
        title = self.history.redo()
        self._keep_focus()
        return title

    def go_to(self, cursor: int) -> None:
        """Undo or redo until ``cursor`` entries are done."""
        self.history.go_to(cursor)
        self._keep_focus()

    def _keep_focus(self) -> None:
        """The inspector follows the selection."""
        groups = self.read.selected_groups()
        if groups and self.focus not in groups:
            self.focus = groups[0]

    # --- previews: the frames of a drag

    def preview(self, build: Callable[[Scene, IntArray], Edit | None]) -> None:
        """Show the edit that ``build`` makes for the selected splats, without an entry."""
        indices = self._selected()
        self.history.preview_with(lambda scene: build(scene, indices))

    def commit_preview(self) -> bool:
        """Make the preview an entry of the history; False if there is none."""
        if self.cleaning is not None:
            return False  # its colors are only to look at: `apply_cleaning`
        before, world = self.history.state_id, self.world
        done = self.history.commit_preview()
        self._note(before, True, world)
        return done

    def cancel_preview(self) -> None:
        """Drop the preview: everything is as before the drag."""
        self.history.preview(None)

    def preview_move(self, matrix: DoubleArray, verb: str = "Move") -> None:
        """Show the selection moved by the world map ``matrix`` (3, 4), counted from the start."""
        title = self.title_for(verb)
        self.preview(lambda scene, indices: edits.transform(scene, indices, matrix, title))

    def preview_recolor(self, rgb: Sequence[float], opacity: float = 1.0) -> None:
        """Show the selection in this mean color, 0..1, with its shading kept."""
        title = self.title_for("Recolor")
        self.preview(lambda scene, indices: _recolored(scene, indices, rgb, opacity, title))

    def settled(self) -> Project:
        """What is open, without a preview: what a file must be written from."""
        self.history.preview(None)
        return self.project

    # --- cleaning: its preview ends with whatever is done next

    @property
    def cleaning(self) -> "CleanPreview | None":
        """What the picture shows in colors of its own: splats that would come and go."""
        held = self._cleaning
        return held[0] if held is not None and held[1] is self.history.preview_edit else None

    def show_cleaning(self, found: "CleanPreview") -> None:
        """Show what cleaning an object would change."""
        tint = cleanup_edits.cleaning_tint(self._settled(), found)
        if tint is not None:
            self.history.preview(tint)
            self._cleaning = found, tint

    def apply_cleaning(self) -> bool:
        """Clean as the preview shows: one entry; False when there is no preview."""
        found = self.cleaning
        if found is None:
            return False
        title = f"Clean {self.name_of(found.group)}"
        return self.do(cleanup_edits.cleaned_edit(self._settled(), found, title))

    # --- edits of the selection

    def move_selected(self, matrix: DoubleArray, verb: str = "Move") -> bool:
        """Move the selection by the world map ``matrix`` (3, 4)."""
        return self._edit(verb, lambda s, i, title: edits.transform(s, i, matrix, title))

    def recolor_selected(self, rgb: Sequence[float], opacity: float = 1.0) -> bool:
        """Give the selection this mean color, 0..1, and multiply its opacity."""
        return self._edit("Recolor", lambda s, i, title: _recolored(s, i, rgb, opacity, title))

    def delete_selected(self) -> bool:
        """Delete the selected splats."""
        return self._edit("Delete", edits.delete)

    def hide_selected(self) -> bool:
        """Hide the selected splats."""
        return self._edit("Hide", edits.hide)

    def isolate_selected(self) -> bool:
        """Hide everything but the selected splats."""
        return self._edit("Isolate", edits.isolate)

    def duplicate_selected(self, direction: DoubleArray) -> bool:
        """Copy the selection beside itself, towards ``direction`` (3,); the copy is selected."""
        lo, hi = self.selected_box() or (np.zeros(3), np.zeros(3))
        step = motion.shift(float(np.abs(direction) @ (hi - lo)) * direction)
        return self._edit("Duplicate", lambda s, i, title: edits.duplicate(s, i, step, title=title))

    def merge_selected(self) -> bool:
        """Make the selected objects one."""
        groups = self.read.selected_groups()
        return self._edit("Merge", lambda s, _, title: edits.merge_groups(s, groups, title))

    def _edit(self, verb: str, build: Callable[[Scene, IntArray, str], Edit | None]) -> bool:
        return self.do(build(self._settled(), self._selected(), self.title_for(verb)))

    def _settled(self) -> Scene:
        """The scene without a preview: what an edit must be built from."""
        self.history.preview(None)
        return self.scene

    def _selected(self) -> IntArray:
        indices = self.read.selected_indices()
        if len(indices) == 0:
            raise GagaError(NOTHING_SELECTED)
        return indices

    # --- edits of objects

    def show_all(self) -> bool:
        """Show everything that is hidden."""
        return self.do(edits.show_all(self._settled()))

    def rename(self, group: int, name: str) -> bool:
        """Name a group; an empty name gives it its number back."""
        return self.do(edits.rename(self._settled(), group, name))

    def set_color(self, group: int, rgb: Sequence[float] | None) -> bool:
        """Give a group a color in lists and group pictures; None = the palette's."""
        title = f"Color {self.name_of(group)}"
        return self.do(edits.set_color(self._settled(), group, rgb, title))

    def preview_color(self, group: int, rgb: Sequence[float]) -> None:
        """Show a group's color while it is being chosen."""
        title = f"Color {self.name_of(group)}"
        self.history.preview_with(lambda scene: edits.set_color(scene, group, rgb, title))

    def set_hidden(self, group: int, hidden: bool) -> bool:
        """Hide or show one object (the eye in the list)."""
        build, verb = (edits.hide, "Hide") if hidden else (edits.show, "Show")
        indices = group_indices(self.scene, group)
        return self.do(build(self._settled(), indices, f"{verb} {self.name_of(group)}"))

    def set_locked(self, group: int, locked: bool) -> bool:
        """Protect one object from being selected, or let it be again (the lock in the list)."""
        build, verb = (edits.lock, "Lock") if locked else (edits.unlock, "Unlock")
        indices = group_indices(self.scene, group)
        return self.do(build(self._settled(), indices, f"{verb} {self.name_of(group)}"))

    def isolate_group(self, group: int) -> bool:
        """Hide everything but one object; shows all again when that is so already."""
        indices = group_indices(self.scene, group)
        alone = edits.isolate(self._settled(), indices, f"Isolate {self.name_of(group)}")
        return self.do(alone) if alone is not None else self.show_all()

    def group(self, found: Association) -> int:
        """Take the groups of an association over; how many objects there are now."""
        labels = spread(self.scene, found.labels)  # duplicates follow their originals
        names = names_of_added(self.scene, labels)
        grouping = edits.set_grouping(
            self._settled(), labels, found.bank, names, confidence=found.confidence
        )
        self.do(grouping)
        return int((self.read.objects(None, False).ids > 0).sum())

    # --- selecting

    def select(self, indices: IntArray, how: How = "set", title: str = "Select") -> bool:
        """Change the selection by splats (K,)."""
        return self.do(edits.select(self._settled(), indices, how, title), is_content=False)

    def select_groups(self, groups: Sequence[int], how: How = "set") -> bool:
        """Select whole objects, add or remove them; the first one comes into the inspector."""
        what = self.name_of(groups[0]) if len(groups) == 1 else f"{len(groups)} objects"
        verb = "Deselect" if how == "remove" else "Select"
        done = self.select(group_indices(self.scene, groups), how, f"{verb} {what}")
        if how != "remove" and groups:
            self.focus = int(groups[0])
        return done

    def select_all(self) -> bool:
        """Select everything that is visible and not locked."""
        return self.select(algebra.everything(self.scene), "set", "Select all")

    def select_none(self) -> bool:
        """Select nothing."""
        return self.select(algebra.nothing(), "set", "Select nothing")

    def select_inverse(self) -> bool:
        """Select what is not selected."""
        return self.select(algebra.inverted(self.scene), "set", "Invert selection")

    # --- reading

    def name_of(self, group: int) -> str:
        """Name of a group, as the object list shows it."""
        return group_name(self.scene, group)

    def title_for(self, verb: str) -> str:
        """Title of an edit of the selection: "Move mug", "Delete 3 objects"."""
        groups = self.read.selected_groups()
        if len(groups) == 1:
            return f"{verb} {self.name_of(groups[0])}"
        return f"{verb} {len(groups)} objects" if groups else f"{verb} splats"

    def selected_box(self) -> tuple[DoubleArray, DoubleArray] | None:
        """Box lo, hi (3,) of the selection, world; None when nothing is selected.

        During a drag: as it was before.
        """
        if len(self.read.selected_indices()) == 0:
            return None
        return self.read.selected_box(self.history.is_previewing)

    def selected_axes(self) -> DoubleArray:
        """How the first selected splat's object was turned (3, 3): its own axes as columns."""
        chosen = self.read.selected_indices()
        if len(chosen) == 0:
            return np.eye(3)
        row = self.scene.placement[chosen[0]]
        u, _, vt = np.linalg.svd(self.scene.placements.matrix[row][:, :3])
        axes: DoubleArray = u @ vt
        return axes if np.linalg.det(axes) > 0 else -axes

    def selected_centre(self) -> DoubleArray | None:
        """Where the handles stand (3,), world; None when nothing is selected."""
        box = self.selected_box()
        return None if box is None else (box[0] + box[1]) / 2


def _recolored(
    scene: Scene, indices: IntArray, rgb: Sequence[float], opacity: float, title: str
) -> Edit | None:
    affine = tint_affine(mean_color(scene, indices), rgb)
    return edits.recolor(scene, indices, affine, opacity, title)
