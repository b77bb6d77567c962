"""Small pieces of surface: a few neighbouring samples that face one way and share their regions."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, LongArray
from gaga_core.grouping.hierarchy.surfels import Surfels
from gaga_core.grouping.hierarchy.surfels_kernels import choose_seeds
from gaga_core.kernels import n_threads

_EDGES = 10  # nearest samples that a sample has edges to
_AROUND = 16  # ... that are its surroundings
_FAR = 3.0  # an edge is at most so many times longer than the spacing around either end
_TURN, _PARTED = 3.0, 2.0  # cost of an edge that turns by 90 degrees, that all views part ...
_ALONG = 0.3  # ... next to that of its length
_RECOLORED = 0.075  # cost of an edge for a unit of CIE Lab, where color counts ...
_OTHER_COLOR = 60.0  # ... up to so many
_SLICE = 1 << 16  # edges compared at once
_OUTLINE = 3.0  # edges along the border of a piece of n samples, times sqrt(n)


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Which samples are next to which."""

    around: LongArray  # (S, 16) nearest ones
    spacing: DoubleArray  # (S,) median distance to the nearest, scene units
    first: LongArray  # (E,) < second
    second: LongArray  # (E,)
    length: DoubleArray  # (E,) scene units

    @staticmethod
    def of(points: DoubleArray) -> "Neighbourhood":
        """Neighbours among points (S, 3); S must be over 16."""
        n = len(points)
        found = cKDTree(points).query(points, k=_AROUND + 1, workers=n_threads())
        distance, nearest = np.asarray(found[0])[:, 1:], np.asarray(found[1], np.int64)[:, 1:]
        spacing = np.median(distance[:, :_EDGES], axis=1)
        a, b = np.repeat(np.arange(n), _EDGES), nearest[:, :_EDGES].ravel()
        key = np.minimum(a, b) * n + np.maximum(a, b)
        keys, once = np.unique(key, return_index=True)
        a, b, length = keys // n, keys % n, distance[:, :_EDGES].ravel()[once]
        near = (length > 0) & (length <= _FAR * np.minimum(spacing[a], spacing[b]))
        return Neighbourhood(nearest, spacing, a[near], b[near], length[near])

    def adjacency(self, rows: LongArray) -> csr_matrix:
        """The edges among some samples (K,), as a sparse matrix (K, K)."""
        n = len(self.spacing)
        place = np.full(n, -1, np.int64)
        place[rows] = np.arange(len(rows))
        a, b = place[self.first], place[self.second]
        both = (a >= 0) & (b >= 0)
        ones = np.ones(int(both.sum()), np.int8)
        return coo_matrix((ones, (a[both], b[both])), shape=(len(rows), len(rows))).tocsr()


def outlines(n_samples: AnyArray) -> DoubleArray:
    """Edges (n,) along the outline of compact pieces of surface of so many samples (n,)."""
    result: DoubleArray = _OUTLINE * np.sqrt(n_samples)
    return result


def small_pieces(
    surfels: Surfels, near: Neighbourhood, color: DoubleArray | None = None
) -> LongArray:
    """The piece (S,) of each sample, dense ids from 0: some seven samples each.

    Samples go to the seed that is nearest along the surface, where turning and leaving a region
    make the way longer, so that pieces end at creases and outlines; with colors (S, 3), CIE Lab,
    also where these change.
    """
    n = len(surfels.points)
    a, b = near.first, near.second
    cosine = (surfels.normals[a] * surfels.normals[b]).sum(axis=1)
    cost = _ALONG + _TURN * np.clip(1 - cosine, 0, 1.5) + _PARTED * _parted(surfels, a, b)
    if color is not None:
        cost += _RECOLORED * np.minimum(np.linalg.norm(color[a] - color[b], axis=1), _OTHER_COLOR)
    cost *= near.length / np.sqrt(near.spacing[a] * near.spacing[b])
    graph = coo_matrix((cost, (a, b)), shape=(n, n)).tocsr()
    seeds = np.empty(n, np.bool_)
    order = np.random.default_rng(0).permutation(n)
    choose_seeds(order, np.ascontiguousarray(near.around[:, :_EDGES]), seeds)
    source = _sources(graph, seeds)
    return np.unique(source, return_inverse=True)[1].astype(np.int64)


def _sources(graph: csr_matrix, seeds: BoolArray) -> LongArray:
    """The seed (S,) from which the way to each sample is shortest; itself where no way leads."""
    indices = np.flatnonzero(seeds)
    found = dijkstra(
        graph, directed=False, indices=indices, min_only=True, return_predecessors=True
    )[2]
    return np.where(found < 0, np.arange(len(seeds)), found)


def _parted(surfels: Surfels, a: LongArray, b: LongArray) -> DoubleArray:
    """Share (E,) of the views of both ends that show them in two regions; 1/3 if there are none."""
    shares, regions = np.empty(len(a)), surfels.all_regions
    for start in range(0, len(a), _SLICE):
        rows = slice(start, start + _SLICE)
        one, other = regions[a[rows]], regions[b[rows]]
        both = (one > 0) & (other > 0)
        n_parted = (both & (one != other)).sum(axis=1)
        shares[rows] = (n_parted + 0.5) / (both.sum(axis=1) + 1.5)
    return shares
