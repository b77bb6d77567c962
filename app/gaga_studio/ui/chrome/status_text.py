"""The status line: what a click does now, what is under the mouse, and who computes."""

import time
from dataclasses import dataclass
from functools import lru_cache

from gaga_core.raster import backend_report
from gaga_studio.session.session import Session
from gaga_studio.tools.base import Tool

_LOOK_EVERY = 10.0  # seconds; a look asks the driver and the installed packages


@dataclass(frozen=True)
class Backend:
    """Who blends splats for association, votes and training (the picture is OpenGL's)."""

    name: str  # "CPU" or "CUDA"
    reason: str  # the device, or why CUDA is not used: a clause without a full stop

    @property
    def sentence(self) -> str:
        """What a tooltip says."""
        return f"Finding objects runs on {self.name}: {self.reason}."


def backend() -> Backend:
    """The backend that a stage started now would choose; answers at once, starts no self-test."""
    return _look(int(time.monotonic() / _LOOK_EVERY))


@lru_cache(maxsize=1)
def _look(_period: int) -> Backend:
    name, reason = backend_report(wait=False)
    return Backend(name.upper(), reason)


def status_text(session: Session, tool: Tool) -> str:
    """One line, never empty."""
    document = session.document
    if session.training is not None:
        return "The splats are shown as they are trained. Drag orbits, the wheel zooms."
    if session.photos is not None:
        return "Make splats of these photos, or open something else."
    if document is None:
        return "Open a scene folder or a file of splats, or drop one here."
    if session.rig.is_flying:
        return "W A S D fly, Q down, E up, Shift fast, Alt slow; drag looks around. V ends flying."
    if document.cleaning is not None:
        return "Enter applies the cleaning, Esc leaves everything as it is. Drag orbits."
    if document.filling is not None:
        return "Enter applies the filling, Esc leaves everything as it is. Drag orbits."
    if session.hint:
        return session.hint
    hint = tool.hint(session)
    hovered = session.hovered_group
    return f"{document.name_of(hovered)}  ·  {hint}" if hovered else hint
