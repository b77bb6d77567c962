"""Large scenes next to versions before, in one run: ``GAGA_BENCH_BEFORE=CHECKOUT`` (`before`).

Level of detail, association of many objects and of many small views, views that join later, and the
window with 5,000 groups. What a version lacks is left out. Without the variable nothing is
measured, and what was recorded stays.
"""

import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch

from tests.bench import bench_many_groups
from tests.bench.before import Costs, call_worker, checkouts, in_turns, run_worker, version
from tests.bench.figures import Figure
from tests.display import xvfb


@dataclass(frozen=True)
class _Compared:
    """Something that two versions do."""

    name: str
    run: Callable[[Path], Costs]
    ratios: Sequence[tuple[str, str]]  # what is said, and the field
    differences: Sequence[tuple[str, str]] = ()
    needs: str = ""  # a file or folder of the checkout


def figures() -> list[Figure]:
    """Ratios to each version before, and differences of what is counted in percent."""
    return [figure for former in checkouts() for figure in _to(former)]


def _to(former: Path) -> list[Figure]:
    found = []
    for compared in _COMPARED:
        if not (former / compared.needs).exists():
            continue
        now, was = in_turns(compared.run, former)
        name = f"{compared.name}, to {version(former)}"
        for said, field in compared.ratios:
            found.append(Figure(f"{name}: {said}", now[field] / was[field], "ratio"))
        for said, field in compared.differences:
            found.append(Figure(f"{name}: {said}", now[field] - was[field], "more"))
    return found


def _worker(module: str, *arguments: str) -> Callable[[Path], Costs]:
    return partial(run_worker, f"tests.bench.{module}", arguments)


def _lod(where: Path) -> Costs:
    """Each run builds a tree of its own."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = [folder, "1000000"]
        call_worker("tests.bench.lod_worker", arguments, where)  # writes the scene
        return run_worker("tests.bench.lod_worker", arguments, where)


def _window(where: Path) -> Costs:
    with tempfile.TemporaryDirectory() as home, xvfb(), patch.dict(os.environ, GAGA_HOME=home):
        call_worker("tests.bench.window_worker", [home])  # writes the scene
        return run_worker("tests.bench.window_worker", [home], where)


_COST = (("time", "cpu_s"), ("peak memory", "peak_mib"))
_FOUND = (("precision", "precision"), ("recall", "recall"))
_COMPARED = (
    _Compared(
        "1M splats",
        _lod,
        (
            ("CPU to build the tree", "build_s"),
            ("memory to build it", "build_mib"),
            ("CPU of a frame", "frame_ms"),
            ("CPU of a click", "pick_ms"),
        ),
        needs="gaga_core/scene/lod",
    ),
    _Compared("250 boxes, 75 views", _worker("hall", "250", "75"), _COST, _FOUND),
    _Compared("500 boxes, 150 views", _worker("hall", "500", "150"), _COST, _FOUND),
    _Compared("100 small views of 768 masks", _worker("small_views", "100"), _COST, _FOUND),
    _Compared(
        "views that join later",
        _worker("bench_joining"),
        (("time", "joining_s"), ("time of all at once", "whole_s")),
        (("IoU in percent", "joined"), ("IoU in percent of all at once", "whole")),
        needs="gaga_core/grouping/add_views.py",
    ),
    _Compared(
        "window, 200k splats",
        _window,
        (
            ("CPU to the first picture", "start_s"),
            ("CPU of a frame at rest", "rest_ms"),
            ("CPU of a frame in motion", "motion_ms"),
        ),
    ),
    _Compared(
        "window with 5,000 groups",
        partial(bench_many_groups.run, 5000),
        tuple(
            (f"a frame, {name}", name)
            for name in ("at rest", "scrolling", "another selection", "memory bank")
        ),
        needs="tests/bench/bench_many_groups.py",
    ),
)
