"""The job runner: everything arrives on the main thread, a cancel leaves nothing."""

import logging
import threading
import time

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.progress import Progress, Stage
from gaga_studio.session import jobs
from gaga_studio.session.jobs import JobRunner
from gaga_studio.session.notices import Level

Said = list[tuple[Level, str]]


def _runner() -> tuple[JobRunner, Said]:
    said: Said = []

    def failed(_title: str, text: str) -> None:
        said.append((Level.ERROR, text))

    return JobRunner(lambda level, text: said.append((level, text)), failed), said


def _count(n: int, pause_s: float = 0.0) -> Stage[int]:
    for i in range(n):
        time.sleep(pause_s)
        yield Progress("Count", i + 1, n, f"number {i}", payload=i)
    return n


def test_value_and_newest_payload_arrive_in_the_polling_thread() -> None:
    runner, said = _runner()
    threads, payloads, values = set(), [], []

    def progress(payload: object) -> None:
        threads.add(threading.get_ident())
        payloads.append(payload)

    def done(value: int) -> None:
        threads.add(threading.get_ident())
        values.append(value)

    assert runner.start("Count", _count(50), progress, done)
    assert runner.wait()
    assert values == [50]
    assert payloads
    assert payloads[-1] == 49
    assert threads == {threading.get_ident()}
    assert said == []
    assert runner.running is None


@pytest.mark.parametrize("writes", [True, False])
def test_what_is_written_is_told_though_cancel_came_in_the_last_step(writes: bool) -> None:
    """A film that was cancelled at its end had taken the place of the old one without a word."""
    runner, said = _runner()
    begun, goes_on = threading.Event(), threading.Event()
    values: list[int] = []

    def stage() -> Stage[int]:
        yield Progress("Write", 0, 1)
        begun.set()
        assert goes_on.wait(10)
        return 1

    runner.start("Write", stage(), on_done=values.append, writes=writes)
    assert begun.wait(10)
    runner.cancel()
    goes_on.set()
    assert runner.wait(5)
    assert values == [1] * writes
    assert [text for _, text in said] == ["Cancelled: Write."] * (not writes)


def test_cancel_closes_the_stage_and_delivers_no_value() -> None:
    runner, said = _runner()
    closed: list[bool] = []
    values: list[int] = []
    ends: list[bool] = []

    def stage() -> Stage[int]:
        try:
            yield from _count(10_000, 0.001)
        finally:
            closed.append(True)
        return 1

    work = stage()  # held here, so that only the runner can have closed it
    runner.start("Count", work, on_done=values.append, on_end=lambda: ends.append(True))
    time.sleep(0.02)
    runner.cancel()
    assert runner.running is not None
    assert runner.running.is_cancelling
    assert runner.wait(5)
    assert closed == [True]
    assert ends == [True]
    assert values == []
    assert said == [(Level.HINT, "Cancelled: Count.")]
    said.clear()
    runner.start("Count", _count(10_000, 0.001))
    runner.drop()
    assert runner.wait(5)
    assert said == [], "nobody asked for that"


def test_error_of_the_user_becomes_its_sentence() -> None:
    runner, said = _runner()
    ends = []

    def stage() -> Stage[int]:
        yield Progress("Look", 0, 1)
        raise GagaError("There is no such file. Choose another.")

    runner.start("Look", stage(), on_end=lambda: ends.append(True))
    assert runner.wait()
    assert said == [(Level.ERROR, "There is no such file. Choose another.")]
    assert ends == [True]


def test_any_other_error_is_kept_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    runner, said = _runner()

    def stage() -> Stage[int]:
        yield Progress("Divide", 0, 1)
        return 1 // 0

    with caplog.at_level(logging.ERROR):
        runner.start("Divide", stage())
        assert runner.wait()
    assert said[0][0] is Level.ERROR
    assert "Divide" in said[0][1]
    assert "log file" in said[0][1]
    assert "ZeroDivisionError" in caplog.text


def test_error_in_taking_the_value_over_is_a_notice_too() -> None:
    runner, said = _runner()

    def refuse(_: int) -> None:
        raise GagaError("This result does not fit.")

    runner.start("Count", _count(1), on_done=refuse)
    assert runner.wait()
    assert said == [(Level.ERROR, "This result does not fit.")]
    assert runner.start("Count", _count(1))
    assert runner.wait()


