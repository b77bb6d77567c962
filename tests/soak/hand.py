"""Random events of mouse and keyboard, sent to a window through the X server."""

import random
import threading
import time
from dataclasses import dataclass

from gaga_studio.features import commands
from tests.app.window import typist

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

    def __init__(self, size: tuple[int, int], seed: int, sent: Sent) -> None:
        super().__init__(daemon=True)
        self._size, self._sent = size, sent
        self._rng = random.Random(seed)
        self._hand = typist.Hand()
        self._chords = [
            keys.split("+") for c in commands.COMMANDS for keys in (c.shortcut, *c.aliases) if keys
        ]
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
        self._hand.close()

    def _place(self) -> tuple[int, int]:
        return self._rng.randrange(self._size[0]), self._rng.randrange(self._size[1])

    def _click(self) -> None:
        self._move(self._place())
        button = self._rng.choice((1, 1, 1, 2, 3))
        for _ in range(self._rng.choice((1, 1, 1, 2))):
            self._stroke(f"Button{button}", True)
            self._stroke(f"Button{button}", False)

    def _drag(self) -> None:
        button, (x, y), (u, v) = self._rng.choice((1, 1, 3)), self._place(), self._place()
        self._move((x, y))
        self._stroke(f"Button{button}", True)
        for step in range(1, 6):
            self._move((x + (u - x) * step // 5, y + (v - y) * step // 5))
            time.sleep(0.01)
        self._stroke(f"Button{button}", False)

    def _scroll(self) -> None:
        self._move(self._place())
        for _ in range(self._rng.randrange(1, 6)):
            self._stroke(f"Button{self._rng.choice((4, 5))}", True)

    def _chord(self, keys: list[str]) -> None:
        names = [_MODIFIERS.get(key) or _NAMES.get(key) or key for key in keys]
        names = [name.lower() if len(name) == 1 else name for name in names]
        for name in names:
            self._stroke(name, True)
        for name in reversed(names):
            self._stroke(name, False)

    def _move(self, place: tuple[int, int]) -> None:
        self._hand.move(*place)
        self._sync()

    def _stroke(self, name: str, is_down: bool) -> None:
        self._hand.stroke(name, is_down)
        self._sync()

    def _sync(self) -> None:
        self._hand.sync()
        self._sent.n_events += 1
