"""Checkpoints of a training: how often one is written, on a clock of its own, and what it keeps."""

import itertools
from dataclasses import replace
from pathlib import Path

import pytest

from gaga_core.training.checkpoint import (
    Best,
    TrainState,
    iteration_of,
    load_checkpoint,
    save_checkpoint,
)
from gaga_core.training.train import Keeper, seconds_between
from tests.scenes import random_gaussians


def times(length: float, took: float, least: float = 60.0) -> list[float]:
    """Seconds at which a training of ``length`` seconds is written."""
    found = [0.0]
    while found[-1] < length:
        last = found[-1]
        # Due is what a later look finds due: the elapsed time grows while one waits.
        due = next(
            t
            for t in itertools.count(last, 0.5)
            if t - last >= seconds_between(least, t, took if last else 0.0) and t > last
        )
        found.append(due + took)
    return [t for t in found[1:] if t <= length]


@pytest.mark.parametrize("took", [0.05, 2.0, 30.0])
@pytest.mark.parametrize("length", [300.0, 3600.0, 40_000.0])
def test_writing_takes_little_time_and_a_crash_costs_little(length: float, took: float) -> None:
    written = times(length, took)
    assert len(written) * took <= 0.021 * length + took  # nothing is known before the first one
    for before, now in itertools.pairwise([0.0, *written]):
        assert now - before <= max(60.0, 50 * took, 0.1 * now) + took + 1


class _Resting:
    """An engine whose state is always right."""

    n_splats = 5

    def fetch(self, state: TrainState) -> None:
        pass


def test_one_file_and_only_when_due(tmp_path: Path) -> None:
    clock = [0.0]
    state = TrainState.first(random_gaussians(5), 2, 100)
    engine = _Resting()
    keeper = Keeper(engine, tmp_path / "train.npz", "", 60.0, lambda: clock[0])  # type: ignore[arg-type]
    seen = []
    for i in range(1, 100):
        clock[0], state.iteration = 10.0 * i, i
        keeper.tick(state)
        seen.append(iteration_of(tmp_path / "train.npz"))
    assert [path.name for path in tmp_path.iterdir()] == ["train.npz"]
    assert seen[4] is None
    kept = sorted({i for i in seen if i})
    assert kept[:10] == [6, 12, 18, 24, 30, 36, 42, 48, 54, 60]
    assert kept[10:] == [67, 75, 84, 94]
    keeper.save(state)
    assert iteration_of(tmp_path / "train.npz") == 99


def test_best_splats_of_fewer_and_of_a_lower_degree_are_kept(tmp_path: Path) -> None:
    best = random_gaussians(7, sh_degree=1)
    first = TrainState.first(random_gaussians(9, sh_degree=3), 2, 50)
    state = replace(first, iteration=20, best=Best(10, 21.5, best))
    save_checkpoint(tmp_path / "a.npz", state, "digest")
    back = load_checkpoint(tmp_path / "a.npz", "digest", views=2, iterations=50)
    assert back is not None
    assert back.best is not None
    assert (back.best.iteration, back.best.psnr) == (10, 21.5)
    assert back.best.gaussians.sh.tobytes() == best.sh.tobytes()
