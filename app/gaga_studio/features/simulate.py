"""Objects as rigid bodies: their convex parts shown and exported, and a fall as one edit.

*Simulate*: objects fall and come to rest for as long as a button is held.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, IntArray
from gaga_core.errors import counted
from gaga_core.export.simulation.bodies import World, library, upright_place
from gaga_core.export.simulation.export import (
    SimulationExport,
    SimulatorForm,
    export_simulation_stage,
    sentences,
    world_stage,
)
from gaga_core.export.simulation.falling import fall
from gaga_core.export.simulation.settings import SimulationConfig
from gaga_core.export.solids import MeshConfig
from gaga_core.progress import Progress, Stage, mapped
from gaga_core.scene import edits
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene
from gaga_studio.features import camera, measure
from gaga_studio.features.base import Command, busy, no_groups
from gaga_studio.features.find.search import SearchState
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.system import paths

COMMAND = "object.simulate"
_TITLE, PREPARES = "Simulate", "Prepare bodies"
_READY = "The bodies are ready. Hold to simulate, and they fall at once."
_FRAME = 1 / 30  # s between the places that are shown
_MOST_SECONDS = 60.0  # of falling
_STILL, _REST_S = 1e-5, 0.5  # change of places between two frames, and for how long: at rest
# Coarser than an export: one waits for the bodies with the button held.
_MESH, _CONFIG = MeshConfig(voxels=48, triangles=0), SimulationConfig(parts=8, concavity=0.1)

Motions = list[tuple[int, DoubleArray]]  # of each group: a world map (4, 4) since the beginning
Wanted = tuple[tuple[int, ...], object]  # groups, none for all, and what the scene is


@dataclass
class SimulateState:
    """The simulation of a document that runs."""

    is_held: bool = False  # its worker reads it
    is_falling: bool = False  # the bodies are made, and something was shown
    runs: Wanted | None = None  # what its worker is for

    def clear(self) -> None:
        """It runs no longer."""
        self.is_held, self.is_falling, self.runs = False, False, None


def state_of(session: Session) -> SimulateState | None:
    """The simulation of the open document; None when nothing is open."""
    return None if session.document is None else session.document.feature(SimulateState)


def not_possible(session: Session) -> str:
    """Needs objects and the job runner; while it runs it can be ended."""
    state = state_of(session)
    if state is not None and state.is_held:
        return ""
    return no_groups(session) or busy(session)


def label(session: Session) -> str:
    """What the button says: how far its bodies are, after it was let go before they were made."""
    state, job = state_of(session), session.jobs.running
    is_prepared = state is None or state.runs is None or state.is_falling
    if is_prepared or job is None or job.title != PREPARES:
        return "Hold to simulate"
    return f"{PREPARES} {100 * max(job.fraction, 0.0):.0f} %"


@notifies
def start(session: Session) -> bool:
    """Let the selected objects fall, else all but the background, until `stop`.

    The bodies are those whose parts were shown, that fell before, or that are being made since it
    was held before, if they are still right. Else they are made first, also when it is let go.
    """
    for name in ("manifold3d", "coacd", "mujoco"):
        library(name)
    state = session.need().feature(SimulateState)
    wanted = session.selected_groups(), _moves(session.need().settled().scene)
    if state.runs == wanted:
        state.is_held = True  # they fall when its worker ends
        return True
    return _run(session, wanted)


def _run(session: Session, wanted: Wanted) -> bool:
    """Start the worker for ``wanted``: its bodies fall, once they are made."""
    bodies = session.need().feature(PartsState)
    if bodies.world is not None and (bodies.groups, bodies.moves) == wanted:
        return _fall(session, wanted, bodies.world)
    return _prepare(session, wanted)


def _prepare(session: Session, wanted: Wanted) -> bool:
    """Make the bodies, as a job that gives way; they fall at its end where it is held then."""
    document, (groups, _) = session.need(), wanted
    scene, state = document.scene, document.feature(SimulateState)
    how = _placed(session, SimulationExport(config=_CONFIG, mesh=_MESH))
    making = mapped(world_stage(scene, how, groups or None), partial(replace, stage=PREPARES))
    made: World | None = None

    def done(world: World) -> None:
        nonlocal made
        if _is_right(session, document, wanted):
            made = world
            document.feature(PartsState).keep(world, *wanted)
            if not state.is_held:
                session.notify(Level.INFO, _READY)

    def end() -> None:
        if state.runs is not wanted:  # another one has begun
            return
        is_held = state.is_held
        state.clear()
        if is_held and made is not None:
            _fall(session, wanted, made)

    ready = stages.prepared(session.rates, PREPARES, lambda: making, parts=("window",))
    return _begin(
        state,
        wanted,
        lambda: session.jobs.start(PREPARES, ready, None, done, end, gives_way=True),
    )


def _fall(session: Session, wanted: Wanted, world: World) -> bool:
    """Let the bodies fall for as long as it is held."""
    document, (groups, _) = session.need(), wanted
    scene, state, bodies = (
        document.scene,
        document.feature(SimulateState),
        document.feature(PartsState),
    )
    how = _placed(session, SimulationExport(config=_CONFIG, mesh=_MESH))
    rows = {int(g): group_indices(scene, int(g)) for g in np.unique(scene.labels) if g > 0}
    place = upright_place(how.up, how.scale)
    was_let_go = False  # before anything fell

    def show(motions: object) -> None:
        if session.document is not document or not isinstance(motions, list):
            return
        if state.is_falling or _is_right(session, document, wanted):
            state.is_falling = True
            moved = [(rows[group], matrix[:3]) for group, matrix in motions]
            document.preview_with(lambda now: edits.transform_each(now, moved, _TITLE))

    def done(motions: Motions) -> None:
        nonlocal was_let_go
        was_let_go = not motions
        if motions:
            show(motions)
        if state.is_falling and session.document is document:
            document.commit_preview()
            bodies.keep_fallen(world, groups, motions, place, _moves(document.scene))
        elif was_let_go and not state.is_held:
            session.notify(Level.INFO, _READY)

    def end() -> None:
        if session.document is document and state.is_falling:
            document.cancel_preview()  # of one that failed; else nothing is shown any more
        is_held_again = state.is_held and was_let_go
        state.clear()
        if is_held_again and _is_right(session, document, wanted):
            _fall(session, wanted, world)

    falling = _fall_stage(world, place, state)
    return _begin(state, wanted, lambda: session.jobs.start(_TITLE, falling, show, done, end))


def _begin(state: SimulateState, wanted: Wanted, start_job: Callable[[], bool]) -> bool:
    """Note that it is held, and start its job; all stays as it was when another job runs."""
    before = state.is_held, state.is_falling, state.runs
    state.is_held, state.is_falling, state.runs = True, False, wanted
    if started := start_job():
        return started
    state.is_held, state.is_falling, state.runs = before
    return started


def _is_right(session: Session, document: Document, wanted: Wanted) -> bool:
    """Whether ``document`` is open and nothing moved in it since it was held."""
    return session.document is document and _moves(document.scene) == wanted[1]


def _fall_stage(world: World, place: DoubleArray, state: SimulateState) -> Stage[Motions]:
    """Let ``world`` fall while it is held; returns how its bodies moved, in the scene, whose map to
    the world is ``place`` (4, 4)."""
    motions, begin = Motions(), time.monotonic()
    if not state.is_held:
        return motions
    first: DoubleArray | None = None
    former, n_still = np.zeros(0), 0
    for k, places in enumerate(fall(world, _MOST_SECONDS, _FRAME)):
        n_still = n_still + 1 if k and np.abs(places - former).max() < _STILL else 0
        first, former = (places if first is None else first), places
        motions = [
            (body.id, np.linalg.inv(place) @ now @ np.linalg.inv(then) @ place)
            for body, now, then in zip(world.bodies, places, first, strict=True)
        ]
        yield Progress(_TITLE, 0, 0, payload=motions)
        if not state.is_held or n_still * _FRAME > _REST_S:
            break
        time.sleep(max(0.0, begin + k * _FRAME - time.monotonic()))  # as fast as it is
    return motions


def stop(session: Session) -> bool:
    """End it: where the objects are now is one edit. Bodies that are not ready go on being made."""
    state = state_of(session)
    if state is None or not state.is_held:
        return False
    state.is_held = False
    if not state.is_falling:
        session.notify(Level.HINT, "The bodies are being prepared: hold it again when they are.")
    return True


def _toggle(session: Session) -> bool:
    state = state_of(session)
    return stop(session) if state is not None and state.is_held else start(session)


# --- Convex parts in the picture, and the export of what they are parts of.

_FLAT = np.cos(np.radians(12.0))  # between the normals of two triangles: no edge is drawn there
_ANY = tuple(SimulatorForm)  # what is made does not depend on the files
_MOST_EDGES = 6_000  # in the picture, the sharpest first


@dataclass
class PartsState:
    """The bodies of a document that are shown by their convex parts."""

    world: World | None = None
    groups: tuple[int, ...] = ()  # that it was made of; none: all
    key: object = None  # of the scene and the settings that they were made of
    edges: DoubleArray | None = None  # (E, 2, 3) world of the scene
    parts: IntArray | None = None  # (E,) which part each is of
    moves: object = None  # revisions of the scene that they are right for

    def keep(self, world: World, groups: tuple[int, ...], moves: object) -> None:
        """Hold bodies that were made."""
        self.edges = None if self.world is not world else self.edges
        self.world, self.groups, self.moves = world, groups, moves
        self.key = None  # an export makes them of what the scene is now

    def keep_fallen(
        self,
        world: World,
        groups: tuple[int, ...],
        motions: Motions,
        place: DoubleArray,
        moves: object,
    ) -> None:
        """Hold the bodies where ``motions`` brought them; ``place`` (4, 4): of their world."""
        fallen = []
        for body, (_, motion) in zip(world.bodies, motions, strict=True):
            turned = place @ motion @ np.linalg.inv(place)
            position = turned[:3, :3] @ body.position + turned[:3, 3]
            fallen.append(replace(body, position=position, turn=turned[:3, :3] @ body.turn))
        had_edges = self.edges is not None and self.world is world
        now = replace(world, bodies=tuple(fallen))
        self.keep(now, groups, moves)
        if had_edges:
            self.edges, self.parts = part_edges(now, np.linalg.inv(place))


def _placed(session: Session, how: SimulationExport) -> SimulationExport:
    """``how`` with the vertical and the background of the open scene."""
    found = session.need().feature(SearchState).described
    background = found.description.background if found is not None else frozenset()
    return replace(how, up=camera.up_of(session), background=background)


def _key(scene: Scene, how: SimulationExport, groups: Sequence[int]) -> object:
    return how, tuple(groups), _moves(scene), scene.revision.names


def _moves(scene: Scene) -> object:
    now = scene.revision
    return now.splats, now.labels, now.placement, now.placements, scene.visible.tobytes()


def shown_parts(session: Session) -> PartsState | None:
    """The parts that are drawn; None where there are none, or the scene is another by now."""
    if session.document is None:
        return None
    state = session.document.feature(PartsState)
    is_right = state.edges is not None and state.moves == _moves(session.document.scene)
    return state if is_right else None


@notifies
def show_parts(session: Session, how: SimulationExport) -> bool:
    """Make the bodies of the selected objects, else of all, as a job, and draw their parts."""
    document = session.need()
    scene, groups = replace(document.settled().scene), session.selected_groups()
    how = _placed(session, how)
    key, moves = _key(scene, replace(how, forms=_ANY), groups), _moves(scene)
    state, place = document.feature(PartsState), np.linalg.inv(upright_place(how.up, how.scale))

    def done(world: World) -> None:
        if session.document is not document:
            return
        state.world, state.key, state.moves = world, key, moves
        state.groups = tuple(groups)
        state.edges, state.parts = part_edges(world, place)
        n, n_bodies = sum(len(body.parts) for body in world.bodies), len(world.bodies)
        parts = f"{counted(n, 'convex part')} of {counted(n_bodies, 'object')}"
        text = f"{parts}, drawn in the picture."
        session.notify(Level.INFO, " ".join((text, *sentences(world, measure.HOW_TO_SCALE))))

    made = world_stage(scene, how.seeing(document.project), groups or None)
    ready = stages.prepared(session.rates, "Draw", lambda: made, parts=("window",))
    return session.jobs.start("Show convex parts", ready, on_done=done)


def hide_parts(session: Session) -> None:
    """Draw them no longer."""
    if session.document is not None:
        state = session.document.feature(PartsState)
        state.edges = state.parts = None


def part_edges(world: World, place: AnyArray) -> tuple[DoubleArray, IntArray]:
    """Edges (E, 2, 3) of all convex parts and the part of each (E,), moved by ``place`` (4, 4).

    At most 6,000, those between the steepest faces first.
    """
    ends, parts, angles = list[DoubleArray](), list[IntArray](), list[DoubleArray]()
    solids = [(body, part) for body in world.bodies for part in body.parts]
    for k, (body, part) in enumerate(solids):
        corners = part.vertices.astype(np.float64) @ body.turn.T + body.position
        a, b, c = (corners[part.faces[:, i]] for i in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        sides = np.sort(part.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        order = np.lexsort(sides.T)  # an edge of a closed solid comes twice
        one, two = order[::2] // 3, order[1::2] // 3
        cosine = (normals[one] * normals[two]).sum(axis=1)
        ends.append(corners[sides[order[::2]]][cosine < _FLAT])
        angles.append(cosine[cosine < _FLAT])
        parts.append(np.full(len(ends[-1]), k, np.int32))
    edges, cosines = np.concatenate(ends), np.concatenate(angles)
    chosen = np.sort(np.argsort(cosines, kind="stable")[:_MOST_EDGES])
    return edges[chosen] @ place[:3, :3].T + place[:3, 3], np.concatenate(parts)[chosen]


def export_stage(session: Session, path: Path, how: SimulationExport) -> Stage[str]:
    """Write the bodies of the selected objects, else of all; the parts shown are not made again."""
    document = session.need()
    scene, groups = replace(document.settled().scene), session.selected_groups()
    how, state = _placed(session, how), document.feature(PartsState)
    is_made = state.key == _key(scene, replace(how, forms=_ANY), groups)
    world = state.world if is_made else None

    def stage() -> Stage[str]:
        seen = how.seeing(document.project)
        made = export_simulation_stage(scene, path, seen, groups or None, document.name, world)
        manifest, bodies = yield from made
        n, where = len(bodies.bodies), paths.shown(manifest.parent)
        said = f"Exported {'1 body' if n == 1 else f'{n} bodies'} to {where}."
        return " ".join((said, *sentences(bodies, measure.HOW_TO_SCALE)))

    return stage()


COMMANDS: tuple[Command, ...] = (Command(COMMAND, _TITLE, _toggle, enabled=not_possible),)
