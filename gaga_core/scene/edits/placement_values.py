"""Edits of where splats stand and how they are colored, and the copies of a duplicate."""

from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from gaga_core.arrays import AnyArray, IntArray
from gaga_core.gaussians import Gaussians
from gaga_core.scene.edits.values import check_length
from gaga_core.scene.index_set import IndexSet, PackedInts
from gaga_core.scene.scene import Placements, Scene, State


@dataclass(frozen=True, eq=False)
class SetPlacement:
    """Rows of the placement table that change or are appended, and splats that move to them.

    A splat of ``moved`` goes from ``rows_from[i]`` to ``rows_to[i]``. The targets are rows that
    this edit appends, so nobody else stands on them and the way back is unique.
    """

    title: str
    n_rows: int  # of the table before
    rows: IntArray  # (C,) rows with new values, sorted; those from n_rows on are appended
    before: Placements  # values of the rows that existed
    after: Placements  # values of all C rows
    moved: IndexSet
    rows_from: IntArray  # (R,)
    rows_to: IntArray  # (R,)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        tables = sum(
            column.nbytes
            for table in (self.before, self.after)
            for column in (table.matrix, table.color, table.opacity)
        )
        rows = self.rows.nbytes + self.rows_from.nbytes + self.rows_to.nbytes
        return tables + rows + self.moved.nbytes

    def same_rows(self, other: "SetPlacement") -> bool:
        """Whether the two differ in the values of their rows at most (frames of one drag)."""
        return (
            self.n_rows == other.n_rows
            and np.array_equal(self.rows, other.rows)
            and np.array_equal(self.rows_from, other.rows_from)
            and np.array_equal(self.rows_to, other.rows_to)
            and self.moved.equals(other.moved)
        )

    def apply(self, scene: Scene) -> None:
        """Write the rows, then send the splats there."""
        check_length(scene, self.moved.n)
        index = self._sent(scene, self.rows_from, self.rows_to)
        table = _resized(scene.placements, max(self.n_rows, int(self.rows.max(initial=0)) + 1))
        scene.placements = _with_rows(table, self.rows, self.after)
        self._put(scene, index)

    def revert(self, scene: Scene) -> None:
        """Send the splats back, write the old rows and cut off the appended ones."""
        check_length(scene, self.moved.n)
        index = self._sent(scene, self.rows_to, self.rows_from)
        table = _resized(scene.placements, self.n_rows)
        scene.placements = _with_rows(table, self.rows[: len(self.before)], self.before)
        self._put(scene, index)

    def rewrite(self, scene: Scene) -> None:
        """Write the new values only: the scene already stands on these rows (see `same_rows`)."""
        scene.placements = _with_rows(scene.placements, self.rows, self.after)
        scene.revision.placements += 1

    def _sent(self, scene: Scene, rows_from: IntArray, rows_to: IntArray) -> IntArray | None:
        if self.moved.count == 0:
            return None
        target = np.arange(max(rows_from.max(), rows_to.max()) + 1, dtype=np.int32)
        target[rows_from] = rows_to
        splats = self.moved.indices()
        index = scene.placement.copy()
        index[splats] = target[index[splats]]
        return index

    def _put(self, scene: Scene, index: IntArray | None) -> None:
        scene.revision.placements += 1
        if index is not None:
            scene.placement = index
            scene.revision.placement += 1


@dataclass(frozen=True, eq=False)
class AppendCopies:
    """Copies of some splats at the end of the scene; the parameters are read from the originals."""

    title: str
    splats: IndexSet
    labels: PackedInts  # of the copies
    rows: PackedInts  # placement rows of the copies
    state: State = State.SELECTED

    @property
    def nbytes(self) -> int:
        """Bytes held, the appended rows of the scene included while they are only here."""
        return self.splats.nbytes + self.labels.nbytes + self.rows.nbytes

    def apply(self, scene: Scene) -> None:
        """Append the copies."""
        check_length(scene, self.splats.n)
        chosen = self.splats.indices()
        gaussians = _joined(scene.gaussians, chosen)
        labels = np.concatenate([scene.labels, self.labels.values()])
        placement = np.concatenate([scene.placement, self.rows.values()])
        state = np.concatenate([scene.state, np.full(len(chosen), self.state, np.uint8)])
        source = np.concatenate([scene.source, scene.source[chosen]])
        scene.gaussians, scene.labels, scene.placement = gaussians, labels, placement
        scene.state, scene.source = state, source
        _bump_all(scene, self.splats.n)

    def revert(self, scene: Scene) -> None:
        """Cut the copies off."""
        n = self.splats.n
        check_length(scene, n + self.splats.count)
        scene.gaussians = first_rows(scene.gaussians, n)
        scene.labels = scene.labels[:n]
        scene.placement = scene.placement[:n]
        scene.state = scene.state[:n]
        scene.source = scene.source[:n]
        _bump_all(scene, n)


def take_rows(table: Placements, rows: IntArray) -> Placements:
    """The chosen rows of a placement table, as a copy."""
    return Placements(table.matrix[rows], table.color[rows], table.opacity[rows])


def _resized(table: Placements, n_rows: int) -> Placements:
    if n_rows <= len(table):
        return Placements(table.matrix[:n_rows], table.color[:n_rows], table.opacity[:n_rows])
    fresh = Placements.identity(n_rows - len(table))
    return Placements(
        np.concatenate([table.matrix, fresh.matrix]),
        np.concatenate([table.color, fresh.color]),
        np.concatenate([table.opacity, fresh.opacity]),
    )


def _with_rows(table: Placements, rows: IntArray, values: Placements) -> Placements:
    result = Placements(table.matrix.copy(), table.color.copy(), table.opacity.copy())
    result.matrix[rows] = values.matrix
    result.color[rows] = values.color
    result.opacity[rows] = values.opacity
    return result


def _joined(g: Gaussians, chosen: IntArray) -> Gaussians:
    """``g`` with copies of the rows ``chosen`` behind it."""

    def twice(column: AnyArray) -> AnyArray:
        return np.concatenate([column, column[chosen]])

    return replace(
        g,
        means=twice(g.means),
        quats=twice(g.quats),
        log_scales=twice(g.log_scales),
        logit_opacities=twice(g.logit_opacities),
        sh=twice(g.sh),
        extra=MappingProxyType({name: twice(column) for name, column in g.extra.items()}),
    )


def first_rows(g: Gaussians, n: int) -> Gaussians:
    """The first ``n`` rows; columns are views."""
    return replace(
        g,
        means=g.means[:n],
        quats=g.quats[:n],
        log_scales=g.log_scales[:n],
        logit_opacities=g.logit_opacities[:n],
        sh=g.sh[:n],
        extra=MappingProxyType({name: column[:n] for name, column in g.extra.items()}),
    )


def _bump_all(scene: Scene, kept: int) -> None:
    """The splats from row ``kept`` on changed, so every other column did."""
    scene.revision.splats_changed(kept)
    scene.revision.labels += 1
    scene.revision.state += 1
    scene.revision.placement += 1
