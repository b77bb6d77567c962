"""Kernels of average linkage over points, on those pairs alone that some view shows in one mask.

Pairs that no view shows in one mask never agree enough to join (`ConsensusConfig`), so they are not
kept. A cluster lists its pairs with how often each is together. An entry may name a cluster that
was merged since: it counts for the one that took it in, and what several entries say of one cluster
adds up. How many views see both is the product of their counts by view. All sums are whole numbers:
the same points give the same groups on every machine.
"""

from heapq import heapify, heappop, heappush

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray, UInt16Array, UInt32Array
from gaga_core.kernels import exact_kernel


@exact_kernel
def list_pairs(
    mask_of: IntArray,  # (S, V) mask that each point shows in each view, 0 = unknown
    first_row: LongArray,  # (V,) row of mask 0 of each view
    row_start: LongArray,  # (R + 1,) where the points of each row begin
    members: IntArray,  # (E,) the points of each row
    start: int,
    stop: int,
    pair_start: LongArray,  # (S + 1,) where the pairs of each point begin, when they are written
    degree: LongArray,  # (S,) number of pairs of each point, written in [start, stop)
    partner: IntArray,  # (P,) the other point; empty: the pairs are only counted
    together: DoubleArray,  # (P,) views in which both show in one mask
) -> None:
    """Count, or write, the pairs of points [start, stop)."""
    n_points, n_views = mask_of.shape
    count = np.zeros(n_points, np.int32)
    touched = np.empty(n_points, np.int32)
    for i in range(start, stop):
        n = 0
        for v in range(n_views):
            mask = mask_of[i, v]
            if mask == 0:
                continue
            row = first_row[v] + mask
            for e in range(row_start[row], row_start[row + 1]):
                j = members[e]
                if count[j] == 0:
                    touched[n] = j
                    n += 1
                count[j] += 1
        n_pairs = 0
        for t in range(n):
            j = touched[t]
            if j != i:
                if len(partner) > 0:
                    partner[pair_start[i] + n_pairs] = j
                    together[pair_start[i] + n_pairs] = count[j]
                n_pairs += 1
            count[j] = 0
        degree[i] = n_pairs


@exact_kernel
def agreement(
    together: float,
    seen: UInt16Array | UInt32Array,  # (S, V) members of each cluster that each view sees
    size: DoubleArray,  # (S,) members, 0 = merged into another
    i: int,
    j: int,
    rules: DoubleArray,  # (3,) threshold, least number of views a pair, weight of the prior 1/2
) -> float:
    """Mean share of views that show members of clusters i and j in one mask; -1 = too little.

    Both are seen in as many views as they are together in, at least: that alone may say that the
    threshold is out of reach.
    """
    pairs = size[i] * size[j]
    share = together / pairs
    if (share + 0.5 * rules[2]) / (share + rules[2]) <= rules[0]:
        return -1.0
    both = np.int64(0)
    for v in range(seen.shape[1]):
        both += np.int64(seen[i, v]) * np.int64(seen[j, v])
    known = both / pairs
    if known < rules[1]:
        return -1.0
    return float((share + 0.5 * rules[2]) / (known + rules[2]))


