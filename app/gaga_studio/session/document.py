"""The open scene: its history, previews, its selection, what is unsaved, state of features."""

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar, cast, runtime_checkable

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.io.folder.lock import FolderLock, InUseError, lock_folder
from gaga_core.io.splats.splat_files import files_of_model
from gaga_core.pipeline.level_of_detail import is_of, rows_of_files
from gaga_core.scene import edits
from gaga_core.scene.camera_path import Bookmark, CameraPath, Shot, carried_shot
from gaga_core.scene.edits import Edit, How
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.values import is_selection
from gaga_core.scene.frame import carried_cameras, inverse
from gaga_core.scene.lod.edited import PickBoxes
from gaga_core.scene.objects import group_name
from gaga_core.scene.orientation import Pose, up_of_moved
from gaga_core.scene.project import Project, has_changed
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.bounds import OrientedBox
from gaga_studio.session.camera_rig import Pose as CameraPose
from gaga_studio.session.notices import NothingSelectedError, PreviewWaitsError
from gaga_studio.session.scene_cache import SceneCache
from gaga_studio.session.view import ViewState

if TYPE_CHECKING:
    from gaga_core.scene.lod.tree import LodTree

Content = tuple[int, int]
Stamps = tuple[tuple[int, int, int] | None, ...]  # inode, time and size of each file; None: gone


T = TypeVar("T")
Build = Callable[[Scene, IntArray, str], Edit | None]  # of the scene, splats (K,) and a title


class SaveState:
    """Maps states of a history to contents; selecting makes a state but no new content."""

    def __init__(self) -> None:
        self._content = {0: 0}  # by History.state_id
        self._newest = 0
        # Number of the present bookmarks and path: a save keeps them, the history does not.
        self.outside = 0
        self._newest_outside = 0
        self._saved: Content | None = (0, 0)

    def note(self, before: int, after: int, is_content: bool) -> None:
        """Note that an edit made state ``after`` from ``before``."""
        if before == after:
            return
        self._newest += is_content
        self._content[after] = self._newest if is_content else self._content.get(before, 0)

    def note_outside_history(self) -> None:
        """Note a change that a save keeps and the history does not know: bookmarks, the path."""
        self._newest_outside += 1
        self.outside = self._newest_outside

    def content(self, state: int) -> Content:
        """Return the content of a state, and the number of the present bookmarks and path."""
        return self._content.get(state, 0), self.outside

    def resume(self, contents: Sequence[int]) -> None:
        """Take ``contents`` as those of the states 0, 1, 2 and so on; they are numbered again."""
        numbers = {content: number for number, content in enumerate(sorted(set(contents)))}
        self._content = {state: numbers[content] for state, content in enumerate(contents)}
        self._newest = len(numbers) - 1

    def saved(self, content: Content | None) -> None:
        """Note that ``content`` is on disk now; None: nothing is."""
        self._saved = content

    def is_unsaved(self, history: History) -> bool:
        """Whether the present state differs from what is on disk."""
        return self.content(history.state_id) != self._saved


Views = tuple[CameraPath, tuple[Bookmark, ...]]  # as the project keeps them


@dataclass(frozen=True)
class _ViewStep:
    title: str
    state: int  # of the history, in which it was made
    before: Views
    after: Views
    contents: tuple[int, int]  # `SaveState.outside` before and after


class ViewSteps:
    """Undo of bookmarks and of the camera's path, which are no part of the scene.

    A step is undone and done again in the state of the history in which it was made: between the
    same two edits. One that another state hides, as after a jump in the history, waits for it.
    """

    def __init__(self) -> None:
        self._done: list[_ViewStep] = []
        self._undone: list[_ViewStep] = []

    def note(self, step: _ViewStep, *, is_drag: bool) -> None:
        """Note a step; the frames of a drag are one."""
        last = self._done[-1] if self._done else None
        if is_drag and last is not None and (last.title, last.state) == (step.title, step.state):
            first = self._done.pop()
            step = replace(
                step, before=first.before, contents=(first.contents[0], step.contents[1])
            )
        self._done.append(step)
        self.forget_undone()

    def forget_undone(self) -> None:
        """Something else was done: nothing is done again."""
        self._undone.clear()

    def go_along(self, passed: Container[int], state: int) -> None:
        """A selection led to ``state``: what was undone in the states that it ``passed`` is done
        again after it, as edits are."""
        self._undone = [
            replace(step, state=state) if step.state in passed else step for step in self._undone
        ]

    def undo_title(self, state: int) -> str:
        """Title of the step that undo takes back in this state of the history; "" if none."""
        return self._done[-1].title if self._done and self._done[-1].state == state else ""

    def redo_title(self, state: int) -> str:
        """Title of the step that redo does again in this state of the history; "" if none."""
        return self._undone[-1].title if self._undone and self._undone[-1].state == state else ""

    def titles(self, state: int) -> tuple[list[str], list[str]]:
        """Titles of the steps in this state of the history that undo and redo reach: those that
        are done, oldest first, and those that were undone, the next one first."""
        done, undone = (
            [step.title for step in takewhile(lambda step: step.state == state, reversed(steps))]
            for steps in (self._done, self._undone)
        )
        return done[::-1], undone

    def undo(self) -> tuple[Views, int]:
        """Take the newest step back; return what there was before it, and its number."""
        self._undone.append(self._done.pop())
        step = self._undone[-1]
        return step.before, step.contents[0]

    def redo(self) -> tuple[Views, int]:
        """Do the step that was undone last again; return what there is after it, and its number."""
        self._done.append(self._undone.pop())
        step = self._done[-1]
        return step.after, step.contents[1]


