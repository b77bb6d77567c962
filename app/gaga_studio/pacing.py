"""Keeps moving the camera smooth: a coarser picture while it moves, the full one when it rests."""

import time
from dataclasses import dataclass, field, replace

from gaga_core.camera import Camera
from gaga_studio.view import ViewState

_REST_S = 0.15  # after the last motion the picture is drawn in full
_TARGET_MS = 40.0  # of a picture while the camera moves
_LEAST_SCALE = 0.35


@dataclass
class Pacing:
    """A controller of the picture's resolution by what the last pictures took."""

    frame_ms: float = 0.0  # of the last picture
    scale: float = 1.0  # of the resolution while moving
    _pose: bytes = b""
    _moved_at: float = -1e9
    _was_coarse: bool = field(default=False)

    @property
    def is_settled(self) -> bool:
        """Whether the picture on the screen is the full one."""
        return not self._was_coarse

    def view_for(self, view: ViewState, camera: Camera, is_software: bool) -> ViewState:
        """The settings to draw this frame with: ``view`` itself unless the camera moves."""
        now = time.monotonic()
        pose = camera.cam_from_world.tobytes()
        if pose != self._pose:
            self._moved_at = now if self._pose else -1e9
            self._pose = pose
        is_moving = now - self._moved_at < _REST_S
        self._was_coarse = is_moving and (self.scale < 1.0 or is_software)
        if not self._was_coarse:
            return view
        return replace(view, resolution_scale=view.resolution_scale * self.scale)

    def drew(self, milliseconds: float) -> None:
        """A picture took this long: a coarse one adjusts the next coarse one."""
        self.frame_ms = milliseconds
        if self._was_coarse or milliseconds > _TARGET_MS:
            # Time goes with the number of pixels at best: half the correction each time.
            wanted = self.scale * (_TARGET_MS / max(milliseconds, 1.0)) ** 0.25
            self.scale = min(max(wanted, _LEAST_SCALE), 1.0)
