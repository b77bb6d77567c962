"""Versions before, measured in the same run: ``GAGA_BENCH_BEFORE=CHECKOUT[:CHECKOUT...]``.

A worker is a module that runs as a process of its own and prints what it took as a line of JSON.
Of another version its own worker runs, or, where it has none yet, that of this one with its code.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

VARIABLE = "GAGA_BENCH_BEFORE"
HERE = Path(__file__).resolve().parents[2]
Costs = dict[str, Any]  # by field of the worker's dataclass
_TURNS = 2
# The code of one checkout, then the worker and what measures of the same or another one.
_RUN = """
import runpy, sys
library, tests, module = sys.argv[1:4]
sys.path[:0] = [library, library + "/app"]
import gaga_core, gaga_studio
sys.path.insert(0, tests)
sys.argv[:] = [module, *sys.argv[4:]]
runpy.run_module(module, run_name="__main__", alter_sys=True)
"""
_WARM_UP = """
from gaga_core.pipeline.compile_kernels import warm_up_stage
from gaga_core.progress import run_stage
run_stage(warm_up_stage())
"""


def checkouts() -> list[Path]:
    """The checkouts of versions before; none where none is named."""
    return [Path(name).resolve() for name in os.environ.get(VARIABLE, "").split(os.pathsep) if name]


def version(checkout: Path) -> str:
    """The commit that is checked out."""
    command = ["git", "-C", str(checkout), "rev-parse", "--short=7", "HEAD"]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


def run_worker(module: str, arguments: Sequence[str], where: Path = HERE) -> Costs:
    """The last line that the worker ``module`` prints, as JSON, by the code of a checkout.

    Raises ``subprocess.CalledProcessError`` when it fails.
    """
    last = call_worker(module, arguments, where).splitlines()[-1]
    costs: Costs = json.loads(last[last.index("{") :])  # behind what ends the color of a log
    return costs


def call_worker(module: str, arguments: Sequence[str], where: Path = HERE) -> str:
    """What the worker prints; kernels are compiled before it starts."""
    _warm_up(where)
    own = (where / f"{module.replace('.', '/')}.py").is_file()
    return _python(_RUN, str(where), str(where if own else HERE), module, *arguments, where=where)


@cache
def _warm_up(where: Path) -> None:
    _python(_WARM_UP, where=where)


def _python(code: str, *arguments: str, where: Path) -> str:
    """What a process prints that runs ``code``, with the packages of a checkout."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(where), str(where / "app")])}
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(
        command, cwd=where, env=environment, check=True, stdout=subprocess.PIPE, text=True
    )
    return done.stdout


def in_turns(run: Callable[[Path], Costs], former: Path) -> tuple[Costs, Costs]:
    """What this version takes and what the former one does: the least of two runs each."""
    now: list[Costs] = []
    was: list[Costs] = []
    for _ in range(_TURNS):
        now.append(run(HERE))
        was.append(run(former))
    return _least(now), _least(was)


def _least(runs: Sequence[Costs]) -> Costs:
    first = runs[0]
    numbers = [name for name, value in first.items() if isinstance(value, int | float)]
    return {name: min(costs[name] for costs in runs) for name in numbers}
