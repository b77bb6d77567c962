"""The version before, measured in the same run: ``GAGA_BENCH_BEFORE=CHECKOUT`` names a checkout.

A benchmark whose worker is a process of its own runs that of the checkout, too, and reports its own
figures as ratios to them. Without the variable these are left out.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

VARIABLE = "GAGA_BENCH_BEFORE"
Costs = dict[str, Any]  # by field of the worker's dataclass


def checkout() -> Path | None:
    """The checkout of the version before; None where none is named."""
    named = os.environ.get(VARIABLE, "")
    return Path(named).resolve() if named else None


def run_worker(module: str, arguments: Sequence[str], where: Path | None = None) -> Costs:
    """The last line that ``python -m module`` prints, as JSON; in the checkout ``where``, or here.

    Raises ``subprocess.CalledProcessError`` when it fails.
    """
    environment = dict(os.environ)
    if where is not None:
        environment["PYTHONPATH"] = os.pathsep.join([str(where), str(where / "app")])
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        cwd=where,
        env=environment,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    costs: Costs = json.loads(done.stdout.splitlines()[-1])
    return costs
