"""Five hundred random commands and gestures, drawn as they go: nothing breaks, nothing piles up.

Commands and mouse gestures of all tools come in an order that only a seed knows, on a small scene,
with the viewport drawing after each on a context without a window. At the end of every round all is
undone, and the scene must be what it was, bit for bit.
"""

import gc
import time
from collections import Counter
from contextlib import suppress
from typing import Any

import numpy as np
import psutil
import pytest

from gaga_core.scene.scene import Scene
from gaga_studio.features import commands, objects, selection, transform
from gaga_studio.gpu.overlays import Overlays
from gaga_studio.gpu.viewport import Pacing, Viewport
from gaga_studio.session.notices import PreviewWaitsError
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, ToolName
from gaga_studio.tools.controller import ToolController
from gaga_studio.tools.gestures import KeyState, PointerState

pytestmark = pytest.mark.gl
_COMMANDS, _STEPS = 500, 75  # commands altogether; steps of a round
_MOST_SPLATS = 12_000  # a walk that selects all and duplicates would double them for ever
_SECONDS_EACH = 1.5  # a command that has taken so long altogether has been tried enough
_MOST_GROWTH = 24 << 20  # bytes, from the fourth round on
# Those that end the document; what is read and written has tests of its own.
_NOT_HERE = {"file.demo", "file.close", "file.quit", "file.open_folder", "file.open_file"}
_NOT_HERE |= {"object.simulate"}  # the bodies of all objects take a minute each
_SIZE = (160, 120)


class _Walk:
    """A person who presses anything."""

    def __init__(self, session: Session, viewport: Viewport, seed: int) -> None:
        self.session, self.viewport = session, viewport
        self.rng = np.random.default_rng(seed)
        self.controller, self.pacing = ToolController(), Pacing(is_software=True)
        self.spent: dict[str, float] = {}  # seconds of the processor
        self.done: Counter[str] = Counter()
        self.ids = [c.id for c in commands.COMMANDS if c.id not in _NOT_HERE]

    def step(self) -> None:
        kind = self.rng.random()
        if kind < 0.75:
            self._command()
        elif kind < 0.9:
            self._gesture()
        else:
            with suppress(PreviewWaitsError):  # the window says that one waits
                self._panel()
        self._settle()
        self._draw()

    def _command(self) -> None:
        order = self.rng.permutation(len(self.ids)).tolist()
        for at in sorted(order, key=lambda at: self.done[self.ids[at]] > 0):  # each one soon
            name = self.ids[at]
            start = time.process_time()
            if self.spent.get(name, 0.0) < _SECONDS_EACH and commands.run(name, self.session):
                break
        self._settle()
        self.done[name] += 1
        self.spent[name] = self.spent.get(name, 0.0) + time.process_time() - start

    def _gesture(self) -> None:
        """A click or a drag of any button, with or without Shift and Ctrl."""
        start, end = self.rng.uniform(0, 1, (2, 2)) * _SIZE
        button = str(self.rng.choice(["left", "left", "left", "right", "middle"]))
        shift, ctrl = self.rng.random(2) < 0.25
        keys = KeyState(bool(shift), bool(ctrl), False, frozenset())
        path = [start] if self.rng.random() < 0.5 else list(np.linspace(start, end, 5))
        for u, v in path:
            self._point(float(u), float(v), button, keys)
        self._point(float(path[-1][0]), float(path[-1][1]), "", keys)

    def _point(self, u: float, v: float, button: str, keys: KeyState) -> None:
        pointer = PointerState(
            u=u,
            v=v,
            width=_SIZE[0],
            height=_SIZE[1],
            left=button == "left",
            right=button == "right",
            middle=button == "middle",
            wheel=float(self.rng.integers(-1, 2)) if not button else 0.0,
            is_double=False,
            is_over=True,
        )
        self.controller.update(self.session, pointer, keys, 0.016)
        self.session.tick(0.016)

    def _panel(self) -> None:
        """What the panels call: rows of the list, sliders, drags of the handles."""
        session, rng = self.session, self.rng
        groups = session.objects().ids
        if len(groups) == 0:  # all is deleted
            session.undo()
            return
        group = int(groups[int(rng.integers(len(groups)))])
        match int(rng.integers(6)):
            case 0:
                selection.select_groups(session, (group,), "add")
            case 1:
                objects.rename(session, group, f"thing {int(rng.integers(9))}")
            case 2:
                self._preview()
            case 3:
                session.undo()
            case 4:
                session.redo()
            case _:
                session.tool = ToolName(rng.choice(list(ToolName)))
                session.view.mode = Mode(rng.choice(list(Mode)))

    def _preview(self) -> None:
        """A drag of the handles or of a color, kept or taken back."""
        session, rng = self.session, self.rng
        if len(session.selected_indices()) == 0:
            return
        is_move = bool(rng.random() < 0.5)
        for x, y, z in rng.random((3, 3)):
            if is_move:
                transform.preview_move(session, np.c_[np.eye(3), [0.1 * x, 0, 0]])
            else:
                transform.preview_recolor(session, (x, y, z), 0.9)
            self._draw()
        if rng.random() < 0.3:
            session.cancel_preview()
        session.commit_preview()

    def _settle(self) -> None:
        """Answer what is asked, close what was opened, let jobs end, keep the scene small."""
        session = self.session
        assert session.jobs.wait()
        if session.pending_question is not None:
            session.answer(session.pending_question.choices[-1])
        session.take_request()
        assert session.scene is not None
        while len(session.scene) > _MOST_SPLATS and session.undo() is not None:
            pass

    def _draw(self) -> None:
        session, scene = self.session, self.session.scene
        session.tick(0.016)
        size = (int(self.rng.integers(20, 200)), 90) if self.rng.random() < 0.05 else _SIZE
        camera = session.rig.camera(*size)
        n_splats = 0 if scene is None else len(scene)
        view = self.pacing.view_for(session.view, camera.cam_from_world.tobytes(), n_splats)
        overlays = Overlays(
            cameras=session.cameras if session.view.show_frusta else (),
            active_camera=session.active_view,
            labels=session.live_labels,
            hovered_group=session.hovered_group,
            focused_group=session.focus,
        )
        self.viewport.draw(scene, camera, view, overlays, wait=bool(self.rng.random() < 0.05))


