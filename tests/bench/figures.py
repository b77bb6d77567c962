"""What a benchmark reports: one figure, its bar, and how it was measured."""

import os
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A measured value. ``bar`` is the limit in words ("<= 100"), empty when only reported."""

    name: str
    value: float
    unit: str
    bar: str = ""

    @property
    def holds(self) -> bool:
        """Whether the bar is met; a figure without one always holds."""
        if not self.bar:
            return True
        sign, limit = self.bar.split()
        return self.value <= float(limit) if sign == "<=" else self.value >= float(limit)


def cpu_median(work: Callable[[], object], runs: int = 5, *, warm_up: int = 1) -> float:
    """Median CPU milliseconds of this process for one call of ``work``."""
    for _ in range(warm_up):
        work()
    times = []
    for _ in range(runs):
        start = time.process_time()
        work()
        times.append((time.process_time() - start) * 1e3)
    return statistics.median(times)


@contextmanager
def one_thread() -> Iterator[None]:
    """Kernels run in the calling thread, as they do with GAGA_THREADS=1."""
    before = os.environ.get("GAGA_THREADS")
    os.environ["GAGA_THREADS"] = "1"
    try:
        yield
    finally:
        os.environ.pop("GAGA_THREADS")
        if before is not None:
            os.environ["GAGA_THREADS"] = before
