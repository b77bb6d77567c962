"""Reduce splats: neighbours are merged, with the loss estimated before and measured after."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gaga_core.arrays import LongArray
from gaga_core.camera import Camera
from gaga_core.progress import Progress, Stage
from gaga_core.scene.edits import Edit
from gaga_core.scene.objects import group_indices
from gaga_core.scene.reduce import (
    EXACT,
    LossCurve,
    Reduction,
    estimate_stage,
    loss_text,
    reduce_stage,
    reduce_title,
    reduced_edit,
    reducible,
)
from gaga_core.scene.scene import Scene
from gaga_studio.actions import unchanged
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session

What = Literal["selection", "objects", "scene"]
TITLE, ESTIMATE = "Reduce splats", "Estimate the loss"
_CHANGED = "The scene changed while splats were merged, so nothing is done. Try it again."


@dataclass
class ReducePlan:
    """What is chosen in the sheet, and what is known of it."""

    what: What = "scene"
    percent: int = 50  # of the splats that are kept
    curve: LossCurve | None = None  # of ``asked``, once it is there
    asked: object = None  # what an estimate was started for
    starts: bool = False  # as soon as the estimate that runs has stopped


def splats(session: Session, what: What) -> LongArray:
    """Return the splats (K,) that may be merged: visible ones that are not locked."""
    document = session.need()
    scene, groups = document.scene, session.selected_groups()
    key = (scene.revision.total(), what, groups)

    def compute() -> LongArray:
        if what == "scene":
            return reducible(scene, np.arange(len(scene)))
        chosen = session.selected_indices() if what == "selection" else group_indices(scene, groups)
        return reducible(scene, chosen)

    return document.read.once(f"reduce {what}", key, compute)


def why_not(session: Session, what: What) -> str:
    """Needs two splats that may be merged."""
    if session.document is None:
        return "No scene is open."
    if what != "scene" and len(session.selected_indices()) == 0:
        return "Nothing is selected."
    few = len(splats(session, what)) < 2
    return "Hidden and locked splats stay as they are, and there are no others." if few else ""


def open_plan(session: Session, plan: ReducePlan) -> None:
    """Propose the selection where there is one; an estimate of before is made again."""
    plan.what = "selection" if not why_not(session, "selection") else "scene"
    plan.asked, plan.curve, plan.starts = None, None, False


def close_plan(session: Session, plan: ReducePlan) -> None:
    """Stop the estimate that nobody waits for any more: other jobs would wait for its end."""
    if plan.asked is None or plan.starts:
        return
    plan.asked = None
    if is_estimating(session):
        session.jobs.cancel()


def is_estimating(session: Session) -> bool:
    """Return whether an estimate of the loss runs now."""
    job = session.jobs.running
    return job is not None and job.title == ESTIMATE


def estimate(session: Session, plan: ReducePlan) -> None:
    """Find out about how much would be lost, unless that is known, or another job runs."""
    document = session.need()
    key = (document.scene.revision.total(), plan.what, session.selected_groups())
    if plan.asked == key:
        return
    plan.asked = plan.curve = None
    if session.jobs.running is not None or why_not(session, plan.what):
        return
    scene, views, chosen = _snapshot(session, plan)

    def stage() -> Stage[LossCurve]:
        yield Progress(ESTIMATE, 0, 0)
        from gaga_core.raster import choose  # numba's import takes long: it belongs to the job

        return (yield from estimate_stage(scene, chosen, views, choose()))

    def done(curve: LossCurve) -> None:
        if plan.asked == key:
            plan.curve = curve

    def end() -> None:
        if plan.starts and session.document is document:
            plan.starts = False
            start(session, plan)

    if session.jobs.start(ESTIMATE, stage(), on_done=done, on_end=end):
        plan.asked = key


def what_is_known(session: Session, plan: ReducePlan) -> str:
    """Return a sentence on what would be lost, or on why that is not known."""
    if plan.curve is not None:
        level = loss_text(plan.curve.at(plan.percent / 100))
        is_lossless = level == loss_text(EXACT)
        said = "Nearly nothing is lost" if is_lossless else f"About {level} against pictures of now"
        return f"{said}; measured when it is done."
    if reason := why_not(session, plan.what):
        return reason
    if is_estimating(session):
        return "Estimating the loss…"
    if session.jobs.running is not None:
        return "The loss is estimated after the job that runs."
    return "The loss is measured when it is done."


def why_not_now(session: Session, plan: ReducePlan) -> str:
    """Needs splats that may be merged, and the job runner; an estimate makes way."""
    job = session.jobs.running
    if job is not None and job.title != ESTIMATE:
        return f"{job.title} is still running."
    return why_not(session, plan.what)


def start(session: Session, plan: ReducePlan) -> None:
    """Merge, as a job whose result is one entry of the history."""
    if why_not_now(session, plan):
        return
    if session.jobs.running is not None:
        plan.starts = True  # when the estimate has stopped
        session.jobs.cancel()
        return
    document = session.need()
    scene, views, chosen = _snapshot(session, plan)
    share, before = plan.percent / 100, document.history.state_id

    def stage() -> Stage[tuple[Reduction, Edit | None]]:
        yield Progress(TITLE, 0, 0)
        from gaga_core.raster import choose

        found = yield from reduce_stage(scene, chosen, share, views, choose())
        return found, reduced_edit(scene, found, reduce_title(scene, chosen, found))

    def is_same() -> bool:
        return document.history.state_id == before and not document.history.is_previewing

    check = unchanged.watch(session, document, is_same, _CHANGED)

    def done(result: tuple[Reduction, Edit | None]) -> None:
        found, edit = result
        if not check():
            return
        if not document.do(edit):
            session.notify(Level.HINT, "No neighbours could be merged: nothing is changed.")
            return
        less = f"{found.n_before:,} splats became {found.n_after:,}"
        session.notify(Level.INFO, f"{less}: {loss_text(found.psnr)}.")

    session.jobs.start(TITLE, stage(), on_done=done)


def _snapshot(session: Session, plan: ReducePlan) -> tuple[Scene, Sequence[Camera], LongArray]:
    project = session.need().settled()
    return replace(project.scene), project.training_views, splats(session, plan.what)
