"""The last recorded figures of each benchmark, and how far a new one is from them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.bench.figures import Figure

PATH = Path(__file__).with_name("record.json")
Record = Mapping[str, Mapping[str, float]]  # benchmark -> figure -> value


def read_record(path: Path) -> Record:
    """The recorded figures; empty when none were recorded yet."""
    if not path.is_file():
        return {}
    return json.loads(path.read_text(encoding="utf-8"))


def write_record(path: Path, measured: Mapping[str, Sequence[Figure]]) -> None:
    """Replace the figures of the benchmarks in ``measured``; those of all others stay.

    Four digits: more are noise, and a change of the file should mean something.
    """
    new = {
        name: {f.name: float(f"{f.value:.4g}") for f in figures}
        for name, figures in measured.items()
    }
    record = {**read_record(path), **new}
    path.write_text(json.dumps(record, indent=2, sort_keys=True) + "\n", encoding="utf-8")


def change(value: float, last: float | None) -> str:
    """How ``value`` differs from the last one: "+12 %", "same", or the difference from zero."""
    if last is None:
        return "new"
    if float(f"{value:.4g}") == last:
        return "same"
    if last == 0:
        return f"{value:+.3g}"
    return f"{100 * (value - last) / abs(last):+.0f} %"
