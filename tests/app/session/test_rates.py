"""How long tasks take beside other programs: what they use counts, what this one uses does not."""

import os
import time
from pathlib import Path

import pytest

from gaga_core.pipeline.compile_kernels import usual_seconds
from gaga_core.progress import Progress, Stage
from gaga_studio.session import rates, stages
from gaga_studio.session.rates import KnownRates, Load


class _Machine:
    """Processors, of which this program and others use some."""

    def __init__(self, patch: pytest.MonkeyPatch, n: int, threads: int) -> None:
        self.now = self.own = self.others = 0.0  # seconds
        patch.setattr(os, "cpu_count", lambda: n)
        patch.setattr(rates, "n_threads", lambda: threads)
        patch.setattr(rates, "_used_seconds", lambda: self.own + self.others)
        patch.setattr(time, "monotonic", lambda: self.now)
        patch.setattr(os, "times", lambda: (self.own / 2, self.own / 4, self.own / 4, 0, self.now))

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
    load, machine = Load(), _Machine(monkeypatch, n, threads)
    assert load.slowdown == 1.0, "not known yet"
    assert machine.run(load, 60, own, others) == pytest.approx(slowdown)
    assert machine.run(load, 30, own, 0) == pytest.approx(1.0), "only the last seconds count"


def test_a_rate_that_was_measured_beside_other_programs_is_that_of_a_free_machine(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A task of 20 s took 70 next to others, and afterwards 70 were expected of a free machine."""
    monkeypatch.setenv("GAGA_HOME", str(tmp_path))
    known, machine = KnownRates(), _Machine(monkeypatch, 2, 2)
    assert machine.run(known.load, 30, 0, 2) == pytest.approx(2.0)

    def stage() -> Stage[None]:
        yield Progress("Count", 0, 1)
        machine.now += 40

    for _ in known.timed(stage(), "Count", 20):
        pass
    assert known.rates["Count"] == pytest.approx(1.0)
    assert known.of("Count") == pytest.approx(2.0), "while they run"
    machine.run(known.load, 30, 0, 0)
    assert known.of("Count") == pytest.approx(1.0)
    assert KnownRates().of("Count") == pytest.approx(1.0)


@pytest.mark.parametrize("usual_s", [None, 20.0])
def test_only_of_work_whose_amount_is_known_a_rate_is_kept_and_a_time_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, usual_s: float | None
) -> None:
    """A film of 10 min has the name of a picture's task, for which 10 min were told next."""
    monkeypatch.setenv("GAGA_HOME", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))  # as in a new installation
    known, machine = KnownRates(), _Machine(monkeypatch, 2, 2)
    kernels_s = usual_seconds("window")

    def kernels(known: KnownRates, *parts: str) -> Stage[None]:
        for k in range(5):
            yield Progress("Prepare kernels", k, 4)

    def stage() -> Stage[None]:
        yield Progress("Draw", 0, 1)
        machine.now += 600

    monkeypatch.setattr(stages, "kernels_stage", kernels)
    for n in range(2):
        steps = list(stages.prepared(known, "Draw", stage, parts=("window",), usual_s=usual_s))
        lefts = [step.left_s for step in steps if "Prepare kernels" in step.message]
        work_s = 0 if usual_s is None else (20, 600)[n]
        assert lefts[0] == pytest.approx(kernels_s + work_s)
        assert lefts[-1] == pytest.approx(work_s)
    assert known.rates == ({} if usual_s is None else {"Draw": 30.0})
    assert (tmp_path / "rates.json").exists() is (usual_s is not None)


@pytest.mark.parametrize("content", [None, "", "cpu", "cpu a b c"])
def test_a_system_that_does_not_say_counts_as_free(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, content: str | None
) -> None:
    stat = tmp_path / "stat"
    if content is not None:
        stat.write_text(content)
    monkeypatch.setattr(rates, "_STAT", stat)
    load = Load()
    assert rates._used_seconds() is None
    load.look()
    assert load.slowdown == 1.0
