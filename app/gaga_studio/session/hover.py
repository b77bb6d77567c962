"""Which object is under the resting mouse, looked up in a thread."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

from gaga_core.camera import Camera
from gaga_core.scene.lod.edited import PickBoxes
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.by_screen import pick

_LEAST_INTERVAL_S = 0.1
_STILL_S = 0.05  # the mouse and the camera must rest this long
_STILL_PIXELS = 2.0


class Hovering:
    """Look up the hovered object without blocking; only the newest position counts."""

    def __init__(self) -> None:
        self.group = 0  # under the mouse; 0 = none
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="hover")
        self._answer: Future[int] | None = None
        self._wanted: tuple[float, float, int, int] | None = None
        self._asked: object = None
        self._moved_at = 0.0
        self._asked_at = 0.0

    def at(self, u: float, v: float, width: int, height: int) -> None:
        """Note that the mouse is at pixel (u, v) of a picture of this size."""
        before = self._wanted
        far = before is None or max(abs(before[0] - u), abs(before[1] - v)) > _STILL_PIXELS
        if far or before is None or before[2:] != (width, height):
            self._wanted = (u, v, width, height)
            self._moved_at = time.monotonic()

    def away(self) -> None:
        """Note that the mouse left the picture, or that a drag or a jump runs."""
        self.group, self._wanted, self._asked = 0, None, None

    def update(
        self,
        scene: Scene,
        camera_of: Callable[[int, int], Camera],
        pose: object,
        antialiased: bool | None = None,
        boxes: PickBoxes | None = None,
    ) -> None:
        """Take an answer, ask the next question. ``pose`` tells whether the camera moved.

        ``antialiased`` is how the splats are drawn, as in `pick`; ``boxes`` of a large scene.
        """
        if self._answer is not None:
            if not self._answer.done():
                return
            answer, self._answer = self._answer, None
            group = answer.result()
            self.group = group if self._wanted is not None else 0
        wanted, now = self._wanted, time.monotonic()
        if wanted is None:
            return
        asked = (wanted, pose, scene.revision.total())
        is_still = now - self._moved_at >= _STILL_S and now - self._asked_at >= _LEAST_INTERVAL_S
        if asked == self._asked or not is_still:
            return
        self._asked, self._asked_at = asked, now
        camera = camera_of(wanted[2], wanted[3])
        # Edits replace columns, never change them in place: this is the scene as it is now.
        self._answer = self._pool.submit(
            _group_at, replace(scene), camera, (wanted[0], wanted[1]), antialiased, boxes
        )

    def shut_down(self) -> None:
        """End the thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)


def _group_at(
    scene: Scene,
    camera: Camera,
    at: tuple[float, float],
    antialiased: bool | None,
    boxes: PickBoxes | None,
) -> int:
    rows = None if boxes is None else boxes.rows_at(camera, *at, len(scene))
    found = pick(scene, camera, *at, antialiased=antialiased, rows=rows)
    return found.group if found is not None else 0