def test_one_job_at_a_time() -> None:
    runner, said = _runner()
    values: list[int] = []
    second = _count(3)
    runner.start("First", _count(200, 0.001), on_done=values.append)
    assert not runner.start("Second", second, on_done=values.append)
    assert said == [(Level.WARNING, "First is still running. Wait for it, or cancel it.")]
    assert runner.wait()
    assert values == [200]
    with pytest.raises(StopIteration):
        next(second)  # it was closed


class _Told:
    """A stage whose words come when the clock says, and what is said of it to the user."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.word = 0.0, Progress("", 0, 0)
        monkeypatch.setattr("gaga_studio.session.jobs.time.monotonic", lambda: self.now)
        self._delivery = jobs._Delivery(self._stage(), None, None, None)

    def _stage(self) -> Stage[None]:
        while True:
            yield self.word

    def hear(self, at: float, done: float, total: int, stage: str = "Train") -> float | None:
        """Hear a word at ``at`` seconds; returns what is left then."""
        self.now, self.word = at, Progress(stage, done, total)
        self._delivery.step()
        return self._delivery.seconds_left()

    def left(self, at: float) -> float | None:
        """What is left at ``at`` seconds, without a word."""
        self.now = at
        return self._delivery.seconds_left()

    @property
    def fraction(self) -> float:
        return self._delivery.fraction


def test_rate_gives_the_time_that_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of a step that goes on where an earlier run stopped, after one that took its own."""
    told = _Told(monkeypatch)
    assert told.hear(0, 0, 0, "Look") is None
    assert told.hear(300, 1, 1, "Look") is None
    lefts = [told.hear(300 + 2 * k, 900 + k, 1000) for k in range(90)]
    assert lefts[1] is None, "no rate yet"
    known = [(k, left) for k, left in enumerate(lefts) if left is not None]
    assert known[0][0] == 9, "after 15 s, and a twentieth of what was left at first"
    for k, left in known:
        assert left == pytest.approx(2 * (100 - k)), "at the rate of what is done now"


def test_the_time_left_counts_down_during_a_long_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """It grew while one step of many took its time, as half of all kernels do."""
    told = _Told(monkeypatch)
    for at in (0, 20, 40):
        told.hear(at, at, 100)
    assert [told.left(at) for at in (40, 70, 100)] == pytest.approx([60, 30, 0])
    assert told.left(110) == pytest.approx(30, rel=0.05), "overdue"


