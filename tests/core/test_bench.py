"""The command that prints the figures: it compares, records, and goes on when one fails."""

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from tests.bench.__main__ import found, main
from tests.bench.figures import Figure
from tests.bench.record import change, read_record, write_record


def _run(path: Path, *arguments: str, fast: float = 10.0) -> tuple[int, str]:
    def broken() -> list[Figure]:
        raise ZeroDivisionError("of its own making")

    benchmarks = {
        "broken": broken,
        "speed": lambda: [Figure("draw", fast, "ms", "<= 12"), Figure("read", 3.0, "ms")],
        "size": lambda: [Figure("entry", 0.5, "bytes")],
    }
    out = io.StringIO()
    status = main(arguments, benchmarks, path, Console(file=out, width=150))
    return status, out.getvalue()


def test_a_benchmark_that_raises_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    status, text = _run(tmp_path / "record.json")
    assert status == 1
    assert "Failed: broken" in text
    assert "of its own making" in text
    assert "draw" in text and "entry" in text  # noqa: PT018


def test_the_last_value_and_the_change_stand_beside_a_figure(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    assert _run(path, "speed", "--record")[0] == 0
    status, text = _run(path, "speed", fast=12.5)
    assert status == 1  # the bar is missed
    row = next(line for line in text.splitlines() if "draw" in line and "│" in line)
    assert [cell.strip() for cell in row.strip("│ ").split("│")] == [
        *("draw", "12.5", "ms", "<= 12", "NO", "10", "+25 %")
    ]
    assert "Bar missed: draw" in text
    assert json.loads(path.read_text())["speed"]["draw"] == 10  # only --record records


def test_recording_replaces_what_was_measured_and_keeps_the_rest(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    write_record(path, {"speed": [Figure("gone", 1, "")], "broken": [Figure("kept", 2, "")]})
    _run(path, "--record")
    assert read_record(path) == {
        "broken": {"kept": 2},
        "size": {"entry": 0.5},
        "speed": {"draw": 10, "read": 3},
    }


def test_list_names_every_benchmark_and_runs_none(tmp_path: Path) -> None:
    status, text = _run(tmp_path / "record.json", "--list")
    assert (status, text.split()) == (0, ["broken", "size", "speed"])
    assert {"raster", "associate", "kernels"} <= set(found())


def test_a_wrong_name_is_said(tmp_path: Path) -> None:
    status, text = _run(tmp_path / "record.json", "spead")
    assert status == 2
    assert "'spead'" in text


@pytest.mark.parametrize(
    ("value", "last", "said"),
    [(3, None, "new"), (3, 3, "same"), (3, 4, "-25 %"), (-3, -4, "+25 %"), (0.5, 0, "+0.5")],
)
def test_changes_in_words(value: float, last: float | None, said: str) -> None:
    assert change(value, last) == said


def test_a_run_that_is_stopped_keeps_what_it_had_measured(tmp_path: Path) -> None:
    path = tmp_path / "record.json"

    def stopped() -> list[Figure]:
        raise KeyboardInterrupt

    benchmarks = {"first": lambda: [Figure("draw", 1.5, "ms")], "second": stopped}
    with pytest.raises(KeyboardInterrupt):
        main(["--record"], benchmarks, path, Console(file=io.StringIO()))
    assert read_record(path) == {"first": {"draw": 1.5}}
