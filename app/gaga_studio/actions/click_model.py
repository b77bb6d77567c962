"""Ask a Segment Anything model what the clicks of the tool Object mean, in the background.

The answer that needs no model is shown at once; the model's takes its place when it is ready, as
an entry of its own in the history, so that undo brings the former one back.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.segmentation.choose import ProviderEntry, promptable_models
from gaga_studio.session.click_state import key_of
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.scene.selection.click import Answer
    from gaga_core.segmentation.sam import Prompter

NO_MODEL = "none"  # as a setting: clicks ask no model even if one is here
_MISSED = "You went on meanwhile, so the model's answer was left out. The next click asks again."


def models_here(session: Session) -> tuple[ProviderEntry, ...]:
    """The models on this machine that can be asked for one thing."""
    state = session.models
    if state.promptable is None:
        state.promptable = promptable_models()
    return state.promptable


def chosen(session: Session) -> ProviderEntry | None:
    """The model that clicks ask; None when the user wants none, or none is here."""
    name, here = session.settings.click_model, models_here(session)
    if name == NO_MODEL or not here:
        return None
    return next((model for model in here if model.name == name), here[0])


def why_none(session: Session) -> str:
    """Return why no model can be asked; "" when one can."""
    if models_here(session):
        return ""
    return "No Segment Anything model is here. Find, Models… gets one."


def choose_model(session: Session, name: str) -> None:
    """Let clicks ask the model called ``name`` from now on; `NO_MODEL`: none."""
    session.change_settings(replace(session.settings, click_model=name))
    if name == NO_MODEL:
        stop(session)
    else:
        ask(session)


def switch(session: Session) -> None:
    """Let clicks ask a model, or none any more."""
    choose_model(session, NO_MODEL if chosen(session) is not None else "")


def ask(session: Session) -> None:
    """Ask the model, if one is chosen, what the clicks up to now mean.

    A question that is under way is given up for it. What began with a box is not asked.
    """
    document, model = session.document, chosen(session)
    if document is None or model is None:
        return
    clicks = document.clicks
    if clicks.is_asking:
        clicks.asks_again = True
        session.jobs.cancel()
        return
    at = document.history.state_id
    answer, camera = clicks.answers.get(at), clicks.views.get(at)
    if answer is None or camera is None:
        return
    if session.jobs.at_risk is not None:
        session.hint = f"{model.title} is not asked while {session.jobs.at_risk.title} runs."
        return
    stage = _answer_stage(session, document, model, answer, camera)

    def done(splats: IntArray) -> None:
        if session.document is document:
            _take(session, document, at, model, splats)

    def end() -> None:
        clicks.is_asking, again = False, clicks.asks_again
        clicks.asks_again = False
        if again and session.document is document:
            ask(session)

    clicks.is_asking = session.jobs.start(f"Ask {model.title}", stage, on_done=done, on_end=end)


def stop(session: Session) -> None:
    """Give up the question that is under way."""
    if session.document is not None and session.document.clicks.is_asking:
        session.document.clicks.asks_again = False
        session.jobs.cancel()


def _answer_stage(
    session: Session, document: Document, model: ProviderEntry, answer: "Answer", camera: Camera
) -> Stage[IntArray]:
    scene, cameras = replace(document.settled().scene), session.cameras
    loaded = session.models.prompters

    def stage() -> Stage[IntArray]:
        from gaga_core.pipeline.click import model_answer_stage

        yield Progress("Ask the model", 0, 0, f"load {model.title}")
        prompter = loaded.get(model.name) or _load(model)
        # One model stays in memory. One job at a time asks, so nothing else writes here.
        loaded.clear()
        loaded[model.name] = prompter
        asked = model_answer_stage(scene, cameras, camera, answer.clicks, prompter, choose())
        return (yield from asked)

    return stage()


def _load(model: ProviderEntry) -> "Prompter":
    from gaga_core.segmentation.choose import prompter_named

    return prompter_named(model.name, weights=model.path)


def _take(
    session: Session, document: Document, at: int, model: ProviderEntry, splats: IntArray
) -> None:
    """Show the model's answer to the clicks that led to state ``at`` of the history."""
    from gaga_core.scene.selection.click import adopted

    clicks, history = document.clicks, document.history
    is_now = history.state_id == at and clicks.made_for == key_of(document.scene)
    if not is_now or history.can_redo or history.is_previewing or clicks.graph is None:
        session.hint = _MISSED
        return
    answer, camera = clicks.answers[at], clicks.views[at]
    if not document.select(splats, "set", f"Ask {model.title}"):
        return
    clicks.answers[history.state_id] = adopted(clicks.graph, answer.clicks, splats)
    clicks.views[history.state_id] = camera
