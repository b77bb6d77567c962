"""The command that prints the figures: it compares, records, and goes on when one fails."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from gaga_core.arrays import IntArray
from tests.bench.__main__ import found, main
from tests.bench.figures import Figure
from tests.bench.record import change, read_record, write_record
from tools.demo.shapes import Item
from tools.scenes.parts import N_OBJECTS, SamFaults, Thing, View, objects_of, sam_masks


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


# --- The benchmark of small objects of parts: each kind of fault is there, alone and at its rate.


NONE = SamFaults(parts=0, wholes=0, merge=0, miss=0, miss_small=0)
SIDE, N = 24, 12  # pixels of a tile, tiles along either side


def view(trait: float = 0.0) -> View:
    """Tiles apart from one another, each of two parts; the first six are tables, tile k > 6 stands
    on table k % 6."""
    parts = np.zeros((N * SIDE, N * SIDE), np.int32)
    wholes = np.zeros_like(parts)
    things = []
    for k in range(N * N):
        y, x = (SIDE * (k // N) + 2, SIDE * (k % N) + 2)
        size = 20 if k % 2 else 8
        wholes[y : y + size, x : x + size] = k + 1
        parts[y : y + size, x : x + size] = 2 * k + 1
        parts[y : y + size // 2, x : x + size] = 2 * k + 2
        things.append(Thing((), k % 6 if k >= 6 else -1))
    return View(parts, wholes, things, np.full(N * N + 1, trait))


def masks(v: View, f: SamFaults, seed: int = 0) -> IntArray:
    return sam_masks(v, np.random.default_rng(seed), f)


def owners(v: View, shown: IntArray, least: int = 8) -> list[set[int]]:
    """For each mask, the objects of which it has a good part."""
    found = []
    for m in range(1, int(shown.max()) + 1):
        ids, counts = np.unique(v.wholes[(shown == m) & (v.wholes > 0)], return_counts=True)
        found.append(set(ids[counts > least].tolist()))
    return found


def test_without_faults_every_object_is_one_mask() -> None:
    v = view()
    assert sorted(map(sorted, owners(v, masks(v, NONE)))) == [[k + 1] for k in range(N * N)]


def test_an_object_comes_as_its_parts_in_every_view_as_its_trait_says() -> None:
    v = view(trait=1.0)
    shown = masks(v, NONE)
    assert int(shown.max()) > 0.95 * 2 * N * N  # a few halves melt into crumbs
    for m in range(1, int(shown.max()) + 1):
        ids, counts = np.unique(v.parts[shown == m], return_counts=True)
        assert counts[ids > 0].max() > 0.6 * counts[ids > 0].sum()
    v.trait[:] = 0.5
    assert 1.3 * N * N < masks(v, NONE).max() < 1.7 * N * N


def test_a_whole_is_a_table_with_all_that_stands_on_it() -> None:
    v = view()
    sizes = sorted(len(one) for one in owners(v, masks(v, SamFaults(0, 3, 1, 0, 0, 0))))
    assert sizes == [N * N // 6] * 6


def test_small_things_are_missing_more_often_than_large_ones() -> None:
    v = view()
    f = SamFaults(parts=0, wholes=0, merge=0, miss=0.0, miss_small=0.6, small=0.002)
    seen: set[int] = set()
    n_small = n_large = 0
    for seed in range(5):
        seen = set().union(*owners(v, masks(v, f, seed)))
        n_small += sum(k % 2 == 1 for k in seen)  # id k + 1 of an even, small tile
        n_large += sum(k % 2 == 0 for k in seen)
    assert n_small < 0.75 * 5 * N * N / 2
    assert n_large > 0.85 * 5 * N * N / 2


def test_neighbours_melt_at_their_rate() -> None:
    """Tiles that touch: a merged pair takes one mask."""
    wholes = np.kron(np.arange(1, N * N + 1).reshape(N, N), np.ones((SIDE, SIDE))).astype(np.int32)
    things = [Thing((), -1)] * (N * N)
    v = View(2 * wholes, wholes, things, np.zeros(N * N + 1))
    f = SamFaults(parts=0, wholes=0, merge=0.12, miss=0, miss_small=0)
    pairs = [sum(len(one) > 1 for one in owners(v, masks(v, f, seed), 200)) for seed in range(6)]
    assert 0.07 < np.mean(pairs) / (N * N) < 0.14


@pytest.mark.parametrize("seed", [31, 35])
def test_objects_are_many_of_one_to_three_parts_and_repeat(seed: int) -> None:
    found, again = (objects_of(np.random.default_rng(seed)) for _ in range(2))
    assert len(found) == len(again) == N_OBJECTS
    n_parts = [len(thing.parts) for thing in found]
    assert set(n_parts) == {1, 2, 3}
    assert np.mean(np.array(n_parts) > 1) > 0.4
    items = zip([t.parts for t in found], [t.parts for t in again], strict=True)
    assert all(same(a, b) for a, b in items)


def same(a: tuple[Item, ...], b: tuple[Item, ...]) -> bool:
    return all(np.array_equal(x.matrix, y.matrix) for x, y in zip(a, b, strict=True))
