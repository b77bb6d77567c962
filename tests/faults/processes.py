"""Processes to kill: where the system can, forks of one that has all imported and no threads."""

import multiprocessing
import time
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from tests.faults.programs import make_program, run_program

_CAN_FORK = "forkserver" in multiprocessing.get_all_start_methods()
_FORKS: Any = multiprocessing.get_context("forkserver" if _CAN_FORK else "spawn")
_FORKS.set_forkserver_preload(["tests.faults.programs", "tests.faults.disks"])
_SECONDS = 300


class Child:
    """A process that says what it does."""

    def __init__(self, target: Callable[..., None], *arguments: object) -> None:
        self._ours, theirs = _FORKS.Pipe(duplex=False)
        self.process: BaseProcess = _FORKS.Process(target=target, args=(*arguments, theirs))
        self.process.start()
        theirs.close()

    def says(self) -> Any:
        """The next thing that it says; "" when it has ended."""
        assert self._ours.poll(_SECONDS), "it says nothing"
        try:
            return self._ours.recv()
        except EOFError:
            return ""

    def kill(self) -> None:
        """End it as the system does when memory runs out."""
        self.process.kill()
        self.end()

    def end(self) -> None:
        """Wait for its end."""
        self.process.join(_SECONDS)
        self._ours.close()


def make(name: str, root: Path) -> None:
    """Make what a program needs in ``root``."""
    child = Child(make_program, name, root)
    assert child.says() == "ended"
    child.end()


def run_whole(name: str, root: Path, version: str) -> float:
    """Run a program to its end; the seconds that it took."""
    child = Child(run_program, name, root, version)
    assert child.says() == "begun"
    start = time.monotonic()
    said = child.says()
    assert said == "ended", said
    child.end()
    return time.monotonic() - start


def run_and_kill(name: str, root: Path, version: str, seconds: float) -> None:
    """Run a program and kill it so many seconds after it has begun."""
    child = Child(run_program, name, root, version)
    assert child.says() == "begun"
    time.sleep(seconds)
    child.kill()
