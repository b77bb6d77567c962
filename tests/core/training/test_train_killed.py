"""A training that the system kills goes on from its checkpoint, to the same splats."""

import subprocess
import sys
import time
from pathlib import Path

from gaga_core.progress import run_stage
from gaga_core.training.checkpoint import iteration_of
from gaga_core.training.train import train, train_stage
from tests.core.training.train_scenes import CPU, Known, assert_same
from tests.core.training.train_worker import worker_config

_ITERATIONS = 160
_SECONDS = 300  # a machine that compiles the kernels first


def _train_until_killed(folder: Path, iteration: int) -> int:
    """Train in a process of its own, kill that after ``iteration``; how far the checkpoint is."""
    module = "tests.core.training.train_worker"
    command = [sys.executable, "-m", module, str(folder), str(_ITERATIONS)]
    process = subprocess.Popen(command)
    end = time.monotonic() + _SECONDS
    try:
        while (iteration_of(folder / "training.npz") or 0) < iteration:
            assert process.poll() is None, "the training ended before"
            assert time.monotonic() < end
            time.sleep(0.002)
    finally:
        process.kill()
        process.wait()
    assert not (folder / "rank0.npz").exists()
    return iteration_of(folder / "training.npz") or 0


def test_a_killed_training_goes_on_to_the_same_splats(known: Known, tmp_path: Path) -> None:
    """Killed twice, before and after splats were added; the rest is done here."""
    config = worker_config(_ITERATIONS)
    whole = train(known.initial, known.views, config, CPU)
    first = _train_until_killed(tmp_path, 9)
    second = _train_until_killed(tmp_path, max(first + 1, 70))
    assert 9 <= first < second < _ITERATIONS
    (tmp_path / ".training.npz.0.part").write_bytes(b"as if killed while it wrote")
    stage = train_stage(
        known.initial, known.views, config, CPU, checkpoint=tmp_path / "training.npz"
    )
    resumed = run_stage(stage)
    assert_same(resumed.gaussians, whole.gaussians)
    assert resumed.quality == whole.quality
    assert [path.name for path in tmp_path.iterdir()] == ["training.npz"]
