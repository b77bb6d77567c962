"""A short walk of the session's state machine; ``make soak`` is the long one."""

import hypothesis
import pytest
from hypothesis.stateful import run_state_machine_as_test

from tests.soak.machine import SessionMachine

_SETTINGS = hypothesis.settings(
    max_examples=5,
    stateful_step_count=40,
    derandomize=True,
    database=None,
    deadline=None,
    phases=(hypothesis.Phase.generate, hypothesis.Phase.shrink),
    suppress_health_check=list(hypothesis.HealthCheck),
)


def test_commands_undo_saves_and_crashes_in_any_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(SessionMachine, "n_commands", 0)
    run_state_machine_as_test(SessionMachine, settings=_SETTINGS)  # type: ignore[no-untyped-call]
    assert SessionMachine.n_commands > 50
