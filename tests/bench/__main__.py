"""``python -m tests.bench [NAME ...]``: print every figure as a table.

Each ``bench_*.py`` beside this file has a function ``figures() -> list[Figure]``.
"""

import importlib
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table


def main() -> int:
    """Run the named benchmarks (all when none is named); 1 when a bar is missed."""
    found = sorted(p.stem.removeprefix("bench_") for p in Path(__file__).parent.glob("bench_*.py"))
    wanted = sys.argv[1:] or found
    table = Table("figure", "value", "unit", "bar", "met")
    missed = 0
    for name in wanted:
        for figure in importlib.import_module(f"tests.bench.bench_{name}").figures():
            missed += not figure.holds
            met = "" if not figure.bar else ("yes" if figure.holds else "NO")
            table.add_row(figure.name, f"{figure.value:.4g}", figure.unit, figure.bar, met)
    Console(width=130).print(table)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
