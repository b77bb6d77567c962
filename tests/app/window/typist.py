"""Types into a real window as a hand does: key events from another connection to the X server."""

import ctypes
import ctypes.util
import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import glfw
from imgui_bundle import glfw_utils, hello_imgui, imgui, immapp

from gaga_studio.studio import Studio

Stroke = tuple[str, bool]  # X11's name of a key; whether it goes down
_PRESS, _RELEASE = 2, 3  # KeyPress and KeyRelease, also the numbers of their masks
_STATES = {"Shift_L": 1, "Control_L": 4, "Alt_L": 8}


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


class Keyboard:
    """Sends keys to one window, whatever that window is doing."""

    def __init__(self, window: int) -> None:
        self._x = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
        self._x.XOpenDisplay.restype = ctypes.c_void_p
        self._x.XStringToKeysym.restype = ctypes.c_ulong
        self._display = ctypes.c_void_p(self._x.XOpenDisplay(os.environ["DISPLAY"].encode()))
        self._window = ctypes.c_ulong(window)
        self._state, self._time = 0, 0

    def stroke(self, name: str, is_down: bool) -> None:
        symbol = ctypes.c_ulong(self._x.XStringToKeysym(name.encode()))
        code = self._x.XKeysymToKeycode(self._display, symbol) & 0xFF
        kind = _PRESS if is_down else _RELEASE
        event = XEvent(type=kind, send_event=1, state=self._state, keycode=code, same_screen=1)
        event.display, event.window = self._display.value, self._window.value
        # As a hand types: GLFW takes a press right after a release for a repeating key.
        self._time += 30
        event.time = self._time  # ms
        mask = ctypes.c_long(1 << (kind - 2))
        self._x.XSendEvent(self._display, self._window, 1, mask, ctypes.byref(event))
        bit = _STATES.get(name, 0)
        self._state = self._state | bit if is_down else self._state & ~bit

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
    patience_s: float = 120.0,
) -> tuple[Any, Any]:
    """Open the window and type ``script`` when all is drawn; what was to ``see`` before and after.

    From then on a frame says that it took ``frame_s``, and has ``in_a_frame`` strokes: all that a
    hand types while so slow a frame is drawn. Nobody sleeps for that.
    """
    params = studio.window.params()
    studio.never_idle = True
    params.fps_idling.enable_idling = False
    left, seen, end = list(script), [], time.monotonic() + patience_s
    keyboards: list[Keyboard] = []
    still, real = [0], params.callbacks.pre_new_frame

    def before_frame() -> None:
        if keyboards:
            imgui.get_io().delta_time = frame_s
        real()

    def after_frame() -> None:
        assert time.monotonic() < end, "the window is not done in time"
        is_at_rest = studio.is_settled and not studio.window.keys_wait
        still[0] = still[0] + 1 if is_at_rest else 0
        if keyboards and left:
            for name, is_down in left[:in_a_frame]:
                keyboards[0].stroke(name, is_down)
            keyboards[0].sync()
            del left[:in_a_frame]
            still[0] = 0
        elif still[0] > 4:
            still[0] = 0
            seen.append(see(studio))
            if keyboards:
                keyboards.pop().close()
                hello_imgui.get_runner_params().app_shall_exit = True
            else:
                window = glfw.get_x11_window(glfw_utils.glfw_window_hello_imgui())
                keyboards.append(Keyboard(window))

    params.callbacks.pre_new_frame = before_frame
    params.callbacks.after_swap = after_frame
    immapp.run(params, immapp.AddOnsParams())
    return seen[0], seen[1]


def strokes(text: str) -> list[Stroke]:
    """Down and up of each word: "Control_L+a" is a chord, "a" a key."""
    script: list[Stroke] = []
    for chord in text.split():
        names = chord.split("+")
        script += [(name, True) for name in names]
        script += [(name, False) for name in reversed(names)]
    return script
