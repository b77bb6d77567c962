"""How clusters grow to parts: their borders are judged, they join, and borders are judged again.

A mean over borders of small pieces joins a bowl and the box next to it, so borders are judged again
with the surroundings of what has grown. Noise of the splats speaks in that as well, and two rules
depend on how much of it there is (`is_calm`). Where splats are calm, borders are judged again at
each level of parts. Where they are rough, most borders that are left after each join are noise, so
that is done once, before whole objects join, and within one plane the better of both judgements
counts, because noise tears patches out of tables.
"""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.grouping.hierarchy.borders import (
    Agreement,
    coarse_graph,
    in_one_plane,
    is_calm,
)
from gaga_core.grouping.hierarchy.enclosed import keep_enclosed
from gaga_core.grouping.hierarchy.linkage import Clusters
from gaga_core.grouping.hierarchy.pieces import Neighbourhood
from gaga_core.grouping.hierarchy.surfels import Surfels


@dataclass(frozen=True, eq=False)
class Judge:
    """What is known of the samples, and the judgement of borders by it."""

    surfels: Surfels
    near: Neighbourhood
    plane: IntArray  # (S,) that each sample lies on, 0 = none
    piece: LongArray  # (S,) small pieces
    shown: DoubleArray  # (S,) share of the views that see each sample
    noise: DoubleArray  # (2,) as `noise_of` finds it

    def judged(self, cluster: LongArray) -> Clusters:
        """Clusters (S,) of small pieces with the evidence about their borders; their size is how
        many samples a view shows of them, on average."""
        views_say = Agreement.of(self.surfels, self.near, self.piece, cluster)
        graph = coarse_graph(
            self.surfels, self.near, self.plane, self.piece, views_say, cluster, self.noise
        )
        size = np.bincount(cluster, self.shown).astype(np.float64)
        return Clusters(cluster, replace(graph, size=size))

    def again(self, before: Clusters) -> Clusters:
        """The same clusters with their borders judged again."""
        now = self.judged(before.cluster)
        if is_calm(self.noise):
            return now
        kept = in_one_plane(self.plane, now) & (before.graph.evidence > now.graph.evidence)
        evidence = np.where(kept, before.graph.evidence, now.graph.evidence)
        return Clusters(now.cluster, replace(now.graph, evidence=evidence))

    def parts(
        self,
        cluster: LongArray,
        least_evidence: tuple[float, ...],
        least_size: float,
        least_thing: float,
    ) -> list[Clusters]:
        """Levels of parts that grow from clusters (S,): one a number of ``least_evidence``, which
        descends.

        The smallest part has ``least_size`` where it has neighbours; enclosed things of at least
        ``least_thing`` stay apart (`keep_enclosed`).
        """
        levels: list[Clusters] = []
        now = self.judged(cluster)
        for evidence in least_evidence:
            if levels and is_calm(self.noise):
                now = self.again(now)
            if levels:
                now = keep_enclosed(self.surfels, self.near, now, least_thing)
            now = now.joined(evidence)
            now = now if levels else now.joined(-np.inf, least_size)
            levels.append(now)
        return levels
