"""Ask a Segment Anything model what the clicks of the tool Object mean, in the background.

The answer that needs no model is shown at once; the model's takes its place when it is ready, as
an entry of its own in the history, so that undo brings the former one back.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection import algebra
from gaga_core.segmentation.choose import ProviderEntry, promptable_models
from gaga_studio.features import selection
from gaga_studio.features.base import Command, no_scene, no_selection
from gaga_studio.features.find.association import FindState
from gaga_studio.features.find.masks import ModelsState
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import Point, ToolName, ViewportPoint

if TYPE_CHECKING:
    from gaga_core.camera import Camera
    from gaga_core.scene.selection.click import Answer, Click, ClickGraph
    from gaga_core.segmentation.sam import Prompter


class ClickState:
    """The answers are kept by `History.state_id`: undo of a click brings the one before back."""

    def __init__(self) -> None:
        self.graph: ClickGraph | None = None
        self.made_for: object = None  # `key_of` the scene that the graph was made of
        self.is_preparing = False
        self.answers: dict[int, Answer] = {}  # by state of the history
        self.views: dict[int, Camera] = {}  # of the last click on the object, by state
        # Clicked before the graph was ready, from where, and the selection at that time.
        self.waiting: list[tuple[Click, Camera, IntArray]] = []
        self.is_asking = False  # a model, in the background
        self.asks_again = False  # as soon as the model has stopped: there are more clicks

    def is_ready(self, scene: Scene) -> bool:
        """Whether the graph is that of the scene as it is now."""
        return self.graph is not None and self.made_for == key_of(scene)

    def take(self, graph: "ClickGraph", key: object) -> None:
        """Use a new graph; answers of the former one are void."""
        self.graph, self.made_for = graph, key
        self.answers, self.views = {}, {}


def key_of(scene: Scene) -> object:
    """Values that change when splats are added or moved, so that a graph is outdated."""
    revision = scene.revision
    return revision.splats, revision.placement, revision.placements


# --- a model is asked in the background


NO_MODEL = "none"  # as a setting: clicks ask no model even if one is here
_MISSED = "You clicked again, so the model's answer was ignored. The next click asks again."


def models_here(session: Session) -> tuple[ProviderEntry, ...]:
    """The models on this machine that can segment one object."""
    state = session.feature(ModelsState)
    if state.promptable is None:
        state.promptable = promptable_models()
    return state.promptable


def chosen_model(session: Session) -> ProviderEntry | None:
    """The model that clicks ask; None when the user wants none, or none is here."""
    name, here = session.settings.click_model, models_here(session)
    if name == NO_MODEL or not here:
        return None
    return next((model for model in here if model.name == name), here[0])


def why_no_model(session: Session) -> str:
    """Return why no model can be asked; "" when one can."""
    if models_here(session):
        return ""
    return "No Segment Anything model is installed. Get one by Models in the menu Find."


def choose_model(session: Session, name: str) -> None:
    """Let clicks ask the model called ``name`` from now on; `NO_MODEL`: none."""
    session.change_settings(replace(session.settings, click_model=name))
    if name == NO_MODEL:
        stop_asking(session)
    else:
        ask_model(session)


def switch_model(session: Session) -> None:
    """Let clicks ask a model, or none any more."""
    choose_model(session, NO_MODEL if chosen_model(session) is not None else "")


def ask_model(session: Session) -> None:
    """Ask the model, if one is chosen, what the clicks up to now mean.

    A question that is under way is given up for it. What began with a box is not asked.
    """
    document, model = session.document, chosen_model(session)
    if document is None or model is None:
        return
    clicks = document.feature(ClickState)
    if clicks.is_asking:
        clicks.asks_again = True
        session.jobs.drop()
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
            ask_model(session)

    clicks.is_asking = session.jobs.start(
        f"Ask {model.title}", stage, on_done=done, on_end=end, gives_way=True
    )


def stop_asking(session: Session) -> None:
    """Give up the question that is under way."""
    if session.document is not None and session.document.feature(ClickState).is_asking:
        session.document.feature(ClickState).asks_again = False
        session.jobs.drop()


def _answer_stage(
    session: Session, document: Document, model: ProviderEntry, answer: "Answer", camera: Camera
) -> Stage[IntArray]:
    scene, cameras = replace(document.settled().scene), session.cameras
    loaded = session.feature(ModelsState).prompters

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

    clicks, history = document.feature(ClickState), document.history
    is_now = history.state_id == at and clicks.made_for == key_of(document.scene)
    undone = history.entries()[history.cursor :]
    is_last = not undone or not undone[0].is_selection  # else the answer would replace a click
    if not (is_now and is_last) or history.is_previewing or clicks.graph is None:
        session.hint = _MISSED
        return
    answer, camera = clicks.answers[at], clicks.views[at]
    if not document.select(splats, "set", f"Ask {model.title}"):
        return
    clicks.answers[history.state_id] = adopted(clicks.graph, answer.clicks, splats)
    clicks.views[history.state_id] = camera


# --- clicks

TITLE = "Prepare clicks"
_LEAST = 0.25  # opacity of a pixel at which it counts as a surface
_NOTHING_HERE = "There is no surface here. Click on something."
_LONGEST = 480  # longest side, pixels, of the depth picture of a box


def begin(session: Session) -> None:
    """Take the tool, and look at the scene in the background if that is still to be done."""
    session.tool = ToolName.OBJECT
    session.feature(FindState).took_the_tool = False
    prepare(session)


def first_click(session: Session, place: ViewportPoint) -> bool:
    """Take the tool with a click on something in a scene without objects; False elsewhere."""
    document, is_on = session.document, place.how != "remove"
    if document is None or session.live is not None or document.read.has_groups() or not is_on:
        return False
    found = session.pick(place.u, place.v, place.width, place.height)
    if found is None or found.weights.sum() < _LEAST:
        return False
    begin(session)
    session.feature(FindState).took_the_tool = True
    click(session, place.u, place.v, place.width, place.height, is_on=True)
    return True


def prompt(session: Session) -> str:
    """Return what a click does now, in words."""
    document = session.need()
    if n := len(document.feature(ClickState).waiting):
        waits = "1 click waits" if n == 1 else f"{n} clicks wait"
        return f"{waits}: the scene is being analysed. Middle drag orbits, Esc clears."
    if document.feature(ClickState).is_preparing:
        return "Analysing the scene; clicks are answered when it is done. Middle drag orbits."
    if document.feature(ClickState).is_asking:
        return "The model segments it from several views. Keep clicking, or press Esc to clear."
    if not is_clicking(session):
        return "Click an object, or drag a box around it. Middle drag orbits."
    return "Click adds, Ctrl click takes away. Enter makes it an object, Esc clears."


def waiting(session: Session) -> list["Click"]:
    """The clicks that are answered when the scene is analysed."""
    state = session.need().feature(ClickState)
    return [clicked for clicked, *_ in state.waiting]


def has_clicks(session: Session) -> bool:
    """Whether the selection is the answer to clicks."""
    document = session.document
    return (
        document is not None and document.history.state_id in document.feature(ClickState).answers
    )


def is_clicking(session: Session) -> bool:
    """Whether the tool is in use and has something to confirm or to clear.

    An edit after the clicks (Turn upright) leaves their selection, which is still the tool's.
    """
    if session.tool is not ToolName.OBJECT or session.document is None:
        return False
    waits = bool(waiting(session))
    return waits or has_clicks(session) or len(session.selected_indices()) > 0


@notifies
def prepare(session: Session) -> bool:
    """Start to look at the scene; False when that is done already, or when another job runs."""
    return _prepare(session)


def _prepare(session: Session, *, waits: bool = False) -> bool:
    document = session.need()
    state, scene = document.feature(ClickState), replace(document.settled().scene)
    if state.is_preparing or state.is_ready(scene):
        return False
    key, cameras, up_to_date = key_of(scene), session.cameras, document
    is_outdated = False

    def stage() -> "Stage[ClickGraph]":
        # Imported when first needed: numba and scipy take a large part of the launch time.
        from gaga_core.scene.selection.click import click_graph_stage, click_views

        views = click_views(cameras, algebra.world_means(scene, algebra.everything(scene)))
        return click_graph_stage(scene, views, choose())

    def dropped(n: int, why: str) -> None:
        if n:
            waited = "The click that waited is" if n == 1 else f"The {n} clicks that waited are"
            session.notify(Level.HINT, f"{waited} dropped. {why}")

    def done(graph: "ClickGraph") -> None:
        nonlocal is_outdated
        if session.document is not up_to_date:
            return
        state.take(graph, key)
        is_outdated = not state.is_ready(document.settled().scene)
        if is_outdated:
            return
        now, waiting, state.waiting = session.selected_indices(), state.waiting, []
        still = [(click, camera) for click, camera, then in waiting if np.array_equal(then, now)]
        if session.feature(FindState).took_the_tool and document.read.has_groups():
            _select_objects(session, [click.point for click, _ in still])
        elif still:
            for click, camera in still:
                _answer(document, click, camera)
            ask_model(session)
        dropped(len(waiting) - len(still), "Other things were selected meanwhile.")

    def end() -> None:
        state.is_preparing = False
        if session.document is not up_to_date or not state.waiting:
            state.waiting = []
        elif is_outdated or session.jobs.at_risk is not None:  # another job took the place
            _prepare(session, waits=True)
        else:
            waiting, state.waiting = state.waiting, []
            dropped(len(waiting), "Click again.")

    started = session.jobs.start(
        TITLE, stage(), on_done=done, on_end=end, gives_way=True, waits=waits
    )
    state.is_preparing = started
    return started


@notifies
def click(session: Session, u: float, v: float, width: int, height: int, *, is_on: bool) -> bool:
    """Click the surface at a pixel: what is there is part of the object, or not."""
    from gaga_core.scene.selection.click import Click

    document = session.need()
    found = session.pick(u, v, width, height)
    if found is None or found.weights.sum() < _LEAST:
        session.hint = _NOTHING_HERE
        return False
    scene = document.scene
    if is_on and scene.has(State.LOCKED)[found.splat]:
        session.hint = selection.locked_hint(document.name_of(int(scene.labels[found.splat])))
        return False
    if not is_on and not has_clicks(session) and not document.feature(ClickState).waiting:
        session.hint = "Click the object first, then what does not belong to it."
        return False
    session.hint = ""
    x, y, z = (float(value) for value in found.point)
    clicked, camera = Click((x, y, z), is_on), session.rig.camera(width, height)
    if document.feature(ClickState).is_ready(document.settled().scene):
        done = _answer(document, clicked, camera)
        ask_model(session)
        return done
    if prepare(session) or document.feature(ClickState).is_preparing:
        document.feature(ClickState).waiting.append((clicked, camera, session.selected_indices()))
    return False


@notifies
def box(
    session: Session, corners: tuple[float, float, float, float], width: int, height: int
) -> bool:
    """Begin an object with the splats in a box (u0, v0, u1, v1), pixels of the picture."""
    from gaga_core.scene.selection.click import boxed

    document = session.need()
    scene, state = document.settled().scene, document.feature(ClickState)
    if state.graph is None or not state.is_ready(scene):
        prepare(session)
        session.hint = "The scene is still being analysed. Draw the box again when it is done."
        return False
    camera = session.rig.camera(width, height)
    shrink = min(1.0, _LONGEST / max(width, height))
    size = max(round(width * shrink), 1), max(round(height * shrink), 1)
    small = camera.resized(*size)
    factors = np.array([size[0] / width, size[1] / height] * 2)
    u0, v0, u1, v1 = (float(value) for value in np.array(corners) * factors)
    answer = boxed(state.graph, small, (u0, v0, u1, v1), _depth(scene, small))
    if not answer.nodes.any():
        session.hint = "There is no whole object in this box. Draw a larger one, or click."
        return False
    return _show(document, answer, "Select by a box")


@notifies
def make_object(session: Session) -> bool:
    """Make the clicked splats a new object, and ask for its name."""
    stop_asking(session)
    document = session.need()
    scene = document.settled().scene
    group = edits.free_group(scene)
    done = document.do(edits.separate(scene, document.selected(), "Make object"))
    if done:
        document.focus = group
        session.request = Request.RENAME
    return done


@notifies
def clear(session: Session) -> bool:
    """Forget the clicks: nothing is selected, and the next one begins another object."""
    stop_asking(session)
    session.need().feature(ClickState).waiting = []
    return session.need().select(algebra.nothing(), "set", "Clear the clicks")


def _select_objects(session: Session, points: Sequence[Point]) -> None:
    """Answer clicks on ``points`` (world) that took the tool while there were no objects, and now
    there are: with the objects there."""
    scene = session.need().scene
    shown, groups = np.flatnonzero(scene.visible).astype(np.int32), list[int]()
    means = algebra.world_means(scene, shown)
    for point in points if len(shown) else ():
        nearest = np.square(means - np.asarray(point, np.float32)).sum(axis=1).argmin()
        groups.append(int(scene.labels[shown[nearest]]))
    if found := tuple(dict.fromkeys(group for group in groups if group)):
        selection.select_groups(session, found)
    elif points:
        session.notify(Level.HINT, "There is no object where you clicked.")


def _answer(document: Document, click: "Click", camera: Camera) -> bool:
    """Answer one more click, made in the picture of ``camera``, as an entry of the history."""
    from gaga_core.scene.selection.click import clicked, nothing_yet

    state = document.feature(ClickState)
    assert state.graph is not None
    at = document.history.state_id
    before = state.answers.get(at, nothing_yet(state.graph))
    view = camera if click.is_on else state.views.get(at)
    if before.nodes.any() and at not in state.views:
        view = None  # begun by a box
    title = "Click an object" if not before.clicks else "Click more" if click.is_on else "Click off"
    done = _show(document, clicked(state.graph, before, click), title)
    if view is not None:
        state.views[document.history.state_id] = view
    return done


def _show(document: Document, answer: "Answer", title: str) -> bool:
    state: ClickState = document.feature(ClickState)
    assert state.graph is not None
    scene = document.settled().scene
    rows: IntArray = state.graph.splats(answer.samples)
    done = document.select(rows[algebra.selectable(scene)[rows]], "set", title)
    state.answers[document.history.state_id] = answer
    return done


def _depth(scene: Scene, camera: Camera) -> FloatArray:
    return choose("cpu").render(bake(scene), camera).median_depth


def _one_already(session: Session) -> str:
    """Needs something else than one whole object."""
    table, groups = session.objects(), session.selected_groups()
    row = table.row(groups[0]) if len(groups) == 1 else None
    is_one = row is not None and table.counts[row] == len(session.selected_indices())
    return "This is one object already." if is_one else ""


def no_clicks(session: Session) -> str:
    """Needs splats that were selected with the tool Object."""
    if has_clicks(session) or is_clicking(session):
        return no_selection(session) or _one_already(session)
    return no_scene(session) or "Nothing was clicked. Click with the tool Object (O) first."


COMMANDS: tuple[Command, ...] = (
    Command(
        "tool.object",
        "Select an object by clicks",
        begin,
        "O",
        enabled=no_scene,
        is_on=lambda session: session.tool is ToolName.OBJECT,
    ),
    Command("object.make", "Make an object of the clicks", make_object, enabled=no_clicks),
    Command(
        "tool.click_model",
        "Clicks of the tool Object ask a model",
        switch_model,
        enabled=why_no_model,
        is_on=lambda session: chosen_model(session) is not None,
    ),
)
