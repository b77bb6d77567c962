"""Estimates of time while other programs run: their load counts, that of this program does not."""

import os
import time
from pathlib import Path

import pytest

from gaga_core.pipeline.compile_kernels import usual_seconds
from gaga_core.progress import Progress, Stage, run_stage
from gaga_studio.session import rates, stages
from gaga_studio.session.rates import KnownRates, Load


@pytest.fixture(autouse=True)
def home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path))


class _Machine:
    """Processors, of which this program and others use some."""

    def __init__(self, patch: pytest.MonkeyPatch, n: int, threads: int) -> None:
        self.now = self.own = self.others = 0.0  # seconds
        patch.setattr(os, "cpu_count", lambda: n)
        patch.setattr(rates, "n_threads", lambda: threads)
        patch.setattr(
            rates, "_used", lambda: rates._Used(self.now, self.own + self.others, self.own)
        )
        patch.setattr(time, "monotonic", lambda: self.now)

    def run(self, load: Load, seconds: int, own: float, others: float) -> float:
        """Use so many processors for a while; the slowdown then."""
        for _ in range(seconds):
            self.now, self.own, self.others = self.now + 1, self.own + own, self.others + others
            load.look()
        return load.slowdown


@pytest.mark.parametrize(
    ("n", "threads", "own", "others", "slowdown"),
    [
        (2, 2, 0, 0, 1.0),
        (2, 2, 2, 0, 1.0),  # this program alone
        (2, 2, 0, 2, 2.0),  # each of four threads gets half of a processor
        (2, 2, 1, 1, 1.5),
        (16, 16, 0, 8, 1.5),
        (16, 4, 0, 8, 1.0),  # four are free
    ],
)
def test_what_other_programs_use_slows_down(
    monkeypatch: pytest.MonkeyPatch, n: int, threads: int, own: int, others: int, slowdown: float
) -> None:
    machine = _Machine(monkeypatch, n, threads)
    load = Load()
    assert load.slowdown == 1.0, "not known yet"
    assert machine.run(load, 60, own, others) == pytest.approx(slowdown)
    assert machine.run(load, 30, own, 0) == pytest.approx(1.0), "only the last seconds count"


def test_a_rate_that_was_measured_beside_other_programs_is_that_of_a_free_machine(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A task of 20 s took 70 next to others, and afterwards 70 were expected of a free machine.
    They may begin with the task, or end with it."""
    machine = _Machine(monkeypatch, 2, 2)
    known = KnownRates()

    def stage() -> Stage[None]:
        yield Progress("Count", 0, 1)
        machine.run(known.load, 40, own=0, others=2)

    run_stage(known.timed(stage(), "Count", 20))
    assert known.rates["Count"] == pytest.approx(1.0)
    assert known.of("Count") == pytest.approx(2.0), "while they run"
    machine.run(known.load, 30, 0, 0)
    assert known.of("Count") == pytest.approx(1.0)
    assert KnownRates().of("Count") == pytest.approx(1.0)


@pytest.mark.parametrize("loading_s", [0.0, 30.0])
@pytest.mark.parametrize("stops_after", [1, 2, 9])
def test_kernels_tell_by_those_that_are_compiled(
    monkeypatch: pytest.MonkeyPatch, loading_s: float, stops_after: int
) -> None:
    """What is compiled already is loaded, in a time that is none of the steps that are missing;
    where little is, or was done when it was stopped, nothing is known."""
    machine = _Machine(monkeypatch, 2, 2)
    known = KnownRates()

    def kernels() -> Stage[None]:
        yield Progress("Prepare kernels", 0, 40)
        machine.now += loading_s  # of a step without a share
        for done in (0, 10, 20, 30, 40):
            yield Progress("Prepare kernels", done, 40)
            machine.now += 9.0

    stage = known.timed_kernels(kernels(), 12.0)
    for n, _ in enumerate(stage):
        if n > stops_after:
            stage.close()
            break
    wanted = {} if stops_after == 1 else {"Prepare kernels": pytest.approx(3.0)}
    assert KnownRates().rates == wanted


@pytest.mark.parametrize("usual_s", [None, 20.0])
def test_only_of_work_whose_amount_is_known_a_rate_is_kept_and_a_time_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, usual_s: float | None
) -> None:
    """A film of 5 min has the name of a picture's task, for which 5 min were told next."""
    monkeypatch.setenv("GAGA_HOME", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))  # as in a new installation
    known, machine = KnownRates(), _Machine(monkeypatch, 2, 2)
    kernels_s = usual_seconds("window")

    def kernels(known: KnownRates, *parts: str) -> Stage[None]:
        for k in range(5):
            yield Progress("Prepare kernels", k, 4)

    def stage() -> Stage[None]:
        yield Progress("Draw", 0, 1)
        machine.now += 300

    monkeypatch.setattr(stages, "kernels_stage", kernels)
    for n in range(2):
        steps = list(stages.prepared(known, "Draw", stage, parts=("window",), usual_s=usual_s))
        lefts = [step.left_s for step in steps if "Prepare kernels" in step.message]
        work_s = 0 if usual_s is None else (20, 300)[n]
        assert lefts[0] == pytest.approx(kernels_s + work_s)
        assert lefts[-1] == pytest.approx(work_s)
    assert known.rates == ({} if usual_s is None else {"Draw": 15.0})
    assert (tmp_path / "rates.json").exists() is (usual_s is not None)


@pytest.mark.parametrize("others", [0, 2])
@pytest.mark.parametrize("off", [0.3, 1.0, 5.0])
def test_a_task_tells_its_time_by_its_own_pace_and_the_next_one_at_once(
    monkeypatch: pytest.MonkeyPatch, off: float, others: int
) -> None:
    """Of a task that takes ``off`` times as long as usual, next to other programs or not."""
    machine, known, n = _Machine(monkeypatch, 2, 2), KnownRates(), 200
    slower = 2 if others else 1
    machine.run(known.load, 60, 0, others)

    def stage() -> Stage[None]:
        for k in range(n):
            yield Progress("Draw", k, n)
            for _ in range(3):
                machine.now += off * slower / 3
                machine.others += others * off * slower / 3
                known.load.look()

    for is_known in (False, True):
        began = machine.now
        for step in known.timed(stage(), "Draw", n):
            true = off * slower * (n - step.done)
            assert step.left_s is not None
            if is_known or (machine.now - began > 15 and step.done > n / 20):
                assert true / 1.1 <= step.left_s <= 1.1 * true


@pytest.mark.parametrize(("took_s", "is_kept"), [(0.5, False), (50, True)])
def test_a_task_that_is_hardly_more_than_its_start_says_nothing_of_the_next(
    monkeypatch: pytest.MonkeyPatch, took_s: float, is_kept: bool
) -> None:
    """A picture of 0.1 s took 0.5, and a film was told to take five times as long as usual."""
    machine, known = _Machine(monkeypatch, 2, 2), KnownRates()

    def stage() -> Stage[None]:
        yield Progress("Draw", 0, 1)
        machine.now += took_s

    run_stage(known.timed(stage(), "Draw", 0.1))
    assert ("Draw" in known.rates) is is_kept


@pytest.mark.parametrize("content", [None, "", "cpu", "cpu a b c"])
def test_a_system_that_does_not_say_counts_as_free(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, content: str | None
) -> None:
    stat = tmp_path / "stat"
    if content is not None:
        stat.write_text(content)
    monkeypatch.setattr(rates, "_STAT", stat)
    load = Load()
    assert rates._used() is None
    load.look()
    assert load.slowdown == 1.0
