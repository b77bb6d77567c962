"""Progress of long work: every stage is a generator that yields ``Progress`` and returns a value.

Cancelling is closing the generator: between two steps ``GeneratorExit`` is raised inside it, its
``finally`` blocks remove temporary files, and nothing half-made is left.
"""

from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TypeVar

T = TypeVar("T")
_STEPS = 1000  # progress units of one part; parts differ in their number of steps


@dataclass(frozen=True)
class Progress:
    """One step of a long task.

    ``payload`` carries what a live observer may show (the bank after a view, say); it is a value
    that the worker will not change any more.
    """

    stage: str  # "Associate masks"
    done: int
    total: int  # 0 when unknown
    message: str = ""
    payload: object = None


Stage = Generator[Progress, None, T]


def run_stage(stage: Stage[T], on_progress: Callable[[Progress], None] | None = None) -> T:
    """Drive ``stage`` to its end in this thread and return its value."""
    while True:
        try:
            progress = next(stage)
        except StopIteration as end:
            value: T = end.value
            return value
        if on_progress is not None:
            on_progress(progress)


def mapped(stage: Stage[T], change: Callable[[Progress], Progress]) -> Stage[T]:
    """Run ``stage`` with its progress changed; it is closed at once when this is."""
    with closing(stage):
        while True:
            try:
                step = next(stage)
            except StopIteration as end:
                value: T = end.value
                return value
            yield change(step)


def part(stage: Stage[T], index: int, n_parts: int, title: str, *, prefix: str = "") -> Stage[T]:
    """Run ``stage``; its progress is passed on as that of one of ``n_parts`` parts of ``title``.

    ``prefix`` stands before each message.
    """

    def change(step: Progress) -> Progress:
        done = index * _STEPS + step.done * _STEPS // max(step.total, 1)
        message = prefix + step.message
        return replace(step, stage=title, done=done, total=n_parts * _STEPS, message=message)

    return mapped(stage, change)
