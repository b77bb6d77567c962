"""A hand that plays mouse and keys on a session, and what tests of tools look at."""

from dataclasses import replace
from typing import Any

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.session.session import Session
from gaga_studio.tools.controller import ToolController
from gaga_studio.tools.gestures import KeyState, PointerState

W, H = 640, 480
_PLAIN = KeyState()


class Hand:
    """Plays frames of the mouse on a session."""

    def __init__(self, session: Session, size: tuple[int, int] = (W, H)) -> None:
        self.session = session
        self.controller = ToolController()
        self.pointer = PointerState(5, 5, *size)
        self.play()

    def play(self, keys: KeyState = _PLAIN, **changes: Any) -> None:
        self.pointer = replace(self.pointer, **{"is_double": False, "wheel": 0.0, **changes})
        self.controller.update(self.session, self.pointer, keys, 1 / 60)

    def press(self, u: float, v: float, **changes: Any) -> None:
        self.play(u=float(u), v=float(v))
        self.play(left=True, **changes)

    def move(self, u: float, v: float) -> None:
        self.play(u=float(u), v=float(v))

    def release(self) -> None:
        self.play(left=False)

    def click_at(self, at: DoubleArray, keys: KeyState = _PLAIN) -> None:
        self.click(float(at[0]), float(at[1]), keys)

    def click(self, u: float, v: float, keys: KeyState = _PLAIN) -> None:
        self.play(u=u, v=v)
        self.play(keys, left=True)
        self.play(keys, left=False)

    def drag(self, start: DoubleArray, end: DoubleArray, keys: KeyState = _PLAIN) -> None:
        self.play(u=float(start[0]), v=float(start[1]))
        self.play(keys, left=True)
        for t in (0.3, 0.7, 1.0):
            u, v = start + t * (end - start)
            self.play(keys, u=float(u), v=float(v))
        self.play(keys, left=False)


def surface(session: Session) -> DoubleArray:
    """A pixel (2,) that shows something solid."""
    scene = session.need().scene
    points = world_means(scene, np.arange(len(scene), dtype=np.int32)).astype(np.float64)
    pixels, _ = session.rig.camera(W, H).project(points)
    for u, v in np.floor(pixels) + 0.5:
        inside = 0 < u < W and 0 < v < H
        found = session.pick(float(u), float(v), W, H) if inside else None
        if found is not None and found.weights.sum() > 0.9:
            return np.array([u, v])
    raise AssertionError("nothing solid is in the picture")


def titles(session: Session) -> list[str]:
    return [entry.title for entry in session.need().history.entries()]


def state(session: Session) -> bytes:
    scene = session.need().scene
    return b"".join(
        a.tobytes() for a in (scene.state, scene.labels, scene.placement, scene.placements.matrix)
    )
