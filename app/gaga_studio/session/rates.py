"""How long tasks take on this machine, in parts of what is expected; kept between runs."""

import json
import logging
import os
import time
from collections import deque
from pathlib import Path
from typing import TypeVar

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.json_file import read_json
from gaga_core.progress import RECENT_S, Stage
from gaga_core.threads import n_threads
from gaga_studio.system import paths

T = TypeVar("T")
_FILE = "rates.json"  # in the home of gaga-studio
_STAT = Path("/proc/stat")  # of Linux
_LOOK_S = 2.0  # from one look at the load to the next
_LOG = logging.getLogger(__name__)


class Load:
    """How busy other programs keep the processors. Only Linux says so; elsewhere they are free."""

    def __init__(self) -> None:
        # Times, and processor seconds of the whole system and of this process until then.
        self._looks: deque[tuple[float, float, float]] = deque()

    def look(self) -> None:
        """Take note of what is used now; as often as one likes."""
        now = time.monotonic()
        if self._looks and now - self._looks[-1][0] < _LOOK_S:
            return
        used = _used_seconds()
        if used is not None:
            own = sum(os.times()[:4])  # with programs that it ran, once they have ended
            self._looks.append((now, used, own))
        while len(self._looks) > 2 and self._looks[1][0] < now - RECENT_S:
            self._looks.popleft()

    @property
    def slowdown(self) -> float:
        """Times as long as on a free machine that work of all threads takes beside the other
        programs, by the last `RECENT_S`; each of them gets as much of a processor as each of
        ours."""
        if len(self._looks) < 2:
            return 1.0
        (since, of_all, own), (now, of_all_now, own_now) = self._looks[0], self._looks[-1]
        others = max(of_all_now - of_all - (own_now - own), 0.0) / (now - since)
        return max((n_threads() + others) / (os.cpu_count() or 1), 1.0)


def _used_seconds() -> float | None:
    """Processor seconds that the system has used since it was started; None: it does not say."""
    try:
        words = _STAT.read_text(encoding="ascii").split("\n", 1)[0].split()
        user, nice, system = (int(word) for word in words[1:4])
        return (user + nice + system) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, AttributeError):  # another system
        return None


class KnownRates:
    """Times of steps and tasks by name, in parts of what they usually take; those that are kept are
    of a machine that no other program uses."""

    def __init__(self) -> None:
        self.load = Load()
        self.rates: dict[str, float] = {}
        path = paths.home() / _FILE
        try:
            self.rates = read_json(path, dict[str, float], "") if path.is_file() else {}
        except GagaError as error:  # it is measured again
            _LOG.warning("rates: %s", error)

    def of(self, name: str) -> float:
        """The rate of ``name`` now, beside other programs; of what never ran here that of kernels,
        which every installation compiles first."""
        from gaga_core.kernels import STAGE  # numba is a good part of the launch time

        return self.load.slowdown * self.rates.get(name, self.rates.get(STAGE, 1.0))

    def keep(self, rates: dict[str, float]) -> None:
        """Keep what was measured for the next run."""
        self.rates = rates
        try:
            with atomic_write(paths.home() / _FILE) as temporary:
                temporary.write_text(json.dumps(rates, indent=1) + "\n", encoding="utf-8")
        except (GagaError, OSError) as error:  # what was made is there all the same
            _LOG.warning("rates: %s", error)

    def timed(self, stage: Stage[T], name: str, usual_s: float) -> Stage[T]:
        """``stage``, whose time in parts of ``usual_s`` is kept for the next estimate."""
        start, slowdown = time.monotonic(), self.load.slowdown
        value = yield from stage
        took = time.monotonic() - start
        self.keep(self.rates | {name: took / (usual_s * slowdown)})
        return value

    def timed_kernels(self, kernels: Stage[None], usual_s: float) -> Stage[None]:
        """``kernels``, which usually take ``usual_s``: known after each of their steps, so that
        what waits for them is told right; kept at the end, or where it was stopped."""
        from gaga_core.kernels import STAGE

        start, rate, expected_s = time.monotonic(), 0.0, usual_s * self.load.slowdown
        try:
            for step in kernels:
                if step.done and step.total > 0:
                    rate = (time.monotonic() - start) / (expected_s * step.done / step.total)
                    self.rates = self.rates | {STAGE: rate}
                yield step
        finally:
            kernels.close()
            if rate:
                self.keep(self.rates | {STAGE: rate})
