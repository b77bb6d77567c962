"""Association of many objects: halls of boxes of growing size, and what each costs.

Views and splats grow with the boxes, so cost near linear means time in proportion to them. Every
run is a process of its own (`hall`). Small halls show the growth; ``GAGA_BENCH_LONG=1`` adds 1,000
boxes and 300 views. The largest, ``python -m tests.bench.hall 4000 1000``, runs by hand.
"""

import json
import os
import subprocess
import sys

import numpy as np

from tests.bench.figures import Figure
from tests.bench.hall import Cost

_SIZES = ((125, 40), (250, 75), (500, 150))
_LONG = ((1000, 300),)
_LARGEST = (4000, 1000)
_VIEWS, _BOXES, _SMALL = (40, 80, 160), 125, ("320", "240")  # more views of the same boxes
_MANY_VIEWS = 5000
_LIMIT_MIB = 4096
_LOSS = ">= -0.02"  # of precision or recall from the smallest hall to the largest


def figures() -> list[Figure]:
    """CPU time, memory, precision and recall by size, and the power of the growth."""
    sizes = _SIZES + (_LONG if os.environ.get("GAGA_BENCH_LONG") else ())
    costs = [run(*size) for size in sizes]
    found = []
    for cost in costs:
        name = f"hall: {cost.objects} boxes, {cost.views} views"
        found += [
            Figure(f"{name}: association", cost.cpu_s, "CPU-s"),
            Figure(f"{name}: peak memory", cost.peak_mib, "MiB", f"<= {_LIMIT_MIB}"),
            Figure(f"{name}: precision", cost.precision, ""),
            Figure(f"{name}: recall", cost.recall, ""),
        ]
    small, large = costs[0], costs[-1]
    found += [
        Figure("hall: precision, largest - smallest", large.precision - small.precision, "", _LOSS),
        Figure("hall: recall, largest - smallest", large.recall - small.recall, "", _LOSS),
    ]
    views, seconds = [cost.views for cost in costs], [cost.cpu_s for cost in costs]
    power, base = np.polyfit(np.log(views), np.log(seconds), 1)
    n_boxes, n_views = _LARGEST
    expected = float(np.exp(base) * n_views**power)
    found += [
        Figure("hall: time grows with boxes and views to the power", float(power), ""),
        Figure(f"hall: expected of {n_boxes} boxes, {n_views} views", expected, "CPU-s"),
    ]
    return found + _more_views()


def _more_views() -> list[Figure]:
    """How time and memory grow with the views of one hall."""
    costs = [run(_BOXES, n, *_SMALL) for n in _VIEWS]
    seconds, memory = [cost.cpu_s for cost in costs], [cost.peak_mib for cost in costs]
    power = np.polyfit(np.log(_VIEWS), np.log(seconds), 1)[0]
    by_view, mib_by_view = (np.polyfit(_VIEWS, values, 1)[0] for values in (seconds, memory))
    name = f"hall: {_BOXES} boxes, 320x240"
    return [
        Figure(f"{name}: time grows with views to the power", float(power), "", "<= 1.15"),
        Figure(f"{name}: one view more", 1e3 * float(by_view), "CPU-ms"),
        Figure(f"{name}: memory that one view more takes", float(mib_by_view), "MiB"),
        Figure(f"{name}: expected of {_MANY_VIEWS} views", float(by_view) * _MANY_VIEWS, "CPU-s"),
    ]


def run(n_boxes: int, n_views: int, *size: str) -> Cost:
    """One run in a process of its own."""
    command = [sys.executable, "-m", "tests.bench.hall", str(n_boxes), str(n_views), *size]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return Cost(**json.loads(done.stdout))
