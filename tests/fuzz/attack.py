"""Drives the workers: which cases run, and what was found."""

import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz.targets import TARGETS

BATCH = 50  # cases of a worker


@dataclass
class Result:
    """What an attack did."""

    n_cases: int = 0
    findings: list[str] = field(default_factory=list)  # reader, seed, case and what happened


def attack(folder: Path, seconds: float, seeds: Iterable[int], targets: Iterable[str]) -> Result:
    """Damage files of ``targets`` in turns for ``seconds``; every reader gets one batch at least.

    A worker that dies is a finding; the next begins after the case that killed it.
    """
    result, names, seeds = Result(), list(targets), list(seeds)
    end, first = time.monotonic() + seconds, 0
    while True:
        for seed in seeds:
            for name in names:
                if first and time.monotonic() > end:
                    return result
                _batch(result, folder / name.replace(" ", "_"), name, seed, first)
        first += BATCH
        if time.monotonic() > end:
            return result


def _batch(result: Result, folder: Path, name: str, seed: int, first: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    number, last = first, first + BATCH
    while number < last:
        arguments = [name, str(seed), str(number), str(last - number), str(folder)]
        run = subprocess.run(
            [sys.executable, "-m", "tests.fuzz.worker", *arguments],
            capture_output=True,
            text=True,
            check=False,
        )
        lines = run.stdout.splitlines()
        begun = [int(line) for line in lines if line.isdecimal()]
        result.n_cases += len(begun)
        label = f"{name}, seed {seed}, case "
        result.findings += [label + line[2:] for line in lines if line.startswith("! ")]
        if lines and lines[-1] == "end":
            return
        died = f"ended with {run.returncode}: {run.stderr[-1500:]}"
        result.findings.append(f"{label}{begun[-1] if begun else 'none'} {died}")
        if not begun:
            return
        number = begun[-1] + 1


def all_targets() -> tuple[str, ...]:
    """The names of all readers."""
    return tuple(TARGETS)
