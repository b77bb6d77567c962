"""Random events of mouse and keyboard, sent to a window through the X server."""

import ctypes
import ctypes.util
import os
import random
import threading
import time
from dataclasses import dataclass

from gaga_studio.features import commands
from gaga_studio.ui.kit.picture_area import PictureArea
from tests.app.window import typist
from tests.app.window.typist import XEvent

_BUTTON_PRESS, _BUTTON_RELEASE, _MOTION = 4, 5, 6  # X.h
_MASKS = {_BUTTON_PRESS: 1 << 2, _BUTTON_RELEASE: 1 << 3, _MOTION: 1 << 6}
_MODIFIERS = {"Ctrl": "Control_L", "Shift": "Shift_L", "Alt": "Alt_L"}
_NAMES = {"Backspace": "BackSpace", "Enter": "Return", "/": "slash", ",": "comma", ".": "period"}
_NAMES |= {"[": "bracketleft", "]": "bracketright"}
_PLAIN = ("Escape", "Escape", "Return", "Tab", "space", "Up", "Down", *"wasdqe", *"0123456789")


@dataclass
class Sent:
    """How much was sent."""

    n_events: int = 0


class Hand(threading.Thread):
    """Moves, clicks, drags, scrolls and types at random until it is told to stop."""

    def __init__(self, window: int, size: tuple[int, int], seed: int, sent: Sent) -> None:
        super().__init__(daemon=True)
        self._window, self._size, self._sent = window, size, sent
        self._rng = random.Random(seed)
        self._x = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
        self._x.XOpenDisplay.restype = ctypes.c_void_p
        self._display = ctypes.c_void_p(self._x.XOpenDisplay(os.environ["DISPLAY"].encode()))
        self._keyboard = typist.Hand(window, PictureArea())
        self._chords = [
            keys.split("+") for c in commands.COMMANDS for keys in (c.shortcut, *c.aliases) if keys
        ]
        self._at = (0, 0)
        self.is_over = False

    def run(self) -> None:
        """Act until `is_over`."""
        rng = self._rng
        while not self.is_over:
            kind = rng.random()
            if kind < 0.35:
                self._click()
            elif kind < 0.5:
                self._drag()
            elif kind < 0.6:
                self._scroll()
            elif kind < 0.85:
                self._chord(rng.choice(self._chords))
            else:
                self._chord([rng.choice(_PLAIN)])
            time.sleep(rng.choice((0.0, 0.01, 0.05, 0.2)))
        self._keyboard.close()
        self._x.XCloseDisplay(self._display)

    def _place(self) -> tuple[int, int]:
        return self._rng.randrange(self._size[0]), self._rng.randrange(self._size[1])

    def _click(self) -> None:
        self._move(self._place())
        button = self._rng.choice((1, 1, 1, 2, 3))
        for _ in range(self._rng.choice((1, 1, 1, 2))):
            self._send(_BUTTON_PRESS, button)
            self._send(_BUTTON_RELEASE, button)

    def _drag(self) -> None:
        button, (x, y), (u, v) = self._rng.choice((1, 1, 3)), self._place(), self._place()
        self._move((x, y))
        self._send(_BUTTON_PRESS, button)
        for step in range(1, 6):
            self._move((x + (u - x) * step // 5, y + (v - y) * step // 5))
            time.sleep(0.01)
        self._send(_BUTTON_RELEASE, button)

    def _scroll(self) -> None:
        self._move(self._place())
        for _ in range(self._rng.randrange(1, 6)):
            self._send(_BUTTON_PRESS, self._rng.choice((4, 5)))

    def _chord(self, keys: list[str]) -> None:
        names = [_MODIFIERS.get(key) or _NAMES.get(key) or key for key in keys]
        names = [name.lower() if len(name) == 1 else name for name in names]
        for name in names:
            self._keyboard.stroke(name, True)
        for name in reversed(names):
            self._keyboard.stroke(name, False)
        self._sent.n_events += 2 * len(names)

    def _move(self, place: tuple[int, int]) -> None:
        self._at = place
        self._send(_MOTION, 0)

    def _send(self, kind: int, button: int) -> None:
        event = XEvent(type=kind, send_event=1, keycode=button, same_screen=1)
        event.display, event.window = self._display.value, self._window
        event.x, event.y = self._at
        event.time = int(time.monotonic() * 1000)
        mask = ctypes.c_long(_MASKS[kind])
        window = ctypes.c_ulong(self._window)
        self._x.XSendEvent(self._display, window, 1, mask, ctypes.byref(event))
        self._x.XFlush(self._display)
        self._sent.n_events += 1
