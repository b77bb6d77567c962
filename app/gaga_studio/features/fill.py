"""Delete and fill: a removed object's hole is filled, in a preview to apply or cancel."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.errors import GagaError, counted
from gaga_core.fill import inpaint
from gaga_core.progress import Progress, Stage
from gaga_core.scene.edits import Edit
from gaga_core.scene.scene import Scene, State
from gaga_studio.features import folders
from gaga_studio.features.base import (
    Command,
    Preview,
    ask,
    busy,
    need_no_job,
    needs,
    no_scene,
    watch,
)
from gaga_studio.session import stages
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.fill.fill import Filling

_CHANGED = "The scene changed while the hole was analysed. Try again."
_NO_PREVIEW = "There is no fill preview. Use Delete and fill first."
_COVERED = "the place is covered already, or nothing around it continues well there."
_PUT = "it was put there, so the photos show what is behind it."
_REFUSED = "the fill would be barely visible or would alter nearby surfaces."


class Fill(Preview["Filling"]):
    """A filled hole, and the edit that makes it."""


def shown(session: Session) -> "Filling | None":
    """Return the filling whose preview is shown now."""
    return session.document.feature(Fill).shown(session) if session.document else None


_nothing_to_fill = needs(
    lambda session: (
        len(session.selected_indices()) or session.need().scene.has(State.DELETED).any()
    ),
    "Nothing is selected, and nothing was deleted. Select an object first.",
)


def why_not(session: Session) -> str:
    """Needs a selection or deleted splats, and the job runner."""
    return _nothing_to_fill(session) or busy(session)


def title(session: Session) -> str:
    """Return what the command is called: nothing selected means to fill what was deleted."""
    chosen = session.document is None or len(session.selected_indices()) > 0
    return "Delete and fill" if chosen else "Fill what was deleted"


def _why(found: "Filling") -> str:
    """Return why no splats are added."""
    return _PUT if found.was_put else _REFUSED if found.is_refused else _COVERED


def summary(found: "Filling") -> tuple[str, ...]:
    """Return sentences on what the preview changes, and on what it leaves as it is."""
    lines = [f"{counted(len(found.removed), 'splat')} removed, {len(found.splats):,} new"]
    if len(found.splats) == 0:
        lines.append(f"No new splats: {_why(found)} What is open now stays open.")
    if len(found.unseen):
        lines.append(f"{counted(len(found.unseen), 'splat')} out of sight removed as well")
    if len(found.stained):
        lines.append(f"{counted(len(found.stained), 'splat')} in its shadow lightened")
    elif found.lighten:
        lines.append("No shadow was found")
    return tuple(lines)


@notifies
def start(session: Session, *, lighten: bool = True) -> None:
    """Compute what fills the place of the selection, and show it with the selection removed.

    What lies under objects that are selected whole is removed with them. Nothing selected means
    what was deleted.
    """
    if why_not(session):
        return
    document = session.need()
    project = document.settled()
    taken = folders.along(session) if len(session.selected_indices()) else None
    named = folders.title_along(document, "Delete and fill", taken.groups) if taken else ""
    # A selection that changes meanwhile changes nothing here.
    scene = replace(project.scene, state=project.scene.state.copy())
    views, at = project.training_views, document.history.state_id
    name, rates = title(session), session.rates
    model = session.settings.inpainting_model

    def stage() -> "Stage[tuple[Filling, Edit | None, str]]":
        yield Progress(name, 0, 0, "Preparing")
        # SciPy's and numba's import takes long: it belongs to the job.
        from gaga_core.fill.fill import (
            fill_stage,
            fill_title,
            fillable,
            filled_edit,
            usual_seconds,
        )
        from gaga_core.fill.surfaces import FillConfig
        from gaga_core.raster import choose

        splats = fillable(scene) if taken is None else taken.splats
        config = FillConfig(lighten=lighten, model=model)
        found = yield from stages.prepared(
            rates,
            name,
            lambda: fill_stage(scene, splats, views, choose(), config),
            parts=("window",),
            usual_s=usual_seconds(scene, len(views), config),
            name="Delete and fill, by a model" if model else "Delete and fill",
        )
        is_alone = taken is None or not taken.groups
        done_title = fill_title(scene, splats) if is_alone else named
        return found, filled_edit(scene, found, done_title), done_title

    def done(result: "tuple[Filling, Edit | None, str]") -> None:
        found, edit, done_title = result
        if not watch(session, document, _CHANGED, lambda: _fits(found, scene, document.scene))():
            return
        if document.history.state_id != at:
            from gaga_core.fill.fill import filled_edit

            edit = filled_edit(document.settled().scene, found, done_title)
        if edit is None or not found:
            text = f"There is nothing to fill: {_why(found)}"
            session.notify(Level.HINT, text, "edit.delete" if taken is not None else "")
            return
        document.show(edit, waits_as="Delete and fill")
        document.feature(Fill).take(found, edit)

    session.jobs.start(name, stage(), on_done=done)


def _fits(found: "Filling", before: Scene, now: Scene) -> bool:
    """Whether what was found in ``before`` still fits: what was analysed stands as it did.

    Other objects may be hidden or named meanwhile, and copies be made: rows never move.
    """
    n, n_placed = len(before), len(before.placements.opacity)
    if len(now) < n:
        return False
    turned = before.state ^ now.state[:n]
    is_there = not (turned & State.DELETED).any()
    is_shown = not (turned[found.removed] & State.HIDDEN).any()
    columns = [(before.labels, now.labels[:n]), (before.placement, now.placement[:n])]
    columns += [
        (getattr(before.placements, name), getattr(now.placements, name)[:n_placed])
        for name in ("matrix", "color", "opacity")
    ]
    return is_there and is_shown and all(np.array_equal(*pair) for pair in columns)


@notifies
def switch_lighten(session: Session) -> None:
    """Compute the preview again, with the shadow taken off or left as it is."""
    found = shown(session)
    if found is None:
        raise GagaError(_NO_PREVIEW)
    need_no_job(session)  # or the preview would be lost
    cancel(session)
    start(session, lighten=not found.lighten)


def why_no_model(session: Session) -> str:
    """Needs PyTorch, and the job runner."""
    return inpaint.why_no_model() or busy(session)


@notifies
def choose_model(session: Session, path: Path) -> None:
    """Let the inpainting model in the file ``path`` color holes from now on, after a trial.

    A preview that is shown is computed again. A file that fails changes nothing.
    """
    need_no_job(session)

    def done(_: None) -> None:
        _use_model(session, str(path.resolve()))

    session.jobs.start("Try the inpainting model", inpaint.trial_stage(path), on_done=done)


@notifies
def continue_colors(session: Session) -> None:
    """Let the colors of holes continue the surroundings from now on, without a model."""
    need_no_job(session)
    if session.settings.inpainting_model:
        _use_model(session, "")


def _use_model(session: Session, model: str) -> None:
    """Keep the choice of a model ("": none), and compute the preview that is shown again."""
    session.change_settings(replace(session.settings, inpainting_model=model))
    found = shown(session)
    if found is not None:
        cancel(session)
        start(session, lighten=found.lighten)


@notifies
def apply(session: Session) -> bool:
    """Keep what the preview shows: one entry of the history."""
    return shown(session) is not None and session.need().commit_preview()


def cancel(session: Session) -> bool:
    """Cancel the preview; False when there is none."""
    if shown(session) is None:
        return False
    session.cancel_preview()
    return True


def _no_filling(session: Session) -> str:
    return "" if shown(session) is not None else no_scene(session) or _NO_PREVIEW


COMMANDS: tuple[Command, ...] = (
    Command("object.fill", "Delete and fill", start, enabled=why_not, describe=title),
    Command("object.fill_apply", "Apply the fill", apply, enabled=_no_filling),
    Command(
        "object.fill_lighten",
        "Take off its shadow",
        switch_lighten,
        enabled=_no_filling,
        is_on=lambda s: (found := shown(s)) is not None and found.lighten,
    ),
    Command(
        "object.fill_continue",
        "Color holes from their surroundings",
        continue_colors,
        is_on=lambda s: not s.settings.inpainting_model,
    ),
    Command(
        "object.fill_model",
        "Color holes by an inpainting model…",
        ask("", "", Request.INPAINTING_MODEL).run,
        enabled=why_no_model,
        is_on=lambda s: bool(s.settings.inpainting_model),
    ),
)
