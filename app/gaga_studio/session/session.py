"""The state of the program: the open document, the view, the jobs, the notices.

Pull, not push: panels read it every frame. Main thread only; works without a window.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, plain_text
from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.memory_bank import Decision
from gaga_core.io.folder.lock import InUseError
from gaga_core.masks import MaskSet
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.lod.edited import PickBoxes
from gaga_core.scene.objects import ObjectTable, folder_colors, muted_colors
from gaga_core.scene.project import (
    ModelChangedError,
    Project,
    SavedElsewhereError,
    is_saved_still,
    listed_path,
    reopen_stage,
)
from gaga_core.scene.scene import RGB, Scene
from gaga_core.scene.selection.bounds import splat_box, whole_box
from gaga_core.scene.selection.by_screen import Pick, pick
from gaga_studio.session import stages
from gaga_studio.session.camera_rig import CameraRig
from gaga_studio.session.document import Document
from gaga_studio.session.jobs import JobRunner
from gaga_studio.session.notices import (
    HINT_SECONDS,
    Level,
    Notice,
    Request,
    UserQuestion,
    choose_one,
    notifies,
)
from gaga_studio.session.rates import KnownRates
from gaga_studio.session.settings import Settings, load_settings, save_settings
from gaga_studio.session.view import (
    ImageSource,
    Mode,
    PhotoCompareMode,
    RenderRequests,
    ToolName,
    TrainingPreview,
    ViewState,
)
from gaga_studio.system import paths

if TYPE_CHECKING:
    from gaga_core.pipeline.reconstruct import PhotoFind


_LEAST_INTERVAL_S = 0.1
_STILL_S = 0.05  # the mouse and the camera must rest this long
_STILL_PIXELS = 2.0


class Hovering:
    """Look up the hovered object without blocking; only the newest position counts."""

    def __init__(self) -> None:
        self.group = 0  # under the mouse; 0 = none
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="hover")
        self._answer: Future[int] | None = None
        self._wanted: tuple[float, float, int, int] | None = None
        self._asked: object = None
        self._moved_at = 0.0
        self._asked_at = 0.0

    def at(self, u: float, v: float, width: int, height: int) -> None:
        """Note that the mouse is at pixel (u, v) of a picture of this size."""
        before = self._wanted
        far = before is None or max(abs(before[0] - u), abs(before[1] - v)) > _STILL_PIXELS
        if far or before is None or before[2:] != (width, height):
            self._wanted = (u, v, width, height)
            self._moved_at = time.monotonic()

    def away(self) -> None:
        """Note that the mouse left the picture, or that a drag or a jump runs."""
        self.group, self._wanted, self._asked = 0, None, None

    def update(
        self,
        scene: Scene,
        camera_of: Callable[[int, int], Camera],
        pose: object,
        antialiased: bool | None = None,
        boxes: PickBoxes | None = None,
    ) -> None:
        """Take an answer, ask the next question. ``pose`` tells whether the camera moved.

        ``antialiased`` is how the splats are drawn, as in `pick`; ``boxes`` of a large scene.
        """
        if self._answer is not None:
            if not self._answer.done():
                return
            answer, self._answer = self._answer, None
            group = answer.result()
            self.group = group if self._wanted is not None else 0
        wanted, now = self._wanted, time.monotonic()
        if wanted is None:
            return
        asked = (wanted, pose, scene.revision.total())
        is_still = now - self._moved_at >= _STILL_S and now - self._asked_at >= _LEAST_INTERVAL_S
        if asked == self._asked or not is_still:
            return
        self._asked, self._asked_at = asked, now
        camera = camera_of(wanted[2], wanted[3])
        # Edits replace columns, never change them in place: this is the scene as it is now.
        self._answer = self._pool.submit(
            _group_at, replace(scene), camera, (wanted[0], wanted[1]), antialiased, boxes
        )

    def shut_down(self) -> None:
        """End the thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)


def _group_at(
    scene: Scene,
    camera: Camera,
    at: tuple[float, float],
    antialiased: bool | None,
    boxes: PickBoxes | None,
) -> int:
    rows = None if boxes is None else boxes.rows_at(camera, *at, len(scene))
    found = pick(scene, camera, *at, antialiased=antialiased, rows=rows)
    return found.group if found is not None else 0


