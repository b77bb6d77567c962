"""Kernels over the edges of a neighbour graph: average linkage, and labels that flood it.

Exact arithmetic in a fixed order: the same graph gives the same pieces on every machine.
"""

from heapq import heapify, heappop, heappush

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, LongArray
from gaga_core.kernels import exact_kernel


@exact_kernel
def root_of(parent: LongArray, i: int) -> int:
    """The root of a node, with its path halved."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@exact_kernel
def link_half(head: LongArray, tail: LongArray, after: LongArray, node: int, half: int) -> None:
    """Append half an edge to the list of a node."""
    after[half] = -1
    if head[node] < 0:
        head[node] = half
    else:
        after[tail[node]] = half
    tail[node] = half


@exact_kernel
def edge_between(
    head: LongArray, after: LongArray, ends: LongArray, alive: BoolArray, node: int, other: int
) -> np.int64:
    """The edge from ``node`` to ``other``, -1 = none; ``node`` should be the one of fewer edges."""
    half: np.int64 = head[node]
    while half >= 0:
        if alive[half >> 1] and ends[half ^ 1] == other:
            return half >> 1
        half = after[half]
    return np.int64(-1)


@exact_kernel
def pieces_of(
    ends: LongArray,  # (2 E,) nodes of edge e at 2 e and 2 e + 1; changed in place
    total: DoubleArray,  # (E,) likeness of the two ends; changed in place
    parent: LongArray,  # (N,) 0, 1, ..; changed in place: roots are pieces
) -> None:
    """Join the two pieces whose edges are likest on average, while that is above 0."""
    n, n_edges = len(parent), len(total)
    count = np.ones(n_edges, np.int64)
    version = np.zeros(n_edges, np.int64)
    alive = np.ones(n_edges, np.bool_)
    after = np.full(2 * n_edges, -1, np.int64)
    head, tail = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    degree = np.zeros(n, np.int64)
    for half in range(2 * n_edges):
        link_half(head, tail, after, ends[half], half)
        degree[ends[half]] += 1
    queue = [(-total[e], e, version[e]) for e in range(n_edges) if total[e] > 0]
    heapify(queue)
    while len(queue) > 0:
        _, e, at = heappop(queue)
        if not alive[e] or version[e] != at:
            continue
        alive[e] = False
        big, small = ends[2 * e], ends[2 * e + 1]
        if degree[big] < degree[small]:
            big, small = small, big
        parent[small] = big
        degree[big] -= 1
        half = head[small]
        while half >= 0:
            following, k = after[half], half >> 1
            if alive[k]:
                other = ends[half ^ 1]
                near, far = (big, other) if degree[big] < degree[other] else (other, big)
                twin = edge_between(head, after, ends, alive, near, far)
                if twin >= 0:
                    total[twin] += total[k]
                    count[twin] += count[k]
                    alive[k] = False
                    degree[other] -= 1
                    k = twin
                else:
                    ends[half] = big
                    link_half(head, tail, after, big, half)
                    degree[big] += 1
                version[k] += 1
                if total[k] > 0:
                    heappush(queue, (-total[k] / count[k], k, version[k]))
            half = following


@exact_kernel
def flood(
    first: LongArray,  # (E,) nodes of each edge, the likest edge first
    second: LongArray,  # (E,)
    parent: LongArray,  # (N,) 0, 1, ..; changed in place
    labels: LongArray,  # (N,) 0 = none; changed in place
) -> None:
    """Give every unlabelled node the label that it reaches over the likest edges.

    Edges join what they connect unless both sides have labels: a watershed.
    """
    for e in range(len(first)):
        a, b = root_of(parent, first[e]), root_of(parent, second[e])
        if a == b or (labels[a] > 0 and labels[b] > 0):
            continue
        if labels[a] > 0:
            parent[b] = a
        else:
            parent[a] = b
    for i in range(len(labels)):
        labels[i] = labels[root_of(parent, i)]
