"""Add a scene of the same place: aligned, in a preview to apply or cancel, and what changed."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.progress import Progress, Stage, joined, portion
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import camera
from gaga_studio.features.base import (
    Command,
    Preview,
    ask,
    first_of,
    no_scene,
    not_saveable,
    preview_waits,
    watch,
)
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, Request, choose_one, notifies
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.arrays import DoubleArray
    from gaga_core.pipeline.align import Addition, Aligned
    from gaga_core.scene.captures.changes import Change
    from gaga_core.scene.project import Project

TITLE = "Add a scene"
_OPENED = 0.08  # share of the work until the other scene is open: 2 s of 24, of the demo
_CHANGED = (
    "The scene was moved or taken apart meanwhile, or a preview was open. Add the other one again."
)
_NO_PREVIEW = "There is no preview of an added scene. Use Add a scene first."


@dataclass(frozen=True, eq=False)
class Found:
    """A scene that can be added, and how it fits."""

    name: str
    second: "Project"
    world: "DoubleArray"  # (4, 4), from the other scene to the open one
    addition: "Addition"
    aligned: "Aligned | None"  # None: ``why_not``
    why_not: str = ""


class Adding(Preview[Found]):
    """A scene that is shown where it fits, and the edit that shows it."""


@dataclass
class ListedChanges:
    """What changed between the open scene and the one that was added last."""

    name: str = ""  # of that one
    is_metric: bool = False  # distances are in metres
    why_none: str = "No changes are known. Add a scene of the same place first."
    found: "tuple[tuple[Change, tuple[int, ...]], ...]" = ()  # with the groups here that show it


def shown(session: Session) -> Found | None:
    """Return the scene whose preview is shown now."""
    return session.document.feature(Adding).shown(session) if session.document else None


def summary(found: Found) -> tuple[str, ...]:
    """Return how it fits and what changed, in sentences."""
    if found.aligned is None:
        return found.why_not, "Apply it, and move, turn and scale it by its handles."
    return found.aligned.sentence(), *found.aligned.lines()


@notifies
def start(session: Session, path: Path) -> None:
    """Open the scene at ``path``, align it with the one that is open, and show it there, tinted.

    One that cannot be aligned is offered to be placed by hand.
    """
    document = session.need()
    project = replace(document.settled(), scene=replace(document.scene))

    def stage() -> Stage[Found]:
        yield Progress(TITLE, 0, 0)
        # SciPy's and numba's import takes long: it belongs to the job.
        from gaga_core.pipeline import align
        from gaga_core.pipeline.settings import AlignConfig
        from gaga_core.scene.captures.alignment import NotAlignedError

        opening = joined(align.open_capture_stage(path), TITLE, align.OPENING)
        capture, second = yield from portion(opening, 0, _OPENED, TITLE)
        if second is None:
            raise GagaError(f"{path.name} has no splats yet. Make them first, then add it.")
        first, aligned, why = align.capture_of(project), None, ""
        folder = project.folder
        place = align.workspace_of(folder.root if folder else project.model_path)
        try:
            config = AlignConfig()
            work = stages.prepared(
                session.rates,
                TITLE,
                lambda: align.align_stage(first, capture, config, place),
                usual_s=sum(align.usual_seconds(first, capture, config).values()),
            )
            aligned = yield from portion(work, _OPENED, 1, TITLE)
            world = aligned.alignment.world
        except NotAlignedError as error:
            world, why = align.middle_of_first(project.scene, second.scene), str(error)
        addition = align.addition_of(project.scene, second, world)
        return Found(capture.name, second, world, addition, aligned, why)

    check = watch(session, document, _CHANGED, lambda: _stands(project.scene, document))

    def show(found: Found) -> None:
        document.show(found.addition.shown, waits_as=TITLE)
        document.feature(Adding).take(found, found.addition.shown)

    def run(work: Stage[Found], *, waits: bool = False) -> None:
        at, title = document.history.state_id, f"{TITLE}: {path.name}"
        session.jobs.start(title, work, on_done=partial(done, at), waits=waits)

    def again(found: Found, scene: Scene) -> Stage[Found]:
        yield Progress(TITLE, 0, 0)
        from gaga_core.pipeline.align import addition_of

        return replace(found, addition=addition_of(scene, found.second, found.world))

    def done(at: int, found: Found) -> None:
        if not check():
            return
        if document.history.state_id != at:  # something was selected or named meanwhile
            run(again(found, replace(document.settled().scene)), waits=True)
            return
        if found.aligned is None:
            choices = {"Place it by hand": lambda: show(found)}
            session.pending_question = choose_one(found.why_not, choices)
        else:
            show(found)

    run(stage())


def _stands(before: Scene, document: Document) -> bool:
    """Whether most splats of the scene stand where they did when the other one was aligned with
    it: what was named, selected, hidden, copied or deleted meanwhile matters nothing."""
    now, n = document.scene, len(before)
    if document.history.is_previewing or len(now) < n:
        return False
    moved = (world_means(now)[:n] != world_means(before)).any(axis=1)
    return float(moved.mean()) < 0.5


@notifies
def apply(session: Session) -> bool:
    """Keep the scene where the preview shows it: one entry of the history, without the tint."""
    found = shown(session)
    if found is None:
        return False
    document = session.need()
    session.cancel_preview()
    changes = None if found.aligned is None else found.aligned.changes
    here = found.addition.groups
    listed = document.feature(ListedChanges)
    listed.name, listed.why_none = found.name, _why_none(found)
    listed.is_metric = found.aligned is not None and found.aligned.is_metric
    listed.found = tuple((c, _groups(c, here)) for c in changes or ())
    done = document.do(found.addition.edit)
    session.notify(
        Level.INFO,
        f"Added {found.name}; it is selected, and its handles move it.",
        "scene.changes" if changes else "",
    )
    return done


def _groups(change: "Change", here: dict[int, int]) -> tuple[int, ...]:
    """Groups of the open scene that show a change, that of the added scene last."""
    second = () if change.second is None else (here[change.second],)
    return second if change.first is None else (change.first, *second)


def cancel(session: Session) -> bool:
    """Cancel the preview; False when there is none."""
    if shown(session) is None:
        return False
    session.cancel_preview()
    return True


def changes(session: Session) -> ListedChanges:
    """Return the list of the scene that was added last."""
    return session.need().feature(ListedChanges)


@notifies
def select(session: Session, groups: tuple[int, ...]) -> bool:
    """Select what a line of the list is about, and frame it."""
    document = session.need()
    splats = group_indices(document.scene, groups)
    if len(splats) == 0:
        raise GagaError("These objects are not in the scene any more.")
    title = f"Select {document.titled(*groups)}"
    done = document.select(splats.astype(np.int32), "set", title)
    camera.frame_selected(session)
    return done


def _no_preview(session: Session) -> str:
    return "" if shown(session) is not None else no_scene(session) or _NO_PREVIEW


def _why_none(found: Found) -> str:
    if found.aligned is None:
        return f"{found.name} was placed by hand; only scenes that were aligned are compared."
    if found.aligned.changes is None:
        return f"Find objects here and in {found.name}, and add it again: objects are compared."
    return f"Nothing came, went or moved between this scene and {found.name}."


_no_changes = first_of(
    no_scene, lambda session: "" if changes(session).found else changes(session).why_none
)
COMMANDS: tuple[Command, ...] = (
    ask(
        "file.add_scene",
        "Add a scene…",
        Request.ADD_SCENE,
        enabled=first_of(not_saveable, preview_waits),
    ),
    Command("scene.add_apply", "Apply the added scene", apply, enabled=_no_preview),
    ask("scene.changes", "What changed…", Request.CHANGES, enabled=_no_changes),
)
