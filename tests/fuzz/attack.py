"""Drives the workers: which cases run, and what was found."""

import itertools
import multiprocessing
import threading
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO, Any

from tests.fuzz.targets import TARGETS
from tests.fuzz.worker import END, Case, Cases, Cost, run_cases

BATCH = 50  # cases of a worker; fewer of a slow reader

# Where the system can, workers are forks of a process that has imported everything and has no
# threads.
_CAN_FORK = "forkserver" in multiprocessing.get_all_start_methods()
_WORKERS: Any = multiprocessing.get_context("forkserver" if _CAN_FORK else "spawn")
_WORKERS.set_forkserver_preload(["tests.fuzz.worker"])


@dataclass
class Result:
    """What an attack did."""

    n_cases: int = 0
    rules: Counter[str] = field(default_factory=Counter)  # cases by rule
    findings: list[str] = field(default_factory=list)  # reader, seed, case, rule, what happened
    seconds: tuple[float, str] = (0.0, "")  # of the slowest case, and which it was
    n_bytes: tuple[int, str] = (0, "")  # most memory of a case
    lock: threading.Lock = field(default_factory=threading.Lock)
    out: IO[str] | None = None  # gets each finding at once

    def find(self, finding: str) -> None:
        """Keep a finding."""
        self.findings.append(finding)
        if self.out:
            self.out.write(f"{finding}\n")
            self.out.flush()


def attack(
    folder: Path,
    seconds: float,
    seeds: Iterable[int],
    targets: Iterable[str],
    batch: int = BATCH,
    n_workers: int = 1,
    out: IO[str] | None = None,
) -> Result:
    """Damage files of ``targets`` in turns for ``seconds``; every reader gets one batch at least.

    A worker that dies is a finding; the next begins after the case that killed it.
    """
    result, seeds = Result(out=out), list(seeds)
    names = sorted(targets, key=lambda name: -TARGETS[name].share)  # the slow ones first
    end = time.monotonic() + seconds
    turns = ((first, seed) for first in itertools.count(0, batch) for seed in seeds)

    def run(name: str, turn: tuple[int, int]) -> None:
        first, seed = turn
        if turn != (0, seeds[0]) and time.monotonic() > end:
            return
        place = folder / name.replace(" ", "_").replace(",", "")
        place.mkdir(parents=True, exist_ok=True)
        share = TARGETS[name].share
        _run_batch(result, Cases(name, seed, first // share, max(batch // share, 1), place))

    with ThreadPoolExecutor(n_workers) as pool:
        for turn in turns:
            list(pool.map(partial(run, turn=turn), names))
            if time.monotonic() > end:
                break
    return result


def _run_batch(result: Result, cases: Cases) -> None:
    label = f"{cases.name}, seed {cases.seed}, case "
    number, last = cases.first, cases.first + cases.count
    while number < last:
        rest = Cases(cases.name, cases.seed, number, last - number, cases.folder)
        said, status = _worker(rest)
        at, begun = "none", None
        with result.lock:
            for item in said:
                if isinstance(item, Case):
                    at, begun = f"{label}{item.number}, {item.rule}", item
                    result.n_cases += 1
                    result.rules[item.rule] += 1
                elif isinstance(item, Cost):
                    result.seconds = max(result.seconds, (item.seconds, at))
                    result.n_bytes = max(result.n_bytes, (item.n_bytes, at))
                elif item != END:
                    result.find(f"{at}: {item}")
            if said and said[-1] == END:
                return
            errors = (cases.folder / "stderr").read_text(encoding="utf-8", errors="replace")
            result.find(f"{at}: ended with {status}: {errors[-1500:]}")
        if begun is None:
            return
        number = begun.number + 1


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
