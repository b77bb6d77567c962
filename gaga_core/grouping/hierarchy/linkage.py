"""Average linkage over a graph with signed evidence: who joins whom, and in what order.

The evidence between two clusters is the mean over their common border, not over all pairs of
members, so that large surfaces hold together (as in GASP, Bailoni et al., CVPR 2022).
"""

import heapq
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, LongArray


@dataclass(frozen=True, eq=False)
class SignedGraph:
    """Nodes with sizes, and the borders between them, each once."""

    size: DoubleArray  # (n,)
    first: LongArray  # (B,) node
    second: LongArray  # (B,) node
    length: DoubleArray  # (B,) of the border, > 0
    evidence: DoubleArray  # (B,) log odds that both are one thing: the mean over the border

    def contracted(self, cluster: LongArray) -> "SignedGraph":
        """The graph of clusters (n,), dense ids from 0."""
        n = int(cluster.max(initial=-1)) + 1
        a, b = cluster[self.first], cluster[self.second]
        apart = a != b
        key = np.minimum(a, b)[apart] * n + np.maximum(a, b)[apart]
        keys, cell = np.unique(key, return_inverse=True)
        length: DoubleArray = np.bincount(cell, self.length[apart], len(keys)).astype(np.float64)
        total = np.bincount(cell, (self.length * self.evidence)[apart], len(keys))
        size = np.bincount(cluster, self.size, n).astype(np.float64)
        return SignedGraph(size, keys // max(n, 1), keys % max(n, 1), length, total / length)

    def only(self, chosen: BoolArray) -> "SignedGraph":
        """The same nodes with some of the borders (B,)."""
        return replace(
            self,
            first=self.first[chosen],
            second=self.second[chosen],
            length=self.length[chosen],
            evidence=self.evidence[chosen],
        )


@dataclass(frozen=True, eq=False)
class Clusters:
    """Clusters of samples, and what is known of their borders."""

    cluster: LongArray  # (S,) dense ids from 0
    graph: SignedGraph

    def joined(self, least_evidence: float, least_size: float = 0.0) -> "Clusters":
        """After all joins of at least this evidence, as the function `joined` makes them."""
        joins = joined(self.graph, least_evidence, least_size)
        return Clusters(joins[self.cluster], self.graph.contracted(joins))

    def merged(self, into: LongArray) -> "Clusters":
        """After joining clusters (n,) to those of dense ids ``into`` (n,)."""
        return Clusters(into[self.cluster], self.graph.contracted(into))

    def set_apart(self, outside: BoolArray) -> "Clusters":
        """The same with no borders between some clusters (n,) and the others."""
        inside = ~(outside[self.graph.first] | outside[self.graph.second])
        return Clusters(self.cluster, self.graph.only(inside))


def joined(graph: SignedGraph, least_evidence: float, least_size: float = 0.0) -> LongArray:
    """Clusters (n,), dense ids from 0, after all joins of at least this evidence, best first.

    With ``least_size`` only clusters that are smaller join, each the neighbour of best evidence.
    """
    n = len(graph.size)
    size = graph.size.tolist()
    borders: list[dict[int, tuple[float, float]]] = [{} for _ in range(n)]
    heap = []
    rows = zip(graph.first.tolist(), graph.second.tolist(), strict=True)
    totals = (graph.length * graph.evidence).tolist()
    for (a, b), total, length in zip(rows, totals, graph.length.tolist(), strict=True):
        borders[a][b] = borders[b][a] = (total, length)
        heap.append((-total / length, a, b, length))
    heapq.heapify(heap)
    parent, is_alive = np.arange(n), [True] * n
    while heap:
        value, a, b, length = heapq.heappop(heap)
        if not (is_alive[a] and is_alive[b]) or borders[a].get(b, (0.0, 0.0))[1] != length:
            continue  # one of them has joined another since
        if -value < least_evidence:
            break
        if least_size > 0 and min(size[a], size[b]) >= least_size:
            continue
        if len(borders[a]) < len(borders[b]):
            a, b = b, a
        parent[b], is_alive[b] = a, False
        size[a] += size[b]
        del borders[a][b]
        for other, (total, length) in borders[b].items():
            if other == a:
                continue
            del borders[other][b]
            known = borders[a].get(other, (0.0, 0.0))
            both = (total + known[0], length + known[1])
            borders[a][other] = borders[other][a] = both
            heapq.heappush(heap, (-both[0] / both[1], min(a, other), max(a, other), both[1]))
        borders[b] = {}
    while (parent[parent] != parent).any():
        parent = parent[parent]
    return np.unique(parent, return_inverse=True)[1].astype(np.int64)