@exact_kernel
def find_root(parent: IntArray, k: int) -> int:
    """The cluster that k was merged into in the end; the way there gets shorter."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@exact_kernel
def gather(
    k: int,
    start: LongArray,  # (S,) where the list of each cluster begins
    length: LongArray,  # (S,) its length
    other: IntArray,  # (P,) entries of the lists
    together: DoubleArray,  # (P,)
    parent: IntArray,  # (S,)
    total: DoubleArray,  # (S,) added to: sums by cluster
    touched: IntArray,  # (S,) clusters that have a sum; written from n on
    n: int,
) -> int:
    """Add the list of cluster k up by the clusters that there are now; the new number of them."""
    own = find_root(parent, k)
    for e in range(start[k], start[k] + length[k]):
        root = find_root(parent, other[e])
        if root == own:
            continue
        if total[root] == 0:
            touched[n] = root
            n += 1
        total[root] += together[e]
    return n


@exact_kernel
def best_partner(
    k: int,
    start: LongArray,
    length: LongArray,
    other: IntArray,
    together: DoubleArray,
    parent: IntArray,
    seen: UInt16Array | UInt32Array,
    size: DoubleArray,
    rules: DoubleArray,
    total: DoubleArray,  # (S,) zeros, and zeros again at the end
    touched: IntArray,  # (S,) room for a list
    partner: IntArray,  # (S,) written at k
    score: DoubleArray,  # (S,) written at k
) -> None:
    """The cluster that k agrees with most, the first one on a tie; its list is shortened."""
    n = gather(k, start, length, other, together, parent, total, touched, 0)
    partner[k], score[k], length[k] = -1, -1.0, n
    for t in range(n):
        j = touched[t]
        value = agreement(total[j], seen, size, k, j, rules)
        if value > score[k] or (value == score[k] and value > 0 and j < partner[k]):
            partner[k], score[k] = j, value
        other[start[k] + t], together[start[k] + t] = j, total[j]
        total[j] = 0


@exact_kernel
def find_partners(
    first: int,
    last: int,
    start: LongArray,
    length: LongArray,
    other: IntArray,
    together: DoubleArray,
    parent: IntArray,
    seen: UInt16Array | UInt32Array,
    size: DoubleArray,
    rules: DoubleArray,
    partner: IntArray,
    score: DoubleArray,
) -> None:
    """`best_partner` of clusters [first, last), before any was merged."""
    total, touched = np.zeros(len(size)), np.empty(len(size), np.int32)
    clusters = start, length, other, together, parent, seen, size, rules
    for k in range(first, last):
        best_partner(k, *clusters, total, touched, partner, score)


@exact_kernel
def set_leaf(tree: DoubleArray, k: int, value: float) -> None:
    """Change leaf k of a tree of maxima (2 L,) whose root is entry 1."""
    at = len(tree) // 2 + k
    tree[at] = value
    while at > 1:
        at //= 2
        tree[at] = max(tree[2 * at], tree[2 * at + 1])


@exact_kernel
def first_of_best(tree: DoubleArray) -> int:
    """The first leaf that has the greatest value."""
    at = 1
    while at < len(tree) // 2:
        at = 2 * at if tree[2 * at] == tree[at] else 2 * at + 1
    return at - len(tree) // 2


@exact_kernel
def pack_lists(start: LongArray, length: LongArray, other: IntArray, together: DoubleArray) -> int:
    """Move all lists to the front, in place; where the free part begins."""
    at = 0
    for k in np.argsort(start):
        if length[k] == 0:
            continue
        for e in range(length[k]):
            other[at + e] = other[start[k] + e]
            together[at + e] = together[start[k] + e]
        start[k] = at
        at += length[k]
    return at


@exact_kernel
def merge_clusters(
    start: LongArray,  # (S,) lists of the clusters; all arrays are changed in place
    length: LongArray,  # (S,)
    other: IntArray,  # (P + room,) entries, and room for new ones
    together: DoubleArray,  # (P + room,)
    end: LongArray,  # (1,) where the free part of them begins
    parent: IntArray,  # (S,) the cluster that each one was merged into, or itself
    seen: UInt16Array | UInt32Array,  # (S, V)
    size: DoubleArray,  # (S,)
    rules: DoubleArray,  # (3,) only read
    partner: IntArray,  # (S,)
    score: DoubleArray,  # (S,)
    tree: DoubleArray,  # (2 L,) of maxima over the scores
    max_merges: int,
) -> int:
    """Merge the two clusters that agree most, again and again; returns how many times.

    Fewer than ``max_merges`` means that no pair is above the threshold any more. Sums over pairs
    of members add up when clusters merge, so the agreement stays a mean weighted by evidence.
    """
    total, touched = np.zeros(len(size)), np.empty(len(size), np.int32)
    sums, spare = np.zeros(len(size)), np.empty(len(size), np.int32)
    clusters = start, length, other, together, parent, seen, size, rules
    for done in range(max_merges):
        if tree[1] <= rules[0]:
            return done
        i = first_of_best(tree)
        j = int(partner[i])
        i, j = min(i, j), max(i, j)
        for v in range(seen.shape[1]):
            seen[i, v] += seen[j, v]
        size[i] += size[j]
        size[j], score[j], parent[j] = 0.0, -1.0, i
        set_leaf(tree, j, -1.0)
        n = gather(i, start, length, other, together, parent, total, touched, 0)
        n = gather(j, start, length, other, together, parent, total, touched, n)
        length[i], length[j] = 0, 0
        if end[0] + n > len(other):
            end[0] = pack_lists(start, length, other, together)
        start[i], length[i] = end[0], n
        end[0] += n
        partner[i], score[i] = -1, -1.0
        for t in range(n):
            k = touched[t]
            other[start[i] + t], together[start[i] + t] = k, total[k]
            value = agreement(total[k], seen, size, k, i, rules)
            total[k] = 0
            if value > score[i] or (value == score[i] and value > 0 and k < partner[i]):
                partner[i], score[i] = k, value
            if partner[k] == i or partner[k] == j:
                best_partner(k, *clusters, sums, spare, partner, score)
                set_leaf(tree, k, score[k])
            elif value > score[k]:
                partner[k], score[k] = i, value
                set_leaf(tree, k, value)
        set_leaf(tree, i, score[i])
    return max_merges


# --- Kernels over the edges of a neighbour graph: average linkage, and labels that flood it.
# Exact arithmetic in a fixed order: the same graph gives the same pieces on every machine.


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