@runtime_checkable
class Closes(Protocol):
    """State of a feature that ends something when its document is closed."""

    def on_close(self, view: ViewState) -> None:
        """End it, in the view that it was shown in."""
        ...


class Document:
    """One open project. The edits themselves are in ``gaga_studio.features``."""

    def __init__(self, project: Project) -> None:
        self.project = project
        self.scene: Scene = project.scene
        self.history = History(self.scene)
        self.read = SceneCache(self.scene)
        self.save_state = SaveState()
        self._views = ViewSteps()
        self.focus = 0  # group shown in the inspector; 0 = none
        self.lods: tuple[LodTree, ...] = ()  # trees of merged splats that are known
        self.in_use_by = ""  # the other program that has the project open
        # Before and after a motion that set the camera: the world (4, 4), and the pose in it.
        self.kept_poses: tuple[tuple[DoubleArray, CameraPose], ...] = ()
        self.copies_model = False  # saves copy files of splats that changed
        self._lock: FolderLock | None = None  # of the saved project, see `claim`
        self._stamps = _stamps(project)  # of its files when they were last looked at
        self._tint: Edit | None = None  # a preview that is no edit to keep
        self._held: tuple[str, Edit] | None = None  # name and edit of a preview that waits
        self._features: dict[type, object] = {}
        self._keep_focus()  # on what was selected when it was saved

    def feature(self, kind: type[T]) -> T:
        """Return the state of a feature in this document, made when first asked for."""
        if kind not in self._features:
            self._features[kind] = kind()
        return cast(T, self._features[kind])

    def on_close(self, view: ViewState) -> None:
        """Tell the features that end something when the document is closed."""
        for state in self._features.values():
            if isinstance(state, Closes):
                state.on_close(view)

    @property
    def name(self) -> str:
        """Name of the folder or file."""
        return self.project.name

    @property
    def saved_name(self) -> str:
        """Name of what a save writes: the scene folder, or a project."""
        folder, target = self.project.folder, self.project.saves_to
        is_inside = folder is not None and target.resolve() == folder.work.resolve()
        return self.name if is_inside else target.name

    @property
    def title_name(self) -> str:
        """Name of what is open: of the folder or file, or of the project that it was saved as."""
        return self.name if self.project.path is None else self.saved_name

    @property
    def title(self) -> str:
        """The name, starred when there is something to save."""
        name = f"{self.title_name}*" if self.unsaved else self.title_name
        return f"{name} (read-only)" if self.in_use_by else name

    @property
    def changes(self) -> str:
        """What was changed, and as what a save writes it: "room.spz as room.gaga", "room.gaga"."""
        name, saved = self.title_name, self.saved_name
        return name if name == saved else f"{name} as {saved}"

    @property
    def unsaved(self) -> bool:
        """Whether there are edits that are not on disk; a selection is not an edit."""
        return self.save_state.is_unsaved(self.history)

    # --- files

    def claim(self) -> str:
        """Make the saved project this program's; "", or who has it: then it is read-only here."""
        place = self.project.path
        former, self._lock, self.in_use_by, said = self._lock, None, "", ""
        try:
            if place is not None:  # else the first save takes it
                self._lock = lock_folder(place)
        except InUseError as error:
            self.in_use_by = str(error.owner or "another program")
            said = (
                f"{self.name} is open in {self.in_use_by}, so it is read-only here. Use Save "
                "project as to keep edits."
            )
        except GagaError as error:  # a place that cannot be written: saving says the same
            said = f"{error} The project is read-only here."
        if former is not None:
            former.release()
        return said

    def release(self) -> None:
        """Let other programs write to the project."""
        if self._lock is not None:
            self._lock.release()

    def note_files(self) -> bool:
        """Look at the files of splats; whether anything about them differs from the last look."""
        former, self._stamps = self._stamps, _stamps(self.project)
        return former != self._stamps

    def changed_file(self) -> Path | None:
        """A file of splats whose content another program changed, if there is one."""
        files = _files(self.project)
        return next((file[0] for file in files if has_changed(file)), None)

    # --- history

    @property
    def world(self) -> DoubleArray:
        """Motion (4, 4) of the whole scene since it was opened: what a camera follows.

        The same array as long as it was not turned again.
        """
        return self.scene.frame.world

    def do(self, edit: Edit | None, *, is_content: bool = True) -> bool:
        """Apply an edit; False when it is None. ``is_content``: something that a save keeps."""
        self._need_no_preview()
        before, ahead = self.history.state_id, self._ahead()
        done = self.history.do(edit)
        self.save_state.note(before, self.history.state_id, is_content)
        if edit is not None and is_selection(edit):
            passed = {before} | (ahead - self._ahead())
            self._views.go_along(passed, self.history.state_id)
        elif edit is not None:
            self._views.forget_undone()
        self._keep_focus()
        return done

    def _ahead(self) -> set[int]:
        """States of the history that redo leads to."""
        return set(self.history.state_ids[self.history.cursor + 1 :])

    def undo(self) -> str | None:
        """Undo the newest edit; return its title, None if there is none."""
        self._need_no_preview()
        title = self.history.undo()
        self._keep_focus()
        return title

    def redo(self) -> str | None:
        """Redo the next undone edit; return its title, None if there is none."""
        self._need_no_preview()
        title = self.history.redo()
        self._keep_focus()
        return title

    def go_to(self, cursor: int) -> None:
        """Undo or redo until ``cursor`` entries are done."""
        self._need_no_preview()
        self.history.go_to(cursor)
        self._keep_focus()

    def _keep_focus(self) -> None:
        """Keep the focused group inside the selection: the one with most of what is selected."""
        groups = self.read.selected_groups()
        if groups and self.focus not in groups:
            labels = self.scene.labels[self.read.selected_indices()]
            ids, counts = np.unique(labels[labels > 0], return_counts=True)
            self.focus = int(ids[counts.argmax()])

    # --- bookmarks and the camera's path

    def keep_views(
        self,
        title: str,
        *,
        film: CameraPath | None = None,
        bookmarks: tuple[Bookmark, ...] | None = None,
        is_drag: bool = False,
    ) -> None:
        """Take another path, or other bookmarks, as a step that undo takes back."""
        before = self.project.film, self.project.bookmarks
        after = film or before[0], before[1] if bookmarks is None else bookmarks
        if before == after:
            return
        former = self.save_state.outside
        self.save_state.note_outside_history()
        contents = former, self.save_state.outside
        step = _ViewStep(title, self.history.state_id, before, after, contents)
        self._views.note(step, is_drag=is_drag)
        self._take_views(after, contents[1])

    @property
    def undo_title(self) -> str:
        """Title of what Ctrl+Z takes back, an edit or a step of the views; "" if nothing."""
        return self._views.undo_title(self.history.state_id) or self.history.undo_title

    @property
    def redo_title(self) -> str:
        """Title of what Ctrl+Shift+Z does again; "" if nothing."""
        return self._views.redo_title(self.history.state_id) or self.history.redo_title

    def undo_views(self) -> bool:
        """Take back the step of the views that is newer than the newest edit; False if none."""
        if not self._views.undo_title(self.history.state_id):
            return False
        self._take_views(*self._views.undo())
        return True

    def redo_views(self) -> bool:
        """Do a step of the views again that comes before the next edit; False if none."""
        if not self._views.redo_title(self.history.state_id):
            return False
        self._take_views(*self._views.redo())
        return True

    def view_steps(self) -> tuple[list[str], list[str]]:
        """Titles of the steps of the views after the newest edit; see `ViewSteps.titles`."""
        return self._views.titles(self.history.state_id)

    def go_to_view_step(self, n: int) -> None:
        """Undo or redo steps of the views until ``n`` are done after the newest edit."""
        while len(self.view_steps()[0]) > n and self.undo_views():
            pass
        while len(self.view_steps()[0]) < n and self.redo_views():
            pass

    def _take_views(self, views: Views, number: int) -> None:
        self.project.film, self.project.bookmarks = views
        self.save_state.outside = number

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Cameras of the photos in the world of the scene as it is now; () without a folder."""
        folder, world = self.project.folder, self.world
        if folder is None:
            return ()
        key = (id(folder), world.tobytes())
        return self.read.once("cameras", key, lambda: carried_cameras(folder.cameras, world))

    def up_of_photos(self) -> DoubleArray:
        """Up (3,), unit, world, as known or by the photos' cameras; see `up_of_moved`."""
        folder = self.project.folder
        if folder is None:
            return up_of_moved((), self.cameras)
        return up_of_moved(folder.cameras, self.cameras, folder.up, self.world)

    def as_opened(self, shot: Shot, known: Mapping[Shot, Shot]) -> Shot:
        """``shot`` before the scene was moved as a whole: what a project keeps.

        ``known``: shots as they are shown, with what is kept of them bit for bit.
        """
        kept = known.get(shot)
        return carried_shot(shot, inverse(self.world)) if kept is None else kept

    # --- previews: the frames of a drag, and results that wait to be applied or cancelled

    @property
    def waiting(self) -> str:
        """Name of the preview that waits: only `commit_preview` and `cancel_preview` end it."""
        held = self._held
        return held[0] if held is not None and held[1] is self.history.preview_edit else ""

    def _need_no_preview(self) -> None:
        if self.waiting:
            raise PreviewWaitsError(self.waiting)

    def preview_with(self, build: Callable[[Scene], Edit | None]) -> None:
        """Show the edit that ``build`` makes of the scene, without an entry."""
        self._need_no_preview()
        self.history.preview_with(build)

    def preview_selected(self, verb: str, build: Build) -> None:
        """Show the edit that ``build`` makes for the selected splats, without an entry."""
        indices, title = self.selected(), self.title_for(verb)
        self.preview_with(lambda scene: build(scene, indices, title))

    def commit_preview(self) -> bool:
        """Make the preview an entry of the history; False if there is none."""
        if self._tint is not None and self._tint is self.history.preview_edit:
            return False
        before = self.history.state_id
        done = self.history.commit_preview()
        self.save_state.note(before, self.history.state_id, True)
        if done:
            self._views.forget_undone()
        return done

    def show(self, edit: Edit, *, waits_as: str = "", is_tint: bool = False) -> None:
        """Show an edit without an entry; a tint only shows something and is never kept.

        With a name, ``waits_as``, it is not replaced by what is done next: its work would be lost.
        """
        self.settled()
        self.history.preview(edit)
        self._held = (waits_as, edit) if waits_as else None
        self._tint = edit if is_tint else None

    def cancel_preview(self) -> None:
        """Cancel the preview: everything is as before the drag."""
        self.history.preview(None)

    def settled(self) -> Project:
        """Cancel the preview and return the project: what edits and files are made from.

        Raises ``PreviewWaitsError`` when it waits to be applied or cancelled.
        """
        self._need_no_preview()
        self.history.preview(None)
        return self.project

    # --- the selection

    def selected(self) -> IntArray:
        """Selected splats (K,), at least one; ``NothingSelectedError`` when there is none."""
        indices = self.read.selected_indices()
        if len(indices) == 0:
            raise NothingSelectedError
        return indices

    def edit(self, build: Callable[[Scene], Edit | None]) -> bool:
        """Apply the edit that ``build`` makes of the scene."""
        return self.do(build(self.settled().scene))

    def edit_selected(self, verb: str, build: Build) -> bool:
        """Apply the edit that ``build`` makes of the scene, the selected splats and a title."""
        scene = self.settled().scene
        return self.do(build(scene, self.selected(), self.title_for(verb)))

    def select(self, indices: IntArray, how: How = "set", title: str = "Select") -> bool:
        """Change the selection by splats (K,)."""
        edit = edits.select(self.settled().scene, indices, how, title)
        return self.do(edit, is_content=False)

    # --- reading

    @property
    def tree(self) -> "LodTree | None":
        """Of the trees that are known the largest one of the files that are in the scene now."""

        def find() -> "LodTree | None":
            found = [tree for tree in self.lods if is_of(tree, self.project)]
            return max(found, key=len, default=None)

        return self.read.once("level of detail", (self.lods, self.scene.revision.splats), find)

    @property
    def n_file_rows(self) -> int:
        """Splats of the scene that come from files, for which a tree is built."""
        key = self.scene.revision.splats
        return self.read.once("rows of files", key, lambda: rows_of_files(self.scene))

    @property
    def pick_boxes(self) -> PickBoxes | None:
        """Boxes that tell a click in a large scene which splats to look at; None: all of them.

        Also while the level of detail is switched off: what is found is the same.
        """
        tree, now = self.tree, self.scene.revision
        if tree is None:
            return None
        key = (id(tree), now.placement, now.placements)
        return self.read.once("pick boxes", key, lambda: PickBoxes(tree, self.scene))

    def name_of(self, group: int) -> str:
        """Name of a group, as the object list shows it."""
        return group_name(self.scene, group)

    def names_of(self, groups: Sequence[int]) -> str:
        """Name of one object, or how many there are: "chair", "3 objects"."""
        return self.name_of(groups[0]) if len(groups) == 1 else f"{len(groups)} objects"

    def titled(self, *groups: int) -> str:
        """``names_of`` for a title, which stays: an object without a name yet is "an object"."""
        scene = self.scene
        is_named = len(groups) != 1 or groups[0] in {0, *scene.names, *scene.described}
        return self.names_of(groups) if is_named else "an object"

    def title_for(self, verb: str) -> str:
        """Title of an edit of the selection: "Move chair", "Delete 20 splats of 3 objects",
        "Recolor chair and 2 loose splats"."""
        groups, n_loose = self.read.selected_groups(), self.read.n_loose()
        if not groups:
            return f"{verb} splats"
        of = ""
        if self.read.selects_parts():
            of = f"{counted(len(self.read.selected_indices()) - n_loose, 'splat')} of "
        loose = f" and {counted(n_loose, 'loose splat')}" if n_loose else ""
        return f"{verb} {of}{self.titled(*groups)}{loose}"

    def selected_box(self) -> tuple[DoubleArray, DoubleArray] | None:
        """Box lo, hi (3,) of the selection, world; None when nothing is selected.

        During a drag: as it was before.
        """
        if len(self.read.selected_indices()) == 0:
            return None
        return self.read.selected_box(self.history.is_previewing)

    def selected_pose(self) -> Pose | None:
        """Placement of the selection, about the middle of the box that turns with it; None when
        nothing is selected.

        Of several placements: as if nothing was turned or scaled. During a drag: as before it.
        """
        if len(self.read.selected_indices()) == 0:
            return None
        pose = self.read.selected_pose(self.history.is_previewing)
        return pose if pose.is_one else replace(pose, turn=np.eye(3), scale=np.ones(3))

    def selected_sizes(self, *, local: bool) -> DoubleArray | None:
        """Sides (3,) of the selection's box along the world's axes, or its own; None without."""
        box, pose = self.selected_box(), self.selected_pose()
        if box is None or pose is None:
            return None
        if not local:
            return box[1] - box[0]
        return self.read.selected_sizes(self.history.is_previewing, pose.axes)

    def selected_oriented_box(self) -> OrientedBox | None:
        """The smallest box around the selection; None when nothing is selected."""
        if len(self.read.selected_indices()) == 0:
            return None
        return self.read.selected_oriented_box(self.history.is_previewing)

    def selected_axes(self) -> DoubleArray:
        """Rotation of the first selected splat's object (3, 3): its own axes as columns."""
        chosen = self.read.selected_indices()
        if len(chosen) == 0:
            return np.eye(3)
        row = self.scene.placement[chosen[0]]
        u, _, vt = np.linalg.svd(self.scene.placements.matrix[row][:, :3])
        axes: DoubleArray = u @ vt
        return axes if np.linalg.det(axes) > 0 else -axes

    def selected_centre(self) -> DoubleArray | None:
        """Position of the handles (3,), world; None when nothing is selected."""
        pose = self.selected_pose()
        return None if pose is None else pose.centre


def _stamps(project: Project) -> Stamps:
    """A quick sign that a file may have changed."""
    return tuple(_stamp(file) for path, _ in _files(project) for file in files_of_model(path))


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


def _files(project: Project) -> list[tuple[Path, str]]:
    """Files of splats, or the copies that a save has made of them, and their fingerprints."""
    files = [item for item in project.scene.added if not item.is_made]
    added = [(Path(item.path), item.fingerprint) for item in files]
    opened = [(project.model_path, project.model_fingerprint), *added]
    if project.path is None:
        return opened
    return [project.copies.files.get((project.path, file[1]), file) for file in opened]
