"""``python -m tests.soak.walk COMMANDS [SEED ...]``: long walks of the session's state machine.

Status 1 when a step is not as before, or when memory grows by more than a tenth after the first
fifth of a walk.
"""

import gc
import sys
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
        self.memory.append(psutil.Process().memory_info().rss)


def walk(n_steps: int, seed: int) -> str:
    """Walk so many steps with a seed; the first failure is raised. Returns one line of figures."""
    settings = hypothesis.settings(
        max_examples=max(n_steps // _STEPS, 1),
        stateful_step_count=_STEPS,
        database=None,
        deadline=None,
        phases=(hypothesis.Phase.generate, hypothesis.Phase.shrink),
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    _Measured.memory, SessionMachine.n_steps = [], 0
    run_state_machine_as_test(hypothesis.seed(seed)(_Measured), settings=settings)  # type: ignore[no-untyped-call]
    memory = _Measured.memory[len(_Measured.memory) // 5 :]
    growth = max(memory) / memory[0] - 1
    line = f"seed {seed}: {SessionMachine.n_steps:,} steps, {memory[0] >> 20} MB, grew {growth:.1%}"
    if growth > _MOST_GROWTH:
        raise AssertionError(line)
    return line


if __name__ == "__main__":
    for seed in [int(argument) for argument in sys.argv[2:]] or _SEEDS:
        sys.stdout.write(f"{walk(int(sys.argv[1]) // len(_SEEDS), seed)}\n")
        sys.stdout.flush()
