"""Drives the workers: which cases run, and what was found."""

import multiprocessing
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz.targets import TARGETS
from tests.fuzz.worker import END, Cases, run_cases

BATCH = 50  # cases of a worker; a slow reader has a tenth

# Workers are forks of a process that has imported everything and has no threads.
_WORKERS = multiprocessing.get_context("forkserver")
_WORKERS.set_forkserver_preload(["tests.fuzz.worker"])


@dataclass
class Result:
    """What an attack did."""

    n_cases: int = 0
    findings: list[str] = field(default_factory=list)  # reader, seed, case and what happened


def attack(
    folder: Path,
    seconds: float,
    seeds: Iterable[int],
    targets: Iterable[str],
    batch: int = BATCH,
) -> Result:
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
                place = folder / name.replace(" ", "_")
                place.mkdir(parents=True, exist_ok=True)
                share = 10 if TARGETS[name].is_slow else 1
                _run_batch(result, Cases(name, seed, first // share, batch // share, place))
        first += batch
        if time.monotonic() > end:
            return result


def _run_batch(result: Result, cases: Cases) -> None:
    label = f"{cases.name}, seed {cases.seed}, case "
    number, last = cases.first, cases.first + cases.count
    while number < last:
        rest = Cases(cases.name, cases.seed, number, last - number, cases.folder)
        said, status = _worker(rest)
        begun = [item for item in said if isinstance(item, int) and item != END]
        result.n_cases += len(begun)
        at: object = "none"
        for item in said:
            if isinstance(item, str):
                result.findings.append(f"{label}{at}: {item}")
            at = item if isinstance(item, int) else at
        if said and said[-1] == END:
            return
        errors = (cases.folder / "stderr").read_text(encoding="utf-8", errors="replace")
        where = begun[-1] if begun else "none"
        result.findings.append(f"{label}{where}: ended with {status}: {errors[-1500:]}")
        if not begun:
            return
        number = begun[-1] + 1


def _worker(cases: Cases) -> tuple[list[object], int | None]:
    """Run cases in a process; what it sent until its end, and its exit status."""
    ours, theirs = _WORKERS.Pipe(duplex=False)
    process = _WORKERS.Process(target=run_cases, args=(cases, theirs))
    process.start()
    theirs.close()
    said: list[object] = []
    try:
        while True:
            said.append(ours.recv())
    except EOFError:
        process.join()
    return said, process.exitcode


def all_targets() -> tuple[str, ...]:
    """The names of all readers."""
    return tuple(TARGETS)
