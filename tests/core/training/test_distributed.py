"""Two processes train one scene together."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from gaga_core.training.distributed import SINGLE_WORKER, joined_team
from gaga_core.training.optimizer import COLUMNS
from gaga_core.training.train import train
from tests.core.training.train_scenes import CPU, Known
from tests.core.training.train_worker import worker_config

_ROOT = Path(__file__).resolve().parents[3]


def test_two_workers_hold_the_same_splats(known: Known, tmp_path: Path) -> None:
    """Bit for bit; other ones than a worker alone comes to, and better: they saw more views."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    command += ["--log-dir", str(tmp_path / "log")]  # else a temporary folder stays
    command += ["--nproc-per-node", "2", "-m", "tests.core.training.train_worker", str(tmp_path)]
    environment = os.environ | {"GAGA_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        command,
        check=False,
        cwd=_ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    a, b = (np.load(tmp_path / f"rank{i}.npz") for i in range(2))
    assert a["size"] == 2
    for name in (*COLUMNS, "losses", "psnr"):
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    alone = train(known.initial, known.views, worker_config(), CPU)
    assert alone.quality is not None
    assert a["psnr"] > alone.quality.psnr
    assert (tmp_path / "training.npz").is_file()


def test_a_process_that_torchrun_did_not_start_is_alone() -> None:
    with joined_team() as team:
        assert team is SINGLE_WORKER
        assert (team.rank, team.size) == (0, 1)
