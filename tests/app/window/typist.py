"""Types into a real window as a hand does: key events from another connection to the X server."""

import ctypes
import ctypes.util
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import glfw
from imgui_bundle import glfw_utils, hello_imgui, immapp

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
        self._state = 0

    def stroke(self, name: str, is_down: bool) -> None:
        symbol = ctypes.c_ulong(self._x.XStringToKeysym(name.encode()))
        code = self._x.XKeysymToKeycode(self._display, symbol) & 0xFF
        kind = _PRESS if is_down else _RELEASE
        event = XEvent(type=kind, send_event=1, state=self._state, keycode=code, same_screen=1)
        event.display, event.window = self._display.value, self._window.value
        event.time = int(time.monotonic() * 1000)
        mask = ctypes.c_long(1 << (kind - 2))
        self._x.XSendEvent(self._display, self._window, 1, mask, ctypes.byref(event))
        self._x.XFlush(self._display)
        bit = _STATES.get(name, 0)
        self._state = self._state | bit if is_down else self._state & ~bit

    def close(self) -> None:
        self._x.XCloseDisplay(self._display)


def type_into(
    studio: Studio,
    script: Sequence[Stroke],
    *,
    frame_s: float,
    pause_s: float = 0.03,
    patience_s: float = 240.0,
    see: Callable[[Studio], Any],
) -> Any:
    """Open the window, type ``script`` when all is drawn, and return what is to ``see`` then.

    Every frame after that takes ``frame_s`` longer; ``pause_s`` lie between two strokes.
    """
    params = studio.window.params()
    studio.never_idle = True
    params.fps_idling.enable_idling = False
    hand: list[threading.Thread] = []
    state: dict[str, Any] = {"still": 0, "end": time.monotonic() + patience_s, "seen": None}

    def write(window: int) -> None:
        keyboard = Keyboard(window)
        for name, is_down in script:
            keyboard.stroke(name, is_down)
            time.sleep(pause_s)
        keyboard.close()

    def after_frame() -> None:
        assert time.monotonic() < state["end"], "the window is not done in time"
        if not hand:
            state["still"] = state["still"] + 1 if studio.is_settled else 0
            if state["still"] > 3:
                window = glfw.get_x11_window(glfw_utils.glfw_window_hello_imgui())
                hand.append(threading.Thread(target=write, args=(window,)))
                hand[0].start()
                state["still"] = 0
            return
        time.sleep(frame_s)
        is_done = not hand[0].is_alive() and not studio.window.keys_wait and studio.is_settled
        state["still"] = state["still"] + 1 if is_done else 0
        if state["still"] > 4:
            state["seen"] = see(studio)
            hello_imgui.get_runner_params().app_shall_exit = True

    params.callbacks.after_swap = after_frame
    immapp.run(params, immapp.AddOnsParams())
    return state["seen"]


def strokes(text: str) -> list[Stroke]:
    """Down and up of each word: "Control_L+a" is a chord, "a" a key."""
    script: list[Stroke] = []
    for chord in text.split():
        names = chord.split("+")
        script += [(name, True) for name in names]
        script += [(name, False) for name in reversed(names)]
    return script
