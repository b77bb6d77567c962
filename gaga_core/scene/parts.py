"""Parts of an object: what the levels of detail of its association cut it into."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import LongArray
from gaga_core.grouping.levels import Levels

_LEAST_SHARE, _FEWEST = 0.01, 10  # splats of a part, of its whole: smaller ones are no part


@dataclass(frozen=True, eq=False)
class Parting:
    """How some splats are cut into two parts or more."""

    level: int  # that cuts them
    ids: LongArray  # (P,) labels of the parts at that level, the largest first
    part_of: LongArray  # (K,) part 0..P-1 of each splat; what is in no part goes to the largest


def parting(levels: Levels, source: LongArray, first: int = 0) -> Parting | None:
    """Cut splats with these rows (K,) of the opened file at the coarsest level that parts them.

    Levels before ``first`` do not count. None when no level parts them.
    """
    least = max(_FEWEST, _LEAST_SHARE * len(source))
    for level in range(first, len(levels.labels)):
        label = levels.labels[level][source]
        size = np.bincount(label)
        size[:1] = 0
        parts = np.flatnonzero(size >= least)
        if len(parts) > 1:
            ids = parts[np.argsort(-size[parts], kind="stable")]
            number = np.zeros(len(size), np.int64)
            number[ids] = np.arange(len(ids))
            return Parting(level, ids, number[label])
    return None
