"""How many points of each cluster show in each mask of each view: mostly zeros, kept as such."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from scipy.sparse import csr_matrix

from gaga_core.arrays import DoubleArray, IntArray, LongArray


@dataclass(frozen=True, eq=False)
class Leaders:
    """Of the masks of a view the group of most points and the next one, 0 = none."""

    first: IntArray  # (M + 1,)
    n_first: DoubleArray  # (M + 1,) points of it
    second: IntArray  # (M + 1,)
    n_second: DoubleArray  # (M + 1,)
    total: DoubleArray  # (M + 1,) points of all groups

    @staticmethod
    def of(table: csr_matrix) -> "Leaders":
        """``table`` (M + 1, G + 1) as in `PointTables`. Of equal counts the lower group."""
        n, starts = table.shape[0], table.indptr
        lengths = np.diff(starts)
        row = np.repeat(np.arange(n), lengths)
        order = np.lexsort((table.indices, -table.data, row))
        groups, counts = np.zeros((2, n), np.int32), np.zeros((2, n))
        for place in (0, 1):
            has = lengths > place
            at = order[starts[:-1][has] + place]
            groups[place, has], counts[place, has] = table.indices[at], table.data[at]
        total = np.bincount(row, table.data, n).astype(np.float64)
        return Leaders(groups[0], counts[0], groups[1], counts[1], total)


@dataclass(frozen=True, eq=False)
class PointTables(Sequence[csr_matrix]):
    """For each view a sparse table (M + 1, C + 1) of points; row 0 and column 0 are empty.

    The views' rows lie below each other in one matrix: a dense table of many masks and groups
    would cost their product in each view.
    """

    counts: csr_matrix  # (R, C + 1) float64, columns of a row ascending
    first_row: LongArray  # (V + 1,) where the rows of each view begin

    def __len__(self) -> int:
        return len(self.first_row) - 1

    @overload
    def __getitem__(self, v: int) -> csr_matrix: ...
    @overload
    def __getitem__(self, v: slice) -> list[csr_matrix]: ...
    def __getitem__(self, v: int | slice) -> csr_matrix | list[csr_matrix]:
        if isinstance(v, slice):
            return [self[i] for i in range(*v.indices(len(self)))]
        if not -len(self) <= v < len(self):
            raise IndexError(v)
        v %= len(self)
        return self.counts[self.first_row[v] : self.first_row[v + 1]]

    @property
    def width(self) -> int:
        """C + 1."""
        return int(self.counts.shape[1])

    def view_of_row(self) -> LongArray:
        """The view (R,) that each row belongs to."""
        return np.repeat(np.arange(len(self)), np.diff(self.first_row))

    def entries(self) -> tuple[LongArray, LongArray, DoubleArray]:
        """Row, column and number of points (E,) of the cells that have any, row by row."""
        rows = np.repeat(np.arange(self.counts.shape[0]), np.diff(self.counts.indptr))
        return rows, self.counts.indices.astype(np.int64), self.counts.data

    def seen(self) -> DoubleArray:
        """How many points (V, C + 1) of each cluster each view shows."""
        rows, columns, data = self.entries()
        cells = self.view_of_row()[rows] * self.width + columns
        found = np.bincount(cells, data, len(self) * self.width).astype(np.float64)
        result: DoubleArray = found.reshape(len(self), self.width)
        return result

    def by_name(self, names: Sequence[str]) -> "TablesByName":
        """The same by the names of the views."""
        return TablesByName(self, {name: v for v, name in enumerate(names)})


@dataclass(frozen=True, eq=False)
class TablesByName(Mapping[str, csr_matrix]):
    """`PointTables` by the names of the views."""

    tables: PointTables
    places: Mapping[str, int]

    def __getitem__(self, name: str) -> csr_matrix:
        return self.tables[self.places[name]]

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)


@dataclass(frozen=True, eq=False)
class Sightings:
    """Which points show in which masks."""

    row: IntArray  # (E,) mask, counted through all views
    point: IntArray  # (E,)
    first_row: LongArray  # (V + 1,)

    @staticmethod
    def of(mask_of: IntArray, sizes: Sequence[int]) -> "Sightings":
        """``mask_of`` (S, V) has the mask of each point in each view, 0 = none; ``sizes`` the rows
        of each view's table: masks + 1."""
        first_row = np.append(0, np.cumsum(sizes)).astype(np.int64)
        point, view = np.nonzero(mask_of)
        row = first_row[view] + mask_of[point, view]
        return Sightings(row.astype(np.int32), point.astype(np.int32), first_row)

    def tables(self, cluster: IntArray) -> PointTables:
        """Points of each cluster, ``cluster`` (S,) has 1.. or 0 = none."""
        column = cluster[self.point]
        known = column > 0
        shape = (int(self.first_row[-1]), int(cluster.max(initial=0)) + 1)
        ones = np.ones(int(known.sum()))
        counts = csr_matrix((ones, (self.row[known], column[known])), shape=shape)
        counts.sum_duplicates()
        counts.sort_indices()
        return PointTables(counts, self.first_row)


def point_tables(mask_of: IntArray, cluster: IntArray, sizes: Sequence[int]) -> PointTables:
    """For each view how many points of each cluster show in each mask.

    ``mask_of`` (S, V), 0 = none; ``cluster`` (S,) 1.., 0 = none; ``sizes``: masks + 1 of each view.
    """
    return Sightings.of(mask_of, sizes).tables(cluster)
