"""Progress of long work: every stage is a generator that yields ``Progress`` and returns a value.

Cancelling is closing the generator: between two steps ``GeneratorExit`` is raised inside it, its
``finally`` blocks remove temporary files, and nothing half-made is left.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future, wait
from contextlib import closing
from contextvars import ContextVar
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import TYPE_CHECKING, TypeVar

from gaga_core.errors import plain_text

if TYPE_CHECKING:
    from rich.console import Console

T = TypeVar("T")
_STEPS = 1000  # progress units of one part; parts differ in their number of steps
# How far a pace looks back, at most: seconds, but a few words, and never more than this share of
# what was done. Two recorded drafts, whose load becomes 2 or 3 times as much or as little on the
# way: afterwards the time left is wrong by more than 1.5 times for 9 % of the time, by the share
# alone for 16 %; with 10 s for 9 %, but up and down by 12 % in 5 s, not 10; with 20 s for 10 %.
RECENT_S, _FEW_WORDS, _RECENT = 15.0, 10, 0.25
# Share of a task, or of a step, that is done until it tells what is to come. A share that falls by
# more is that of a step that comes back.
TELLING = 0.05
# Share of a step from which on its own pace is trusted more than what was expected, where it was
# not measured for `RECENT_S` before.
_TRUSTED = 0.3
_TICK_S = 0.1  # how often a cancel is looked for while a thread is waited for
_log = logging.getLogger(__name__)
# Each thread has its own; who drives a stage sets a list here to hear what it says.
heard: ContextVar[list[str] | None] = ContextVar("heard", default=None)


@dataclass(frozen=True)
class Progress:
    """One step of a long task.

    ``payload`` carries what a live observer may show (the bank after a view, say); it is a value
    that the worker will not change any more.
    """

    stage: str  # "Associate masks"
    done: float  # whole steps, and the share of the present one where it is known
    total: int  # 0 when unknown
    message: str = ""
    payload: object = None
    left_s: float | None = None  # seconds until all of it is done, where the stage itself knows


Stage = Generator[Progress, None, T]


class Pace:
    """How fast a step goes: by the last seconds of what it has done.

    The load of a machine changes, and the newest rate is that of what is left; a single word, which
    may be a long or a short one, says little. What a resumed step had behind it says nothing, nor
    does its first word that goes on: it may hold what was prepared. A step that comes back begins
    again: one of each file, say.
    """

    def __init__(self) -> None:
        # Times, in seconds, and shares 0..1 of the words that went on and tell the pace.
        self._words: deque[tuple[float, float]] = deque()
        self._n_on = 0  # words that went on
        self._since = 0.0  # when the first of them came
        self.first = 0.0  # share of the first word

    def hear(self, at: float, share: float) -> None:
        """Take the newest word of the step; one that does not go on only says that it waits."""
        if self._words and share < self._words[-1][1] - TELLING:
            self._words.clear()
            self._n_on = 0
        if not self._words:
            self.first = share
        elif share <= self._words[-1][1]:
            return
        else:
            self._n_on += 1
        if self._n_on < 2:
            self._words.clear()
            self._since = at
        self._words.append((at, share))
        before = share - _RECENT * (share - self.first)
        while len(self._words) > 2 and (
            self._words[1][1] <= before
            or (self._words[1][0] <= at - RECENT_S and len(self._words) > _FEW_WORDS + 1)
        ):
            self._words.popleft()

    @property
    def measured_s(self) -> float:
        """For how long it was measured, seconds."""
        return self._words[-1][0] - self._since if self._n_on > 1 else 0.0

    @property
    def seconds(self) -> float | None:
        """How long a whole step takes at this pace; None before two words went on."""
        if self._n_on < 2:
            return None
        (since, before), (at, share) = self._words[0], self._words[-1]
        return (at - since) / (share - before)

    @property
    def part(self) -> float:
        """Share 0..1 that is done of what was to be done at the first word."""
        share = self._words[-1][1] if self._words else 0.0
        return (share - self.first) / max(1 - self.first, 1e-9)

    @property
    def trust(self) -> float:
        """Weight 0..1 of this pace against what was expected of the step: the longer it runs the
        more."""
        if self._n_on < 2:
            return 0.0
        measured = min(self.measured_s / RECENT_S, self.part / TELLING)
        return min(max(measured, self.part / _TRUSTED), 1.0)

    def expected_left(self, guess: float, now: float) -> float:
        """Seconds that are left of the step, of which the whole was expected to take ``guess``."""
        return self.trust * (self.left(now) or 0.0) + (1 - self.trust) * guess * (1 - self.part)

    def left(self, now: float) -> float | None:
        """Seconds that are left of the step; None before two words went on.

        It counts down while no word goes on, and grows again once that is overdue.
        """
        if self.seconds is None:
            return None
        at, share = self._words[-1]
        left = self.seconds * (1 - share) - (now - at)
        return left if left >= 0 else -left * (1 - share) / (share - self._words[0][1])


def say(text: str) -> None:
    """Tell the user one sentence on what was done to their data: logged, and kept in `heard`."""
    text = plain_text(text)
    _log.warning("%s", text)
    told = heard.get()
    if told is not None:
        told.append(text)


def threaded_stage(step: Progress, work: Callable[[], T], turn: threading.Lock) -> Stage[T]:
    """Run ``work``, one call of a library that nothing ends, in a thread; yield ``step`` meanwhile.

    A cancel does not wait for it: it goes on to its end, and its value is dropped. ``turn`` is held
    while it works, so that the next call does not run next to it.
    """
    result: Future[T] = Future()

    def run() -> None:
        with turn:
            if not result.set_running_or_notify_cancel():
                return
            try:
                result.set_result(work())
            except BaseException as error:  # noqa: BLE001  raised again by whoever waits
                result.set_exception(error)

    threading.Thread(target=run, daemon=True, name="stage").start()
    try:
        while not wait([result], _TICK_S).done:
            yield step
        return result.result()
    finally:
        result.cancel()


def run_stage(stage: Stage[T], on_progress: Callable[[Progress], None] | None = None) -> T:
    """Drive ``stage`` to its end in this thread and return its value."""
    while True:
        try:
            progress = next(stage)
        except StopIteration as end:
            return end.value
        if on_progress is not None:
            on_progress(progress)


def show_stage(
    stage: Stage[T],
    console: "Console | None" = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> T:
    """Drive ``stage`` with a bar and the time left in a terminal or notebook; it is closed at once
    when this is interrupted.

    The bar is on standard error unless ``console`` says where; there is none in a file or a pipe.
    """
    from rich import progress as bars
    from rich.console import Console

    console = console or Console(stderr=True)
    columns = (
        bars.TextColumn("{task.description}", markup=False),
        bars.BarColumn(bar_width=30),
        bars.TextColumn("{task.completed:.0f}/{task.total:.0f}"),
        bars.TimeRemainingColumn(),
        bars.TextColumn("{task.fields[message]}", style="dim", markup=False),
    )
    quiet = not (console.is_terminal or console.is_jupyter)
    tasks: dict[str, bars.TaskID] = {}
    with bars.Progress(*columns, console=console, transient=True, disable=quiet) as bar:

        def show(step: Progress) -> None:
            if on_progress is not None:
                on_progress(step)
            total = step.total or max(step.done, 1)
            if step.stage not in tasks:
                title = plain_text(step.stage)
                tasks[step.stage] = bar.add_task(title, total=step.total or 1, message="")
            message = plain_text(step.message)
            bar.update(tasks[step.stage], completed=step.done, total=total, message=message)

        with closing(stage):
            return run_stage(stage, show)


def mapped(stage: Stage[T], change: Callable[[Progress], Progress]) -> Stage[T]:
    """Run ``stage`` with its progress changed; it is closed at once when this is."""
    with closing(stage):
        while True:
            try:
                step = next(stage)
            except StopIteration as end:
                return end.value
            yield change(step)


class Share:
    """How far a stage is: a share 0..1 that never goes back, whatever its steps tell of."""

    def __init__(self) -> None:
        self.furthest, self.is_known = 0.0, False

    def of(self, step: Progress) -> float:
        """The share after the newest word; one of which the total is not known stands still."""
        if step.total > 0:
            self.is_known = True
            self.furthest = max(self.furthest, min(step.done / step.total, 1.0))
        return self.furthest


def portion(stage: Stage[T], begin: float, end: float, title: str) -> Stage[T]:
    """Run ``stage``; its progress is passed on as that of ``title`` from ``begin`` to ``end``,
    in 0..1."""
    share = Share()

    def change(step: Progress) -> Progress:
        done = round(_STEPS * (begin + (end - begin) * share.of(step)))
        return replace(step, stage=title, done=done, total=_STEPS)

    return mapped(stage, change)


def part(stage: Stage[T], index: int, n_parts: int, title: str, *, prefix: str = "") -> Stage[T]:
    """Run ``stage``; its progress is passed on as that of one of ``n_parts`` parts of ``title``.

    ``prefix`` stands before each message.
    """
    share = Share()

    def change(step: Progress) -> Progress:
        done = index * _STEPS + int(_STEPS * share.of(step))
        message = prefix + step.message
        return replace(step, stage=title, done=done, total=n_parts * _STEPS, message=message)

    return mapped(stage, change)


def joined(stage: Stage[T], title: str, seconds: Mapping[str, float]) -> Stage[T]:
    """Run ``stage``, whose steps usually take ``seconds``, by their names and in their order; its
    progress is passed on as one share of ``title``.

    A step that is not among them, or that comes back, is told of and has no share of its own.
    """
    whole, share = sum(seconds.values()), Share()
    ends = accumulate(seconds.values())
    begins = {name: end - seconds[name] for name, end in zip(seconds, ends, strict=True)}

    def change(step: Progress) -> Progress:
        if step.stage in seconds:
            inside = min(step.done / step.total, 1.0) if step.total > 0 else 0.0
            done = (begins[step.stage] + seconds[step.stage] * inside) / whole
            share.of(Progress(title, done, 1))
        message = f"{step.stage}: {step.message}" if step.message else step.stage
        done = _STEPS * share.furthest
        return replace(step, stage=title, done=done, total=_STEPS, message=message)

    return mapped(stage, change)
