"""Brushes that select, erase, color or clone what they go over. A stroke is one edit."""

from time import perf_counter

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.errors import counted
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit, How
from gaga_core.scene.edits.placement import clone
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import by_screen
from gaga_core.scene.selection.by_volume import (
    SurfacePoint,
    in_stroke,
    map_between,
    on_plane,
    surface_point,
)
from gaga_core.scene.tint import mean_color, tint_affine
from gaga_studio.features.selection import Region
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import PathShape, ViewportPoint, region_hint

_SHARE = 0.5  # of the time that the preview of a stroke may take at most
_MIDDLE = 0.35  # of the brush's radius: objects that only its rim touches are not meant
_APART = 0.5  # brush radii between two points of a clone stroke


def _asks(place: ViewportPoint) -> bool:
    """Whether a click takes something (a color, a source) instead of painting: Ctrl or Alt."""
    return place.alt or place.how == "remove"


class _Brush:
    """A round brush that shows what its stroke does and commits it on release."""

    takes_drag = True
    is_content = True  # whether a stroke changes what a save keeps

    def __init__(self) -> None:
        self._document: Document | None = None
        self._how: How = "set"
        self._last = (0.0, 0.0)
        self._at: tuple[float, float] | None = None
        self._radius = 0.0
        self._next = 0.0  # when the preview may be made again

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Do at one place what a stroke does, once."""
        self.press(session, place)
        self.release(session, place)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Begin a stroke."""
        session.hint = ""
        self._radius = session.view.brush_radius
        self._last, self._next = (place.u, place.v), 0.0
        self._document = session.need() if self._begin(session, place) else None
        self.drag(session, place)

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """Continue the stroke, and show what it does."""
        if self._document is None:
            return
        self._go(session, place)
        self._last = (place.u, place.v)
        start = perf_counter()
        if start >= self._next and self._can_show():
            self._document.preview_with(self._edit)
            self._next = perf_counter() + (perf_counter() - start) / _SHARE

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Do it, as one edit."""
        document, self._document = self._document, None
        if document is not None:
            self._go(session, place)
            document.do(self._edit(document.settled().scene), is_content=self.is_content)

    def cancel(self, session: Session) -> None:
        """Cancel: everything is as before the stroke."""
        document, self._document = self._document, None
        if document is not None:
            document.history.preview(None)

    def hover(self, session: Session, place: ViewportPoint | None) -> None:
        """Show the brush at the mouse."""
        self._radius = session.view.brush_radius
        self._at = None if place is None else (place.u, place.v)

    def overlay(self) -> PathShape | None:
        """The brush."""
        at = self._last if self._document is not None else self._at
        how = self._how if self._document is not None else "set"
        return None if at is None else PathShape((at,), how, radius=self._radius)

    def _begin(self, session: Session, place: ViewportPoint) -> bool:
        raise NotImplementedError

    def _go(self, session: Session, place: ViewportPoint) -> None:
        raise NotImplementedError

    def _can_show(self) -> bool:
        """Whether the preview needs no waiting."""
        return True

    def _edit(self, scene: Scene) -> Edit | None:
        raise NotImplementedError


class _SurfaceBrush(_Brush):
    """Acts on the splats of the visible surface that it goes over."""

    def __init__(self) -> None:
        super().__init__()
        self._region: Region | None = None
        self._mask: BoolArray = np.zeros((0, 0), np.bool_)
        self._middle: BoolArray | None = None  # of the stroke, where that counts

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Do it, as one edit; where that is nothing, say why."""
        is_stroke = self._document is not None
        super().release(session, place)
        if is_stroke and self._region is not None:
            self._region.say_why_nothing(self._mask, self._middle)

    def _begin(self, session: Session, place: ViewportPoint) -> bool:
        self._region = Region(session, place, surface_only=True)
        self._mask = np.zeros(self._region.shape, np.bool_)
        return True

    def _go(self, session: Session, place: ViewportPoint) -> None:
        by_screen.stroke(self._mask, self._last, (place.u, place.v), self._radius)

    def _can_show(self) -> bool:
        return self._region is not None and self._region.is_known

    def _edit(self, scene: Scene) -> Edit | None:
        splats = self._region.splats(self._mask) if self._region is not None else None
        return None if splats is None or len(splats) == 0 else self._on(scene, splats)

    def _on(self, scene: Scene, splats: np.ndarray) -> Edit | None:
        raise NotImplementedError