_MOST_NOTICES = 50
_OPEN = "Open "  # begins the title of the task that opens something
T = TypeVar("T")
NO_GROUPS = "There are no groups here. Use Find objects to make them."
NO_OBJECTS_OF_A_FILE = (
    "A single splat file has no photos to find objects in. Make them by clicks with the "
    "tool Object (O), or open the scene folder of the file."
)
COPY, ELSEWHERE, RELOAD = "Save with a copy", "Save elsewhere…", "Reload"


@dataclass(frozen=True)
class HowToSave:
    """Permissions of a save."""

    copies_model: bool = False
    overwrites: bool = False


class Session:
    """At most one open document, its view and its jobs. Edits are in ``gaga_studio.features``."""

    def __init__(
        self,
        settings: Settings | None = None,
        when_opened: Sequence[Callable[["Session"], object]] = (),
    ) -> None:
        """``when_opened`` are called, in order, when the user has opened a scene."""
        self._when_opened = when_opened
        self.document: Document | None = None
        self.view = ViewState()
        self.rig = CameraRig()
        self.tool = ToolName.PICK
        self.jobs = JobRunner(self.notify, self._task_failed, self._task_begins)
        self.hovering = Hovering()
        self.notices: tuple[Notice, ...] = ()  # oldest first
        self._questions: list[UserQuestion] = []  # shown one after the other, as a modal
        self.request: Request | None = None  # what a command asks of the window
        self.should_quit = False
        self.live: BankSnapshot | None = None  # while an association runs
        self.photos: PhotoFind | None = None  # opened, but without splats
        self.training: TrainingPreview | None = None  # while splats are made of them
        self.filter = ""  # of the object list
        self.hint = ""
        self.images: ImageSource | None = None
        self.render_requests: RenderRequests | None = None  # to OpenGL; the window gives one
        self.masks = MaskSet()  # of `provider`
        self._features: dict[type, object] = {}
        self.provider = ""
        self.active_view: int | None = None  # training camera last jumped to
        self.has_exported = False  # anything, since the program was started
        self.settings, problem = (settings, "") if settings else load_settings()
        self._apply_settings()
        if problem:
            self.notify(Level.WARNING, problem)

    def feature(self, kind: type[T]) -> T:
        """Return the state of a feature in this run of the program, made when first asked for."""
        if kind not in self._features:
            self._features[kind] = kind()
        return cast(T, self._features[kind])

    @property
    def rates(self) -> KnownRates:
        """How long tasks take on this machine."""
        return self.feature(KnownRates)

    # --- messages

    @property
    def hint(self) -> str:
        """What is said of the last click or command, for seconds, or until the next one, a changed
        selection, or the end of the task that ran."""
        (document, state_id, job), now = self._hint_of, self._state
        holds = (document, state_id) == now[:2] and job in ("", now[2])
        is_read = time.monotonic() - self._hint_at >= HINT_SECONDS
        return self._hint if holds and not is_read else ""

    @hint.setter
    def hint(self, text: str) -> None:
        self._hint, self._hint_of, self._hint_at = text, self._state, time.monotonic()

    @property
    def _state(self) -> tuple[Document | None, int, str]:
        document, job = self.document, self.jobs.at_risk
        state_id = document.history.state_id if document is not None else 0
        return document, state_id, job.title if job is not None else ""

    def notify(
        self,
        level: Level,
        text: str,
        command: str = "",
        *,
        shows: Path | None = None,
        otherwise: str = "",
    ) -> None:
        """Tell the user one sentence; offer the command with this id, or to show a file.

        With the command ``otherwise`` it is a question, which stays until it is answered. It takes
        the place of one that says the same.
        """
        self._tell(Notice(level, plain_text(text), command, shows=shows, otherwise=otherwise))

    def _tell(self, notice: Notice) -> None:
        waits = self.document is not None and self.document.waiting
        if waits and self.notices and self.notices[-1].text == notice.text:
            return  # it is said already, and a drag would say it in every frame
        said = notice.level, notice.text
        others = (n for n in self.notices if (n.level, n.text) != said)
        self.notices = (*others, notice)[-_MOST_NOTICES:]

    def _task_failed(self, title: str, text: str) -> None:
        self._tell(Notice(Level.ERROR, plain_text(text), of_task=title))

    def _task_begins(self, title: str) -> None:
        """Drop errors of the former try; opening anything is another try of opening."""

        def is_tried_again(task: str) -> bool:
            return task == title or (task.startswith(_OPEN) and title.startswith(_OPEN))

        self.notices = tuple(n for n in self.notices if not is_tried_again(n.of_task))

    def answered_by(self, command: str) -> None:
        """Drop the notices that ask for this command, or for another one instead."""

        def is_answered(notice: Notice) -> bool:
            return bool(notice.otherwise) and command in (notice.command, notice.otherwise)

        self.notices = tuple(n for n in self.notices if not is_answered(n))

    @property
    def pending_question(self) -> UserQuestion | None:
        """The question that is shown; see `answer`. One more waits until this one is answered."""
        return self._questions[0] if self._questions else None

    @pending_question.setter
    def pending_question(self, question: UserQuestion) -> None:
        if all(other.text != question.text for other in self._questions):
            self._questions.append(question)

    def answer(self, choice: str) -> None:
        """Answer the pending question; one that is no longer true is asked again instead."""
        if self._questions and not self._ask_again():
            self._questions.pop(0).on_choice(choice)

    def _ask_again(self) -> bool:
        """Ask the pending question again if it is no longer true; returns whether it was not."""
        if not self._questions or not self._questions[0].is_past():
            return False
        self._questions.pop(0).again()
        return True

    def take_request(self) -> Request | None:
        """Return what a command asked of the window since the last call, or None."""
        request, self.request = self.request, None
        return request

    def change_settings(self, settings: Settings) -> None:
        """Use and save these preferences."""
        before, self.settings = self.settings, settings
        self._apply_settings()
        if self.document is not None:
            self.document.history.set_budget(settings.undo_bytes)
        self._save_settings(before)

    def _apply_settings(self) -> None:
        self.view.background = self.settings.background_color
        self.view.lod_budget = self.settings.lod_budget

    @notifies
    def _save_settings(self, before: Settings) -> None:
        save_settings(self.settings, before)

    # --- the document

    @property
    def project(self) -> Project | None:
        """The open project, if any."""
        return self.document.project if self.document is not None else None

    @property
    def scene(self) -> Scene | None:
        """The scene that is open."""
        return self.document.scene if self.document is not None else None

    @property
    def shown(self) -> Scene | None:
        """The scene in the picture: the open one, or splats that are being trained."""
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

    def open(self, path: Path, *, then: Callable[[], object] | None = None) -> None:
        """Open a scene folder, a .ply or a project; what is open stays until it has succeeded.

        It is read first: about unsaved edits is asked only where something would take their place.
        ``then`` is called once the scene is open, and never if it is not.
        """
        self._start_opening(Path(path), then)

    def open_demo(self) -> None:
        """Open the demo scene; the first time it is copied from the program's own files."""
        self._start_opening(None)

    def close(self) -> None:
        """Close the scene, after asking about unsaved edits."""
        self._when_saved("before it is closed", self._forget)

    def quit(self) -> None:
        """End the program (``should_quit``), after asking about a running job and unsaved edits.

        One question names both.
        """

        job = self.jobs.at_risk
        if job is None:
            self._when_saved("before gaga-studio ends", self._end)
        else:
            lost = "it can go on later" if job.resumes else "unfinished work is lost"
            self._ask_to_quit(f"{job.title} is still running; {lost}.")

    def _end(self) -> None:
        self.should_quit = True

    def _ask_to_quit(self, text: str) -> None:
        end, document, asked = self._end, self.document, self._at_risk()
        choices: dict[str, Callable[[], None]] = {"Quit": end}
        if document is not None and document.waiting:
            text += f" The preview of {document.waiting} is not applied."
        if document is not None and self.unsaved:
            text += f" {document.title_name} has unsaved changes."
            if document.saved_name != document.title_name:
                text += f" Saving them writes {document.saved_name}."
            choices = {
                "Save and quit": lambda: self.save(then=end),
                "Quit without saving": end,
            }

        def again() -> None:
            if any(self._at_risk()):
                self.quit()
            else:
                self._ask_to_quit("What was running is done.")

        # Saving keeps the edits, not the work of a job or a preview.
        self.pending_question = choose_one(
            text, choices, lambda: self._at_risk() != asked, again, loses=any(asked[:2])
        )

    def _at_risk(self) -> tuple[str, str, bool]:
        """What the end of the program loses: a job, a preview that waits, edits."""
        job, document = self.jobs.at_risk, self.document
        waits = document.waiting if document is not None else ""
        return job.title if job is not None else "", waits, self.unsaved

    def save(
        self,
        path: Path | None = None,
        then: Callable[[], None] | None = None,
        how: HowToSave | None = None,
    ) -> None:
        """Save the project as it is now where it was, or to ``path``, next to a job that runs.

        ``then`` is called after success. What the user must decide becomes a question.
        """
        document = self.document
        if document is None:
            return
        how = how or HowToSave(copies_model=document.copies_model)
        content = document.save_state.content(document.history.state_id)

        def done(where: Path) -> None:
            document.project.path = where
            document.copies_model |= how.copies_model
            if how.copies_model:
                document.note_files()
            document.save_state.saved(content)
            waits = document.waiting
            apart = f" The preview of {waits} is not applied, and not in it." if waits else ""
            self.notify(Level.INFO, f"Saved to {where}.{apart}")
            if document.project.folder is None:  # a scene folder opens with what was saved
                former = listed_path(document.project.source)
                self.change_settings(self.settings.opened(where, former))
            if self.document is document:
                self._claim(document)
            if then is not None:
                then()

        def failed(error: GagaError) -> bool:
            if self.document is not document:
                return False
            question = self._save_question(document, error, path, then, how)
            if question is not None:
                self.pending_question = question
            return question is not None

        if not document.waiting:
            document.settled()
        kept = replace(document.project, scene=document.history.base)
        stage = stages.save_stage(kept, path, how.copies_model, how.overwrites)
        self.jobs.start_save("Save", stage, done, failed)

    def look_at_files(self) -> bool:
        """Ask what to do when another program changed the splats that are open; whether it did.

        Called when the window gets the focus; asks once about each change.
        """
        document = self.document
        if document is None or self.pending_question is not None or not document.note_files():
            return False
        changed = document.changed_file()
        if changed is not None:
            if document.project.path is not None and not is_saved_still(document.project):
                document.save_state.saved(None)  # what was saved cannot be opened any more
            error = ModelChangedError(changed)
            question = self._save_question(document, error, None, None, HowToSave())
            if question is not None:
                self.pending_question = question
        return changed is not None

    def _claim(self, document: Document) -> None:
        """Make the saved project this program's, or say why it is read-only."""
        said = document.claim()
        if said:
            self.notify(Level.WARNING, said)

    def _save_question(
        self,
        document: Document,
        error: GagaError,
        path: Path | None,
        then: Callable[[], None] | None,
        how: HowToSave,
    ) -> UserQuestion | None:
        """The question after a save failed with ``error``; None when there is no choice."""
        if isinstance(error, ModelChangedError):
            choices: tuple[str, ...] = (COPY, ELSEWHERE, RELOAD)
        elif isinstance(error, SavedElsewhereError):
            choices = (ELSEWHERE, "Overwrite")
        elif isinstance(error, InUseError):
            choices = (ELSEWHERE, "Try again")
        else:
            return None

        def elsewhere() -> None:
            document.copies_model |= isinstance(error, ModelChangedError)
            self.request = Request.SAVE_AS

        def reload() -> None:
            self.jobs.start("Reload", reopen_stage(document.project), on_done=self.take)

        actions: dict[str, Callable[[], None]] = {
            COPY: lambda: self.save(path, then, replace(how, copies_model=True)),
            "Overwrite": lambda: self.save(path, then, replace(how, overwrites=True)),
            "Try again": lambda: self.save(path, then, how),
            ELSEWHERE: elsewhere,
            RELOAD: reload,
        }
        text = str(error)
        if isinstance(error, ModelChangedError):
            is_saved = document.project.path is not None
            if is_saved and not is_saved_still(document.project):
                text += " Reloading loses all edits: the saved ones do not fit the changed file."
            elif document.unsaved:
                text += " Reloading loses the unsaved edits."
        return choose_one(text, {choice: actions[choice] for choice in choices})

    def shut_down(self) -> None:
        """Stop the threads; the window is closing."""
        if self.render_requests is not None:
            self.render_requests.close()
        self.jobs.shut_down()
        if self.document is not None:
            self.document.release()
        self.hovering.shut_down()

    def _when_saved(
        self, when: str, action: Callable[[], None], saved: Callable[[], None] | None = None
    ) -> None:
        """Do ``action``; with unsaved edits, or a preview that waits, ask first.

        After "Save" do ``saved`` instead, if there is one.
        """
        document = self.document
        if document is None or not (document.unsaved or document.waiting):
            action()
            return
        text = f"The preview of {document.waiting} is not applied. " if document.waiting else ""
        choices = {"Discard": action}
        if document.unsaved:
            text += f"Save the changes to {document.changes} {when}?"
            choices = {"Save": lambda: self.save(then=saved or action), **choices}
        else:
            text += f"Discard it {when}?"
        asked = self._at_risk()[1:]

        def again() -> None:
            if any(self._at_risk()[1:]):
                self._when_saved(when, action, saved)
            else:  # a save that ran has ended
                (saved or action)()

        self.pending_question = choose_one(
            text, choices, lambda: self._at_risk()[1:] != asked, again, loses=bool(asked[0])
        )

    def leave_for(self, photos: "PhotoFind", when: str, action: Callable[[], None]) -> None:
        """Have ``photos`` open in place of the scene and do ``action``; with unsaved edits, ask."""

        def leave() -> None:
            self._forget()
            self.photos = photos
            action()

        self._when_saved(when, leave)

    def _start_opening(self, path: Path | None, then: Callable[[], object] | None = None) -> None:
        """Open ``path``, or the demo."""
        name = path.name if path else "the demo"
        stage = stages.open_stage(path) if path else stages.open_demo_stage(paths.demo_scene())

        def read(project: "Project | PhotoFind") -> None:
            # A save may write what has been read, as where the open project is opened again.
            again = partial(self._start_opening, path, then)
            self._when_saved(f"before {name} is opened", lambda: opened(project), saved=again)

        def opened(project: "Project | PhotoFind") -> None:
            if isinstance(project, Project):
                self.take(project)
                if (saved := project.saved_of_file) is not None:
                    what = "this file" if project.manifest is None else "these objects"
                    text = f"{saved.name} was saved of {what}: open it for your objects and edits."
                    self.notify(Level.INFO, text, "file.saved_project")
                if path is not None and (said := stages.said_of_photos(path)):
                    self.notify(Level.INFO, said, "file.make_again")
                for follow in self._when_opened:
                    follow(self)
                if then is not None:
                    then()
            else:
                self._forget()
                self.photos = project
            if path is not None:
                at = project.opened_again_by(path) if isinstance(project, Project) else path
                self.change_settings(self.settings.opened(at))
            self.jobs.prepare("Prepare kernels", stages.kernels_stage(self.rates))

        self.jobs.start(f"{_OPEN}{name}", stage, on_done=read)

    def take(self, project: Project) -> None:
        """Show ``project`` in place of what is open."""
        found = stages.masks_of(project)
        self._forget()
        self.document, (self.provider, self.masks) = Document(project), found
        self.document.history.set_budget(self.settings.undo_bytes)
        self._claim(self.document)
        self.active_view = self.show_start()

    def show_start(self, *, animated: bool = False) -> int | None:
        """Show what is shown first of a scene; return the photo that it is, if it is one."""
        document = self.need()
        scene, before = document.scene, self.rig.pose
        if self.cameras:
            up = document.up_of_photos()
            self.rig.frame_scene(*splat_box(scene), self.cameras, up=up)
        else:
            up = self.rig.up if animated else np.array(document.project.up)
            box = whole_box(scene)
            self.rig.frame_scene(*box, up=up)
            self.rig.turn_to_clearest(scene, box)
        self.rig.follow(document.world)
        if animated:
            self.rig.fly_from(before)
        return 0 if self.cameras else None

    def _forget(self) -> None:
        if self.document is not None:
            self.document.release()
            self.document.on_close(self.view)
        # What a notice offers or shows, and an error, is about the scene that it was made for.
        self.notices = tuple(
            n for n in self.notices if not (n.command or n.shows or n.level is Level.ERROR)
        )
        self.document = self.live = self.active_view = self.photos = self.training = None
        self.masks, self.provider, self.filter, self.hint = MaskSet(), "", "", ""
        self._forget_places()
        self.hovering.away()

    def _forget_places(self) -> None:
        """Show the next scene in its colors: it may have neither groups nor photos."""
        view = self.view
        if view.mode in (Mode.GROUPS, Mode.MASK, Mode.CONFIDENCE, Mode.IDENTITY):
            view.mode = Mode.COLOR
        view.compare, view.version, view.holds_photo = PhotoCompareMode.OFF, -1, False
        view.outline = view.pivot = view.pointed = None

    def edit(self, build: Callable[[Scene], Edit | None]) -> bool:
        """Apply the edit that ``build`` makes of the open scene."""
        return self.need().edit(build)

    # --- undo and redo, and the end of a drag whose edit is only shown

    def undo(self) -> str | None:
        """Undo the newest edit, or step of bookmarks and path; return its title, None if none."""
        if self.document is None:
            return None
        title = self.document.undo_title
        if not self.document.undo_views():
            return self.document.undo()
        self._keep_playback()
        return title

    def go_to_view_step(self, n: int) -> None:
        """Undo or redo bookmarks and path until ``n`` of their steps are done after the newest
        edit."""
        self.need().go_to_view_step(n)
        self._keep_playback()

    def redo(self) -> str | None:
        """Redo what was undone last; return its title, None if there is none."""
        if self.document is None:
            return None
        title = self.document.redo_title
        if not self.document.redo_views():
            return self.document.redo()
        self._keep_playback()
        return title

    def _keep_playback(self) -> None:
        """Stay inside of a path that undo changed."""
        playback, film = self.view.playback, self.need().project.film
        playback.at = min(playback.at, film.seconds)
        playback.chosen = max(min(playback.chosen, len(film.keyframes) - 1), 0)

    def commit_preview(self) -> bool:
        """Make what a drag shows one entry of the history; False if nothing changed."""
        return self.document is not None and self.document.commit_preview()

    def cancel_preview(self) -> None:
        """Cancel a drag: everything is as it was before."""
        if self.document is not None:
            self.document.cancel_preview()

    # --- every frame

    def tick(self, dt: float) -> None:
        """Take what jobs have produced, move the camera, look up the hovered object."""
        self.jobs.poll()
        self.rates.load.look()
        self._ask_again()
        if self.document is not None:
            self.rig.follow(self.document.world, self.document.kept_poses)
        is_moving = self.rig.update(dt)
        if self.scene is None or is_moving or self.is_previewing:
            self.hovering.away()
        else:
            look = self.view.is_antialiased(self.scene)
            boxes = self.need().pick_boxes
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
    def is_dragging(self) -> bool:
        """Whether a preview is shown that no one has to answer: that of a drag."""
        return self.is_previewing and not self.need().waiting

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

    @property
    def nothing_open_text(self) -> str:
        """Words for panels while no scene is open."""
        if self.photos is None:
            return "No scene is open"
        is_shown = self.training is not None and self.training.scene is not None
        return "These splats are no scene yet" if is_shown else "No splats yet"

    @property
    def no_groups_text(self) -> str:
        """Sentence on how to get objects where there are none."""
        is_file = self.project is not None and self.project.folder is None
        return NO_OBJECTS_OF_A_FILE if is_file else NO_GROUPS

    def decisions(self, group: int) -> tuple[Decision, ...]:
        """Return which masks joined a group and why, in the order of the association."""
        return self.need().read.decisions(group, self.live)

    def need(self) -> Document:
        """Return the open document; ``GagaError`` when there is none."""
        if self.document is None:
            raise GagaError("No scene is open. Open one first.")
        return self.document

    # --- pointing: at pixel (u, v) of the picture; pixel centres are at +0.5

    def pick(self, u: float, v: float, width: int, height: int) -> Pick | None:
        """Return what is at a pixel; None if nothing is."""
        camera = self.rig.camera(width, height)
        if self.document is None:
            return None
        scene, boxes = self.document.scene, self.document.pick_boxes
        rows = None if boxes is None else boxes.rows_at(camera, u, v, len(scene))
        look = self.view.is_antialiased(scene)
        return pick(scene, camera, u, v, antialiased=look, rows=rows)

    def hover(self, u: float, v: float, width: int, height: int) -> None:
        """Note that the mouse is at this pixel: `hovered_group` follows once it rests."""
        self.hovering.at(u, v, width, height)
