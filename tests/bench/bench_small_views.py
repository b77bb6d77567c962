"""Association of many small views with 768 masks each: whether its cost is linear in the views.

Every run is a process of its own (`small_views`). ``GAGA_BENCH_LONG=1`` adds 1,000, 2,000 and
5,000 views: some 670 CPU-seconds in all.
"""

from tests.bench.figures import Figure, Line, is_long
from tests.bench.workers import Costs, run_worker

_VIEWS, _LONG = (100, 250, 500), (1000, 2000, 5000)


def figures() -> list[Figure]:
    """Time, memory, precision and recall of the most views, and the line through all."""
    views = _VIEWS + (_LONG if is_long() else ())
    costs = [_run(n) for n in views]
    line = Line.through(views, [cost["cpu_s"] for cost in costs])
    memory = Line.through(views, [cost["peak_mib"] for cost in costs])
    last, name = costs[-1], f"small views: {views[-1]} of 768 masks"
    return [
        Figure(f"{name}: association", last["cpu_s"], "CPU-s"),
        Figure(f"{name}: peak memory", last["peak_mib"], "MiB", "<= 4096"),
        Figure(f"{name}: precision", last["precision"], ""),
        Figure(f"{name}: recall", last["recall"], ""),
        Figure("small views: one view more", 1e3 * line.by_step, "CPU-ms"),
        Figure("small views: memory that one view more takes", memory.by_step, "MiB"),
        Figure("small views: largest miss of the line", line.largest_miss, "", "<= 0.05"),
        Figure(
            f"small views: one more between {views[-2]} and {views[-1]}, to between "
            f"{views[0]} and {views[1]}",
            line.end_to_begin,
            "ratio",
            "<= 1.05",
        ),
    ]


def _run(n_views: int) -> Costs:
    return run_worker("tests.bench.small_views", [str(n_views)])
