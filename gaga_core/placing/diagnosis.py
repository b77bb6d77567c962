"""Why photos were not placed: what the photos and their matches say, in sentences.

Looked at after each attempt, so that the next one does what may help and a person reads a reason.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gaga_core.arrays import BoolArray, DoubleArray, LongArray
from gaga_core.errors import option
from gaga_core.io.arrays_file import TEXT, Column, read_columns
from gaga_core.placing.metrics import AGAIN, PAIRS
from gaga_core.placing.photos import PhotoSet

# --- Do the rotations between three photos close? Where objects repeat, good matches are wrong.
# A pair of photos that matched says how one camera is turned against the other. Around three
# photos these turns come back to where they began. Where two of them show different objects that
# look alike, they do not (Zach 2010, "Disambiguating visual relations using loop constraints").


_MOST_EDGES = 3000  # pairs that are looked at, at most
_MOST_THIRDS = 8  # third photos of each


@dataclass(frozen=True, eq=False)
class Cycles:
    """Consistency of triplets of photos. T triplets."""

    photos: LongArray  # (T, 3) indices
    errors: DoubleArray  # (T,) degrees between the turn around a triplet and none
    matches: LongArray  # (T,) of the pair that has the fewest

    def open(self, degrees: float) -> BoolArray:
        """Triplets (T,) that miss by more than ``degrees``."""
        return self.errors > degrees


def photo_cycles(
    n: int,  # photos
    pairs: LongArray,  # (Q, 2) indices of photos
    turns: DoubleArray,  # (Q, 3, 3) rotation from the first camera to the second; NaN: unknown
    matches: LongArray,  # (Q,) verified
    seed: int = 0,
) -> Cycles:
    """Close the turns around triplets of photos that all matched; a sample of them, if many."""
    known = ~np.isnan(turns).any(axis=(1, 2))
    of = np.full((n, n), -1, np.int64)
    of[pairs[known, 0], pairs[known, 1]] = np.flatnonzero(known)
    linked = (of >= 0) | (of.T >= 0)
    rng = np.random.default_rng(seed)
    edges = pairs[known][rng.permutation(int(known.sum()))[:_MOST_EDGES]]
    rows = [np.zeros((0, 3), np.int64)]
    for i, j in edges:
        thirds = np.flatnonzero(linked[i] & linked[j])
        chosen = rng.permutation(thirds)[:_MOST_THIRDS]
        rows.append(np.c_[np.full(len(chosen), i), np.full(len(chosen), j), chosen])
    photos = np.unique(np.sort(np.concatenate(rows), axis=1), axis=0)
    a, b, c = photos.T
    around = _turn(of, turns, c, a) @ _turn(of, turns, b, c) @ _turn(of, turns, a, b)
    cosine = (np.trace(around, axis1=1, axis2=2) - 1) / 2
    of_pairs = matches[np.maximum(of, of.T)[[a, b, c], [b, c, a]]]
    return Cycles(photos, np.degrees(np.arccos(np.clip(cosine, -1, 1))), of_pairs.min(axis=0))


def _turn(of: LongArray, turns: DoubleArray, first: LongArray, second: LongArray) -> DoubleArray:
    """Rotations (T, 3, 3) from the first cameras to the second ones, whichever way they are known.

    ``of`` (n, n) is the index of a pair, -1 where the pair is known the other way round.
    """
    forth, back = of[first, second], of[second, first]
    return np.where((forth >= 0)[:, None, None], turns[forth], turns[back].transpose(0, 2, 1))


_NAMED = 3  # photos named in a sentence
_FILE = PAIRS | {  # arrays of `MatchFacts`
    "names": replace(TEXT, shape=("A",)),
    "n_features": Column(np.int64, ("A",), low=0),
    "coverage": Column(np.float64, ("A",)),
    "still": Column(np.float64, ("Q",), unknown=True),
    "turns": Column(np.float64, ("Q", 3, 3), unknown=True),
}


@dataclass(frozen=True, eq=False)
class MatchFacts:
    """Result of the matching before there is a model. A photos, Q pairs."""

    names: tuple[str, ...]  # (A,) by name
    n_features: LongArray  # (A,)
    coverage: DoubleArray  # (A,) share of the picture's cells that hold a feature
    pairs: LongArray  # (Q, 2) indices into names
    pair_matches: LongArray  # (Q,) verified
    still: DoubleArray  # (Q,) share of the matches that do not move in the picture; NaN: too few
    turns: DoubleArray  # (Q, 3, 3) rotation from the first camera to the second; NaN: unknown

    @staticmethod
    def load(path: Path) -> "MatchFacts":
        """Read what `sfm_export.write_match_facts` wrote. Raises ``GagaError``."""
        arrays = read_columns(path, AGAIN, _FILE)
        names = tuple(str(name) for name in arrays.pop("names"))
        return MatchFacts(names=names, **arrays)


@dataclass(frozen=True)
class DiagnosisConfig:
    """Thresholds for blurred, empty, separate and static photos."""

    blurred: float = 0.05  # sharpness under which a photo may be blurred ...
    blurred_share: float = 0.25  # ... if it is under this share of the sharp ones' sharpness
    few_features: int = 300  # median of the photos
    covered: float = 0.45  # share of a picture that holds features, median
    linked: int = 15  # verified matches that link two photos
    # Share of a pair's matches that are static: under 0.0001 where the camera moved, 0.5 and more
    # on turntables before rooms.
    still: float = 0.1
    still_pairs: float = 0.5  # share of the pairs of which that is true
    open_cycle: float = 35.0  # degrees that the turns around three photos may miss by
    open_share: float = 0.15  # of the triplets, from which objects repeat: equal walls have 0.36
    fewest_cycles: int = 20  # triplets below which nothing is said


_CONFIG = DiagnosisConfig()


@dataclass(frozen=True)
class Diagnosis:
    """Reasons that may keep photos from being placed."""

    blurred: tuple[str, ...]  # names
    groups: tuple[tuple[str, ...], ...]  # photos that are linked by matches, largest group first
    few_features: bool
    featureless: bool  # features in a small part of the pictures only
    still: bool  # most matches are of a background that does not move with the camera
    repeats: float = 0.0  # share of triplets that contradict each other; 0: objects do not repeat
    alike: tuple[str, ...] = ()  # three photos that do

    def reasons(self, placed: Collection[str] = ()) -> tuple[str, ...]:
        """One sentence for each cause, with what to do about it; ``placed`` photos are no fault."""
        n = sum(len(group) for group in self.groups)
        found = []
        if self.still:
            found.append(
                "The background is static while the object turns, and what turns shows too few "
                "details to be placed by. Turn it in steps of 10 degrees or less, put a patterned "
                f"plate under it, or give masks of the object with {option('--foreground')}."
            )
        if self.blurred:
            found.append(
                f"{len(self.blurred)} of {n} photos {_are(self.blurred)} blurred: "
                f"{_named(self.blurred)}. Take them again with a steady hand and more light."
            )
        apart = [name for group in self.groups[1:] for name in group if name not in placed]
        if apart and not self.still:
            found.append(
                f"{len(apart)} of {n} photos {'shows' if len(apart) == 1 else 'show'} too little "
                f"of what the others show: {_named(apart)}. Add photos in between, with more than "
                "half in common."
            )
        if self.featureless:
            found.append(
                "Most of the picture is plain, as of an object on white. Put newspaper or a "
                "patterned cloth under the object, and do not turn either."
            )
        elif self.few_features:
            found.append(
                "The photos show few details. Take sharper or larger photos; bare walls, glass "
                "and shine give none."
            )
        return tuple(found)

    def repeated(self) -> str:
        """That objects look alike and what to do about it; "" where they do not.

        Such matches can agree with each other on a wrong model, which then passes every check.
        """
        if not self.repeats or self.still:
            return ""
        return (
            "Similar-looking objects are at several places: "
            f"{self.repeats:.0%} of the photos that match in threes contradict each other, as "
            f"{', '.join(self.alike)} do. Leave out photos that show only what repeats, or "
            "add unique objects to the scene, and take photos that show two places at a time."
        )

    def why_out(self, name: str, placed: Collection[str] = ()) -> str:
        """Reason why the photo ``name`` is not placed, in a few words."""
        if name in placed:
            return "shows another scene"
        if name in self.blurred:
            return "blurred"
        if self.groups and name not in self.groups[0]:
            return "shows too little of what the others show"
        return "too few details in common with the others"


def diagnose(photos: PhotoSet, matches: MatchFacts) -> Diagnosis:
    """Look for the known causes."""
    features = float(np.median(matches.n_features)) if len(matches.n_features) else 0.0
    covered = float(np.median(matches.coverage)) if len(matches.coverage) else 0.0
    repeats, alike = repetition(matches)
    return Diagnosis(
        blurred=blurred_photos(photos),
        groups=linked_groups(matches, _CONFIG.linked),
        few_features=features < _CONFIG.few_features,
        featureless=covered < _CONFIG.covered,
        still=is_still(matches),
        repeats=repeats,
        alike=alike,
    )


def blurred_photos(photos: PhotoSet) -> tuple[str, ...]:
    """Names of the photos that are far less sharp than the sharpest quarter of them."""
    measured = [photo for photo in photos.photos if photo.sharpness > 0]
    if not measured:
        return ()
    sharp = float(np.quantile([photo.sharpness for photo in measured], 0.75))
    bound = min(_CONFIG.blurred, _CONFIG.blurred_share * sharp)
    return tuple(photo.name for photo in measured if photo.sharpness < bound)


def linked_groups(matches: MatchFacts, linked: int) -> tuple[tuple[str, ...], ...]:
    """The photos in groups that verified matches link, largest first."""
    n = len(matches.names)
    strong = matches.pairs[matches.pair_matches >= linked]
    graph = coo_matrix((np.ones(len(strong), np.int8), (strong[:, 0], strong[:, 1])), shape=(n, n))
    _, group = connected_components(graph, directed=False)
    found = [[matches.names[i] for i in np.flatnonzero(group == g)] for g in np.unique(group)]
    return tuple(tuple(names) for names in sorted(found, key=len, reverse=True))


def chain_breaks(matches: MatchFacts) -> tuple[tuple[str, str], ...]:
    """Neighbours by name, as frames of a film are, that matches do not link."""
    strong = matches.pairs[matches.pair_matches >= _CONFIG.linked]
    linked = {(min(i, j), max(i, j)) for i, j in strong.tolist()}
    names = matches.names
    return tuple(
        (names[i], names[i + 1]) for i in range(len(names) - 1) if (i, i + 1) not in linked
    )


def is_still(matches: MatchFacts) -> bool:
    """Whether the camera stood still in front of most of what the photos show."""
    known = ~np.isnan(matches.still)
    if known.sum() < len(matches.names):
        return False
    # A film that rests has still pairs too, but of neighbours only.
    far = known & (np.abs(np.diff(matches.pairs, axis=1)[:, 0]) > max(2, len(matches.names) // 8))
    return bool(far.any() and (matches.still[far] > _CONFIG.still).mean() > _CONFIG.still_pairs)


def repetition(matches: MatchFacts) -> tuple[float, tuple[str, ...]]:
    """Share of the triplets that contradict each other, and the worst; 0 when they are few.

    They count by their matches: few may be wrong by chance, objects that repeat give many.
    """
    pairs, counts = matches.pairs, matches.pair_matches
    cycles = photo_cycles(len(matches.names), pairs, matches.turns, counts)
    if len(cycles.errors) < _CONFIG.fewest_cycles:
        return 0.0, ()
    share = float(np.average(cycles.open(_CONFIG.open_cycle), weights=cycles.matches))
    if share < _CONFIG.open_share:
        return 0.0, ()
    worst = cycles.photos[int(cycles.errors.argmax())]
    return share, tuple(matches.names[i] for i in worst)


def _named(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (" ..." if len(names) > _NAMED else "")


def _are(names: Sequence[str]) -> str:
    return "is" if len(names) == 1 else "are"
