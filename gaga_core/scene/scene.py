"""The scene being edited: one row a splat, and small tables.

Indices never move while editing: delete is a bit, duplicate appends, compaction happens at export.
Only an Edit changes a Scene, and only History applies one.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import IntFlag
from functools import wraps
from typing import Concatenate, Literal, NamedTuple, ParamSpec, TypeVar

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray, UInt8Array
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.io.splats.spz import OURS, SilentAxes
from gaga_core.scene.folders import Folders
from gaga_core.scene.frame import Frame
from gaga_core.scene.index_set import IndexSet

_CATCH_UP = 16  # changes of the Gaussians that mirrors can catch up with
_P = ParamSpec("_P")
_T = TypeVar("_T")

RGB = tuple[float, float, float]  # 0..1
WeightKind = Literal["mass", "density"]
LabelSource = Literal["votes", "identities"]  # of the masks; of the classifier on the encodings


class Weight(NamedTuple):
    """What a person typed of an object's weight, for simulations."""

    kind: WeightKind
    value: float  # kg, or kg/m^3; above 0


class State(IntFlag):
    """Bits of a splat's state byte."""

    SELECTED = 1
    HIDDEN = 2
    LOCKED = 4
    DELETED = 8


@dataclass(frozen=True, eq=False)
class Placements:
    """One row per placement: the pose and the color of its splats.

    A splat at p with SH color c is drawn at ``matrix @ (p, 1)`` with color ``color @ (c, 1)``:
    an affine color in which the DC coefficient gets scale and offset and the rest gets scale, so
    view dependence survives a recolor; the view direction is rotated back by the matrix, so SH
    stay right under a move. Row 0 is the identity and stays so.

    Raises ``ValueError`` when the columns differ in length.
    """

    matrix: DoubleArray  # (P, 3, 4) world_from_file
    color: DoubleArray  # (P, 3, 4) affine in RGB
    opacity: DoubleArray  # (P,) factor

    def __post_init__(self) -> None:
        for name in ("matrix", "color"):  # a list without rows has no shape when it is read
            column = getattr(self, name).reshape(len(self.opacity), 3, 4)
            object.__setattr__(self, name, column)

    def __len__(self) -> int:
        return len(self.opacity)

    @staticmethod
    def identity(n: int = 1) -> "Placements":
        """``n`` rows that change nothing."""
        row = np.eye(3, 4)
        return Placements(np.tile(row, (n, 1, 1)), np.tile(row, (n, 1, 1)), np.ones(n))

    def cam_from_file(self, cam_from_world: DoubleArray) -> DoubleArray:
        """Poses (P, 3, 4) of a camera (3, 4) or (4, 4): its frame from each placement's splats."""
        pose = cam_from_world[:3]
        poses: DoubleArray = np.einsum("ij,pjk->pik", pose[:, :3], self.matrix)
        poses[:, :, 3] += pose[:, 3]
        return poses


@dataclass(frozen=True)
class Added:
    """Another file whose splats were added to the scene, or splats that an edit made."""

    path: str  # absolute; "": no file has them, the project itself keeps them
    fingerprint: str  # of the file as it was read
    first: int  # row of its first splat among the rows of all files, see `Scene.source`
    n: int  # splats
    axes: SilentAxes = OURS  # of an .spz that does not say its own, see `gaga_core.io.splats.spz`
    # How the scene had been moved as a whole when they were added: rows of (4, 4),
    # world_from_opened; none = not at all. Of merged splats with how their origins had been moved
    # by themselves. See `motion_of`.
    frame: tuple[tuple[float, float, float, float], ...] = ()
    is_merged: bool = False  # made of others that were deleted for it, see `gaga_core.scene.reduce`

    def __post_init__(self) -> None:
        if self.frame:
            Frame(np.array(self.frame, np.float64))  # raises ValueError when it is none

    def motion_since(self, world: DoubleArray) -> DoubleArray:
        """Motion (4, 4) of the scene as a whole since then; ``world`` (4, 4) as it is moved now."""
        if not self.frame:
            return world
        then = np.array(self.frame)
        return np.eye(4) if np.array_equal(then, world) else world @ np.linalg.inv(then)

    @property
    def is_made(self) -> bool:
        """Whether an edit made the splats."""
        return not self.path


@dataclass(frozen=True, eq=False)
class Labelling:
    """Groups of the rows of the opened file from one source, while another one is in use."""

    labels: IntArray  # (M,)
    confidence: UInt8Array | None  # (M,) 0..255


@dataclass(frozen=True, eq=False)
class Identities:
    """The source of the labels in use, and what identity encodings say in addition."""

    source: LabelSource = "votes"  # of `Scene.labels`
    other: Labelling | None = None  # of the source that is not in use; None: there is none
    colors: UInt8Array | None = None  # (M, 3) RGB of the encodings (`identity.colors`)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        other = (self.other.labels, self.other.confidence) if self.other is not None else ()
        return sum(array.nbytes for array in (*other, self.colors) if array is not None)


