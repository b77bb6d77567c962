"""Keys and mouse of a real window, as a hand: events from another connection to the X server."""

import ctypes
import ctypes.util
import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import glfw
from imgui_bundle import glfw_utils, hello_imgui, imgui, immapp

from gaga_studio.studio import Studio
from gaga_studio.ui.kit.picture_area import PictureArea

# X11's name of a key, or "Button1"; whether it goes down. "Mouse": where it is, shares of the
# picture from its top left corner. "Close": what a window manager asks for at Alt+F4. "Rest":
# nothing until all is drawn and seen.
Stroke = tuple[str, bool | tuple[float, float]]
# Types of X11's events, and the masks of who gets them.
_PRESS, _RELEASE, _BUTTON_PRESS, _BUTTON_RELEASE, _MOTION, _ENTER = 2, 3, 4, 5, 6, 7
_MASKS = {_PRESS: 1, _RELEASE: 2, _BUTTON_PRESS: 4, _BUTTON_RELEASE: 8, _ENTER: 16, _MOTION: 64}
_STATES = {"Shift_L": 1, "Control_L": 4, "Alt_L": 8, "Button1": 256, "Button3": 1024}


class XEvent(ctypes.Structure):
    _fields_ = (
        ("type", ctypes.c_int),
        ("serial", ctypes.c_ulong),
        ("send_event", ctypes.c_int),
        ("display", ctypes.c_void_p),
        ("window", ctypes.c_ulong),
        ("root", ctypes.c_ulong),
        ("subwindow", ctypes.c_ulong),
        ("time", ctypes.c_ulong),
        ("x", ctypes.c_int),
        ("y", ctypes.c_int),
        ("x_root", ctypes.c_int),
        ("y_root", ctypes.c_int),
        ("state", ctypes.c_uint),
        ("keycode", ctypes.c_uint),
        ("same_screen", ctypes.c_int),
        ("pad", ctypes.c_long * 24),
    )


class Hand:
    """Sends keys and mouse to one window, whatever that window is doing."""

    def __init__(self, window: int, area: PictureArea) -> None:
        self._area = area
        self._x = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
        self._x.XOpenDisplay.restype = ctypes.c_void_p
        self._x.XStringToKeysym.restype = ctypes.c_ulong
        self._display = ctypes.c_void_p(self._x.XOpenDisplay(os.environ["DISPLAY"].encode()))
        self._window = ctypes.c_ulong(window)
        self._state, self._time = 0, 0
        self._at = (0, 0)

    def stroke(self, name: str, is_down: bool | tuple[float, float]) -> None:
        if name == "Close":
            glfw.set_window_should_close(glfw_utils.glfw_window_hello_imgui(), True)
            self._state = 0  # the window manager was told that Alt is up, this window never
            return
        if isinstance(is_down, tuple):
            area = self._area
            self._at = (
                round(area.left + is_down[0] * area.width),
                round(area.top + is_down[1] * area.height),
            )
            self._send(_MOTION, 0)
            return
        if name.startswith("Button"):
            self._send(_BUTTON_PRESS if is_down else _BUTTON_RELEASE, int(name[-1]))
        else:
            symbol = ctypes.c_ulong(self._x.XStringToKeysym(name.encode()))
            code = self._x.XKeysymToKeycode(self._display, symbol) & 0xFF
            self._send(_PRESS if is_down else _RELEASE, code)
        bit = _STATES.get(name, 0)
        self._state = self._state | bit if is_down else self._state & ~bit

    def enter(self) -> None:
        """The mouse comes into the window."""
        self._send(_ENTER, 0)

    def _send(self, kind: int, code: int) -> None:
        event = XEvent(type=kind, send_event=1, state=self._state, keycode=code, same_screen=1)
        if kind == _ENTER:  # it has a mode and a detail where others have their state and key
            event.state = event.keycode = 0
        event.display, event.window = self._display.value, self._window.value
        event.x, event.y = self._at
        # As a hand types: GLFW takes a press right after a release for a repeating key.
        self._time += 30
        event.time = self._time  # ms
        mask = ctypes.c_long(_MASKS[kind])
        self._x.XSendEvent(self._display, self._window, 1, mask, ctypes.byref(event))

    def sync(self) -> None:
        """Until the server has passed on all strokes."""
        self._x.XSync(self._display, 0)

    def close(self) -> None:
        self._x.XCloseDisplay(self._display)


def type_into(
    studio: Studio,
    script: Sequence[Stroke],
    *,
    in_a_frame: int,
    frame_s: float,
    see: Callable[[Studio], Any],
    patience_s: float = 60.0,
) -> list[Any]:
    """Open the window and type ``script`` when all is drawn; what was to ``see`` at each rest.

    The first is before the script, the last after it.

    From then on a frame says that it took ``frame_s``, and has ``in_a_frame`` strokes: all that a
    hand types while so slow a frame is drawn. Nobody sleeps for that. The window may end before.
    ``patience_s`` is what this thread may compute, for on a busy machine the clock says nothing.
    """
    params = studio.window.params()
    studio.never_idle = True
    params.fps_idling.enable_idling = False
    left, seen, end = list(script), [], time.thread_time() + patience_s
    hands: list[Hand] = []
    still, real = [0], params.callbacks.pre_new_frame

    def before_frame() -> None:
        if hands:
            imgui.get_io().delta_time = frame_s
        real()

    def after_frame() -> None:
        assert time.thread_time() < end, "the window is never done"
        is_at_rest = studio.is_settled and not studio.window.keys_wait
        still[0] = still[0] + 1 if is_at_rest else 0
        if hands and left and left[0][0] == "Rest":
            if still[0] > 4:
                seen.append(see(studio))
                del left[0]
        elif hands and left:
            for _ in range(in_a_frame):
                if left and left[0][0] != "Rest":
                    hands[0].stroke(*left.pop(0))
            hands[0].sync()
            still[0] = 0
        elif still[0] > 4:
            still[0] = 0
            seen.append(see(studio))
            if hands:
                hands.pop().close()
                hello_imgui.get_runner_params().app_shall_exit = True
            else:
                window = glfw.get_x11_window(glfw_utils.glfw_window_hello_imgui())
                hands.append(Hand(window, studio.ui.area))
                hands[0].enter()

    params.callbacks.pre_new_frame = before_frame
    params.callbacks.after_swap = after_frame
    immapp.run(params, immapp.AddOnsParams())
    return seen if not hands else [*seen, see(studio)]


def strokes(text: str) -> list[Stroke]:
    """Down and up of each word: "Control_L+a" is a chord, "a" a key."""
    script: list[Stroke] = []
    for chord in text.split():
        names = chord.split("+")
        script += [(name, True) for name in names]
        script += [(name, False) for name in reversed(names)]
    return script
