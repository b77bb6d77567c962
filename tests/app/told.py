"""What a task tells while it runs, as the window hears it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest

from gaga_core.progress import Progress
from gaga_studio.session import jobs


@contextmanager
def words() -> Iterator[list[Progress]]:
    """Every word of the jobs that run meanwhile."""
    heard: list[Progress] = []
    step = jobs._Delivery.step

    def listening(self: jobs._Delivery[object]) -> bool:
        goes_on = step(self)
        if goes_on and self.latest is not None:
            heard.append(self.latest)
        return goes_on

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs._Delivery, "step", listening)
        yield heard


def falls(heard: Sequence[Progress]) -> list[str]:
    """Where the share that a task told became less, or was not told any more."""
    found, former, before = [], -1.0, ""
    for word in heard:
        share = min(word.done / word.total, 1.0) if word.total > 0 else -1.0
        now = f"{word.stage} {share:.3f} ({word.message})"
        if share < former - 1e-9:
            found.append(f"{before} -> {now}")
        former, before = share, now
    return found
