"""``python -m tests.bench [NAME ...]``: print every figure as a table.

Each ``bench_*.py`` next to this file has a function ``figures() -> list[Figure]``. Next to a
figure stands its last recorded value (`record.json`) and the change; ``--record`` records the new
ones. ``--tables`` measures nothing: it writes the tables of docs/performance.md from the record.
"""

import argparse
import importlib
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.bench.figures import Figure
from tests.bench.record import PATH, Record, change, read_record, write_record
from tests.bench.tables import PAGE, other_bars, with_tables

Benchmark = Callable[[], list[Figure]]
_HEADINGS = ("figure", "value", "unit", "bar", "met", "recorded", "change")


def main(
    arguments: Sequence[str],
    benchmarks: Mapping[str, Benchmark],
    record_path: Path,
    out: Console,
) -> int:
    """Run the named benchmarks, all when none is named.

    0 when every bar is met and is that of the page, else 1; 2 when a name is wrong. A
    benchmark that raises is named with its traceback, and the rest goes on; its recorded figures
    stay as they were.
    """
    asked = _parse(arguments)
    if asked.list:
        out.print("\n".join(sorted(benchmarks)))
        return 0
    if asked.tables:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(with_tables(page, read_record(record_path)), encoding="utf-8")
        return 0
    unknown = [name for name in asked.names if name not in benchmarks]
    if unknown:
        out.print(f"There is no benchmark {unknown[0]!r}. Choose from {', '.join(benchmarks)}.")
        return 2
    before = read_record(record_path)
    chosen = {name: benchmarks[name] for name in asked.names or sorted(benchmarks)}
    measured, failed = _measure(chosen, record_path if asked.record else None, out)
    out.print(_table(measured, before))
    if asked.record:
        out.print(f"Recorded in {record_path.name}. --tables writes {PAGE.name} again.")
    every = [figure for figures in measured.values() for figure in figures]
    missed = [figure.name for figure in every if not figure.holds]
    others = other_bars(every)
    for name in missed:
        out.print(f"Bar missed: {name}", markup=False)
    for name in others:
        out.print(f"Another bar in tables.py: {name}", markup=False)
    for name in failed:
        out.print(f"Failed: {name}", markup=False)
    return 1 if missed or others or failed else 0


def _parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="benchmarks; default: all")
    parser.add_argument("--record", action="store_true", help="record the figures as the last ones")
    parser.add_argument("--list", action="store_true", help="list the benchmarks and end")
    parser.add_argument("--tables", action="store_true", help=f"write the tables of {PAGE.name}")
    return parser.parse_args(arguments)


def _measure(
    benchmarks: Mapping[str, Benchmark], record_path: Path | None, out: Console
) -> tuple[dict[str, list[Figure]], list[str]]:
    """Figures of each benchmark that came to its end, and the names of those that did not.

    With a ``record_path`` each is recorded at its end, so that a run that is stopped keeps them.
    """
    measured: dict[str, list[Figure]] = {}
    failed = []
    for name, benchmark in benchmarks.items():
        start = time.perf_counter()
        try:
            measured[name] = benchmark()
        except Exception:  # noqa: BLE001  whatever one benchmark raises must not cost the others
            failed.append(name)
            out.print(f"{name} failed:\n{traceback.format_exc()}", markup=False, highlight=False)
        else:
            if record_path is not None:
                write_record(record_path, {name: measured[name]})
        out.print(f"{name}: {time.perf_counter() - start:.0f} s", style="dim", highlight=False)
    return measured, failed


def _table(measured: Mapping[str, Sequence[Figure]], record: Record) -> Table:
    table = Table(*_HEADINGS)
    for benchmark, figures in measured.items():
        for figure in figures:
            last = record.get(benchmark, {}).get(figure.name)
            met = "" if not figure.bar else ("yes" if figure.holds else "NO")
            shown = "" if last is None else f"{last:.4g}"
            difference = change(figure.value, last) if record else ""
            table.add_row(
                figure.name, f"{figure.value:.4g}", figure.unit, figure.bar, met, shown, difference
            )
    return table


def _figures_of(name: str) -> list[Figure]:
    return importlib.import_module(f"tests.bench.bench_{name}").figures()


def found() -> dict[str, Benchmark]:
    """Every benchmark of this folder by name; its module is imported when it runs."""
    files = Path(__file__).parent.glob("bench_*.py")
    names = sorted(p.stem.removeprefix("bench_") for p in files)
    return {name: partial(_figures_of, name) for name in names}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], found(), PATH, Console(width=150)))
