"""Progress of a stage that is one of several parts of a longer one."""

from dataclasses import replace
from typing import TypeVar

from gaga_core.progress import Stage

_STEPS = 1000  # progress units of one part; parts differ in their number of steps
T = TypeVar("T")


def part(stage: Stage[T], index: int, n_parts: int, title: str) -> Stage[T]:
    """Run ``stage``; its progress is passed on as that of one of ``n_parts`` parts of ``title``."""
    while True:
        try:
            step = next(stage)
        except StopIteration as end:
            value: T = end.value
            return value
        done = index * _STEPS + step.done * _STEPS // max(step.total, 1)
        yield replace(step, stage=title, done=done, total=n_parts * _STEPS)
