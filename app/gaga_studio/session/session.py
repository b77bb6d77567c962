"""The state of the program: the open document, the view, the jobs, the notices.

Pull, not push: panels read it every frame. Main thread only; works without a window.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.memory_bank import Decision
from gaga_core.masks import MaskSet
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import ObjectTable, folder_colors, muted_colors
from gaga_core.scene.orientation import guess_up
from gaga_core.scene.project import Project
from gaga_core.scene.scene import RGB, Scene
from gaga_core.scene.selection.bounds import splat_box, whole_box
from gaga_core.scene.selection.by_screen import Pick, pick
from gaga_studio.session import level_of_detail, next_stage, saving, stages, upright
from gaga_studio.session.camera_rig import CameraRig
from gaga_studio.session.document import Document
from gaga_studio.session.find_options import FindOptions, lift_mode
from gaga_studio.session.hover import Hovering
from gaga_studio.session.jobs import JobRunner
from gaga_studio.session.models_state import ModelsState
from gaga_studio.session.notices import Level, Notice, UserQuestion, notifies, unsaved_question
from gaga_studio.session.render_requests import RenderRequests
from gaga_studio.session.requests import Request
from gaga_studio.session.settings import Settings, load_settings, save_settings
from gaga_studio.session.training_preview import TrainingPreview
from gaga_studio.session.view_state import ImageSource, Mode, ToolName, ViewState
from gaga_studio.system import paths

if TYPE_CHECKING:
    from gaga_core.pipeline.reconstruct import PhotoFind

_MOST_NOTICES = 50
NO_GROUPS = "There are no groups here. Use Find objects to make them."


class Session:
    """At most one open document, its view and its jobs. Edits are in ``gaga_studio.actions``."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.document: Document | None = None
        self.view = ViewState()
        self.rig = CameraRig()
        self.tool = ToolName.PICK
        self.jobs = JobRunner(self.notify)
        self.hovering = Hovering()
        self.notices: tuple[Notice, ...] = ()  # oldest first
        self.pending_question: UserQuestion | None = None  # shown as a modal; see `answer`
        self.request: Request | None = None  # what a command asks of the window
        self.should_quit = False
        self.live: BankSnapshot | None = None  # while an association runs
        self.photos: PhotoFind | None = None  # opened, but without splats
        self.training: TrainingPreview | None = None  # while splats are made of them
        self.filter = ""  # of the object list
        self.hint = ""  # about the last click, until the next one
        self.images: ImageSource | None = None
        self.render_requests: RenderRequests | None = None  # to OpenGL; the window gives one
        self.masks = MaskSet()  # of `provider`
        self.models = ModelsState()
        self.find_options = FindOptions()
        self.provider = ""
        self.active_view: int | None = None  # training camera last jumped to
        self.has_exported = False  # anything, since the program was started
        self.settings, problem = (settings, "") if settings else load_settings()
        self._apply_settings()
        if problem:
            self.notify(Level.WARNING, problem)

    # --- messages

    def notify(
        self, level: Level, text: str, command: str = "", *, shows: Path | None = None
    ) -> None:
        """Tell the user one sentence; offer the command with this id, or to show a file."""
        self.notices = (*self.notices, Notice(level, text, command, shows=shows))[-_MOST_NOTICES:]

    def answer(self, choice: str) -> None:
        """Answer the pending question."""
        question, self.pending_question = self.pending_question, None
        if question is not None:
            question.on_choice(choice)

    def take_request(self) -> Request | None:
        """Return what a command asked of the window since the last call, or None."""
        request, self.request = self.request, None
        return request

    def change_settings(self, settings: Settings) -> None:
        """Use and save these preferences."""
        self.settings = settings
        self._apply_settings()
        if self.document is not None:
            self.document.history.set_budget(settings.undo_bytes)
        self._save_settings()

    def _apply_settings(self) -> None:
        self.view.background = self.settings.background_color
        self.view.lod_budget = self.settings.lod_budget

    @notifies
    def _save_settings(self) -> None:
        save_settings(self.settings)

    # --- the document

    @property
    def project(self) -> Project | None:
        """What is open."""
        return self.document.project if self.document is not None else None

    @property
    def scene(self) -> Scene | None:
        """The scene that is open."""
        return self.document.scene if self.document is not None else None

    @property
    def shown(self) -> Scene | None:
        """What the picture shows: the open scene, or splats that are being trained."""
        return self.training.scene if self.training is not None else self.scene

    @property
    def history(self) -> History | None:
        """The edits of the open scene."""
        return self.document.history if self.document is not None else None

    @property
    def unsaved(self) -> bool:
        """Whether there are edits that are not on disk; a selection is not an edit."""
        return self.document is not None and self.document.unsaved

    @property
    def title(self) -> str:
        """Name of what is open, starred when there is something to save; "" if nothing is."""
        return self.document.title if self.document is not None else ""

    def open(self, path: Path) -> None:
        """Open a scene folder, a .ply or a project; what is open stays until it has succeeded."""
        path = Path(path)
        self._when_saved(f"before {path.name} is opened", lambda: self._start_opening(path))

    def open_demo(self) -> None:
        """Open the demo scene; the first time it is copied from the program's own files."""
        self._when_saved("before the demo is opened", lambda: self._start_opening(None))

    def close(self) -> None:
        """Close the scene, after asking about unsaved edits."""
        self._when_saved("before it is closed", self._forget)

    def quit(self) -> None:
        """End the program (``should_quit``), after asking about a running job and unsaved edits."""

        def end() -> None:
            self.should_quit = True

        def chosen(choice: str) -> None:
            if choice == "Quit":
                self._when_saved("before gaga-studio ends", end)

        job = self.jobs.at_risk
        if job is None:
            chosen("Quit")
            return
        text = f"{job.title} is still running; what it has not finished is lost. Quit?"
        self.pending_question = UserQuestion(text, ("Quit", "Cancel"), chosen)

    def save(self, path: Path | None = None, then: Callable[[], None] | None = None) -> None:
        """Save the project where it was, or to ``path``; ``then`` is called after success.

        Works while a job runs: the project is saved as it is now.
        """
        saving.save(self, path, then)

    def shut_down(self) -> None:
        """Stop the threads; the window is closing."""
        if self.render_requests is not None:
            self.render_requests.close()
        self.jobs.shut_down()
        if self.document is not None:
            saving.release(self.document.lock)
        self.hovering.shut_down()

    def _when_saved(self, when: str, action: Callable[[], None]) -> None:
        """Do ``action``; with unsaved edits ask first."""
        if self.document is None or not self.unsaved:
            action()
            return

        self.pending_question = unsaved_question(
            f"Save the changes to {self.document.name} {when}?",
            save=lambda: self.save(then=action),
            discard=action,
        )

    def _start_opening(self, path: Path | None) -> None:
        """Open ``path``, or the demo."""
        title = f"Open {path.name}" if path else "Open the demo"
        stage = stages.open_stage(path) if path else stages.open_demo_stage(paths.demo_scene())

        def opened(project: "Project | PhotoFind") -> None:
            if isinstance(project, Project):
                self.take(project)
                upright.opened(self)
                level_of_detail.opened(self)
            else:
                self._forget()
                self.photos = project
            if path is not None:
                self.change_settings(self.settings.opened(path))
            self.jobs.start_quiet("Prepare kernels", stages.kernels_stage())

        self.jobs.start(title, stage, on_done=opened)

    def take(self, project: Project) -> None:
        """Show ``project`` in place of what is open."""
        found = stages.masks_of(project)
        self._forget()
        self.document, (self.provider, self.masks) = Document(project), found
        self.document.history.set_budget(self.settings.undo_bytes)
        self.document.stamps = saving.stamps(project)
        saving.claim(self)
        if self.cameras:
            self.rig.frame_scene(
                *splat_box(project.scene), self.cameras, up=self.document.up_of_photos()
            )
        else:
            up = guess_up(project.scene.gaussians)
            self.rig.frame_scene(*whole_box(project.scene), up=up)
        self.rig.follow(self.document.world)
        self.active_view = 0 if self.cameras else None

    def _forget(self) -> None:
        if self.document is not None:
            saving.release(self.document.lock)
            if self.document.timeline.is_open and self.view.mode is Mode.GROUPS:
                self.view.mode = self.document.timeline.former_mode
        # What a notice offers is about the scene that it was made for.
        self.notices = tuple(notice for notice in self.notices if not notice.command)
        self.document = self.live = self.active_view = self.photos = self.training = None
        self.masks, self.provider, self.filter, self.hint = MaskSet(), "", "", ""
        self.view.ground = self.view.measured = ()
        self.hovering.away()

    # --- every frame

    def tick(self, dt: float) -> None:
        """Take what jobs have produced, move the camera, look up the hovered object."""
        self.jobs.poll()
        if self.document is not None:
            self.rig.follow(self.document.world)
        is_moving = self.rig.update(dt)
        if self.scene is None or is_moving or self.is_previewing:
            self.hovering.away()
        else:
            look = self.view.is_antialiased(self.scene)
            boxes = level_of_detail.pick_boxes(self)
            self.hovering.update(self.scene, self.rig.camera, self.rig.pose, look, boxes)

    # --- reading

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Cameras of the photos that the picture is about, by name, around the moved scene."""
        if self.training is not None:
            return self.training.cameras
        return self.document.cameras if self.document is not None else ()

    @property
    def focus(self) -> int:
        """Group shown in the inspector; 0 = none."""
        return self.document.focus if self.document is not None else 0

    @property
    def hovered_group(self) -> int:
        """Object under the resting mouse; 0 = none."""
        return self.hovering.group

    @property
    def is_previewing(self) -> bool:
        """Whether a drag shows an edit that has no entry yet."""
        return self.history is not None and self.history.is_previewing

    @property
    def live_labels(self) -> IntArray | None:
        """Group (N,) of each splat while an association runs, else None."""
        if self.live is None or self.document is None:
            return None
        return self.document.read.live_labels(self.live)

    def objects(self) -> ObjectTable:
        """Return the object list, of the growing bank while an association runs."""
        document = self.need()
        table = document.read.objects(self.live, self.is_previewing)
        if not self.colors_by_folder:
            return table
        folders = document.scene.folders
        return document.read.once(
            "by folder",
            (table, folders),
            lambda: replace(table, colors=folder_colors(folders, table.ids)),
        )

    @property
    def colors_by_folder(self) -> bool:
        """Whether groups have the colors of their folders now."""
        return (
            self.view.folder_colors
            and self.live is None
            and self.scene is not None
            and bool(self.scene.folders.paths)
        )

    def muted_colors(self) -> dict[int, RGB]:
        """Colors of groups instead of the palette's: of large surfaces, also while found, and of
        folders. What a person chose for a group is not among them, unless folders have colors."""
        if self.document is None:
            return {}
        table = self.objects()
        own = {} if self.colors_by_folder else self.document.scene.colors

        def muted() -> dict[int, RGB]:
            found = muted_colors(table)
            return {group: rgb for group, rgb in found.items() if group not in own}

        return self.document.read.once("muted", (table, own), muted)

    def selected_indices(self) -> IntArray:
        """Selected splats (K,)."""
        return self.need().read.selected_indices()

    def selected_groups(self) -> tuple[int, ...]:
        """Objects with a selected splat, ascending."""
        return self.document.read.selected_groups() if self.document is not None else ()

    def decisions(self, group: int) -> tuple[Decision, ...]:
        """Return which masks joined a group and why, in the order of the association."""
        return self.need().read.decisions(group, self.live)

    def stage_offer(self) -> next_stage.StageOffer | None:
        """Return the stage that the open scene needs next; None if none, or while a job runs."""
        if self.document is None or self.jobs.running or self.document.read.has_groups():
            return None
        trains = lift_mode(self.settings) == "paper"
        training = next_stage.training_seconds(self.find_options.lift) if trains else 0.0
        preset, n_masks = self.settings.preset, len(self.masks)
        return next_stage.stage_offer(self.document.project, n_masks, preset, training)

    def need(self) -> Document:
        """Return the open document; ``GagaError`` when there is none."""
        if self.document is None:
            raise GagaError("No scene is open. Open one first.")
        return self.document

    # --- pointing: at pixel (u, v) of the picture; pixel centres are at +0.5

    def pick(self, u: float, v: float, width: int, height: int) -> Pick | None:
        """Return what is at a pixel; None if nothing is."""
        camera = self.rig.camera(width, height)
        if self.scene is None:
            return None
        boxes, look = level_of_detail.pick_boxes(self), self.view.is_antialiased(self.scene)
        rows = None if boxes is None else boxes.rows_at(camera, u, v, len(self.scene))
        return pick(self.scene, camera, u, v, antialiased=look, rows=rows)

    def hover(self, u: float, v: float, width: int, height: int) -> None:
        """Note that the mouse is at this pixel: `hovered_group` follows once it rests."""
        self.hovering.at(u, v, width, height)
