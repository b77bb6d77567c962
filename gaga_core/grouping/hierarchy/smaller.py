"""Levels below the smallest parts: things of few samples, told apart by their color, too.

A book in a row or a toy block shows some twenty samples. Its small pieces straddle its outline, and
what borders of parts ask (a crease, a region in most views) is lost in so few. Here pieces end
where the color changes, and color is a witness of their borders as well. At the levels of objects
it is none, because print and shadows have colors of their own; these levels only offer pieces to
choose from, inside of parts that are found without color.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.color import lab_from_rgb
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.hierarchy.borders import Agreement, fine_graph
from gaga_core.grouping.hierarchy.linkage import Clusters
from gaga_core.grouping.hierarchy.pieces import Neighbourhood, small_pieces
from gaga_core.grouping.hierarchy.surfels import Surfels
from gaga_core.kernels import n_threads

_AROUND = 4  # splats whose median is the color of a sample
_OPAQUE = 0.3  # opacity of such splats
_LIGHTNESS = 0.4  # weight of lightness against hue: faces of one thing are lit differently
_AGAINST = 0.05  # log odds against one thing for a unit of CIE Lab between two pieces
_UNLIKE = 10.0  # difference in CIE Lab that counts as much as the spacing of the samples
_CHUNK = 1 << 16


def hue_of(rgb: FloatArray) -> DoubleArray:
    """Colors (K, 3) of sRGB (K, 3) to compare: CIE Lab, lightness weighted down."""
    lab = lab_from_rgb(rgb)
    lab[:, 0] *= _LIGHTNESS
    return lab


def colors_of_samples(
    gaussians: Gaussians, rows: LongArray, rgb: FloatArray, points: DoubleArray
) -> DoubleArray:
    """Color (S, 3), as of `hue_of`, of points (S, 3) by the splats around them, of ``rows`` (K,)
    with sRGB (K, 3); K > 0."""
    opaque = np.flatnonzero(gaussians.opacities[rows] > _OPAQUE)
    opaque = opaque if len(opaque) >= _AROUND else np.arange(len(rows))
    ranks = list(range(1, min(_AROUND, len(opaque)) + 1))
    tree = cKDTree(gaussians.means[rows[opaque]].astype(np.float64))
    nearest = opaque[np.asarray(tree.query(points, k=ranks, workers=n_threads())[1])]
    around = np.stack([hue_of(rgb[rank]) for rank in nearest.T])
    result: DoubleArray = np.median(around, axis=0)
    return result


def smaller_levels(
    surfels: Surfels,
    near: Neighbourhood,
    part: LongArray,
    color: DoubleArray,
    shown: DoubleArray,
    least_evidence: tuple[float, ...],
    least_size: float,
) -> LongArray:
    """Clusters (L, S) of samples that refine the parts (S,), coarse to fine, one a number of
    ``least_evidence``, which ascends; a part of id -1 stays whole.

    ``color`` (S, 3) is that of each sample, ``shown`` (S,) how much it counts for the size of a
    cluster, which is ``least_size`` at least where the part has as much.
    """
    if not least_evidence:
        return np.zeros((0, len(part)), np.int64)
    piece = small_pieces(surfels, near, color)
    piece = np.where(part < 0, 0, 1 + piece * (int(part.max()) + 1) + part)
    piece = np.unique(piece, return_inverse=True)[1].astype(np.int64)
    graph = fine_graph(surfels, near, piece, Agreement.of(surfels, near, piece))
    part_of = np.zeros(len(graph.size), np.int64)
    part_of[piece] = part
    count = np.bincount(piece)
    mean = np.stack([np.bincount(piece, column) / count for column in color.T], axis=1)
    unlike = np.linalg.norm(mean[graph.first] - mean[graph.second], axis=1)
    size = np.bincount(piece, shown).astype(np.float64)
    graph = replace(graph, size=size, evidence=graph.evidence - _AGAINST * unlike)
    now = Clusters(piece, graph.only(part_of[graph.first] == part_of[graph.second]))
    fine_to_coarse = []
    for i, evidence in enumerate(least_evidence[::-1]):
        now = now.joined(evidence)
        now = now if i > 0 else now.joined(-np.inf, least_size)
        fine_to_coarse.append(now.cluster)
    return np.stack(fine_to_coarse[::-1])


def carriers_by_color(
    distance: DoubleArray,
    samples: IntArray,
    carriers: LongArray,
    part: LongArray,
    colors: tuple[FloatArray, DoubleArray],
    spacing: DoubleArray,
) -> LongArray:
    """The sample (K,) that stands for each splat at the smaller levels, of the nearest ``samples``
    (K, k) at ``distance`` (K, k), which hold its ``carriers`` (K,) at the other levels.

    It is near and alike in color, and in the ``part`` (S,) of that carrier. ``colors`` are sRGB
    (K, 3) of the splats and `colors_of_samples` (S, 3), ``spacing`` (S,) is that of the samples.
    """
    rgb, of_sample = colors
    chosen = np.empty_like(carriers)
    for start in range(0, len(carriers), _CHUNK):
        rows = slice(start, start + _CHUNK)
        near = samples[rows]
        unlike = np.linalg.norm(of_sample[near] - hue_of(rgb[rows])[:, None], axis=2)
        cost = distance[rows] / spacing[near] + unlike / _UNLIKE
        cost[part[near] != part[carriers[rows]][:, None]] = np.inf
        chosen[rows] = near[np.arange(len(near)), cost.argmin(axis=1)]
    return chosen
