"""Progress of long work: every stage is a generator that yields ``Progress`` and returns a value.

Cancelling is closing the generator: between two steps ``GeneratorExit`` is raised inside it, its
``finally`` blocks remove temporary files, and nothing half-made is left (STYLE 14).
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


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
