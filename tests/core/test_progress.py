"""The pace of a step, by which the time left is told."""

import numpy as np
import pytest

from gaga_core.progress import Pace


@pytest.mark.parametrize("load", [0.33, 0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("changes_at", [0.2, 0.4, 0.6])
def test_the_pace_is_that_of_the_load_of_now(load: float, changes_at: float) -> None:
    """Other programs start or end: with what was done since in the past, the rest is known."""
    for seed in range(5):
        costs = np.random.default_rng(seed).lognormal(0, 0.2, 400)
        shares = np.linspace(0, 1, 401)
        costs[shares[:-1] >= changes_at] *= load
        times = np.append(0, np.cumsum(costs))
        pace = Pace()
        for share, at in zip(shares, times, strict=True):
            pace.hear(float(at), float(share))
            if 1.4 * changes_at <= share <= 0.95:
                assert pace.seconds is not None
                left = pace.seconds * (1 - share)
                assert left == pytest.approx(times[-1] - at, rel=0.2)


def test_the_pace_of_a_step_that_goes_on_is_that_of_what_is_done_now() -> None:
    pace = Pace()
    assert pace.seconds is None
    pace.hear(100.0, 0.6)
    assert (pace.seconds, pace.first) == (None, 0.6)
    pace.hear(101.0, 0.6)
    assert pace.seconds is None, "nothing was done yet"
    pace.hear(104.0, 0.7)
    assert pace.seconds == pytest.approx(30), "of three for a tenth: the first word waited"
