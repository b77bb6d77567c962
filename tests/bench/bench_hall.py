"""Association of many objects: halls of boxes of growing size, and what each costs.

Views and splats grow with the boxes, so cost near linear means time in proportion to them. Every
run is a process of its own (`hall`). Small halls show the growth; ``GAGA_BENCH_LONG=1`` adds 1,000
boxes in 300 views, 4,000 in 1,000 views, and 125 in 5,000 views: some 1,000 CPU-seconds.
"""

import numpy as np

from tests.bench.figures import Figure, Line, is_long
from tests.bench.hall import Cost
from tests.bench.workers import run_worker

_SIZES = ((125, 40), (250, 75), (500, 150))
_LONG, _LARGEST = (1000, 300), (4000, 1000)
_VIEWS, _BOXES, _SMALL = (40, 80, 160), 125, ("320", "240")  # more views of the same boxes
_LONG_VIEWS = (640, 5000)
_LIMIT_MIB = 4096
_LOSS = ">= -0.02"  # of precision or recall


def figures() -> list[Figure]:
    """CPU time, memory, precision and recall by size, and the power of the growth."""
    costs = [run(*size) for size in _SIZES]
    found = [figure for cost in costs for figure in _of(cost)]
    found += _differences("largest - smallest", costs[-1], costs[0])
    if is_long():
        long = run(*_LONG)
        costs.append(long)
        found += _of(long) + _largest(long)
    views, seconds = [cost.views for cost in costs], [cost.cpu_s for cost in costs]
    power = np.polyfit(np.log(views), np.log(seconds), 1)[0]
    found.append(Figure("hall: time grows with boxes and views to the power", float(power), ""))
    return found + _more_views()


def _of(cost: Cost) -> list[Figure]:
    """What one hall took."""
    name = f"hall: {cost.objects} boxes, {cost.views} views"
    return [
        Figure(f"{name}: association", cost.cpu_s, "CPU-s"),
        Figure(f"{name}: peak memory", cost.peak_mib, "MiB", f"<= {_LIMIT_MIB}"),
        Figure(f"{name}: precision", cost.precision, ""),
        Figure(f"{name}: recall", cost.recall, ""),
    ]


def _largest(long: Cost) -> list[Figure]:
    """The largest hall, next to one of a fourth of its boxes."""
    largest = run(*_LARGEST)
    ratio = largest.cpu_s / long.cpu_s
    what = f"{largest.objects} boxes, {largest.views} views, to {long.objects}, {long.views}"
    return [
        *_of(largest),
        Figure(f"hall: {what}: time", ratio, "ratio", "<= 8"),
        *_differences(f"{largest.objects} - {long.objects} boxes", largest, long),
    ]


def _differences(name: str, one: Cost, other: Cost) -> list[Figure]:
    return [
        Figure(f"hall: precision, {name}", one.precision - other.precision, "", _LOSS),
        Figure(f"hall: recall, {name}", one.recall - other.recall, "", _LOSS),
    ]


def _more_views() -> list[Figure]:
    """How time and memory grow with the views of one hall."""
    views = _VIEWS + (_LONG_VIEWS if is_long() else ())
    costs = [run(_BOXES, n, *_SMALL) for n in views]
    seconds, memory = [cost.cpu_s for cost in costs], [cost.peak_mib for cost in costs]
    power = np.polyfit(np.log(views), np.log(seconds), 1)[0]
    line = Line.through(views, seconds)
    name = f"hall: {_BOXES} boxes, 320x240"
    found = [
        Figure(f"{name}: time grows with views to the power", float(power), "", "<= 1.15"),
        Figure(f"{name}: one view more", 1e3 * line.by_step, "CPU-ms"),
        Figure(f"{name}: largest miss of the line", line.largest_miss, "", "<= 0.1"),
        Figure(
            f"{name}: memory that one view more takes", Line.through(views, memory).by_step, "MiB"
        ),
    ]
    if is_long():
        found += [
            Figure(f"{name}, {views[-1]} views: association", seconds[-1], "CPU-s"),
            Figure(f"{name}, {views[-1]} views: peak memory", memory[-1], "MiB"),
        ]
    return found


def run(n_boxes: int, n_views: int, *size: str) -> Cost:
    """One run in a process of its own."""
    return Cost(**run_worker("tests.bench.hall", [str(n_boxes), str(n_views), *size]))
