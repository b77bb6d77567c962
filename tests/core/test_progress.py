"""The pace of a step, by which the time left is told."""

from itertools import pairwise

import numpy as np
import pytest

from gaga_core.progress import RECENT_S, Pace, Progress, Stage, joined, part, portion, run_stage


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


@pytest.mark.parametrize("begins", [0.0, 0.3])
@pytest.mark.parametrize("ends", [0.5, 1.0])
def test_a_step_that_comes_back_has_the_pace_of_its_second_pass(begins: float, ends: float) -> None:
    """Once for each file, say; a share that wavers is no second pass."""
    pace, at = Pace(), 0.0
    for share in np.linspace(0, ends, 21):
        pace.hear(at, float(share))
        pace.hear(at, float(share) - 0.01)
        at += 1
    whole = 20 / ends
    assert pace.seconds == pytest.approx(whole)
    for k, share in enumerate(np.linspace(begins, 1, 21)):
        pace.hear(at, float(share))
        assert pace.first == begins
        assert (pace.seconds is None) == (k < 2), "it may hold what was prepared"
        if pace.seconds is not None:
            assert pace.left(at) == pytest.approx(60 - 3 * k)
        at += 3


def _any_steps(rng: np.random.Generator) -> Stage[str]:
    """Steps one after the other, some of them twice, some unknown, some without a share."""
    for name in rng.choice(list("abcdx"), 8):
        n = int(rng.integers(0, 5))
        yield Progress(name, 0, n)
        for i in range(int(rng.integers(0, n + 1))):
            yield Progress(name, i, n, "on")
    return "done"


@pytest.mark.parametrize("seed", range(20))
def test_the_share_of_the_whole_never_goes_back(seed: int) -> None:
    """Whatever the steps tell, in whatever order, and however the wholes lie in each other."""
    seconds = dict(zip("abcd", np.random.default_rng(seed).uniform(0.01, 9, 4), strict=True))

    def whole() -> Stage[str]:
        some, more = (_any_steps(np.random.default_rng((seed, k))) for k in range(2))
        yield from portion(joined(some, "all", seconds), 0, 0.3, "all")
        yield from portion(part(more, 0, 2, "all"), 0.3, 0.6, "all")
        last = joined(_any_steps(np.random.default_rng((seed, 2))), "all", seconds)
        return (yield from portion(last, 0.6, 1, "all"))

    words: list[Progress] = []
    assert run_stage(whole(), words.append) == "done"
    shares = [word.done / word.total for word in words]
    assert {word.stage for word in words} == {"all"}
    assert all(former <= share <= 1 for former, share in pairwise(shares))


def test_a_step_has_the_share_of_the_whole_that_it_has_of_the_time() -> None:
    def steps() -> Stage[None]:
        yield from (Progress("a", k, 2) for k in range(3))
        yield Progress("other", 1, 1)
        yield from (Progress("b", k, 4) for k in range(5))

    words = list(joined(steps(), "all", {"a": 1.0, "b": 3.0}))
    shares = [word.done / word.total for word in words]
    assert shares == pytest.approx([0, 1 / 8, 1 / 4, 1 / 4, 1 / 4, 7 / 16, 5 / 8, 13 / 16, 1])
