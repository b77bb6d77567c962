"""Workers of benchmarks: modules that run as a process of their own and print what they took as a
line of JSON."""

import json
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from typing import Any

from gaga_core.pipeline.compile_kernels import warm_up_stage
from gaga_core.progress import run_stage

Costs = dict[str, Any]  # by field of the worker's dataclass


def run_worker(module: str, arguments: Sequence[str]) -> Costs:
    """The last line that the worker ``module`` prints, as JSON.

    Raises ``subprocess.CalledProcessError`` when it fails.
    """
    last = call_worker(module, arguments).splitlines()[-1]
    return json.loads(last[last.index("{") :])  # behind what ends the color of a log


def call_worker(module: str, arguments: Sequence[str]) -> str:
    """What the worker prints; kernels are compiled before it starts."""
    _compile_kernels()
    command = [sys.executable, "-m", module, *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


@cache
def _compile_kernels() -> None:
    run_stage(warm_up_stage())
