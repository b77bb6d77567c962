"""Numbers of splats by name: what a histogram shows, and a range of it selects."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.color import LUMA, rgb_from_dc
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import rows_of, selectable, world_means

_LUMA = LUMA.astype(np.float32)
LENGTHS = frozenset({"size", "longest axis", "x", "y", "z"})  # columns in scene units
_TAILS = (0.1, 99.9)  # percentiles between which the bins of a histogram lie


@dataclass(frozen=True, eq=False)
class Histogram:
    """Distribution of the values of the splats that can be selected."""

    edges: DoubleArray  # (B + 1,)
    counts: LongArray  # (B,)
    chosen: LongArray  # (B,) of them, among the splats that were asked for


def shown_colors(scene: Scene) -> FloatArray:
    """Color (N, 3) of each splat without view dependence, recolored as it is drawn, 0..1."""
    rgb = rgb_from_dc(scene.gaussians.sh[:, 0])
    index = scene.placement
    changed = np.flatnonzero(index)
    if len(changed):
        affine = scene.placements.color[index[changed]].astype(np.float32)
        rgb[changed] = np.einsum("nij,nj->ni", affine[:, :, :3], rgb[changed]) + affine[:, :, 3]
    return np.clip(rgb, 0, 1, out=rgb)


def column_names(scene: Scene) -> tuple[str, ...]:
    """The numbers that splats of this scene have, in the order to offer them."""
    own = [name for name, column in scene.gaussians.extra.items() if column.dtype.kind in "fiu"]
    return (*_COLUMNS, *(name for name in own if name not in _COLUMNS))


def column(scene: Scene, name: str) -> FloatArray:
    """Values (N,) float32, world units, placements applied.

    Raises ``ValueError`` for a name that is not among `column_names`.
    """
    if name in _COLUMNS:
        return np.ascontiguousarray(_COLUMNS[name](scene), np.float32)
    if name not in scene.gaussians.extra:
        raise ValueError(f"column: {name!r} is not one of {', '.join(column_names(scene))}")
    return scene.gaussians.extra[name].astype(np.float32)


def in_range(scene: Scene, name: str, low: float, high: float) -> IntArray:
    """Splats (K,) that can be selected with ``low <= value <= high``."""
    values = column(scene, name)
    return rows_of((values >= low) & (values <= high) & selectable(scene))


def histogram(
    scene: Scene, name: str, among: IntArray | None = None, n_bins: int = 64
) -> Histogram:
    """Counts of a column over the splats that can be selected; ``among`` (K,) are counted apart.

    The bins run from the 0.1th to the 99.9th percentile; what lies outside is in the first and the
    last bin, so that a few far splats do not flatten the rest.
    """
    values = column(scene, name)
    usable = selectable(scene) & np.isfinite(values)
    shown = values[usable]
    if len(shown) == 0:
        shown = np.zeros(1, np.float32)
        usable = np.zeros(len(scene), np.bool_)
    low, high = (float(edge) for edge in np.percentile(shown[:: max(len(shown) >> 20, 1)], _TAILS))
    if not high > low:
        low, high = low - 0.5, high + 0.5
    edges = np.linspace(low, high, n_bins + 1)
    mask = np.zeros(len(scene), np.bool_)
    mask[among if among is not None else []] = True
    counts, chosen = (
        np.histogram(np.clip(values[rows], edges[0], edges[-1]), edges)[0]
        for rows in (usable, usable & mask)
    )
    return Histogram(edges, counts, chosen)


def like_color(scene: Scene, rgb: Sequence[float], tolerance: float) -> IntArray:
    """Splats (K,) that can be selected, of a color at most ``tolerance`` from ``rgb``, 0..1.

    The difference is the largest of the three channels', as eyedroppers measure it.
    """
    far = np.abs(shown_colors(scene) - np.asarray(rgb, np.float32)).max(axis=1)
    return rows_of((far <= tolerance) & selectable(scene))


def _opacity(scene: Scene) -> FloatArray:
    factor = scene.placements.opacity.astype(np.float32)
    return np.minimum(scene.gaussians.opacities * factor[scene.placement], 1)


def _sizes(scene: Scene) -> FloatArray:
    """Standard deviations (N, 3) in the world; a placement stretches all three alike."""
    table = scene.placements.matrix[:, :, :3]
    stretch = np.cbrt(np.abs(np.linalg.det(table))).astype(np.float32)
    with np.errstate(over="ignore"):
        sizes: FloatArray = scene.gaussians.scales * stretch[scene.placement][:, None]
    return sizes


def _hue(scene: Scene) -> FloatArray:
    """Hue (N,) in degrees, 0 for greys."""
    rgb = shown_colors(scene)
    top, bottom = rgb.max(axis=1), rgb.min(axis=1)
    spread = np.where(top > bottom, top - bottom, 1)
    red, green, blue = rgb.T
    sixth = np.where(
        top == red,
        (green - blue) / spread % 6,
        np.where(top == green, (blue - red) / spread + 2, (red - green) / spread + 4),
    )
    return np.where(top > bottom, 60 * sixth, 0)


def _saturation(scene: Scene) -> FloatArray:
    rgb = shown_colors(scene)
    top = rgb.max(axis=1)
    return np.where(top > 0, (top - rgb.min(axis=1)) / np.where(top > 0, top, 1), 0)


_COLUMNS: Mapping[str, Callable[[Scene], FloatArray]] = {
    "opacity": _opacity,
    "size": lambda s: np.cbrt(_sizes(s).prod(axis=1)),
    "longest axis": lambda s: _sizes(s).max(axis=1),
    "flatness": lambda s: 1 - np.exp(-np.ptp(s.gaussians.log_scales, axis=1)),
    "x": lambda s: world_means(s)[:, 0],
    "y": lambda s: world_means(s)[:, 1],
    "z": lambda s: world_means(s)[:, 2],
    "red": lambda s: shown_colors(s)[:, 0],
    "green": lambda s: shown_colors(s)[:, 1],
    "blue": lambda s: shown_colors(s)[:, 2],
    "brightness": lambda s: shown_colors(s) @ _LUMA,
    "hue": _hue,
    "saturation": _saturation,
    "group": lambda s: s.labels.astype(np.float32),
}
