"""Find the shadow that an object casts on the surface on which it stands.

Its outline is known but for the light: it is that of the object's own splats, moved along the
surface by so much for each unit of height. The light whose shadow explains the brightness of the
surface best is taken (between-class variance over all variance, Otsu 1979), and it is none when
that explains little: dark wood, stripes and the shadows of other things have other outlines.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.scene.fill.chart import Chart

_TURNS = 24  # of the light around the object
_TURN = 2 * np.pi / _TURNS
_LENGTHS = (0.25, 0.4, 0.6, 0.9, 1.3, 1.9)  # of a shadow, in heights of what casts it
_MOST_POINTS = 1500  # of the object
_CLOSE = 3  # cells between its splats
_RING, _LEAST_RING = 0.15, 4  # around a shadow: in sizes of the hole, and cells
_LEAST_CELLS, _LEAST_SHARE = 20, 0.05  # of a shadow: cells, and areas of the hole
_NEXT, _EVERYWHERE = 0.3, 0.17  # share of variance that a shadow explains: next to it, and of all
_ONE_SIDED = 0.75  # of its depth: a shadow is not so dark on the other side, a stripe is


@dataclass(frozen=True, eq=False)
class Cast:
    """A shadow."""

    mask: BoolArray  # (H, W) where it falls
    depth: float  # log by which it is darker than what is next to it
    share: float  # of the variance next to it that it explains


def cast_shadow(
    chart: Chart, dark: DoubleArray, foot: BoolArray, own: DoubleArray, taken: BoolArray
) -> Cast | None:
    """The shadow of the splats at ``own`` (K, 3), plane coordinates; None where there is none.

    ``dark``: (H, W) log of the light that is missing, up to a constant; ``foot``: (H, W) where the
    object stands; ``taken``: (H, W) where other things do.
    """
    free = chart.known & ~ndimage.binary_dilation(taken, iterations=2) & ~foot
    ring = round(max(_LEAST_RING, _RING * np.sqrt(foot.sum())))
    least = max(_LEAST_CELLS, _LEAST_SHARE * foot.sum())
    points = own[own[:, 2] > 0]
    points = points[:: max(1, len(points) // _MOST_POINTS)]

    def shadow(turn: float, length: float) -> Cast:
        mask = _outline(chart, points, turn, length)
        near = ndimage.binary_dilation(mask | foot, iterations=ring) & ~mask & free
        if (mask & free).sum() < least or near.sum() < _LEAST_CELLS:
            return Cast(mask, 0.0, 0.0)
        return Cast(mask, *_explained(dark[mask & free], dark[near]))

    lights = [(turn, length) for turn in np.arange(_TURNS) * _TURN for length in _LENGTHS]
    tried = [shadow(*light) for light in lights]
    turn, length = lights[int(np.argmax([one.share for one in tried]))]
    finer = [
        (turn + k * _TURN, length * f) for k in (-0.5, 0, 0.5) for f in (0.8, 0.9, 1, 1.1, 1.25)
    ]
    turn, length = max(finer, key=lambda light: shadow(*light).share)
    found, opposite = shadow(turn, length), shadow(turn + np.pi, length)
    if found.share < _NEXT or opposite.depth > _ONE_SIDED * found.depth:
        return None
    everywhere = _explained(dark[found.mask & free], dark[free & ~found.mask])[1]
    return found if everywhere > _EVERYWHERE else None


def _outline(chart: Chart, points: DoubleArray, turn: float, length: float) -> BoolArray:
    """Where the shadow (H, W) of ``points`` (K, 3), plane coordinates, falls."""
    moved = points[:, :2] + length * points[:, 2:] * [np.cos(turn), np.sin(turn)]
    row, column, inside = chart.cells(moved)
    mask = np.zeros(chart.shape, np.bool_)
    mask[row[inside], column[inside]] = True
    padded = ndimage.binary_closing(np.pad(mask, _CLOSE + 1), iterations=_CLOSE)
    return padded[_CLOSE + 1 : -_CLOSE - 1, _CLOSE + 1 : -_CLOSE - 1] | mask


def _explained(dark: DoubleArray, bright: DoubleArray) -> tuple[float, float]:
    """By how much the first are darker, and the share of the variance that this explains."""
    if len(dark) == 0 or len(bright) == 0:
        return 0.0, 0.0
    both = np.concatenate([dark, bright])
    depth = float(dark.mean() - bright.mean())
    between = len(dark) * len(bright) / len(both) ** 2 * max(depth, 0.0) ** 2
    return depth, between / max(float(both.var()), 1e-9)
