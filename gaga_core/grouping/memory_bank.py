"""The 3D-aware memory bank (section 3.2): which Gaussians each group owns, and why."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import IntArray


@dataclass(frozen=True)
class Decision:
    """Why a mask went where it went."""

    view: str  # name of the view
    mask: int  # id in that view's label map
    group: int  # the group that it joined or opened; 0 = none (no Gaussians passed the gate)
    is_new: bool  # opened the group
    overlap: float  # with the best group before the decision, #(G(m) and G_i) / #G(m)
    runner_up: int  # second-best group, 0 = none
    runner_up_overlap: float
    n_gaussians: int  # #G(m)


@dataclass(frozen=True, eq=False)
class MemoryBank:
    """The bank after some views. ``log`` holds one decision a mask, in the order made."""

    group: IntArray  # (N,) -1 = free, else group id 1..n_groups
    n_groups: int
    log: tuple[Decision, ...] = ()

    @staticmethod
    def empty(n_gaussians: int) -> "MemoryBank":
        """A bank in which every Gaussian is free."""
        return MemoryBank(np.full(n_gaussians, -1, np.int32), 0)
