"""While something moves the picture costs what it may; at rest it is the full one."""

from dataclasses import dataclass

import pytest

from gaga_studio.gpu.viewport import (
    LEAST_SCALE,
    LEAST_SPLATS,
    REST_S,
    SOFTWARE_TARGET_MS,
    TARGET_MS,
    Pacing,
)
from gaga_studio.session.view import ViewState

VIEW = ViewState()


@dataclass
class _Machine:
    """Draws n splats at a scale in a time that grows with both."""

    pacing: Pacing
    n: int
    ms_per_million: float  # at full resolution
    now: float = 0.0
    pose: int = 0

    def __post_init__(self) -> None:
        self.pacing.clock = lambda: self.now

    def frame(self, *, moves: bool, seconds: float = 0.02) -> tuple[ViewState, float]:
        self.now += seconds
        self.pose += moves
        view = self.pacing.view_for(VIEW, self.pose, self.n)
        drawn = view.splat_budget or self.n
        ms = drawn / 1e6 * self.ms_per_million * (0.3 + 0.7 * view.resolution_scale**2)
        self.pacing.drew(ms)
        return view, ms


def test_a_fast_machine_draws_everything_all_the_time() -> None:
    machine = _Machine(Pacing(), 3_000_000, 5)
    for _ in range(30):
        view, _ = machine.frame(moves=True)
        assert (view.splat_budget, view.resolution_scale) == (0, 1.0)
        assert machine.pacing.is_settled


def test_splats_go_first_and_pixels_second() -> None:
    machine = _Machine(Pacing(), 3_000_000, 60)  # 180 ms in full
    machine.frame(moves=False)
    for _ in range(40):
        view, ms = machine.frame(moves=True)
    assert ms < 1.4 * TARGET_MS
    assert LEAST_SPLATS < view.splat_budget < 3_000_000
    assert view.resolution_scale == 1.0
    slow = _Machine(Pacing(), 3_000_000, 3000)
    slow.frame(moves=False)
    for _ in range(40):
        view, _ = slow.frame(moves=True)
    assert view.splat_budget == LEAST_SPLATS
    assert view.resolution_scale == pytest.approx(LEAST_SCALE)


def test_the_first_moving_frame_is_already_cheap() -> None:
    machine = _Machine(Pacing(), 2_000_000, 400)
    machine.frame(moves=False)
    _, ms = machine.frame(moves=True)
    assert ms < 4 * TARGET_MS


def test_full_quality_comes_back_after_the_rest_and_not_before() -> None:
    machine = _Machine(Pacing(), 2_000_000, 400)
    machine.frame(moves=False)
    machine.frame(moves=True)
    view, _ = machine.frame(moves=False, seconds=0.8 * REST_S)
    assert view.splat_budget
    assert not machine.pacing.is_settled
    view, _ = machine.frame(moves=False, seconds=0.3 * REST_S)
    assert (view.splat_budget, view.resolution_scale) == (0, 1.0)
    assert machine.pacing.is_settled
    assert view.coarse_budget == machine.pacing.budget


def test_software_begins_with_few_splats_and_half_the_pixels() -> None:
    machine = _Machine(Pacing(is_software=True), 1_000_000, 1500)
    for _ in range(2):  # the first is coarse
        view, _ = machine.frame(moves=False)
    assert view.splat_budget == 0
    view, _ = machine.frame(moves=True)
    assert 50_000 <= view.splat_budget <= 100_000
    assert view.resolution_scale < 0.6
    for _ in range(40):
        view, ms = machine.frame(moves=True)
    assert ms < 1.4 * SOFTWARE_TARGET_MS


def test_the_budget_does_not_flicker() -> None:
    machine = _Machine(Pacing(), 3_000_000, 60)
    machine.frame(moves=False)
    budgets = [machine.frame(moves=True)[0].splat_budget for _ in range(60)]
    assert len(set(budgets[20:])) == 1


def test_a_small_scene_is_never_thinned() -> None:
    machine = _Machine(Pacing(is_software=True), LEAST_SPLATS // 2, 5000)
    for _ in range(20):
        view, _ = machine.frame(moves=True)
        assert view.splat_budget == 0


def test_a_limit_that_the_person_set_stays() -> None:
    pacing = Pacing(is_software=True)
    pacing.clock = lambda: 1.0
    few = ViewState(splat_budget=1000)
    pacing.view_for(few, 0, 1_000_000)
    assert pacing.view_for(few, 1, 1_000_000).splat_budget == 1000


def test_another_scene_begins_again() -> None:
    machine = _Machine(Pacing(), 3_000_000, 400)
    for _ in range(20):
        machine.frame(moves=True)
    machine.n = 100_000
    view, _ = machine.frame(moves=True)
    assert (view.splat_budget, view.resolution_scale) == (0, 1.0)


def test_the_processor_begins_every_scene_with_a_coarse_picture() -> None:
    machine = _Machine(Pacing(is_software=True), 1_000_000, 3000)
    for n in (1_000_000, 3_000_000):  # the second is another scene
        machine.n = n
        first, first_ms = machine.frame(moves=False)
        assert not machine.pacing.is_settled
        second, second_ms = machine.frame(moves=False)
        assert machine.pacing.is_settled
        assert (second.splat_budget, second.resolution_scale) == (0, 1.0)
        assert first.resolution_scale < 1
        assert 0 < first.splat_budget < n
        assert first_ms < 0.2 * second_ms
