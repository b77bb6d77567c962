"""Turn mouse and keys over the picture into actions. Independent of the window toolkit.

A gesture is made of every place that the mouse was at, however few frames saw it.

Middle drag orbits, always; left drag orbits unless the tool wants it; Alt + left drag orbits too
(trackpads). Right drag and Shift + middle drag pan; the wheel and Ctrl + middle drag zoom. A click
is a press that moved less than ``CLICK_PIXELS``; a right click opens the menu of what is there.
Shift adds, Ctrl removes, both intersect.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto
from typing import Literal

from gaga_core.scene.edits import How
from gaga_studio.session.camera_rig import FLY_KEYS as FLY_KEYS

CLICK_PIXELS = 4.0
_ZOOM_PER_PIXEL = 0.03  # wheel notches
Button = Literal["left", "right", "middle"]


@dataclass(frozen=True)
class PointerState:
    """The mouse at one moment, in pixels of the picture from its top left corner."""

    u: float
    v: float
    width: int
    height: int
    left: bool = False
    right: bool = False
    middle: bool = False
    wheel: float = 0.0  # notches, up is positive
    is_double: bool = False  # the left button went down for the second time in this frame
    is_over: bool = True  # over the picture, and nothing else wants the mouse (a handle, a popup)


@dataclass(frozen=True)
class KeyState:
    """The keys in one frame that matter to the picture."""

    shift: bool = False
    ctrl: bool = False
    alt: bool = False
    held: frozenset[str] = frozenset()  # of FLY_KEYS


class Act(Enum):
    """What a gesture does."""

    ORBIT = auto()
    LOOK = auto()
    PAN = auto()
    ZOOM = auto()
    CLICK = auto()
    DOUBLE_CLICK = auto()
    MENU = auto()  # of what is there
    TOOL_PRESS = auto()
    TOOL_DRAG = auto()
    TOOL_RELEASE = auto()
    HOVER = auto()
    AWAY = auto()


@dataclass(frozen=True)
class Action:
    """One thing to do: a motion in pixels (``ZOOM``: in notches, as ``dy``) or a place."""

    act: Act
    u: float = 0.0
    v: float = 0.0
    dx: float = 0.0
    dy: float = 0.0
    how: How = "set"
    alt: bool = False  # of a click


@dataclass
class _Press:
    button: Button
    act: Act  # what a drag of it does
    u: float
    v: float
    how: How
    alt: bool = False
    is_drag: bool = False


class Gestures:
    """Follows the mouse from frame to frame."""

    def __init__(self) -> None:
        self._press: _Press | None = None
        self._last: tuple[float, float] | None = None
        self._ignored: set[Button] = set()  # went down elsewhere, or their gesture was cancelled
        self._hovers = False

    @property
    def is_dragging(self) -> bool:
        """Whether a drag is under way."""
        return self._press is not None and self._press.is_drag

    def cancel(self) -> None:
        """Forget the gesture; its button does nothing until it is pressed again."""
        if self._press is not None:
            self._ignored.add(self._press.button)
            self._press = None

    def update(
        self, pointer: PointerState, keys: KeyState, *, tool_drags: bool, looks: bool
    ) -> tuple[Action, ...]:
        """Return this frame's actions. ``tool_drags``: the tool wants the left drag; ``looks``:
        flying, so left and right drags turn the camera in place."""
        actions = tuple(self._actions(pointer, keys, tool_drags, looks))
        self._last = (pointer.u, pointer.v)
        return actions

    def _actions(
        self, pointer: PointerState, keys: KeyState, tool_drags: bool, looks: bool
    ) -> Iterator[Action]:
        down = {b for b in _BUTTONS if getattr(pointer, b)}
        self._ignored &= down
        if self._press is None:
            yield from self._start(pointer, keys, down, tool_drags, looks)
        elif self._press.button in down:
            yield from self._drag(self._press, pointer)
        else:
            yield from self._end(self._press, pointer)
        if pointer.wheel and pointer.is_over:
            yield Action(Act.ZOOM, pointer.u, pointer.v, dy=pointer.wheel)
        if self._press is None and pointer.is_over:
            self._hovers = True
            yield Action(Act.HOVER, pointer.u, pointer.v)
        elif self._hovers:
            self._hovers = False
            yield Action(Act.AWAY)

    def _start(
        self,
        pointer: PointerState,
        keys: KeyState,
        down: set[Button],
        tool_drags: bool,
        looks: bool,
    ) -> Iterator[Action]:
        fresh = down - self._ignored
        if not fresh:
            return
        if not pointer.is_over:
            self._ignored |= fresh
            return
        button = next(b for b in _BUTTONS if b in fresh)
        self._ignored |= fresh - {button}
        act = _meaning(button, keys, tool_drags, looks)
        self._press = _Press(button, act, pointer.u, pointer.v, how_of(keys), keys.alt)
        if button == "left" and pointer.is_double:
            self.cancel()
            yield Action(Act.DOUBLE_CLICK, pointer.u, pointer.v)

    def _drag(self, press: _Press, pointer: PointerState) -> Iterator[Action]:
        last_u, last_v = self._last or (pointer.u, pointer.v)
        if not press.is_drag:
            if max(abs(pointer.u - press.u), abs(pointer.v - press.v)) < CLICK_PIXELS:
                return
            press.is_drag = True
            last_u, last_v = press.u, press.v  # no part of the motion is lost
            if press.act is Act.TOOL_DRAG:
                yield Action(Act.TOOL_PRESS, press.u, press.v, how=press.how)
        dx, dy = pointer.u - last_u, pointer.v - last_v
        if not (dx or dy):
            return
        if press.act is Act.ZOOM:
            dy = -dy * _ZOOM_PER_PIXEL
        yield Action(press.act, pointer.u, pointer.v, dx, dy, press.how)

    def _end(self, press: _Press, pointer: PointerState) -> Iterator[Action]:
        self._press = None
        if press.is_drag:
            if press.act is Act.TOOL_DRAG:
                yield Action(Act.TOOL_RELEASE, pointer.u, pointer.v, how=press.how)
        elif press.button != "middle":
            act = Act.CLICK if press.button == "left" else Act.MENU
            yield Action(act, press.u, press.v, how=press.how, alt=press.alt)


_BUTTONS: tuple[Button, ...] = ("left", "right", "middle")


def how_of(keys: KeyState) -> How:
    """Return what the modifiers do to a selection."""
    if keys.shift and keys.ctrl:
        return "intersect"
    return "add" if keys.shift else "remove" if keys.ctrl else "set"


def fly_move(keys: KeyState, is_flying: bool) -> tuple[tuple[float, float, float], float]:
    """Return the direction (right, up, forward), each -1..1, and speed factor of the fly keys held.

    Shift is fast, Alt slow. Ctrl makes shortcuts of the letters, and so does Shift of a D alone
    (duplicate) unless ``is_flying``.
    """
    held = keys.held
    if keys.ctrl or (keys.shift and held == {"D"} and not is_flying):
        return (0.0, 0.0, 0.0), 1.0

    def along(plus: str, minus: str) -> float:
        return float((plus in held) - (minus in held))

    speed = 4.0 if keys.shift else 0.25 if keys.alt else 1.0
    return (along("D", "A"), along("E", "Q"), along("W", "S")), speed


def _meaning(button: Button, keys: KeyState, tool_drags: bool, looks: bool) -> Act:
    """Return what a drag of this button does."""
    if button == "middle":
        return Act.PAN if keys.shift else Act.ZOOM if keys.ctrl else Act.ORBIT
    if button == "right":
        return Act.LOOK if looks else Act.PAN
    if keys.alt:
        return Act.ORBIT
    if looks:
        return Act.LOOK
    return Act.TOOL_DRAG if tool_drags else Act.ORBIT