def _contents(scene: Scene) -> list[bytes]:
    """Everything that edits change."""
    g = scene.gaussians
    columns = (g.means, g.sh, scene.labels, scene.state, scene.placement, scene.source)
    table = scene.placements
    rows = [c.tobytes() for c in (*columns, table.matrix, table.color, table.opacity)]
    return [*rows, repr(scene.names).encode(), repr(sorted(scene.named_selections)).encode()]


def test_random_commands(associated: Session, gl: Any) -> None:
    session = associated
    viewport = Viewport(gl)
    walk = _Walk(session, viewport, seed=5)
    assert session.history is not None
    process, memory = psutil.Process(), []
    at_first = _contents(session.need().scene)
    while walk.done.total() < _COMMANDS:
        for _ in range(_STEPS):
            walk.step()
        session.cancel_preview()
        session.history.go_to(0)
        assert _contents(session.need().scene) == at_first
        session.history.clear()
        walk._draw()
        gl.finish()
        assert gl.error == "GL_NO_ERROR"
        gc.collect()
        memory.append(process.memory_info().rss)
    viewport.release()
    middle = len(memory) // 2  # by then every command has loaded what it needs once
    growth = np.diff(memory[middle - 1 :])  # the median: a leak grows each time, a library once
    assert np.median(growth) * len(growth) < _MOST_GROWTH, [m >> 20 for m in memory]
    assert len(walk.done) > 0.8 * len(walk.ids)
    assert viewport.n_draws > _COMMANDS / 2
