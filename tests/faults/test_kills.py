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
from gaga_core.io.folder.lock import LOCK
from tests.faults.processes import make, run_and_kill, run_whole
from tests.faults.programs import PROGRAMS, finish

_KILLS = int(os.environ.get("GAGA_TEST_KILLS", "0"))
_FEW = {"export": 2, "export objects": 2, "save": 2, "associate": 2, "lift": 2}  # else one
_UNFINISHED = ("*.part", "*.checkpoint.npz")
_LOCKS = (LOCK, ".downloads")  # a lock's file stays: removing it would let two in


def _stray(root: Path) -> list[str]:
    """What is there that is no result, an hour after the last program."""
    _age(root)
    for folder in [root, *(path for path in root.rglob("*") if path.is_dir())]:
        remove_leftovers(folder)
    found = [path for pattern in (".*", *_UNFINISHED) for path in root.rglob(pattern)]
    return sorted(str(path.relative_to(root)) for path in found if path.name not in _LOCKS)


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
def test_a_killed_program_leaves_the_old_result_or_the_new_one(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, root = PROGRAMS[name], tmp_path / "it"
    monkeypatch.setenv("GAGA_HOME", str(root / "home"))
    make(name, root)
    fresh = tmp_path / "fresh"
    shutil.copytree(root, fresh)
    seconds, results = 0.0, {}
    for version in "BA" if program.has_versions else "B":
        seconds = run_whole(name, root, version)
        results[version] = program.result(root)
    assert len({*results.values()}) == len(results)
    rng = np.random.default_rng(11)
    n_kills = _KILLS or _FEW.get(name, 1)
    for kill in range(n_kills):
        if not program.has_versions:
            shutil.rmtree(root)
            shutil.copytree(fresh, root)
        run_and_kill(name, root, "BA"[kill % 2], float(rng.uniform(0, 1.1 * seconds)))
        assert _ended(root), f"workers outlive kill {kill}"
        finish(root)
        program.opens(root)
        whole = {*results.values(), *([] if program.has_versions else [""])}
        assert program.result(root) in whole, f"kill {kill}"
        if (
            kill % 3 == 2 or kill == n_kills - 1 or not program.has_versions
        ):  # what is left is taken up, or is in no way
            run_whole(name, root, "B")
            assert program.result(root) == results["B"], f"after kill {kill}"
            assert _stray(root) == [], f"after kill {kill}"
