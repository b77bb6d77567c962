"""Do the turns between three photos close? Where things repeat, pairs match well and still lie.

A pair of photos that matched says how one camera is turned against the other. Around three photos
these turns come back to where they began. Where two of them show different things that look alike,
they do not (Zach 2010, "Disambiguating visual relations using loop constraints").
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, LongArray

_EDGES = 3000  # pairs that are looked at, at most
_THIRDS = 8  # third photos of each


@dataclass(frozen=True, eq=False)
class Cycles:
    """What the triplets of photos say. T triplets."""

    photos: LongArray  # (T, 3) indices
    errors: DoubleArray  # (T,) degrees between the turn around a triplet and none

    def open(self, degrees: float) -> BoolArray:
        """Triplets (T,) that miss by more than ``degrees``."""
        result: BoolArray = self.errors > degrees
        return result


def photo_cycles(
    n: int,  # photos
    pairs: LongArray,  # (Q, 2) indices of photos
    turns: DoubleArray,  # (Q, 3, 3) rotation from the first camera to the second; NaN: unknown
    seed: int = 0,
) -> Cycles:
    """Close the turns around triplets of photos that all matched; a sample of them, if many."""
    known = ~np.isnan(turns).any(axis=(1, 2))
    of = np.full((n, n), -1, np.int64)
    of[pairs[known, 0], pairs[known, 1]] = np.flatnonzero(known)
    linked = (of >= 0) | (of.T >= 0)
    rng = np.random.default_rng(seed)
    edges = pairs[known][rng.permutation(int(known.sum()))[:_EDGES]]
    rows = [np.zeros((0, 3), np.int64)]
    for i, j in edges:
        thirds = np.flatnonzero(linked[i] & linked[j])
        chosen = rng.permutation(thirds)[:_THIRDS]
        rows.append(np.c_[np.full(len(chosen), i), np.full(len(chosen), j), chosen])
    photos = np.unique(np.sort(np.concatenate(rows), axis=1), axis=0)
    a, b, c = photos.T
    around = _turn(of, turns, c, a) @ _turn(of, turns, b, c) @ _turn(of, turns, a, b)
    cosine = (np.trace(around, axis1=1, axis2=2) - 1) / 2
    return Cycles(photos, np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _turn(of: LongArray, turns: DoubleArray, first: LongArray, second: LongArray) -> DoubleArray:
    """Rotations (T, 3, 3) from the first cameras to the second ones, whichever way they are known.

    ``of`` (n, n) is the index of a pair, -1 where the pair is known the other way round.
    """
    forth, back = of[first, second], of[second, first]
    result: DoubleArray = np.where(
        (forth >= 0)[:, None, None], turns[forth], turns[back].transpose(0, 2, 1)
    )
    return result
