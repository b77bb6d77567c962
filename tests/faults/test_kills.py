"""Programs killed at random moments: the old result or the new one, whole; nothing stray; a second
run works. ``make faults KILLS=100`` for many."""

import os
import shutil
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from gaga_core.io.files import remove_leftovers
from tests.faults.processes import make, run_and_kill, run_whole
from tests.faults.programs import PROGRAMS, finish

_KILLS = int(os.environ.get("GAGA_TEST_KILLS", "0"))
_FEW = {"export": 4, "export objects": 4, "associate": 3, "run": 1, "train": 1, "place": 1}


def _hidden(root: Path) -> list[str]:
    return sorted(str(path.relative_to(root)) for path in root.rglob(".*"))


def _age(root: Path) -> None:
    for path in root.rglob("*"):
        if ".gaga-" in str(path) or path.name.endswith(".part"):
            os.utime(path, (1e9, 1e9))


def _ended(root: Path) -> bool:
    """Whether every process that was started for ``root`` ends within ten seconds."""
    for _ in range(100):
        lines = [process.info["cmdline"] or [] for process in psutil.process_iter(["cmdline"])]
        if not any(str(root) in part for line in lines for part in line):
            return True
        time.sleep(0.1)
    return False


@pytest.mark.parametrize("name", list(PROGRAMS))
def test_a_killed_program_leaves_the_old_result_or_the_new_one(name: str, tmp_path: Path) -> None:
    program, root = PROGRAMS[name], tmp_path / "it"
    make(name, root)
    fresh = tmp_path / "fresh"
    shutil.copytree(root, fresh)
    seconds = run_whole(name, root, "B")
    results = {"B": program.result(root)}
    if program.has_versions:
        seconds = run_whole(name, root, "A")  # now that all is compiled
    results["A"] = program.result(root)
    assert (results["A"] != results["B"]) == program.has_versions
    rng = np.random.default_rng(11)
    for kill in range(_KILLS or _FEW[name]):
        if not program.has_versions:
            shutil.rmtree(root)
            shutil.copytree(fresh, root)
        run_and_kill(name, root, "AB"[kill % 2], float(rng.uniform(0, 1.1 * seconds)))
        assert _ended(root), f"workers outlive kill {kill}"
        finish(root)
        if program.has_versions:
            assert program.result(root) in results.values(), f"kill {kill}"
        if kill % 3 == 2 or not program.has_versions:  # what is left is taken up, or is in no way
            run_whole(name, root, "A")
            assert program.result(root) == results["A"], f"after kill {kill}"
    _age(root)
    for folder in [root, *(path for path in root.rglob("*") if path.is_dir())]:
        remove_leftovers(folder)
    assert _hidden(root) == []
