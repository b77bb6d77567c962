"""Groups at several levels of detail: each level is a partition that the next one refines."""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import IntArray, LongArray, check_shape


@dataclass(frozen=True, eq=False)
class Levels:
    """Labels of all levels, coarse to fine.

    A group that falls apart at the next level leaves its id to its largest part, so names and
    colors stay with what they were given to.
    """

    labels: IntArray  # (L, N) group of each Gaussian, 0 = none
    chosen: int  # the level that was found to show whole objects
    background: int = 0  # group of what surrounds the scene, 0 = none; finer levels may divide it

    def __post_init__(self) -> None:
        check_shape("labels", self.labels, ("L", "N"), np.int32)
        if not 0 <= self.chosen < len(self.labels):
            raise ValueError(f"chosen: there is no level {self.chosen} of {len(self.labels)}")

    @staticmethod
    def of(clusters: LongArray, chosen: int, background: LongArray) -> "Levels":
        """Number nested clusters (L, N), coarse to fine, any ids >= 0, -1 = none.

        ``background`` (N,) is 1 where a Gaussian is background at every level. Raises
        ``ValueError`` when a level does not refine the one before.
        """
        labels = np.zeros(clusters.shape, np.int32)
        for level, cluster in enumerate(clusters):
            before = labels[level - 1] if level > 0 else np.zeros_like(labels[0])
            labels[level] = _named(cluster, before, level)
        shown = labels[0][background > 0]
        return Levels(labels, chosen, int(shown[0]) if len(shown) else 0)

    @staticmethod
    def around(clusters: LongArray, labels: IntArray, chosen: int) -> "Levels":
        """Nested clusters (L, N) of which level ``chosen`` has the ids ``labels`` (N,), 0 = none.

        Groups that join at a coarser level take the id of the largest. Raises ``ValueError`` when
        a level does not refine the one before.
        """
        named = np.zeros(clusters.shape, np.int32)
        named[chosen] = labels
        for level in range(chosen - 1, -1, -1):
            named[level] = _of_largest(clusters[level], named[level + 1])
        for level in range(chosen + 1, len(clusters)):
            named[level] = _named(clusters[level], named[level - 1], level)
        return Levels(named, chosen)

    def at(self, detail: float) -> int:
        """The level of a detail: 0 = coarsest, 0.5 = the chosen one, 1 = finest."""
        coarse, fine = min(max(2 * detail, 0.0), 1.0), min(max(2 * detail - 1, 0.0), 1.0)
        return round(coarse * self.chosen) + round(fine * (len(self.labels) - 1 - self.chosen))

    def choose(self, detail: float) -> "Levels":
        """The same levels with another one chosen."""
        return replace(self, chosen=self.at(detail))


def _named(cluster: LongArray, before: IntArray, level: int) -> IntArray:
    """Ids (N,) of clusters (N,), -1 = none: the largest in a group of the level ``before`` (N,)
    keeps its id, the others count on from the largest id."""
    known = np.flatnonzero(cluster >= 0)
    ids, first, place, size = np.unique(
        cluster[known], return_index=True, return_inverse=True, return_counts=True
    )
    parent = before[known[first]]
    if (parent[place] != before[known]).any():
        raise ValueError(f"clusters: level {level} does not refine the one before")
    order = np.lexsort((first, -size, parent))
    name = np.zeros(len(ids), np.int32)
    inner = order[parent[order] > 0]
    heads = inner[np.unique(parent[inner], return_index=True)[1]]
    name[heads] = parent[heads]
    rest = order[name[order] == 0]
    rest = rest[np.lexsort((first[rest], -size[rest]))]
    name[rest] = int(before.max(initial=0)) + 1 + np.arange(len(rest))
    labels = np.zeros(len(cluster), np.int32)
    labels[known] = name[place]
    return labels


def _of_largest(cluster: LongArray, labels: IntArray) -> IntArray:
    """For each Gaussian (N,) the largest group of ``labels`` (N,) in its cluster (N,), -1 = none.

    Raises ``ValueError`` when a group lies in several clusters.
    """
    known = np.flatnonzero((cluster >= 0) & (labels > 0))
    groups, first, size = np.unique(labels[known], return_index=True, return_counts=True)
    home = np.full(int(labels.max(initial=0)) + 1, -1, np.int64)
    home[groups] = cluster[known[first]]
    if (home[labels[known]] != cluster[known]).any():
        raise ValueError("clusters: a level does not refine the one before")
    order = np.lexsort((-groups, size))  # the largest writes last, of equal ones the first
    name = np.zeros(int(cluster.max(initial=-1)) + 1, np.int32)
    name[home[groups[order]]] = groups[order]
    result = np.zeros_like(labels)
    result[known] = name[cluster[known]]
    return result
