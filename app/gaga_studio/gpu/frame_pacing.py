"""Keeps moving smooth: fewer splats, then fewer pixels while something moves; all of it at rest."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from gaga_studio.session.view import ViewState

REST_S = 0.15  # after the last motion the picture is drawn in full
TARGET_MS = 33.0  # of a picture while something moves
SOFTWARE_TARGET_MS = 120.0  # the same where the processor draws: the panels need it too
LEAST_SPLATS = 75_000  # the most important ones carry a picture alone
LEAST_SCALE = 0.35  # of the resolution
_SOFTWARE_SCALE = 0.5  # to begin with
_STEPS = 2  # budgets there are between a number of splats and half of it
# Halvings too many or too few that are left alone: more than a step apart, or the picture would
# flicker between two budgets.
_FAST_ENOUGH, _TOO_SLOW = -0.45, 0.25


@dataclass
class Pacing:
    """A controller of what a moving picture costs, by what the last pictures took.

    ``saved`` is how many times the work was halved: first the splats are halved down to
    `LEAST_SPLATS`, the most important ones staying, then the pixels.
    """

    is_software: bool = False
    clock: Callable[[], float] = time.monotonic
    frame_ms: float = 0.0  # of the last picture
    saved: float = -1.0  # halvings; -1 before the first motion
    _n_splats: int = 0
    _full_ms: float = 0.0  # of the last picture in full
    _step: float = 0.0  # `saved` in whole steps
    _motion: object = None
    _moved_at: float = -1e9
    _is_moving: bool = False
    _is_first: bool = True  # nothing of this scene was drawn yet
    _is_coarse: bool = False

    @property
    def is_settled(self) -> bool:
        """Whether the picture on the screen is the full one."""
        return not self._is_coarse

    @property
    def budget(self) -> int:
        """Splats to draw while moving; 0 = all."""
        halvings = min(self._step, self._most_by_splats)
        n = max(round(self._n_splats / 2**halvings), LEAST_SPLATS)
        return n if n < self._n_splats else 0

    @property
    def scale(self) -> float:
        """Share of the resolution while moving; the work goes with its square."""
        halvings = max(0.0, self._step - self._most_by_splats)
        return max(LEAST_SCALE, 2 ** (-halvings / 2))

    def view_for(self, view: ViewState, motion: object, n_splats: int) -> ViewState:
        """The settings to draw this frame with: coarser while ``motion`` (any value) changes.

        ``n_splats`` of the scene. Twice or half as many are another scene: it begins again. Where
        the processor draws, its first picture is a coarse one: the full one takes seconds.
        """
        now = self.clock()
        if not self._n_splats < 2 * n_splats < 4 * self._n_splats:
            self._full_ms, self.saved, self._step, self._is_first = 0.0, -1.0, 0.0, True
        self._n_splats = n_splats
        if motion != self._motion:
            self._moved_at = now if self._motion is not None else -1e9
            self._motion = motion
        is_moving = now - self._moved_at < REST_S
        is_draft = is_moving or (self._is_first and self.is_software)
        if is_draft and not self._is_moving and self.saved < 0:
            self._begin()
        self._is_moving = is_moving
        self._is_coarse = is_draft and self._step > 0
        if not self._is_coarse:
            return replace(view, coarse_budget=_least(view.splat_budget, self.budget))
        return replace(
            view,
            splat_budget=_least(view.splat_budget, self.budget),
            resolution_scale=view.resolution_scale * self.scale,
        )

    def drew(self, milliseconds: float) -> None:
        """A picture took this long: one that was drawn while moving adjusts the next."""
        self.frame_ms = milliseconds
        if self._is_first:  # what the full one takes tells more
            self._is_first, self.saved, self._step = False, -1.0, 0.0
        if not self._is_coarse:
            self._full_ms = milliseconds
        if not self._is_moving:
            return
        halvings = math.log2(max(milliseconds, 0.5) / self._target)
        if not _FAST_ENOUGH < halvings < _TOO_SLOW:
            # Half the correction each time: a single slow picture says little.
            self._save(self.saved + 0.5 * halvings)

    @property
    def _target(self) -> float:
        return SOFTWARE_TARGET_MS if self.is_software else TARGET_MS

    @property
    def _most_by_splats(self) -> float:
        return max(0.0, math.log2(max(self._n_splats, 1) / LEAST_SPLATS))

    def _begin(self) -> None:
        """The first motion: what the picture in full took says how much is too much."""
        least = self._most_by_splats - 2 * math.log2(_SOFTWARE_SCALE) if self.is_software else 0.0
        by_time = math.log2(self._full_ms / self._target) if self._full_ms > 0 else 0.0
        self._save(max(least, by_time))

    def _save(self, halvings: float) -> None:
        most = self._most_by_splats - 2 * math.log2(LEAST_SCALE)
        self.saved = min(max(halvings, 0.0), most)
        self._step = round(self.saved * _STEPS) / _STEPS


def _least(a: int, b: int) -> int:
    """The smaller of two budgets, of which 0 is no limit."""
    return min(a, b) if a and b else a or b
