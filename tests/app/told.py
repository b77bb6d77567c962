"""What a task tells while it runs, as the window hears it."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from gaga_core.progress import Progress
from gaga_studio.session import jobs


@contextmanager
def by_job() -> Iterator[dict[object, list[Progress]]]:
    """Every word of each of the jobs that run meanwhile."""
    heard: dict[object, list[Progress]] = {}
    step = jobs._Delivery.step

    def listening(self: jobs._Delivery[object]) -> bool:
        goes_on = step(self)
        if goes_on and self.latest is not None:
            heard.setdefault(self, []).append(self.latest)
        return goes_on

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs._Delivery, "step", listening)
        yield heard
