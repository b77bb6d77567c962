"""Simulate: objects fall and come to rest for as long as a button is held; one edit of them all."""

import time
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.export.simulation.bodies import library, upright_place
from gaga_core.export.simulation.export import SimulationExport, world_stage
from gaga_core.export.simulation.falling import fall
from gaga_core.export.simulation.settings import SimulationConfig
from gaga_core.export.solids import MeshConfig
from gaga_core.progress import Progress, Stage
from gaga_core.scene import edits
from gaga_core.scene.objects import group_indices
from gaga_studio.features import export
from gaga_studio.features.base import Command, busy, no_groups
from gaga_studio.features.find.search import SearchState
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session

COMMAND = "object.simulate"
_TITLE = "Simulate"
_FRAME = 1 / 30  # s between the places that are shown
_MOST_SECONDS = 60.0  # of falling
_STILL, _REST_S = 1e-5, 0.5  # change of places between two frames, and for how long: at rest
# Coarser than an export: one waits for the bodies with the button held.
_MESH, _CONFIG = MeshConfig(voxels=48, triangles=0), SimulationConfig(parts=8, concavity=0.1)

Motions = list[tuple[int, DoubleArray]]  # of each group: a world map (4, 4) since the beginning


@dataclass
class SimulateState:
    """The simulation of a document that runs."""

    is_held: bool = False  # its worker reads it
    is_falling: bool = False  # the bodies are made, and something was shown


def state_of(session: Session) -> SimulateState | None:
    """The simulation of the open document; None when nothing is open."""
    return None if session.document is None else session.document.feature(SimulateState)


def not_possible(session: Session) -> str:
    """Needs objects and the job runner; while it runs it can be ended."""
    state = state_of(session)
    if state is not None and state.is_held:
        return ""
    return no_groups(session) or busy(session)


@notifies
def start(session: Session) -> bool:
    """Let the selected objects fall, else all but the background, until `stop`."""
    for name in ("manifold3d", "coacd", "mujoco"):
        library(name)
    document = session.need()
    scene, state = document.settled().scene, document.feature(SimulateState)
    groups = session.selected_groups()
    found = document.feature(SearchState).described
    how = SimulationExport(
        config=_CONFIG,
        mesh=_MESH,
        up=export.up_of(session),
        background=found.description.background if found is not None else (),
    )
    rows = {int(g): group_indices(scene, int(g)) for g in np.unique(scene.labels) if g > 0}
    state.is_held, state.is_falling = True, False

    def stage() -> Stage[Motions]:
        world = yield from world_stage(scene, how, groups or None)
        place, motions, begin = upright_place(how.up, 1.0), Motions(), time.monotonic()
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

    def show(motions: object) -> None:
        if session.document is document and isinstance(motions, list):
            state.is_falling = True
            moves = [(rows[group], matrix[:3]) for group, matrix in motions]
            document.preview_with(lambda now: edits.transform_each(now, moves, _TITLE))

    def keep(motions: Motions) -> None:
        show(motions)
        if session.document is document:
            document.commit_preview()

    def end() -> None:
        if session.document is document and state.is_falling:
            document.cancel_preview()  # of one that failed; else nothing is shown any more
        state.is_held = state.is_falling = False

    started = session.jobs.start(_TITLE, stage(), show, keep, end)
    state.is_held = started
    return started


def stop(session: Session) -> bool:
    """End it: where the objects are now is one edit."""
    state = state_of(session)
    if state is None or not state.is_held:
        return False
    state.is_held = False
    if not state.is_falling:
        session.jobs.cancel()
        session.notify(Level.HINT, "The bodies were not ready yet. Hold it until they fall.")
    return True


def _toggle(session: Session) -> bool:
    state = state_of(session)
    return stop(session) if state is not None and state.is_held else start(session)


COMMANDS: tuple[Command, ...] = (Command(COMMAND, _TITLE, _toggle, enabled=not_possible),)
