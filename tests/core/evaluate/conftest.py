"""A miniature of the data set Replica, and the report of a benchmark over it."""

from pathlib import Path

import pytest

from gaga_core.evaluate.benchmark.run import run_benchmark
from gaga_core.evaluate.benchmark.tables import BenchmarkReport
from gaga_core.evaluate.settings import BenchmarkConfig
from gaga_core.io.datasets import open_dataset
from gaga_core.progress import run_stage
from tests.datasets import (
    gaga_replica,
    semantic_nerf,
)


@pytest.fixture(scope="package")
def replica(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("replica")
    gaga_replica(root / "office_0")
    semantic_nerf(root / "room_0")
    return root


@pytest.fixture(scope="package")
def report(replica: Path, tmp_path_factory: pytest.TempPathFactory) -> BenchmarkReport:
    out = tmp_path_factory.mktemp("out")
    config = BenchmarkConfig(preset="paper", lift="vote", shares=(0.5,))
    return run_stage(run_benchmark(open_dataset("replica", replica), out, config))
