"""Run one stage at a time in a thread, with progress, cancel and errors; a save runs in parallel.

A stage that nobody waits for gives way to any other, and one that concerns nothing else waits.

The worker never touches the scene: what a stage yields and returns is handed over by ``poll``,
which the main thread calls every frame.
"""

import logging
import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

from gaga_core.errors import GagaError
from gaga_core.io.files import explain_os_error
from gaga_core.progress import RECENT_S, TELLING, Pace, Progress, Share, Stage, heard
from gaga_studio.session.notices import Level
from gaga_studio.system.paths import failure

T = TypeVar("T")
Notify = Callable[[Level, str], None]
_LOG = logging.getLogger(__name__)
_QUIET_STEP_S = 60.0  # longest step of a quiet job: seconds of compiling, on a busy machine
_FOLLOWS_S = 3.0  # in which what is said follows two thirds of a change: it takes that to read it


@dataclass(frozen=True)
class Job:
    """Status of the running work for panels."""

    title: str
    stage: str  # the step it is in; the title until the first progress
    message: str
    fraction: float  # 0..1 of the whole, never less than before; -1 while unknown
    eta_s: float | None  # seconds left; None while unknown
    is_cancelling: bool
    resumes: bool  # another run goes on where it ended


class JobRunner:
    """One worker thread at most, one for saves, and one for a quiet job that no user started.

    Saves work on values of their own, so they run next to any job, one after the other.
    ``notify`` gets the sentence when a job fails or was cancelled, and those that it said
    (`gaga_core.progress.say`) when it is done; a quiet one fails into the log. ``failed`` gets the
    title of a job and why it failed; ``begins`` the title of one that the user starts.
    """

    def __init__(
        self,
        notify: Notify,
        failed: Callable[[str, str], None],
        begins: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._notify, self._failed, self._begins = notify, failed, begins
        self._worker: _Worker | None = None
        self._waiting: deque[_Worker] = deque()  # for the worker
        self._quiet: _Worker | None = None
        self._preparing: _Worker | None = None
        self._saver: _Worker | None = None
        self._saves: deque[_Worker] = deque()  # they wait for the saver

    @property
    def running(self) -> Job | None:
        """The job, else the save that runs, until ``poll`` has delivered its end."""
        worker = self._worker or self._saver
        return worker.describe() if worker is not None else None

    @property
    def why_busy(self) -> str:
        """Sentence on what runs; "" when nothing does, or only what gives way."""
        ahead = self._ahead() or [one for one in (self._saver,) if one is not None]
        return f"{ahead[0].title} is still running." if ahead else ""

    @property
    def at_risk(self) -> Job | None:
        """The job that is lost when the program ends now; saves are waited for.

        It ``resumes`` where all that wait for it do, too.
        """
        ahead = self._ahead()
        if not ahead:
            return None
        return replace(ahead[0].describe(), resumes=all(one.resumes for one in ahead))

    def start(  # noqa: PLR0913 - all that a job may be
        self,
        title: str,
        stage: Stage[T],
        on_progress: Callable[[object], None] | None = None,
        on_done: Callable[[T], None] | None = None,
        on_end: Callable[[], None] | None = None,
        *,
        gives_way: bool = False,
        waits: bool = False,
        resumes: bool = False,
        writes: bool = False,
    ) -> bool:
        """Run ``stage`` in a thread; False, and a notice, when another job runs.

        A job that ``gives_way`` ends, without a value, for any other that is started; one that
        ``waits`` starts after the one that runs, so it must work on values of its own. Of one that
        ``resumes`` another run goes on where it ended. What one that ``writes`` files has made is
        there, and told, also where the user's Cancel came in its last step.

        ``on_progress`` gets the newest payload, ``on_done`` the value; ``on_end`` is called last
        in every case: done, failed, cancelled. All are called by ``poll``.
        """
        ahead = self._ahead()
        if ahead and not waits:
            stage.close()
            text = f"{ahead[-1].title} is still running. Wait for it, or cancel it."
            self._notify(Level.WARNING, text)
            return False
        if ahead:
            self._notify(Level.HINT, f"Waits for {ahead[-1].title}: {title}.")
        self._begins(title)
        worker = _Worker(title, _Delivery(stage, on_progress, on_done, on_end))
        worker.gives_way, worker.resumes, worker.writes = gives_way, resumes, writes
        if self._worker is not None and self._worker.gives_way:
            self._worker.cancel()
        self._waiting.append(worker)
        self._next()
        return True

    def start_save(
        self,
        title: str,
        stage: Stage[T],
        on_done: Callable[[T], None],
        on_error: Callable[[GagaError], bool],
    ) -> None:
        """Run ``stage`` next to the job, after the saves that were started before.

        ``on_error`` gets what the user can fix; when it returns False the error is a notice.
        """
        self._begins(title)
        self._saves.append(_Worker(title, _Delivery(stage, None, on_done, None), on_error))
        self._next_save()

    @property
    def quiet(self) -> Job | None:
        """The quiet job that runs in parallel; it stops no other and the user cannot cancel it."""
        return self._quiet.describe() if self._quiet is not None else None

    def start_quiet(self, title: str, stage: Stage[object]) -> bool:
        """Run ``stage`` in a thread of its own, without a result; False when one runs already."""
        if self._quiet is not None:
            stage.close()
            return False
        self._quiet = _Worker(title, _Delivery(stage, None, None, None))
        self._quiet.start()
        return True

    @property
    def preparing(self) -> Job | None:
        """What is prepared in parallel to all other jobs."""
        return self._preparing.describe() if self._preparing is not None else None

    def prepare(self, title: str, stage: Stage[object]) -> None:
        """Run ``stage`` in a thread of its own, without a result, unless one runs already: what
        later work would otherwise wait for."""
        if self._preparing is not None:
            stage.close()
            return
        self._preparing = _Worker(title, _Delivery(stage, None, None, None))
        self._preparing.start()

    def poll(self) -> None:
        """Hand over what the workers have produced since the last call. Main thread only."""
        for ended in (self._quiet, self._preparing):
            if ended is not None and not ended.is_alive() and ended.error is not None:
                _LOG.error("%s failed", ended.title, exc_info=ended.error)
        self._quiet = _while_alive(self._quiet)
        self._preparing = _while_alive(self._preparing)
        self._poll_save()
        worker = self._worker
        if worker is None:
            return
        is_finished = not worker.is_alive()
        if not worker.is_cancelling:
            worker.delivery.progress()
        if not is_finished:
            return
        worker.join()
        self._worker = None
        try:
            self._finish(worker)
        finally:
            self._next()

    def cancel(self) -> None:
        """Ask the job to stop at its next step; all stays as it was before it, but for what one
        that writes has written. That is said when it has ended."""
        worker = self._worker or self._saver
        if worker is not None:
            worker.says_cancelled = True
            worker.cancel()

    def drop(self) -> None:
        """Ask the job to stop, without a word: who started it has no more use for it."""
        worker = self._worker or self._saver
        if worker is not None:
            worker.cancel()

    def wait(self, timeout_s: float = 60.0) -> bool:
        """Poll until nothing runs (scripts and tests); False when the time is up."""
        end = time.monotonic() + timeout_s
        while (worker := self._worker or self._saver) is not None and time.monotonic() < end:
            worker.join(0.005)
            self.poll()
        return self._worker is None and self._saver is None

    def shut_down(self, timeout_s: float = 5.0) -> None:
        """Cancel and wait, without delivering anything: the window is closing.

        Saves are not cancelled.
        """
        while self._waiting:
            self._waiting.pop().delivery.stage.close()
        # A compiler that is cut off by the end of the process may abort it: wait for its step.
        quiet = (self._quiet, _QUIET_STEP_S), (self._preparing, _QUIET_STEP_S)
        ending = ((self._worker, timeout_s), *quiet)
        for worker, _ in ending:
            if worker is not None:
                worker.cancel()
        for worker, seconds in ending:
            if worker is not None:
                worker.join(seconds)
        self._worker = self._quiet = self._preparing = None
        while self._saver is not None:
            self._saver.join()
            self._saver = None
            self._next_save()

    def _ahead(self) -> "list[_Worker]":
        """What runs or waits and does not give way."""
        return [one for one in (self._worker, *self._waiting) if one and not one.gives_way]

    def _next(self) -> None:
        if self._worker is None and self._waiting:
            firm = (one for one in self._waiting if not one.gives_way)
            self._worker = next(firm, self._waiting[0])
            self._waiting.remove(self._worker)
            self._worker.start()

    def _next_save(self) -> None:
        if self._saver is None and self._saves:
            self._saver = self._saves.popleft()
            self._saver.start()

    def _poll_save(self) -> None:
        saver = self._saver
        if saver is not None and not saver.is_alive():
            self._saver = None
            self._next_save()
            self._finish(saver)

    def _finish(self, worker: "_Worker") -> None:
        error = worker.error
        if isinstance(error, OSError) and error.filename is not None:  # a name too long, a disk
            _LOG.warning("%s: %s", worker.title, error)
            error = GagaError(explain_os_error(error, Path(os.fsdecode(error.filename))))
        try:
            if isinstance(error, GagaError):
                if worker.on_error is None or not worker.on_error(error):
                    self._failed(worker.title, str(error))
            elif error is not None:
                _LOG.error("%s failed", worker.title, exc_info=error)
                self._failed(worker.title, failure(worker.title))
            elif worker.has_value and (worker.writes or not worker.is_cancelling):
                self._deliver(worker)
            elif worker.says_cancelled:
                self._notify(Level.HINT, f"Cancelled: {worker.title}.")
        finally:
            worker.delivery.end()

    def _deliver(self, worker: "_Worker") -> None:
        for text in dict.fromkeys(worker.said):
            self._notify(Level.WARNING, text)
        try:
            worker.delivery.done()
        except GagaError as error:
            self._failed(worker.title, str(error))


def _while_alive(worker: "_Worker | None") -> "_Worker | None":
    return worker if worker is not None and worker.is_alive() else None


class _Delivery(Generic[T]):
    """A stage and the callbacks for its results."""

    def __init__(
        self,
        stage: Stage[T],
        on_progress: Callable[[object], None] | None,
        on_done: Callable[[T], None] | None,
        on_end: Callable[[], None] | None,
    ) -> None:
        self.stage = stage
        self._on_progress, self._on_done, self._on_end = on_progress, on_done, on_end
        self._value: T | None = None
        self._payload: object = None
        self.latest: Progress | None = None
        self._heard_at = 0.0  # time of the newest word
        self._said: tuple[float, float] | None = None  # when, and how many seconds were left
        self._paces: dict[str, Pace] = {}  # of the steps that have a share
        self._share = Share()

    def seconds_left(self, word: Progress | None = None) -> float | None:
        """Seconds left, as the user reads them: None until enough is measured; they count down, and
        what they are wrong by is made good within seconds, without a jump.

        ``word`` is the one that is shown with them, by default the newest.
        """
        now, left = time.monotonic(), self._measured_left(word or self.latest)
        if left is None:
            self._said = None
            return None
        if self._said is not None:
            at, before = self._said
            expected = max(before - (now - at), 0.0)
            left = expected + (left - expected) * (1 - math.exp(-(now - at) / _FOLLOWS_S))
        self._said = now, left
        return left

    def _measured_left(self, latest: Progress | None) -> float | None:
        """Estimate of the time left in the present step; None while it is not known.

        Goes on at the pace of the last part (`Pace`): a first word that waited for kernels, what a
        resumed training had behind it and the steps before say nothing.
        """
        now = time.monotonic()
        if latest is None:
            return None
        if latest.left_s is not None:
            # It counts down while no word comes; what is overdue takes as long as it is, once more.
            return abs(latest.left_s - (now - self._heard_at))
        if latest.total <= 0:
            return None
        pace = self._paces[latest.stage]
        done = min(latest.done / latest.total, 1.0) - pace.first
        is_measured = pace.measured_s >= RECENT_S and done >= TELLING * (1 - pace.first)
        return pace.left(now) if is_measured else None

    @property
    def fraction(self) -> float:
        """Share 0..1 of all: stages of several steps tell that of the whole (`joined`, `part`,
        `portion`), and what one does not join stands still, and never goes back; -1 while
        unknown."""
        return self._share.furthest if self._share.is_known else -1.0

    def step(self) -> bool:
        """One step of the stage, in the worker; False at its end."""
        try:
            progress = next(self.stage)
        except StopIteration as end:
            self._value = end.value
            return False
        if progress.payload is not None:
            self._payload = progress.payload
        self._share.of(progress)
        self._heard_at = time.monotonic()
        if progress.total > 0:
            pace = self._paces.setdefault(progress.stage, Pace())
            pace.hear(self._heard_at, progress.done / progress.total)
        self.latest = progress
        return True

    def progress(self) -> None:
        """Deliver the newest payload, once."""
        payload, self._payload = self._payload, None
        if payload is not None and self._on_progress is not None:
            self._on_progress(payload)

    def done(self) -> None:
        """Deliver the value."""
        if self._on_done is not None:
            self._on_done(self._value)  # type: ignore[arg-type]  # None is a T where it is returned

    def end(self) -> None:
        """Say that nothing more comes."""
        if self._on_end is not None:
            self._on_end()


class _Worker(threading.Thread):
    """Drives one stage."""

    def __init__(
        self,
        title: str,
        delivery: "_Delivery[T]",
        on_error: Callable[[GagaError], bool] | None = None,
    ) -> None:
        super().__init__(name=f"job: {title}", daemon=True)
        self.title = title
        self.delivery = delivery
        self.on_error = on_error
        self.gives_way = self.resumes = self.writes = False
        self.says_cancelled = False  # the user asked for it
        self.error: Exception | None = None
        self.said: list[str] = []  # sentences for the user: what readers left out, say
        self.has_value = False
        self._started_at = time.monotonic()
        self._stop_asked = threading.Event()

    @property
    def is_cancelling(self) -> bool:
        """Whether the user asked it to stop."""
        return self._stop_asked.is_set()

    def cancel(self) -> None:
        """Stop at the next step."""
        self._stop_asked.set()

    def run(self) -> None:
        """Run in the thread."""
        heard.set(self.said)
        try:
            while not self._stop_asked.is_set():
                if not self.delivery.step():
                    self.has_value = True
                    return
            self.delivery.stage.close()
        except Exception as error:  # noqa: BLE001  of a job: it becomes a notice and a log entry
            self.error = error

    def describe(self) -> Job:
        """The current status."""
        progress = self.delivery.latest
        if progress is None:
            return Job(self.title, self.title, "", -1.0, None, self.is_cancelling, self.resumes)
        return Job(
            self.title,
            progress.stage,
            progress.message,
            self.delivery.fraction,
            self.delivery.seconds_left(progress),
            self.is_cancelling,
            self.resumes,
        )
