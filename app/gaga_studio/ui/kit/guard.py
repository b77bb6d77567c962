"""What becomes of an error while something is drawn: it is told, and the frame goes on.

An error that leaves a child window, a popup or a table open would end the process at the end of the
frame. So the toolkit's stacks are put back to where they were before.
"""

import traceback
from collections.abc import Callable

from imgui_bundle import imgui

Act = Callable[[], object]


class Guard:
    """Calls what the window wants drawn. ``tell`` gets the place and the error.

    A place that fails in every frame in the same way is told of once.
    """

    def __init__(self, tell: Callable[[str, Exception], None]) -> None:
        self._tell = tell
        self._failing: dict[str, str] = {}  # what each place failed with when it was called last

    def wrap(self, place: str, act: Act) -> Callable[[], None]:
        """``act``, called by this guard."""
        return lambda: self.call(place, act)

    def call(self, place: str, act: Act) -> None:
        """Call ``act``; whatever it raises is told, never passed on."""
        stacks = _stacks()
        try:
            act()
        except Exception as error:  # noqa: BLE001  the toolkit would abort: it becomes a notice and a log entry
            # A list clipper ends itself when it goes, and needs its window for that.
            traceback.clear_frames(error.__traceback__)
            if stacks is not None:
                _put_back(stacks)
            failure = repr(error)
            if self._failing.get(place) != failure:
                self._failing[place] = failure
                self._tell(place, error)
        else:
            self._failing.pop(place, None)


def _stacks() -> imgui.internal.ErrorRecoveryState | None:
    """How much is open now; None between two frames, when nothing can be."""
    if not imgui.get_current_context().within_frame_scope:
        return None
    stacks = imgui.internal.ErrorRecoveryState()
    imgui.internal.error_recovery_store_state(stacks)
    return stacks


def _put_back(stacks: imgui.internal.ErrorRecoveryState) -> None:
    """Close what was opened since; in silence, for the error itself is told."""
    io = imgui.get_io()
    kept = (
        io.config_error_recovery_enable_assert,
        io.config_error_recovery_enable_tooltip,
        io.config_error_recovery_enable_debug_log,
    )
    io.config_error_recovery_enable_assert = False
    io.config_error_recovery_enable_tooltip = False
    io.config_error_recovery_enable_debug_log = False
    imgui.internal.error_recovery_try_to_recover_state(stacks)
    io.config_error_recovery_enable_assert = kept[0]
    io.config_error_recovery_enable_tooltip = kept[1]
    io.config_error_recovery_enable_debug_log = kept[2]