def test_a_time_that_a_stage_knows_grows_again_once_it_is_overdue(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A large picture, of which no word comes, had no time left for half of its time."""
    told = _Told(monkeypatch)
    monkeypatch.setattr(jobs, "_FOLLOWS_S", 1e-3)
    told.word = Progress("Draw", 0, 2, left_s=30.0)
    told._delivery.step()
    lefts = [told.left(float(at)) for at in (0, 20, 30, 60, 150)]
    assert lefts == pytest.approx([30, 10, 0, 30, 120])


@pytest.mark.parametrize("prepared_s", [0.0, 0.5, 40.0])
@pytest.mark.parametrize("word_s", [0.02, 0.3, 3.0])
def test_a_first_word_that_waited_does_not_spoil_the_time_left(
    prepared_s: float, word_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels are compiled in the first view of many: minutes for one, then none. The first time
    that is said is right, and none is said by a moment."""
    told, n = _Told(monkeypatch), round(100 / word_s)
    assert told.hear(0, 0, n, "Look") is None
    first = 0.0
    for done in range(1, n + 1):
        at = prepared_s + word_s * done
        left = told.hear(at, done, n, "Look")
        if left is not None:
            first = first or at
            assert left == pytest.approx(word_s * (n - done), abs=1e-6)
    assert 15 <= first - prepared_s <= 21
    assert told.hear(at, 0, 10, "Fill") is None


@pytest.mark.parametrize("seed", range(10))
def test_the_share_that_is_shown_never_falls(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever a stage says: steps that come again, a share that is not known any more."""
    told, rng, before = _Told(monkeypatch), np.random.default_rng(seed), -1.0
    for at in range(200):
        total = int(rng.integers(0, 9))
        told.hear(at, float(rng.uniform(0, total + 1)), total, str(rng.choice(["Look", "Fill"])))
        assert before <= told.fraction <= 1
        assert (told.fraction < 0) == (before < 0 and total == 0), "known from its first share on"
        before = told.fraction


@pytest.mark.parametrize("known_s", [0.5, 4.0])
def test_a_step_whose_rest_says_nothing_of_itself_has_no_time_left(
    known_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """*Simulate* said 2 min 45 s at 20 % for the last ten: the surface was meshed at once, and the
    search for convex parts said only that it went on."""
    told, at = _Told(monkeypatch), 0.0
    for k in range(100):
        at = known_s * k / 100
        assert told.hear(at, k / 250, 2) is None
    while at < 60:
        at += 0.1
        assert told.hear(at, 0.4, 2) is None


@pytest.mark.parametrize("load", [1 / 3, 1 / 2, 2, 3])
def test_a_change_of_load_moves_the_time_left_within_seconds_and_without_a_jump(
    load: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A film's time left went from 49 s to 77 s and back to 51 s in 4 s; that of a training grew
    from 84 s to five minutes over more than one."""
    told, at, before = _Told(monkeypatch), 0.0, None
    changed = float("inf")
    for done in range(2000):
        word_s = 0.1 if done < 600 else 0.1 * load
        changed = at if done == 600 else changed
        at += word_s
        left = told.hear(at, done, 2000)
        true = word_s * (1999 - done)
        if left is not None and before is not None:
            assert abs(left - before + word_s) <= 0.1 * max(left, before, 10.0)
        if at - changed > 20 and true > 5:
            assert true / 1.5 < (left or 0.0) < 1.5 * true
        before = left


def test_a_quiet_job_runs_in_parallel_and_stops_none() -> None:
    runner, said = _runner()
    go = threading.Event()
    values: list[int] = []

    def waits() -> Stage[None]:
        yield Progress("Prepare kernels", 1, 4, "votes")
        go.wait(10)

    assert runner.start_quiet("Prepare kernels", waits())
    assert not runner.start_quiet("Prepare kernels", waits())  # one is enough
    assert runner.running is None
    assert runner.start("Count", _count(5), on_done=values.append)
    assert runner.wait()
    assert values == [5]
    assert runner.quiet is not None
    assert (runner.quiet.stage, runner.quiet.fraction) == ("Prepare kernels", 0.25)
    go.set()
    _until_quiet_ends(runner)
    assert said == []


def test_a_quiet_job_fails_into_the_log_alone(caplog: pytest.LogCaptureFixture) -> None:
    runner, said = _runner()

    def fails() -> Stage[None]:
        yield Progress("Prepare kernels", 0, 1)
        raise OSError("the disk is full")

    with caplog.at_level(logging.ERROR):
        runner.start_quiet("Prepare kernels", fails())
        _until_quiet_ends(runner)
    assert said == []
    assert "the disk is full" in caplog.text


def test_shutting_down_ends_the_quiet_job() -> None:
    runner, _ = _runner()
    closed = threading.Event()

    def endless() -> Stage[None]:
        try:
            yield from _count(10_000, 0.001)
        finally:
            closed.set()

    runner.start_quiet("Prepare kernels", endless())
    runner.shut_down()
    assert closed.is_set()
    assert runner.quiet is None


def test_quiet_jobs_run_beside_what_is_prepared() -> None:
    """Names of objects waited for all kernels, two minutes on a new installation."""
    runner, _ = _runner()
    closed = threading.Event()

    def endless() -> Stage[None]:
        try:
            yield from _count(100_000, 0.001)
        finally:
            closed.set()

    runner.prepare("Prepare kernels", endless())
    assert runner.start_quiet("Measure the objects", _count(5))
    _until_quiet_ends(runner)
    assert runner.preparing is not None
    runner.shut_down()
    assert closed.is_set()
    assert runner.preparing is None


def _until_quiet_ends(runner: JobRunner) -> None:
    end = time.monotonic() + 10
    while runner.quiet is not None:
        assert time.monotonic() < end
        time.sleep(0.002)
        runner.poll()


def test_a_job_gives_way_to_one_that_concerns_something_else_and_exports_wait() -> None:
    runner, said = _runner()
    values: list[int] = []
    ends: list[str] = []
    runner.start(
        "Prepare clicks",
        _count(10_000, 0.001),
        on_done=values.append,
        on_end=lambda: ends.append("prepared"),
        gives_way=True,
    )
    assert runner.why_busy == ""
    assert runner.at_risk is None
    assert runner.start("Open", _count(3), on_done=values.append)
    assert runner.why_busy == "Open is still running."
    assert not runner.start("Find objects", _count(1))
    assert runner.start("Export", _count(5), on_done=values.append, waits=True)
    assert runner.wait()
    assert ends == ["prepared"]
    assert values[-2:] == [3, 5]
    assert said == [
        (Level.WARNING, "Open is still running. Wait for it, or cancel it."),
        (Level.HINT, "Waits for Open: Export."),
    ]
