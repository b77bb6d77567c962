"""``python -m tests.soak.walk COMMANDS [SEED ...]``: long walks of the session's state machine.

So many commands are applied at least: those that cannot be run do not count. Status 1 when a step
is not as before, or when memory grows by more than a tenth after the first fifth of a walk.
"""

import ctypes
import gc
import itertools
import logging
import sys
import warnings
from typing import ClassVar

import hypothesis
import psutil
from hypothesis.stateful import run_state_machine_as_test

from tests.soak.machine import SessionMachine

_SEEDS = (1, 2, 3, 4)
_STEPS = 50  # of a machine
_MOST_GROWTH = 0.1


class _Measured(SessionMachine):
    """Counts memory at the end of each machine."""

    memory: ClassVar[list[int]] = []  # bytes

    def teardown(self) -> None:
        super().teardown()
        gc.collect()
        if sys.platform == "linux":  # only what is in use counts
            ctypes.CDLL(None).malloc_trim(0)
        self.memory.append(psutil.Process().memory_info().rss)


def walk(n_commands: int, seed: int) -> str:
    """Apply so many commands with a seed; raise the first failure, return a line of figures."""
    _Measured.memory, SessionMachine.n_commands = [], 0
    SessionMachine.n_damaged.clear()
    for part in itertools.count():
        missing = n_commands - SessionMachine.n_commands
        if missing <= 0:
            break
        settings = hypothesis.settings(
            max_examples=max(missing // _STEPS, 1),
            stateful_step_count=_STEPS,
            database=None,
            deadline=None,
            phases=(hypothesis.Phase.generate, hypothesis.Phase.shrink),
            suppress_health_check=list(hypothesis.HealthCheck),
        )
        begin = hypothesis.seed(seed + (part << 32))
        run_state_machine_as_test(begin(_Measured), settings=settings)  # type: ignore[no-untyped-call]
    memory = _Measured.memory[len(_Measured.memory) // 5 :]
    growth = max(memory) / memory[0] - 1
    line = f"seed {seed}: {SessionMachine.n_commands:,} commands, {memory[0] >> 20} MB, "
    line += f"grew {growth:.1%}, damaged files {dict(sorted(SessionMachine.n_damaged.items()))}"
    if growth > _MOST_GROWTH:
        raise AssertionError(line)
    return line


if __name__ == "__main__":
    logging.disable(logging.WARNING)  # of damaged files
    warnings.simplefilter("ignore", UserWarning)  # of zipfile, while files are damaged
    seeds = [int(argument) for argument in sys.argv[2:]] or _SEEDS
    for seed in seeds:
        sys.stdout.write(f"{walk(-(-int(sys.argv[1]) // len(seeds)), seed)}\n")
        sys.stdout.flush()
