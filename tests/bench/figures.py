"""What a benchmark reports: one figure, its bar, and how it was measured; how a cost grows."""

import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from unittest.mock import patch

import numpy as np

_T = TypeVar("_T")


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


def median_ms(
    work: Callable[[], object],
    runs: int = 5,
    *,
    warm_up: int = 1,
    clock: Callable[[], float] = time.process_time,
) -> float:
    """Median milliseconds of one call of ``work``: CPU of this process, or of another clock."""
    for _ in range(warm_up):
        work()
    times = []
    for _ in range(runs):
        start = clock()
        work()
        times.append((clock() - start) * 1e3)
    return statistics.median(times)


def timed(work: Callable[[], _T]) -> tuple[_T, float]:
    """What ``work`` returns, and the CPU seconds of this process for it."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def peak_mib() -> float:
    """Most memory that this process has held so far."""
    import resource  # not on Windows

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def is_long() -> bool:
    """Whether what takes many minutes is asked for: ``GAGA_BENCH_LONG=1``."""
    return os.environ.get("GAGA_BENCH_LONG", "") not in ("", "0")


def data_folder(name: str) -> Path:
    """Folder of a real scene (GAGA_TEST_DATA), which need not be on this machine."""
    shared = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("GAGA_TEST_DATA", shared)) / name


def egl_context() -> Any:
    """A moderngl context without a display; None where there is none."""
    import moderngl

    options: dict[str, Any] = {"backend": "egl"}
    try:
        return moderngl.create_context(require=330, standalone=True, **options)
    except (moderngl.Error, OSError, ValueError, RuntimeError):
        return None


@contextmanager
def one_thread() -> Iterator[None]:
    """Kernels run in the calling thread, as they do with GAGA_THREADS=1."""
    with patch.dict(os.environ, GAGA_THREADS="1"):
        yield


@dataclass(frozen=True)
class Line:
    """The line at the start + by_step * steps that is best by shares: few steps weigh as much as
    many."""

    start: float
    by_step: float
    largest_miss: float  # share by which a value misses the line at most
    end_to_begin: float  # a step between the last two values, to one between the first two

    @staticmethod
    def through(steps: Sequence[int], values: Sequence[float]) -> "Line":
        """Of at least two values; ``steps`` ascend."""
        x, y = np.array(steps, np.float64), np.array(values)
        a, b = np.linalg.lstsq(np.stack([1 / y, x / y], axis=1), np.ones(len(x)), rcond=None)[0]
        slopes = np.diff(y) / np.diff(x)
        miss = float(np.abs((a + b * x) / y - 1).max())
        return Line(float(a), float(b), miss, float(slopes[-1] / slopes[0]))
