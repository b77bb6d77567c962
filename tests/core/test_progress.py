"""The pace of a step, by which the time left is told."""

import numpy as np
import pytest

from gaga_core.progress import RECENT_S, Pace


@pytest.mark.parametrize("load", [0.33, 0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("changes_at", [0.2, 0.4, 0.6])
@pytest.mark.parametrize("word_s", [0.02, 0.2, 4.0])
def test_the_pace_is_that_of_the_load_of_now(load: float, changes_at: float, word_s: float) -> None:
    """Other programs start or end: seconds afterwards the rest is known, or a few words."""
    n = round(400 / word_s)
    for seed in range(3):
        costs = word_s * np.random.default_rng(seed).lognormal(0, 0.2, n)
        shares = np.linspace(0, 1, n + 1)
        costs[shares[:-1] >= changes_at] *= load
        times = np.append(0, np.cumsum(costs))
        known = np.interp(changes_at, shares, times) + max(RECENT_S, 12 * word_s * load)
        pace = Pace()
        for share, at in zip(shares, times, strict=True):
            pace.hear(float(at), float(share))
            if at > known and share <= 0.9:
                assert pace.seconds is not None
                assert pace.seconds * (1 - share) == pytest.approx(times[-1] - at, rel=0.3)


@pytest.mark.parametrize("n", [8, 20, 400])
@pytest.mark.parametrize("prepared_s", [0.0, 30.0])
@pytest.mark.parametrize("says_so", [False, True])
def test_what_was_prepared_in_the_first_word_says_nothing(
    n: int, prepared_s: float, says_so: bool
) -> None:
    """Whether the step says meanwhile that it waits, or says nothing."""
    pace, at = Pace(), prepared_s
    for waited in np.arange(0, prepared_s + 0.1, 0.1) if says_so else [0.0]:
        pace.hear(float(waited), 0.0)
        assert pace.seconds is None
    for k in range(1, n + 1):
        at += 1
        pace.hear(at, k / n)
        assert (pace.seconds is None) == (k == 1)
        assert pace.seconds is None or pace.seconds == pytest.approx(n)
    assert pace.measured_s == n - 1


def test_the_pace_of_a_step_that_goes_on_is_that_of_what_is_done_now() -> None:
    pace = Pace()
    assert pace.seconds is None
    pace.hear(100.0, 0.6)
    assert (pace.seconds, pace.first) == (None, 0.6)
    pace.hear(101.0, 0.6)
    assert pace.seconds is None, "nothing was done yet"
    pace.hear(104.0, 0.7)
    assert pace.seconds is None, "it may hold what was prepared"
    pace.hear(107.0, 0.8)
    assert pace.seconds == pytest.approx(30), "three for a tenth"
    assert [pace.left(now) for now in (107.0, 110.0, 113.0)] == pytest.approx([6, 3, 0])
    pace.hear(112.0, 0.8)
    assert pace.left(110.0) == pytest.approx(3), "that it waits says nothing"
    assert pace.left(116.0) == pytest.approx(6), "overdue"
