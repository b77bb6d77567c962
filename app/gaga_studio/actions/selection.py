"""Selecting by numbers: ranges of columns, colors, boxes. What the "Select by" panel calls."""

from collections.abc import Callable, Sequence

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.scene import edits
from gaga_core.scene.edits import How
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra, by_value, by_volume
from gaga_core.scene.selection.by_value import Histogram
from gaga_core.scene.tint import mean_color
from gaga_studio.session.session import Session


class Histograms:
    """The histogram of the chosen column, made anew when the scene changed."""

    def __init__(self) -> None:
        self._key: tuple[object, int, str] | None = None
        self._kept: Histogram | None = None

    def of(self, session: Session, name: str) -> Histogram:
        """Counts of a column, those of the selection apart."""
        document = session.need()
        scene = document.history.base
        key = (document, scene.revision.total(), name)
        if self._kept is None or key != self._key:
            self._kept = by_value.histogram(scene, name, document.read.selected_indices())
            self._key = key
        return self._kept


def by_range(session: Session, name: str, low: float, high: float, how: How = "set") -> bool:
    """Select splats whose column lies in a range."""
    return _take(session, name, how, lambda s: by_value.in_range(s, name, low, high))


def by_color(session: Session, rgb: Sequence[float], tolerance: float, how: How = "set") -> bool:
    """Select splats of a color."""
    return _take(session, "a color", how, lambda s: by_value.like_color(s, rgb, tolerance))


def in_box(session: Session, lo: DoubleArray, hi: DoubleArray, how: How = "set") -> bool:
    """Select splats in an upright box (3,) to (3,), world."""
    return _take(session, "a box", how, lambda s: by_volume.in_box(s, box_matrix(lo, hi)))


def crop(session: Session, lo: DoubleArray, hi: DoubleArray) -> bool:
    """Delete every splat outside an upright box that can be selected."""

    def run() -> bool:
        document = session.need()
        scene = document.settled().scene
        inside = by_volume.in_box(scene, box_matrix(lo, hi))
        outside = np.setdiff1d(algebra.everything(scene), inside)
        return document.do(edits.delete(scene, outside, "Crop"))

    return session.attempt(run)


def box_matrix(lo: DoubleArray, hi: DoubleArray) -> DoubleArray:
    """World from the unit cube (4, 4); a side is never shorter than a thousandth of the longest."""
    sides = np.abs(hi - lo)
    sides = np.maximum(sides, max(float(sides.max()) * 1e-3, 1e-9))
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(sides)
    matrix[:3, 3] = (lo + hi) / 2
    return matrix


def selected_color(session: Session) -> tuple[float, float, float]:
    """Mean color of the selection; grey when nothing is selected."""
    document = session.need()
    red, green, blue = mean_color(document.history.base, document.read.selected_indices())
    return float(red), float(green), float(blue)


def _take(session: Session, what: str, how: How, choose: Callable[[Scene], IntArray]) -> bool:
    def run() -> bool:
        document = session.need()
        rows = choose(document.settled().scene)
        verb = "Deselect" if how == "remove" else "Select"
        return document.select(rows, how, f"{verb} by {what}")

    return session.attempt(run)
