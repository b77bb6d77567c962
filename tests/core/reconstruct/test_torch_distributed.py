"""Training in processes of its own: two train one scene together; one is killed and succeeded."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from gaga_core.training.distributed import joined_team
from gaga_core.training.engine import SINGLE_WORKER
from gaga_core.training.optimizer import COLUMNS
from gaga_core.training.train import TrainUpdate, train, train_stage
from tests.core.reconstruct.train_scenes import CPU, known_scene
from tests.core.reconstruct.train_worker import worker_config

_ROOT = Path(__file__).resolve().parents[3]


def test_two_workers_hold_the_same_splats(tmp_path: Path) -> None:
    """Bit for bit; other ones than a worker alone comes to, and better: they saw more views."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    command += ["--log-dir", str(tmp_path / "log")]  # else a temporary folder stays
    command += ["--nproc-per-node", "2", "-m", "tests.core.reconstruct.train_worker", str(tmp_path)]
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
    known = known_scene()
    alone = train(known.initial, known.views, worker_config(), CPU)
    assert alone.quality is not None
    assert a["psnr"] > alone.quality.psnr
    assert (tmp_path / "training.npz").is_file()


def test_a_killed_training_is_taken_up_where_it_was(tmp_path: Path) -> None:
    """kill -9 at any moment: the next one goes on from the checkpoint, to the same splats."""
    file = tmp_path / "training.npz"
    command = [sys.executable, "-m", "tests.core.reconstruct.train_worker", str(tmp_path)]
    environment = os.environ | {"GAGA_THREADS": "1"}
    with subprocess.Popen(command, cwd=_ROOT, env=environment) as process:
        until = time.monotonic() + 200
        while not file.is_file() and time.monotonic() < until and process.poll() is None:
            time.sleep(0.01)
        process.kill()
    assert not (tmp_path / "rank0.npz").exists()
    (tmp_path / ".training.npz.0123abcd.part").touch()  # killed over a checkpoint
    known, seen = known_scene(), []
    stage = train_stage(known.initial, known.views, worker_config(), CPU, checkpoint=file)
    for progress in stage:
        if isinstance(progress.payload, TrainUpdate):
            seen.append(progress.payload.iteration)
    assert 1 < seen[0] < 60
    assert [p.name for p in tmp_path.iterdir()] == ["training.npz"]
    resumed = np.load(file)
    whole = train(known.initial, known.views, worker_config(), CPU)
    for name in ("means", "log_scales", "logit_opacities"):
        np.testing.assert_array_equal(getattr(whole.gaussians, name), resumed[f"values_{name}"])


def test_a_process_that_torchrun_did_not_start_is_alone() -> None:
    with joined_team() as team:
        assert team is SINGLE_WORKER
        assert (team.rank, team.size) == (0, 1)