@dataclass
class Revision:
    """Counters that grow when a column changed; GPU mirrors compare them."""

    splats: int = 0  # gaussians replaced or appended (everything else must be uploaded too)
    labels: int = 0
    state: int = 0
    placement: int = 0  # the per-splat index
    placements: int = 0  # the table
    names: int = 0
    kept: tuple[tuple[int, int], ...] = ()  # see `splats_changed`; the newest last

    def splats_changed(self, kept: int) -> None:
        """Count a change of the Gaussians that left the first ``kept`` rows as they were."""
        self.splats += 1
        self.kept = (*self.kept, (self.splats, kept))[-_CATCH_UP:]

    def rows_kept_since(self, splats: int) -> int:
        """Leading rows of the Gaussians that are what they were at this count of ``splats``."""
        rows = dict(self.kept)
        return min((rows.get(k, 0) for k in range(splats + 1, self.splats + 1)), default=0)

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
    # (N,) row in the opened file, counted on in files that were added; a duplicate repeats its
    # original's.
    source: LongArray
    placements: Placements
    names: dict[int, str] = field(default_factory=dict)  # only of groups that a person named
    # What other groups are called meanwhile: measured (`query.descriptions`), no edit.
    described: dict[int, str] = field(default_factory=dict)
    colors: dict[int, RGB] = field(default_factory=dict)  # ... that a person colored in the list
    weights: dict[int, Weight] = field(default_factory=dict)  # ... that a person weighed
    folders: Folders = field(default_factory=Folders)  # of the object list
    bank: MemoryBank | None = None  # log of the association that gave the labels
    # How sure each row of the opened file is of its group, 0..255; see `confidence_of`.
    confidence: UInt8Array | None = None
    named_selections: dict[str, IndexSet] = field(default_factory=dict)
    identities: Identities = field(default_factory=Identities)
    frame: Frame = field(default_factory=Frame)  # how the whole scene was moved
    revision: Revision = field(default_factory=Revision)
    added: tuple[Added, ...] = ()  # other files whose splats are here too

    def __len__(self) -> int:
        return len(self.gaussians)

    @staticmethod
    def of(gaussians: Gaussians, labels: IntArray | None = None) -> "Scene":
        """A scene as opened: nothing selected, hidden or moved; metric where the file says so."""
        n = len(gaussians)
        return Scene(
            gaussians=gaussians,
            labels=np.zeros(n, np.int32) if labels is None else labels.astype(np.int32),
            state=np.zeros(n, np.uint8),
            placement=np.zeros(n, np.int32),
            source=np.arange(n, dtype=np.int64),
            placements=Placements.identity(),
            frame=Frame(is_metric=gaussians.is_metric),
        )

    def has(self, bits: State) -> BoolArray:
        """Splats (N,) with any of these bits."""
        return (self.state & np.uint8(bits)) != 0

    def confidence_of(self) -> UInt8Array | None:
        """Confidence (N,) of each splat in its group, 0..255; a duplicate has its original's.

        Splats of an added file are in no doubt: 255.
        """
        return self._by_splat(self.confidence, 255)

    def identity_colors_of(self) -> UInt8Array | None:
        """RGB (N, 3) of each splat's identity encoding; gray where splats were added.

        None without encodings. A duplicate has its original's.
        """
        return self._by_splat(self.identities.colors, 128)

    def _by_splat(self, column: UInt8Array | None, added: int) -> UInt8Array | None:
        """A column (M, ...) of the opened file for each splat (N, ...); others get ``added``."""
        if column is None:
            return None
        if not self.added:
            return column[self.source]
        filled = np.concatenate([column, np.full((1, *column.shape[1:]), added, np.uint8)])
        return filled[np.minimum(self.source, len(column))]

    def motion_of(self, source: int) -> DoubleArray:
        """Motion (4, 4) of the scene as a whole since a splat came into it; ``source``: its row."""
        item = next((a for a in self.added if a.first <= source < a.first + a.n), None)
        return self.frame.world if item is None else item.motion_since(self.frame.world)

    @property
    def n_opened(self) -> int:
        """Rows of the file that was opened: a prefix of the scene."""
        if self.added:
            return self.added[0].first
        return int((self.source == np.arange(len(self), dtype=np.int64)).sum())

    @property
    def n_rows_of_files(self) -> int:
        """Rows of the opened and of all added files."""
        return self.added[-1].first + self.added[-1].n if self.added else self.n_opened

    @property
    def visible(self) -> BoolArray:
        """Splats (N,) that are drawn, picked and exported: neither hidden nor deleted."""
        return ~self.has(State.HIDDEN | State.DELETED)


def of_scene_now(
    work: Callable[Concatenate[Scene, _P], _T],
) -> Callable[Concatenate[Scene, _P], _T]:
    """Let a stage see the scene as it is at the call, not at the first step.

    Columns are never written in place, so this copies nothing.
    """

    @wraps(work)
    def started(scene: Scene, /, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        return work(replace(scene, revision=Revision()), *args, **kwargs)

    return started
