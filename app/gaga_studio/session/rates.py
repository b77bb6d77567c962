"""How long tasks take on this machine, in parts of what is expected; kept between runs."""

import json
import logging
import time
from typing import TypeVar

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.json_file import read_json
from gaga_core.progress import Stage
from gaga_studio.system import paths

T = TypeVar("T")
_FILE = "rates.json"  # in the home of gaga-studio
_LOG = logging.getLogger(__name__)


class KnownRates:
    """Times of steps and tasks by name, in parts of what they usually take."""

    def __init__(self) -> None:
        self.rates: dict[str, float] = {}
        path = paths.home() / _FILE
        try:
            self.rates = read_json(path, dict[str, float], "") if path.is_file() else {}
        except GagaError as error:  # it is measured again
            _LOG.warning("rates: %s", error)

    def of(self, name: str) -> float:
        """The rate of ``name``; of what never ran here that of kernels, which every installation
        compiles first."""
        from gaga_core.kernels import STAGE  # numba is a good part of the launch time

        return self.rates.get(name, self.rates.get(STAGE, 1.0))

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
        start = time.monotonic()
        value = yield from stage
        took = time.monotonic() - start
        self.keep(self.rates | {name: took / usual_s})
        return value

    def timed_kernels(self, kernels: Stage[None], usual_s: float) -> Stage[None]:
        """``kernels``, which usually take ``usual_s``: known after each of their steps, so that
        what waits for them is told right; kept at the end, or where it was stopped."""
        from gaga_core.kernels import STAGE

        start, rate = time.monotonic(), 0.0
        try:
            for step in kernels:
                if step.done and step.total > 0:
                    rate = (time.monotonic() - start) / (usual_s * step.done / step.total)
                    self.rates = self.rates | {STAGE: rate}
                yield step
        finally:
            kernels.close()
            if rate:
                self.keep(self.rates | {STAGE: rate})
