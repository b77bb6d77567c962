"""How long tasks take on this machine, in parts of what is expected; kept between runs."""

import json
import logging
import os
import time
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.json_file import read_json
from gaga_core.kernels import STAGE
from gaga_core.progress import RECENT_S, Pace, Progress, Share, Stage, mapped
from gaga_core.threads import n_threads
from gaga_studio.system import paths

T = TypeVar("T")
_FILE = "rates.json"  # in the home of gaga-studio
_STAT = Path("/proc/stat")  # of Linux
_TELLING_S = 5.0  # of kernels, or of a task, until they tell how fast this machine is
# Between this machine and the one that was measured, at most: a rate that is farther off was of
# kernels that came from a cache, or of a machine that slept.
_MOST_OFF = 4.0
_MOST_OFF_TASK = 20.0  # the same of a task, as of the steps of a reconstruction
_LOOK_S = 2.0  # from one look at the load to the next
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Used:
    """Processor seconds that were used until a time."""

    at: float  # seconds
    of_all: float
    own: float  # with programs that this one ran, once they have ended


class Load:
    """How busy other programs keep the processors. Only Linux says so; elsewhere they are free."""

    def __init__(self) -> None:
        self._looks: deque[_Used] = deque()
        self.look()

    def look(self) -> None:
        """Take note of what is used now; as often as one likes."""
        now = time.monotonic()
        if self._looks and now - self._looks[-1].at < _LOOK_S:
            return
        used = _used()
        if used is not None:
            self._looks.append(used)
        while len(self._looks) > 2 and self._looks[1].at < now - RECENT_S:
            self._looks.popleft()

    @property
    def slowdown(self) -> float:
        """Factor by which work of all threads takes longer because of other programs, measured over
        the last `RECENT_S`."""
        return _slowdown(self._looks[0], self._looks[-1], n_threads()) if self._looks else 1.0


def _slowdown(then: _Used | None, now: _Used | None, threads: int) -> float:
    """Factor by which work of so many threads took longer from then to now; 1 if it is not known.

    Each thread of another program gets as much of a processor as each of ours.
    """
    if then is None or now is None or now.at <= then.at:
        return 1.0
    others = max(now.of_all - then.of_all - (now.own - then.own), 0.0) / (now.at - then.at)
    return max((threads + others) / (os.cpu_count() or 1), 1.0)


def _used() -> _Used | None:
    """What is used until now; None: the system does not say. What gives way is left out."""
    try:
        words = _STAT.read_text(encoding="ascii").split("\n", 1)[0].split()
        of_all = (int(words[1]) + int(words[3])) / os.sysconf("SC_CLK_TCK")
        gives_way = os.nice(0) > 0
    except (OSError, ValueError, AttributeError, IndexError):  # another system
        return None
    return _Used(time.monotonic(), of_all, 0.0 if gives_way else sum(os.times()[:4]))


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
        """The rate of ``name`` at the present load of the machine; of a task that never ran here
        that of kernels, which every installation compiles first."""
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
        """``stage``, which usually takes ``usual_s``: it tells its time left from its first word
        on, by what such tasks took here, and by its own pace the more the longer it runs.

        What it took is kept for the next estimate, unless it is so little that most of it was its
        start.
        """
        start, before = time.monotonic(), _used()
        pace, share = Pace(), Share()

        def told(step: Progress) -> Progress:
            now = time.monotonic()
            pace.hear(now, share.of(step))
            guess = max(usual_s * self.of(name), now - start)
            return replace(step, left_s=pace.expected_left(guess, now))

        value = yield from mapped(stage, told)
        took = time.monotonic() - start
        slowdown = _slowdown(before, _used(), n_threads())
        if took >= _TELLING_S and usual_s > 0:
            rate = took / (usual_s * slowdown)
            rate = min(max(rate, 1 / _MOST_OFF_TASK), _MOST_OFF_TASK)
            self.keep(self.rates | {name: rate})
        return value

    def timed_kernels(self, kernels: Stage[None], usual_s: float) -> Stage[None]:
        """``kernels``, which usually take ``usual_s``: known after some of their steps, so that
        what waits for them is told right; kept at the end, or where it was stopped."""
        spent = usual = rate = 0.0  # of steps that were compiled, seconds
        heard, before = (0.0, 1.0), _used()  # when, and how far it was
        try:
            for step in kernels:
                now, share = time.monotonic(), step.done / step.total if step.total > 0 else 0.0
                if share > heard[1]:
                    spent, usual = spent + now - heard[0], usual + usual_s * (share - heard[1])
                heard = now, share
                if usual >= _TELLING_S:  # one thread compiles
                    rate = spent / (usual * _slowdown(before, _used(), 1))
                    rate = min(max(rate, 1 / _MOST_OFF), _MOST_OFF)
                    self.rates = self.rates | {STAGE: rate}
                yield step
        finally:
            kernels.close()
            if rate:
                self.keep(self.rates | {STAGE: rate})
