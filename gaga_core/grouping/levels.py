"""Groups at several levels of detail: each level is a partition that the next one refines."""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray, check_shape


@dataclass(frozen=True, eq=False)
class Levels:
    """Labels of all levels, coarse to fine.

    A group that falls apart at the next level leaves its id to its largest part, so names and
    colors stay with what they were given to. Ids of a level are 1..G without gaps.
    """

    labels: IntArray  # (L, N) group of each Gaussian, 0 = none
    chosen: int  # the level that was found to show whole objects
    background: int = 0  # group of what surrounds the scene, the same at all levels; 0 = none

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
        before = np.zeros(clusters.shape[1], np.int64)
        n_ids = 0
        for level, cluster in enumerate(clusters):
            known = np.flatnonzero(cluster >= 0)
            ids, first, place, size = np.unique(
                cluster[known], return_index=True, return_inverse=True, return_counts=True
            )
            parent = before[known[first]]
            if (parent[place] != before[known]).any():
                raise ValueError(f"clusters: level {level} does not refine the one before")
            order = np.lexsort((first, -size, parent))
            name = np.zeros(len(ids), np.int64)
            heads = np.unique(parent[order], return_index=True)[1][: len(ids) * (level > 0)]
            name[order[heads]] = parent[order[heads]]
            rest = order[name[order] == 0]
            rest = rest[np.lexsort((first[rest], -size[rest]))]
            name[rest] = n_ids + 1 + np.arange(len(rest))
            n_ids += len(rest)
            before = np.zeros_like(before)
            before[known] = name[place]
            labels[level] = before
        shown = labels[0][background > 0]
        return Levels(labels, chosen, int(shown[0]) if len(shown) else 0)

    def at(self, detail: float) -> int:
        """The level of a detail: 0 = coarsest, 1 = finest."""
        return round(min(max(detail, 0.0), 1.0) * (len(self.labels) - 1))

    @property
    def detail(self) -> float:
        """The detail, 0..1, of the chosen level."""
        return self.chosen / max(len(self.labels) - 1, 1)

    def choose(self, detail: float) -> "Levels":
        """The same levels with another one chosen."""
        return replace(self, chosen=self.at(detail))


def agreement_of(groups: IntArray, chosen: IntArray) -> FloatArray:
    """Share (N,) of the neighbours' groups (N, k) that are the chosen one (N,)."""
    share: FloatArray = (groups == chosen[:, None]).mean(axis=1).astype(np.float32)
    return share
