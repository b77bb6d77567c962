"""A file that another program cuts while it is read ends in one sentence, never in a signal."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.masks.coco import decode_rle
from gaga_core.io.splats.splat_files import write_splats_stage
from gaga_core.progress import run_stage
from tests.scenes import random_gaussians

# In a process of its own: reading mapped pages behind the end of a file is a SIGBUS.
_READ = """
import os, sys
from pathlib import Path
from gaga_core.errors import GagaError
from gaga_core.io.splats.splat_files import read_splats_stage

path, step = Path(sys.argv[1]), int(sys.argv[2])
stage = read_splats_stage(path)
try:
    for _ in range(step):
        next(stage)
    os.truncate(path, path.stat().st_size // 3)
    while True:
        next(stage)
except GagaError as error:
    print("refused:", error)
except StopIteration as end:
    print("read:", len(end.value), bool((end.value.means != 0).any(axis=1).all()))
"""


@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply", "a.splat", "a.spz"])
@pytest.mark.parametrize("step", [1, 2])
def test_a_file_cut_while_it_is_read(tmp_path: Path, name: str, step: int) -> None:
    n = 70_000
    path = tmp_path / name
    run_stage(write_splats_stage(path, random_gaussians(n)))
    done = subprocess.run(
        [sys.executable, "-c", _READ, str(path), str(step)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    answer = done.stdout.strip()
    assert answer.startswith("refused: ") or answer == f"read: {n} True"


@pytest.mark.parametrize(
    ("counts", "size"),
    [
        ([2**62, 2**62, 2**62, 2**62, 768], (24, 32)),  # adds up to 768 in 64 bits
        ([2**63 - 1, 2**63 - 1, 770], (24, 32)),
        ([2**62], (2**31, 2**31)),
        ([768], (-24, -32)),
        ([np.iinfo(np.int64).max], (24, 32)),
    ],
)
def test_runs_that_wrap_around_are_refused(counts: list[int], size: tuple[int, int]) -> None:
    with pytest.raises(GagaError):
        decode_rle(counts, size)