class BrushTool(_SurfaceBrush):
    """Paint over what is to be selected: objects that are seen there, or splats as options say."""

    name = ToolName.BRUSH
    is_content = False

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        return region_hint(session, "Paint") + " [ and ] change the size."

    def _begin(self, session: Session, place: ViewportPoint) -> bool:
        self._how = place.how
        self._region = Region(session, place, paints=True)
        self._mask, self._middle = np.zeros((2, *self._region.shape), np.bool_)
        return True

    def _go(self, session: Session, place: ViewportPoint) -> None:
        super()._go(session, place)
        assert self._middle is not None
        by_screen.stroke(self._middle, self._last, (place.u, place.v), _MIDDLE * self._radius)

    def _edit(self, scene: Scene) -> Edit | None:
        if self._region is None:
            return None
        chosen, title = self._region.chosen(self._mask, self._middle)
        if len(chosen) == 0 and self._how == "set":
            return None  # a stroke next to everything keeps what was selected
        return edits.select(scene, chosen, self._how, title)


class EraseTool(_SurfaceBrush):
    """Delete the visible splats under the brush."""

    name = ToolName.ERASE

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        return "Drag over splats to erase them; those behind them stay. [ and ] change the size."

    def _on(self, scene: Scene, splats: np.ndarray) -> Edit | None:
        return edits.delete(scene, splats, f"Erase {counted(len(splats), 'splat')}")


class ColorTool(_SurfaceBrush):
    """Give the visible splats under the brush ``view.brush_color``; their shading stays."""

    name = ToolName.COLOR

    def __init__(self) -> None:
        super().__init__()
        self._color, self._strength = (0.5, 0.5, 0.5), 1.0

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Color what is under the brush, or take its color (Ctrl, Alt)."""
        if not _asks(place):
            super().click(session, place)
            return
        found = session.pick(place.u, place.v, place.width, place.height)
        if found is not None:
            r, g, b = (float(c) for c in mean_color(session.need().scene, found.indices))
            session.view.brush_color = (r, g, b)

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        return "Drag to color; Ctrl+click takes the color of the surface. [ and ] change the size."

    def _begin(self, session: Session, place: ViewportPoint) -> bool:
        self._color, self._strength = session.view.brush_color, session.view.brush_strength
        return super()._begin(session, place)

    def _on(self, scene: Scene, splats: np.ndarray) -> Edit | None:
        affine = tint_affine(mean_color(scene, splats), self._color, self._strength)
        return edits.recolor(scene, splats, affine, title=f"Color {counted(len(splats), 'splat')}")


class CloneTool(_Brush):
    """Copy splats from around a source point, laid onto the surface under the brush."""

    name = ToolName.CLONE

    def __init__(self) -> None:
        super().__init__()
        self._source: tuple[Document, SurfacePoint] | None = None
        self._target: SurfacePoint | None = None
        self._points: list[DoubleArray] = []
        self._reach = 0.0  # radius of the brush at the surface, scene units

    def source(self, session: Session) -> DoubleArray | None:
        """Point (3,), world, that is copied from now: it goes along with a stroke."""
        if self._source is None or self._source[0] is not session.document:
            return None
        source = self._source[1]
        if self._document is None or self._target is None or not self._points:
            return source.point
        back = map_between(self._target, source)
        return np.asarray(back[:, :3] @ self._points[-1] + back[:, 3], np.float64)

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Copy to one place, or set the source (Ctrl, Alt)."""
        if not _asks(place):
            super().click(session, place)
            return
        self._radius = session.view.brush_radius
        found = self._surface(session, place)
        if found is not None:
            self._source = session.need(), found
            session.hint = "The source is set. Drag where the copies should go."

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        if self._source is None or self._source[0] is not session.document:
            return "Ctrl+click a surface: the source that the brush copies."
        return "Drag to copy from the source; Ctrl+click sets another one. [ and ] change the size."

    def _begin(self, session: Session, place: ViewportPoint) -> bool:
        if self._source is None or self._source[0] is not session.document:
            session.notify(Level.HINT, "Ctrl+click a surface first: the source that is copied.")
            return False
        session.need().settled()
        self._target, self._points = self._surface(session, place), []
        return self._target is not None

    def _go(self, session: Session, place: ViewportPoint) -> None:
        if self._target is None:
            return
        camera = session.rig.camera(place.width, place.height)
        point = on_plane(self._target, camera, place.u, place.v)
        if point is None:
            return
        apart = _APART * self._reach
        if all(np.linalg.norm(point - other) > apart for other in self._points):
            self._points.append(point)

    def _edit(self, scene: Scene) -> Edit | None:
        if self._source is None or self._target is None:
            return None
        source, target = self._source[1], self._target
        splats = in_stroke(scene, self._points, self._reach, map_between(target, source))
        title = f"Clone {counted(len(splats), 'splat')}"
        return clone(scene, splats, map_between(source, target), target.group, title)

    def _surface(self, session: Session, place: ViewportPoint) -> SurfacePoint | None:
        found = session.pick(place.u, place.v, place.width, place.height)
        if found is None:
            session.hint = "There is no surface here. Begin on something."
            return None
        camera = session.rig.camera(place.width, place.height)
        self._reach = self._radius * found.depth / float(camera.K[0, 0])
        scene = session.need().settled().scene
        return surface_point(scene, found.point, self._reach, camera.position, found.group)
