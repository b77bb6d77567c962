"""The parts of all objects of a scene whose association has levels, looked up when shown."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.grouping.levels import Levels
from gaga_core.scene.edits.objects import parting
from gaga_core.scene.scene import Scene, State

PartKey = tuple[int, ...]  # an object: (group,); its second part: (group, 1); the first in it ...


@dataclass(frozen=True, eq=False)
class Part:
    """A part of an object, or of another part."""

    key: PartKey
    rows: IntArray  # (K,) splats, not deleted
    level: int  # that made it a part

    @property
    def name(self) -> str:
        """What it is called in the list."""
        return f"part {self.key[-1] + 1}"


class PartIndex:
    """The parts of one state of the groups: of a scene with ``levels``."""

    def __init__(self, scene: Scene, levels: Levels) -> None:
        self._levels, self._source = levels, scene.source
        known = ~scene.has(State.DELETED) & (scene.source < levels.labels.shape[1])
        rows = np.flatnonzero(known & (scene.labels > 0)).astype(np.int32)
        rows = rows[np.argsort(scene.labels[rows], kind="stable")]
        groups, starts = np.unique(scene.labels[rows], return_index=True)
        self._rows = dict(zip(groups.tolist(), np.split(rows, starts[1:]), strict=len(groups) > 0))
        self._known: dict[PartKey, tuple[Part, ...]] = {}

    def parts(self, whole: Part | int) -> tuple[Part, ...]:
        """The parts of an object (a group) or of a part, the largest first; () when it is one."""
        key = whole.key if isinstance(whole, Part) else (whole,)
        if key not in self._known:
            rows = whole.rows if isinstance(whole, Part) else self._rows.get(whole)
            first = whole.level + 1 if isinstance(whole, Part) else 0
            self._known[key] = () if rows is None else self._cut(key, rows, first)
        return self._known[key]

    def _cut(self, key: PartKey, rows: IntArray, first: int) -> tuple[Part, ...]:
        cut = parting(self._levels, self._source[rows], first)
        if cut is None:
            return ()
        return tuple(
            Part((*key, i), rows[cut.part_of == i], cut.level) for i in range(len(cut.ids))
        )
