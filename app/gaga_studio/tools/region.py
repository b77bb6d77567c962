"""What a region gesture selects: splats or whole objects, everything or the visible surface."""

from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.edits import How
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra
from gaga_studio.session.session import Session
from gaga_studio.tools.base import ViewportPoint

if TYPE_CHECKING:
    from gaga_core.scene.selection.by_screen import Screen

_LONGEST = 480  # longest side, pixels, of the depth picture

_worker = ThreadPoolExecutor(1, thread_name_prefix="surface")


class Region:
    """One gesture's view of the scene: from the press to the release."""

    def __init__(
        self, session: Session, place: ViewportPoint, *, surface_only: bool = False
    ) -> None:
        """``surface_only``: single splats of the visible surface, whatever the options say."""
        document = session.need()
        self._document = document
        self._camera = session.rig.camera(place.width, place.height)
        self._scene = document.settled().scene
        takes_splats = surface_only or session.view.takes_splats
        self._whole = not takes_splats and document.read.has_groups()
        self._depth: Future[FloatArray] | None = None
        self._through: Screen | None = None
        self._surface: Screen | None = None
        if surface_only or session.view.visible_only:
            self._depth = _worker.submit(_median_depth, self._scene, self._camera)
        self.how: How = place.how

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the picture."""
        return self._camera.height, self._camera.width

    @property
    def is_known(self) -> bool:
        """Whether the visible surface is there, if it counts: until then `splats` waits for it."""
        return self._depth is None or self._depth.done()

    def preview(self, mask: BoolArray) -> None:
        """Show what ``mask`` (H, W) would select; the surface as soon as it is known."""
        if not self.is_known:
            return
        chosen, title = self._chosen(mask)
        self._document.history.preview_with(
            lambda base: edits.select(base, chosen, self.how, title)
        )

    def take(self, mask: BoolArray) -> bool:
        """Select what ``mask`` (H, W) covers, as one edit."""
        self._document.history.preview(None)
        chosen, title = self._chosen(mask)
        return self._document.select(chosen, self.how, title)

    def splats(self, mask: BoolArray) -> IntArray:
        """Splats (K,) that ``mask`` (H, W) covers."""
        return self._screen().inside(mask)

    def cancel(self) -> None:
        """Cancel: everything is as before the gesture."""
        self._document.history.preview(None)

    def _chosen(self, mask: BoolArray) -> tuple[IntArray, str]:
        splats = self._screen().inside(mask)
        verb = "Deselect" if self.how == "remove" else "Select"
        if not self._whole:
            return splats, f"{verb} {len(splats):,} splats"
        groups = algebra.groups_inside(self._scene, splats)
        rows = group_indices(self._scene, groups)
        if len(groups) == 1:
            return rows, f"{verb} {self._document.name_of(int(groups[0]))}"
        return rows, f"{verb} {len(groups)} objects"

    def _screen(self) -> "Screen":
        # Imported when first asked for: numba is a good part of the launch time.
        from gaga_core.scene.selection.by_screen import screen

        # Of an object all splats count, seen or not.
        if self._depth is None or self._whole:
            self._through = self._through or screen(self._scene, self._camera)
            return self._through
        self._surface = self._surface or screen(self._scene, self._camera, self._depth.result())
        return self._surface


def _median_depth(scene: Scene, camera: Camera) -> FloatArray:
    """Render the median depth (H, W) at the camera's size, from a smaller picture."""
    shrink = min(1.0, _LONGEST / max(camera.width, camera.height))
    width, height = max(round(camera.width * shrink), 1), max(round(camera.height * shrink), 1)
    plain = bake(scene)
    depth = choose("cpu").render(plain, camera.resized(width, height)).median_depth
    rows = (np.arange(camera.height) + 0.5) * height / camera.height
    columns = (np.arange(camera.width) + 0.5) * width / camera.width
    result: FloatArray = depth[rows.astype(int)[:, None], columns.astype(int)]
    return result
