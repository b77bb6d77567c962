"""When a training is written to disk: often enough for a crash, rarely enough for the disk."""

import time
from collections.abc import Callable
from pathlib import Path

from gaga_core.reconstruct.checkpoint import TrainState, save_checkpoint
from gaga_core.reconstruct.engine import Engine

_MOST_TIME = 0.02  # of the training's time may go into writing
_MOST_LOST = 0.1  # of the time since its start a crash may cost, where that is more than the least


def seconds_between(least: float, elapsed: float, took: float) -> float:
    """Seconds from one checkpoint to the next.

    At least ``least``; more when the last one ``took`` long, or when the training has been running
    for long: their number grows with the logarithm of the time then. ``least`` = 0 writes after
    each iteration.
    """
    if least <= 0:
        return 0.0
    return max(least, took / _MOST_TIME, _MOST_LOST * elapsed)


class Keeper:
    """Writes checkpoints of one training: when they are due, and when asked, if there is anything
    new. Without a path it writes none."""

    def __init__(
        self,
        engine: Engine,
        path: Path | None,
        digest: str,
        seconds: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._engine, self._clock = engine, clock
        self._path, self._digest, self._seconds = path, digest, seconds
        self._start = self._last = self._clock()
        self._saved = 0
        self._took = 0.0

    def tick(self, state: TrainState) -> None:
        """Write ``state`` when that is due."""
        now = self._clock()
        if now - self._last >= seconds_between(self._seconds, now - self._start, self._took):
            self.save(state)

    def save(self, state: TrainState) -> None:
        """Write ``state``, unless that iteration was written."""
        if self._path is not None and state.iteration != self._saved:
            start = self._clock()
            self._engine.fetch(state)
            save_checkpoint(self._path, state, self._digest)
            self._last, self._saved = self._clock(), state.iteration
            self._took = self._last - start
