"""One process of a team that torchrun starts: trains a small scene and writes what it holds.

torchrun --nproc-per-node 2 -m tests.core.training.train_worker FOLDER
"""

import sys
from pathlib import Path

import numpy as np

from gaga_core.progress import run_stage
from gaga_core.raster.base import Gradients
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.training.distributed import Team, joined_team
from gaga_core.training.optimizer import COLUMNS
from gaga_core.training.settings import TrainConfig
from gaga_core.training.train import train_stage
from tests.core.training.train_scenes import known_scene, short


def main() -> None:
    folder = Path(sys.argv[1])
    with joined_team() as team:
        if team.size > 1:
            check_means(team)
        known = known_scene()
        config = worker_config()
        stage = train_stage(
            known.initial,
            known.views,
            config,
            CpuRasterizer(),
            team=team,
            checkpoint=folder / "training.npz",
        )
        trained = run_stage(stage)
        columns = {name: getattr(trained.gaussians, name) for name in COLUMNS}
        quality = trained.quality.psnr if trained.quality else 0.0
        np.savez(
            folder / f"rank{team.rank}.npz",
            losses=trained.losses,
            psnr=quality,
            size=team.size,
            **columns,
        )


def worker_config() -> TrainConfig:
    """What each process of this file trains; a checkpoint as often as can be."""
    return short(60, exposure=True, checkpoint_seconds=0.0)


def check_means(team: Team) -> None:
    """Both see different splats: the mean has the rows of either, those unseen count as zero."""
    n = 6
    rows = np.array([0, 2, 3] if team.rank == 0 else [2, 5], np.int32)
    value = np.float32(1 + team.rank)

    def filled(*shape: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        return np.full((len(rows), *shape), value, np.float32)

    mean = team.mean(
        Gradients(
            rows, filled(3), filled(4), filled(3), filled(), filled(4, 3), filled(), filled()
        ),
        n,
    )
    np.testing.assert_array_equal(mean.indices, [0, 2, 3, 5])
    want = np.array([0.5, 1.5, 0.5, 1.0], np.float32)
    np.testing.assert_array_equal(mean.means, np.repeat(want[:, None], 3, axis=1))
    np.testing.assert_array_equal(mean.sh, np.tile(want[:, None, None], (1, 4, 3)))
    np.testing.assert_array_equal(mean.logit_opacities, want)
    np.testing.assert_array_equal(mean.screen, [1, 1.5, 1, 2])
    np.testing.assert_array_equal(team.mean_values(np.array([float(team.rank)])), [0.5])


if __name__ == "__main__":
    main()
