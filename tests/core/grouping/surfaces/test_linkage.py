"""Average linkage over signed borders, against a plain reference; contraction is exact."""

import numpy as np
import pytest

from gaga_core.arrays import LongArray
from gaga_core.grouping.surfaces.borders import SignedGraph, joined


def _random_graph(seed: int, n: int = 30) -> SignedGraph:
    rng = np.random.default_rng(seed)
    first, second = np.triu_indices(n, 1)
    some = rng.random(len(first)) < 0.2
    first, second = first[some], second[some]
    length = rng.integers(1, 9, len(first)).astype(np.float64)
    return SignedGraph(np.ones(n), first, second, length, rng.normal(0, 2, len(first)))


def _reference(graph: SignedGraph, least: float) -> list[set[int]]:
    """Join the two clusters whose mean evidence is greatest, until it is too little."""
    clusters = [{i} for i in range(len(graph.size))]
    rows = list(zip(graph.first, graph.second, graph.length, graph.evidence, strict=True))
    while True:
        best, pair = least, None
        for i in range(len(clusters)):
            for j in range(i):
                a, b = clusters[i], clusters[j]
                cut = [(w, e) for u, v, w, e in rows if (u in a and v in b) or (u in b and v in a)]
                if cut and sum(w * e for w, e in cut) / sum(w for w, _ in cut) >= best:
                    best, pair = sum(w * e for w, e in cut) / sum(w for w, _ in cut), (i, j)
        if pair is None:
            return clusters
        clusters[pair[1]] |= clusters.pop(pair[0])


def _as_sets(cluster: LongArray) -> set[frozenset[int]]:
    return {frozenset(np.flatnonzero(cluster == k).tolist()) for k in np.unique(cluster)}


@pytest.mark.parametrize("seed", range(4))
def test_the_best_mean_over_the_common_border_joins_first(seed: int) -> None:
    graph = _random_graph(seed)
    assert _as_sets(joined(graph, 0.3)) == {frozenset(c) for c in _reference(graph, 0.3)}


@pytest.mark.parametrize("seed", range(4))
def test_joining_in_two_steps_is_joining_in_one(seed: int) -> None:
    graph = _random_graph(seed)
    first = joined(graph, 1.0)
    second = joined(graph.contracted(first), -0.5)
    assert _as_sets(second[first]) == _as_sets(joined(graph, -0.5))


def test_only_small_clusters_join_when_a_size_is_asked_for() -> None:
    size = np.array([9.0, 1.0, 9.0])
    borders = (np.array([0, 1]), np.array([1, 2]), np.ones(2), np.array([-5.0, -1.0]))
    cluster = joined(SignedGraph(size, *borders), -np.inf, least_size=5)
    assert cluster[1] == cluster[2] != cluster[0]
