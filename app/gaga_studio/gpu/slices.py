"""How much of a picture one frame draws, so that the window answers meanwhile."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

_FIRST = 4096  # splats of the first part: what a splat costs is not known yet
_MOST_GROWTH = 2.0  # from one part to the next: near splats, drawn last, cost more
_LEAST = 128
_CAUTION = 0.5  # of the time that is left: the next part may be slower than the last


@dataclass
class Slices:
    """Sizes of the parts of a picture: each as long as the time that is left in its frame.

    ``finish`` waits for what was drawn. Speeds are kept from picture to picture.
    """

    finish: Callable[[], object]
    clock: Callable[[], float] = time.perf_counter
    seconds: float = 0.0  # of the last whole picture
    _speeds: dict[str, float] = field(default_factory=dict)  # splats a second, by kind of part
    _pixels: int = 0  # of this picture
    _spent: float = 0.0  # on this picture so far
    _until: float = 0.0
    _frame_s: float = 0.0  # 0 = all at once
    _part: tuple[str, int, float] | None = None  # kind, splats, start of the part under way

    def begin(self, n_pixels: int) -> None:
        """Start another picture; splats cost more where it has more pixels than the last."""
        self._spent, self._part = 0.0, None
        if "blend" in self._speeds:
            self._speeds["blend"] *= min(1.0, self._pixels / n_pixels)
        self._pixels = n_pixels

    def frame(self, seconds: float) -> None:
        """Start a frame that may draw for ``seconds``, 0 = as long as it takes."""
        self._frame_s = seconds
        self._until = self.clock() + seconds

    def size(self, kind: str) -> int:
        """Splats of the next part; 0 = all that are left."""
        if self._frame_s <= 0:
            return 0
        n = _FIRST
        if kind in self._speeds:
            left = max(self._until - self.clock(), 0.1 * self._frame_s)
            n = max(int(_CAUTION * self._speeds[kind] * left), _LEAST)
        self._part = (kind, n, self.clock())
        return n

    def is_over(self) -> bool:
        """After a part: wait for it, learn its speed; whether the frame has had its time."""
        self.finish()
        if self._part is not None:
            kind, n, start = self._part
            speed = n / max(self.clock() - start, 1e-6)
            known = self._speeds.get(kind)
            self._speeds[kind] = speed if known is None else min(speed, _MOST_GROWTH * known)
            self._part = None
        return self._frame_s > 0 and self.clock() >= self._until - 0.2 * self._frame_s

    def leave(self, start: float, *, is_done: bool) -> None:
        """End the frame that began to draw at ``start``."""
        self._spent += self.clock() - start
        if is_done:
            self.seconds = self._spent
