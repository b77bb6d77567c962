"""The scene being edited: one row a splat, small tables beside it.

Indices never move while editing: delete is a bit, duplicate appends, compaction happens at export.
Only an Edit changes a Scene, and only History applies one (STYLE 10).
"""

from dataclasses import dataclass, field
from enum import IntFlag

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray, UInt8Array
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.scene.index_set import IndexSet


class State(IntFlag):
    """Bits of a splat's state byte."""

    SELECTED = 1
    HIDDEN = 2
    LOCKED = 4
    DELETED = 8


@dataclass(frozen=True, eq=False)
class Placements:
    """One row per placement: where its splats stand and how they are colored.

    A splat at p with SH color c is drawn at ``matrix @ (p, 1)`` with color ``color @ (c, 1)``:
    an affine color in which the DC coefficient gets scale and offset and the rest gets scale, so
    view dependence survives a recolor; the view direction is rotated back by the matrix, so SH
    stay right under a move. Row 0 is the identity and stays so.
    """

    matrix: DoubleArray  # (P, 3, 4) world_from_file
    color: DoubleArray  # (P, 3, 4) affine in RGB
    opacity: DoubleArray  # (P,) factor

    def __len__(self) -> int:
        return len(self.opacity)

    @staticmethod
    def identity(n: int = 1) -> "Placements":
        """``n`` rows that change nothing."""
        row = np.eye(3, 4)
        return Placements(np.tile(row, (n, 1, 1)), np.tile(row, (n, 1, 1)), np.ones(n))


@dataclass
class Revision:
    """Counters that grow when a column changed; GPU mirrors compare them (STYLE 11)."""

    splats: int = 0  # gaussians replaced or appended (everything else must be uploaded too)
    labels: int = 0
    state: int = 0
    placement: int = 0  # the per-splat index
    placements: int = 0  # the table
    names: int = 0

    def total(self) -> int:
        """A number that grows with every change of any kind."""
        return (
            self.splats + self.labels + self.state + self.placement + self.placements + self.names
        )


@dataclass(eq=False)
class Scene:
    """Splats and what has been done to them."""

    gaussians: Gaussians
    labels: IntArray  # (N,) group id, 0 = none
    state: UInt8Array  # (N,) State bits
    placement: IntArray  # (N,) row of placements
    source: LongArray  # (N,) row in the opened file; a duplicate repeats its original's
    placements: Placements
    names: dict[int, str] = field(default_factory=dict)  # only of groups that a person named
    bank: MemoryBank | None = None  # log of the association that gave the labels
    # How sure each row of the opened file is of its group, 0..255; see `confidence_of`.
    confidence: UInt8Array | None = None
    sets: dict[str, IndexSet] = field(default_factory=dict)  # selections that a person named
    revision: Revision = field(default_factory=Revision)

    def __len__(self) -> int:
        return len(self.gaussians)

    @staticmethod
    def of(gaussians: Gaussians, labels: IntArray | None = None) -> "Scene":
        """A scene as opened: nothing selected, hidden or moved."""
        n = len(gaussians)
        return Scene(
            gaussians=gaussians,
            labels=np.zeros(n, np.int32) if labels is None else labels.astype(np.int32),
            state=np.zeros(n, np.uint8),
            placement=np.zeros(n, np.int32),
            source=np.arange(n, dtype=np.int64),
            placements=Placements.identity(),
        )

    def has(self, bits: State) -> BoolArray:
        """Splats (N,) with any of these bits."""
        result: BoolArray = (self.state & np.uint8(bits)) != 0
        return result

    def confidence_of(self) -> UInt8Array | None:
        """Confidence (N,) of each splat in its group, 0..255; a duplicate has its original's."""
        return None if self.confidence is None else self.confidence[self.source]

    @property
    def visible(self) -> BoolArray:
        """Splats (N,) that are drawn, picked and exported: neither hidden nor deleted."""
        return ~self.has(State.HIDDEN | State.DELETED)
