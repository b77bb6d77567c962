"""Pictures that a job needs and only the thread with the OpenGL context can draw."""

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_studio.session.view_state import ViewState

Draw = Callable[[Camera, ViewState], UInt8Array]  # (H, W, 3)
_PATIENCE_S = 120.0  # for one picture: software OpenGL at a large size


@dataclass
class _Request:
    camera: Camera
    view: ViewState
    done: threading.Event = field(default_factory=threading.Event)
    picture: UInt8Array | None = None


class RenderRequests:
    """A worker calls ``paint`` and waits; the window's thread calls ``serve`` every frame."""

    def __init__(self, *, max_side: int, is_fast: bool) -> None:
        self.max_side = max_side  # pixels of a side that OpenGL can draw
        self.is_fast = is_fast  # a graphics card: else the CPU's own rasterizer is quicker
        self._waiting: queue.SimpleQueue[_Request] = queue.SimpleQueue()
        self._closed = False

    def paint(self, camera: Camera, view: ViewState, *, transparent: bool = False) -> UInt8Array:
        """Return the picture (H, W, 3), or with ``transparent`` (H, W, 4) in straight alpha.

        Raises ``GagaError`` when the window closes or does not answer.
        """
        if not transparent:
            return self._ask(camera, view)
        dark, light = (
            self._ask(camera, replace(view, background=(level, level, level))).astype(np.int16)
            for level in (0.0, 1.0)
        )
        # The difference of the backgrounds is the light that the splats let through.
        alpha = 255 - np.clip(light - dark, 0, 255).max(axis=2, keepdims=True)
        straight = np.where(alpha > 0, dark * 255.0 / np.maximum(alpha, 1), 0)
        picture = np.concatenate([straight, alpha], axis=2)
        result: UInt8Array = (np.clip(picture, 0, 255) + 0.5).astype(np.uint8)
        return result

    @property
    def is_wanted(self) -> bool:
        """Whether a picture is requested: the window must not rest."""
        return not self._waiting.empty()

    def serve(self, draw: Draw) -> bool:
        """Draw one requested picture; return whether there was one."""
        try:
            request = self._waiting.get_nowait()
        except queue.Empty:
            return False
        request.picture = draw(request.camera, request.view)
        request.done.set()
        return True

    def close(self) -> None:
        """Release every waiting worker: the window closes."""
        self._closed = True
        while True:
            try:
                self._waiting.get_nowait().done.set()
            except queue.Empty:
                return

    def _ask(self, camera: Camera, view: ViewState) -> UInt8Array:
        request = _Request(camera, view)
        if not self._closed:
            self._waiting.put(request)
            request.done.wait(_PATIENCE_S)
        if request.picture is None:
            raise GagaError("The window did not draw the picture. Try again.")
        return request.picture
