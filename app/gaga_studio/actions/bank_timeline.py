"""Replay how the memory bank grew, view by view, in the picture."""

from dataclasses import replace
from typing import TYPE_CHECKING

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.scene.edits.splats import spread
from gaga_studio.actions import navigation
from gaga_studio.actions.association_repair import evidence_of, file_columns
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import notifies
from gaga_studio.session.requests import Request
from gaga_studio.session.session import Session
from gaga_studio.session.timeline import Timeline
from gaga_studio.session.view_state import Mode

if TYPE_CHECKING:
    from gaga_core.grouping.figures import BankGrowth

_ALL_S, _LEAST_S, _MOST_S = 16.0, 0.15, 0.8  # of a replay, and of one view


def timeline_of(session: Session) -> Timeline:
    """Return the replay of the open scene; a closed one when nothing is open."""
    return session.document.timeline if session.document is not None else Timeline()


@notifies
def toggle(session: Session) -> bool:
    """Open the replay, as a job where the growth is not known yet; or close it."""
    document = session.need()
    timeline, bank = document.timeline, document.scene.bank
    if timeline.is_open:
        close(session)
        return True
    session.request = Request.TIMELINE
    if bank is None:
        raise GagaError("The memory bank is empty. Use Find objects first.")
    if timeline.growth is not None and timeline.bank is bank:
        _show(session, document)
        return True
    evidence, (labels, _) = evidence_of(session, document), file_columns(document.scene)

    def stage() -> "Stage[BankGrowth]":
        from gaga_core.grouping.figures import growth_stage  # numba

        return growth_stage(evidence.gated, bank, labels, choose())

    def done(growth: "BankGrowth") -> None:
        if session.document is document and document.scene.bank is bank:
            timeline.growth, timeline.bank = growth, bank
            _show(session, document)

    name = "Replay the memory bank"
    return session.jobs.start(name, stages.prepared(name, stage), on_done=done)


def _show(session: Session, document: Document) -> None:
    timeline = document.timeline
    timeline.former_mode, session.view.mode = session.view.mode, Mode.GROUPS
    timeline.is_open = timeline.is_playing = True
    go_to_step(session, 0)


def close(session: Session) -> None:
    """Show the scene as it is again; a view mode that was chosen during the replay stays."""
    timeline = timeline_of(session)
    if timeline.is_open:
        timeline.is_open = timeline.is_playing = False
        if session.view.mode is Mode.GROUPS:
            session.view.mode = timeline.former_mode


def toggle_playing(session: Session) -> None:
    """Play, from the start when it had ended; or stop."""
    timeline = timeline_of(session)
    if timeline.growth is None or not timeline.is_open:
        return
    timeline.is_playing = not timeline.is_playing
    if timeline.is_playing and timeline.step >= timeline.growth.last_step:
        go_to_step(session, 0)


def go_to_step(session: Session, step: int) -> None:
    """Show the bank after ``step`` views, or at the nearest step that there is."""
    timeline = timeline_of(session)
    growth = timeline.growth
    if growth is None:
        return
    timeline.step, timeline.waited_s = min(max(step, 0), growth.last_step), 0.0
    view = view_of_step(session)
    index = navigation.view_index(session, view) if view else None
    if timeline.follows and index is not None:
        navigation.go_to_view(session, index)


def set_follows(session: Session, follows: bool) -> None:
    """Let the camera follow the views, or stay where it is."""
    timeline_of(session).follows = follows
    if follows:
        go_to_step(session, timeline_of(session).step)


def view_of_step(session: Session) -> str:
    """Return the view whose masks came last; "" before the first and at the end."""
    timeline = timeline_of(session)
    growth = timeline.growth
    if growth is None or not 0 < timeline.step < growth.last_step:
        return ""
    return growth.views[timeline.step - 1]


def tick(session: Session, dt: float) -> None:
    """Advance the replay, once a frame. It ends when its bank does: edits and jobs replace it."""
    timeline = timeline_of(session)
    growth, scene = timeline.growth, session.scene
    if scene is None or growth is None or not timeline.is_open:
        return
    if scene.bank is not timeline.bank or session.live is not None:
        close(session)
        return
    if not timeline.is_playing:
        return
    timeline.waited_s += dt
    if timeline.waited_s >= min(max(_ALL_S / growth.last_step, _LEAST_S), _MOST_S):
        go_to_step(session, timeline.step + 1)
        timeline.is_playing = timeline.step < growth.last_step


def labels(session: Session) -> IntArray | None:
    """Return the group (N,) of each splat at this step; None when the scene's own are shown.

    At the last step that is so: the saved groups, with the edits since then.
    """
    document = session.document
    if document is None or not document.timeline.is_open or document.timeline.growth is None:
        return None
    growth, step, scene = document.timeline.growth, document.timeline.step, document.scene
    if step == growth.last_step:
        return None
    key = (growth, step, scene.revision.splats)
    return document.read.once("timeline", key, lambda: spread(scene, growth.labels_at(step)))


def bank_at(session: Session) -> MemoryBank | None:
    """Return the bank with the decisions made up to this step; None without a replay."""
    document = session.document
    if document is None or document.timeline.bank is None or document.timeline.growth is None:
        return None
    bank, growth = document.timeline.bank, document.timeline.growth
    step = min(document.timeline.step, len(growth.views))
    key = (bank, step)
    return document.read.once(
        "bank at", key, lambda: replace(bank, log=bank.log[: growth.n_decisions[step]])
    )
