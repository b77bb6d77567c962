"""Clean objects, with a preview or before isolate, delete and export; reduce splats."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from gaga_core.arrays import IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.progress import Progress, Stage
from gaga_core.scene import cleanup
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
from gaga_core.scene.reduce import TITLE as REDUCE
from gaga_core.scene.scene import Scene
from gaga_studio.features import folders, objects
from gaga_studio.features.base import (
    Command,
    Preview,
    ask,
    busy,
    first_of,
    no_scene,
    no_selection,
    not_one_object,
    setting,
    watch,
)
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.scene.cleanup import CleanPreview

TITLE = "Clean up"
_CLEANUP_CHANGED = "The scene changed while the object was cleaned. Try again."
Build = Callable[[Scene, Sequence[int], IntArray, str], Edit | None]


# --- the preview


class Cleaning(Preview["CleanPreview"]):
    """Splats that would join and leave an object, and the edit that shows them."""


def shown(session: Session) -> "CleanPreview | None":
    """Return the preview that is shown now."""
    return session.document.feature(Cleaning).shown(session) if session.document else None


@notifies
def start(session: Session) -> None:
    """Compute what cleaning the selected object would change, and show it."""
    groups = session.selected_groups()
    if session.document is None or len(groups) != 1:
        return
    document, group = session.document, groups[0]
    stage = cleanup.clean_object_stage(document.settled().scene, group)
    is_same = watch(session, document, _CLEANUP_CHANGED)

    def done(found: "CleanPreview") -> None:
        if not found:
            session.notify(Level.HINT, found.sentence())
        elif is_same():
            tint = cleanup.cleaning_tint(document.settled().scene, found)
            if tint is not None:
                document.show(tint, waits_as=TITLE, is_tint=True)
                document.feature(Cleaning).take(found, tint)

    session.jobs.start(f"Clean {document.name_of(group)}", stage, on_done=done)


@notifies
def apply(session: Session) -> bool:
    """Clean as the preview shows: one entry of the history."""
    document = session.need()
    found = shown(session)
    if found is None:
        return False
    title = f"Clean {document.titled(found.group)}"
    session.cancel_preview()  # which has colors of its own
    return document.do(cleanup.cleaned_edit(document.scene, found, title))


def cancel(session: Session) -> bool:
    """Cancel the preview; False when there is none."""
    if shown(session) is None:
        return False
    session.cancel_preview()
    return True


# --- cleaning first


def isolate_selected(session: Session) -> None:
    """Hide everything but the selection; whole objects are cleaned first if that is wanted."""
    also = folders.locked_along(session)

    def build(scene: Scene, groups: Sequence[int], labels: IntArray, title: str) -> Edit | None:
        return cleanup.isolate_cleaned(scene, groups, labels, title, also)

    _clean_then(session, "Isolate", build, objects.isolate, with_locked=True)


def delete_selected(session: Session) -> None:
    """Delete the selection; whole objects are cleaned first if that is wanted."""
    _clean_then(session, "Delete", cleanup.delete_cleaned, objects.delete)


def _clean_then(
    session: Session,
    verb: str,
    build: Build,
    plain: Callable[[Session], bool],
    *,
    with_locked: bool = False,
) -> None:
    """Clean, then ``build``; ``plain`` instead where nothing is to be cleaned.

    ``with_locked`` objects that go along are named, too: `children.along`.
    """
    groups = to_clean(session)
    if not groups:
        plain(session)
        return
    document = session.need()
    under = folders.along(session, with_locked=with_locked).groups
    title = folders.title_along(document, verb, under)
    stage = cleanup.clean_objects_stage(document.settled().scene, groups)
    is_same = watch(session, document, _CLEANUP_CHANGED)

    def done(labels: IntArray) -> None:
        if is_same():
            document.do(build(document.scene, groups, labels, title))

    session.jobs.start(f"{title}, cleaned", stage, on_done=done)


def to_clean(session: Session) -> tuple[int, ...]:
    """Objects to clean before something is done to the selection; parts of objects never are."""
    if session.scene is None or not session.settings.clean_first:
        return ()
    return cleanup.whole_objects(folders.scene_along(session, with_locked=False))


# --- reduce splats

ReduceWhat = Literal["selection", "objects", "scene"]
ESTIMATE = "Estimate the loss"
_REDUCE_CHANGED = "The scene changed while splats were merged. Try again."


@dataclass
class ReducePlan:
    """The choices of the sheet, and the estimate of their loss."""

    what: ReduceWhat = "scene"
    percent: int = 50  # of the splats that are kept
    curve: LossCurve | None = None  # of ``asked``, once it is there
    asked: object = None  # what an estimate was started for
    starts: bool = False  # as soon as the estimate that runs has stopped


def reducible_splats(session: Session, what: ReduceWhat) -> LongArray:
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


def why_not_reducible(session: Session, what: ReduceWhat) -> str:
    """Needs two splats that may be merged."""
    if reason := no_scene(session):
        return reason
    if what != "scene" and len(session.selected_indices()) == 0:
        return "Nothing is selected."
    few = len(reducible_splats(session, what)) < 2
    return "Hidden and locked splats stay as they are, and there are no others." if few else ""


def open_reduce_plan(session: Session, plan: ReducePlan) -> None:
    """Propose the selection where there is one; an estimate of before is made again."""
    plan.what = "selection" if not why_not_reducible(session, "selection") else "scene"
    plan.asked, plan.curve, plan.starts = None, None, False


def close_reduce_plan(session: Session, plan: ReducePlan) -> None:
    """Stop the estimate that is no longer needed: other jobs would wait for its end."""
    if plan.asked is None or plan.starts:
        return
    plan.asked = None
    if is_estimating(session):
        session.jobs.drop()


def is_estimating(session: Session) -> bool:
    """Return whether an estimate of the loss runs now."""
    job = session.jobs.running
    return job is not None and job.title == ESTIMATE


def estimate_loss(session: Session, plan: ReducePlan) -> None:
    """Find out about how much would be lost, unless that is known, or another job runs."""
    document = session.need()
    key = (document.scene.revision.total(), plan.what, session.selected_groups())
    if plan.asked == key:
        return
    plan.asked = plan.curve = None
    if session.jobs.running is not None or why_not_reducible(session, plan.what):
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
            start_reducing(session, plan)

    if session.jobs.start(ESTIMATE, stage(), on_done=done, on_end=end):
        plan.asked = key


def what_is_known_of_loss(session: Session, plan: ReducePlan) -> str:
    """Return a sentence on what would be lost, or on why that is not known."""
    if plan.curve is not None:
        level = loss_text(plan.curve.at(plan.percent / 100))
        is_lossless = level == loss_text(EXACT)
        said = (
            "Nearly nothing is lost"
            if is_lossless
            else f"About {level} against the current pictures"
        )
        return f"{said}; measured when it is done."
    if reason := why_not_reducible(session, plan.what):
        return reason
    if is_estimating(session):
        return "Estimating the loss…"
    if session.jobs.running is not None:
        return "The loss is estimated after the job that runs."
    return "The loss is measured when it is done."


def why_not_reducing(session: Session, plan: ReducePlan) -> str:
    """Needs splats that may be merged, and the job runner; an estimate makes way."""
    return ("" if is_estimating(session) else busy(session)) or why_not_reducible(
        session, plan.what
    )


def start_reducing(session: Session, plan: ReducePlan) -> None:
    """Merge, as a job whose result is one entry of the history."""
    if why_not_reducing(session, plan):
        return
    if session.jobs.running is not None:
        plan.starts = True  # when the estimate has stopped
        session.jobs.drop()
        return
    document = session.need()
    scene, views, chosen = _snapshot(session, plan)
    share = plan.percent / 100

    def stage() -> Stage[tuple[Reduction, Edit | None]]:
        yield Progress(REDUCE, 0, 0)
        from gaga_core.raster import choose

        found = yield from reduce_stage(scene, chosen, share, views, choose())
        return found, reduced_edit(scene, found, reduce_title(scene, chosen, found))

    check = watch(session, document, _REDUCE_CHANGED)

    def done(result: tuple[Reduction, Edit | None]) -> None:
        found, edit = result
        if not check():
            return
        if not document.do(edit):
            session.notify(Level.HINT, "No neighbours could be merged: nothing is changed.")
            return
        less = f"{found.n_before:,} splats became {found.n_after:,}"
        session.notify(Level.INFO, f"{less}: {loss_text(found.psnr)}.")

    session.jobs.start(REDUCE, stage(), on_done=done)


def _snapshot(session: Session, plan: ReducePlan) -> tuple[Scene, Sequence[Camera], LongArray]:
    project = session.need().settled()
    return replace(project.scene), project.training_views, reducible_splats(session, plan.what)


def _no_cleaning(session: Session) -> str:
    if shown(session) is not None:
        return ""
    return no_scene(session) or "There is no clean-up preview. Use Clean up first."


def _not_ready(session: Session) -> str:
    """Needs a selection, and the job runner when it is to be cleaned first."""
    return no_selection(session) or (busy(session) if session.settings.clean_first else "")


COMMANDS: tuple[Command, ...] = (
    Command("edit.delete", "Delete", delete_selected, "Delete", ("Backspace",), enabled=_not_ready),
    ask("edit.reduce", "Reduce splats…", Request.REDUCE, enabled=no_scene),
    Command("object.isolate", "Isolate", isolate_selected, "/", enabled=_not_ready),
    Command("object.clean", TITLE, start, enabled=first_of(not_one_object, busy)),
    Command("object.clean_apply", "Apply the cleaning", apply, enabled=_no_cleaning),
    setting("object.clean_first", "Always clean first", "clean_first"),
)
