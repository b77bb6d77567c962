"""A model of structure from motion as arrays, and what can be measured of it.

Pure numpy: the arrays are written by `sfm_export` in the process that holds the model.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, LongArray
from gaga_core.io.arrays_file import TEXT, Column, read_columns

AGAIN = "Remove it and reconstruct again."
_ROWS = Column(np.int64, low=0)
PAIRS = {  # photos A that were matched in Q pairs
    "pairs": replace(_ROWS, shape=("Q", 2), below="A"),
    "pair_matches": replace(_ROWS, shape=("Q",)),
}
# Arrays of `SfmFacts`. Points behind a camera may have errors without end.
_FILE = PAIRS | {
    "names": replace(TEXT, shape=("V",)),
    "poses": Column(np.float64, ("V", 3, 4)),
    "focal": Column(np.float64, ("V", 2), low=0.001, high=1e9),  # pixels, ratios are taken
    "sizes": replace(_ROWS, shape=("V", 2), low=1),
    "points": Column(np.float64, ("P", 3)),
    "track_lengths": replace(_ROWS, shape=("P",)),
    "seen_points": replace(_ROWS, shape=("O",), below="P"),
    "seen_views": replace(_ROWS, shape=("O",), below="V"),
    "seen_errors": Column(np.float64, ("O",), unknown=True),
    "match_views": replace(_ROWS, shape=("M", 2), below="V"),
    "match_points": replace(_ROWS, shape=("M", 2), low=-1, below="P"),
    "match_rays": Column(np.float64, ("M", 2, 3), low=-1.001, high=1.001, unknown=True),  # units
    "all_names": replace(TEXT, shape=("A",)),
    "model_sizes": replace(_ROWS, shape=("models",)),
}


@dataclass(frozen=True, eq=False)
class SfmFacts:
    """A model as arrays. V placed views (by name), P points, O observations, M sampled matches."""

    names: tuple[str, ...]  # (V,)
    poses: DoubleArray  # (V, 3, 4) cam_from_world
    focal: DoubleArray  # (V, 2) pixels
    sizes: LongArray  # (V, 2) width, height
    points: DoubleArray  # (P, 3) world
    track_lengths: LongArray  # (P,) views that see a point
    seen_points: LongArray  # (O,) index into points
    seen_views: LongArray  # (O,) index into views
    seen_errors: DoubleArray  # (O,) pixels between where a point is seen and where it should be
    match_views: LongArray  # (M, 2) views of a verified match
    match_points: LongArray  # (M, 2) the point that each side belongs to, -1 = none
    match_rays: DoubleArray  # (M, 2, 3) unit viewing directions, camera frame
    all_names: tuple[str, ...]  # (A,) every photo, placed or not
    pairs: LongArray  # (Q, 2) photos with verified matches, indices into all_names
    pair_matches: LongArray  # (Q,) how many
    model_sizes: LongArray  # views of each model that the mapper made, largest first

    @staticmethod
    def load(path: Path) -> "SfmFacts":
        """Read what `sfm_export.write_facts` wrote. Raises ``GagaError``."""
        arrays = read_columns(path, AGAIN, _FILE)
        names, all_names = (
            tuple(str(n) for n in arrays.pop(key)) for key in ("names", "all_names")
        )
        return SfmFacts(names=names, all_names=all_names, **arrays)


@dataclass(frozen=True)
class MeasureConfig:
    """Thresholds of agreement."""

    pair_pixels: float = 8.0  # how far a match may be from its epipolar line, or its point
    strong: int = 60  # verified matches from which a pair must agree; the median if that is less
    shared: int = 15  # points that two views must share to hold each other


_CONFIG = MeasureConfig()


@dataclass(frozen=True)
class SfmSummary:
    """The figures behind the verdicts, for the report."""

    photos: int
    registered: int
    points: int
    reprojection: float  # pixels, mean
    track: float  # views, mean
    focal: float  # pixels, median
    parallax: float  # degrees, median
    agreeing: float  # share of strong pairs
    doubled: float  # share of matches
    behind: float  # share of observations
    parts: int  # groups of views that share points only among themselves

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}


def summarize(facts: SfmFacts) -> SfmSummary:
    """Measure a model."""
    return SfmSummary(
        photos=len(facts.all_names),
        registered=len(facts.names),
        points=len(facts.points),
        reprojection=_mean(facts.seen_errors),
        track=_mean(facts.track_lengths),
        focal=float(np.median(facts.focal)) if len(facts.focal) else 0.0,
        parallax=_parallax(facts),
        agreeing=pair_agreement(facts)[0],
        doubled=_doubled(facts),
        behind=_mean(_seen_depths(facts) <= 0),
        parts=_parts(facts, _CONFIG.shared),
    )


def _mean(values: AnyArray) -> float:
    return float(values.mean()) if len(values) else 0.0


def _seen_depths(facts: SfmFacts) -> DoubleArray:
    """Depth (O,) of each observed point in the camera that sees it."""
    rows = facts.poses[facts.seen_views, 2]
    xyz = facts.points[facts.seen_points]
    return (rows[:, :3] * xyz).sum(axis=1) + rows[:, 3]


def centres_of(facts: SfmFacts) -> DoubleArray:
    """Camera centres (V, 3), world."""
    rotations, offsets = facts.poses[:, :, :3], facts.poses[:, :, 3]
    return -np.einsum("vij,vi->vj", rotations, offsets)


def _parallax(facts: SfmFacts) -> float:
    """Median over points of twice the greatest angle, degrees, from their mean viewing direction.

    Within a factor of two of the greatest angle between two views, in one pass.
    """
    if not len(facts.seen_points):
        return 0.0
    toward = centres_of(facts)[facts.seen_views] - facts.points[facts.seen_points]
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    mean = np.zeros_like(facts.points)
    np.add.at(mean, facts.seen_points, toward)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    cosine = (mean[facts.seen_points] * toward).sum(axis=1)
    widest = np.ones(len(facts.points))
    np.minimum.at(widest, facts.seen_points, cosine)
    return float(2 * np.degrees(np.median(np.arccos(np.clip(widest, -1, 1)))))


def _relative(facts: SfmFacts, first: LongArray, second: LongArray) -> tuple[DoubleArray, ...]:
    """Rotation (M, 3, 3) and offset (M, 3) from the first views' cameras to the second ones'."""
    rotations, offsets = facts.poses[:, :, :3], facts.poses[:, :, 3]
    turn = np.einsum("mij,mkj->mik", rotations[second], rotations[first])
    return turn, offsets[second] - np.einsum("mij,mj->mi", turn, offsets[first])


def _tolerance(facts: SfmFacts, pixels: float) -> DoubleArray:
    """``pixels`` as an angle (M,), radians, in the second view of each match."""
    return pixels / facts.focal.mean(axis=1)[facts.match_views[:, 1]]


def pair_agreement(facts: SfmFacts) -> tuple[float, int]:
    """Share of strong pairs that agree with the poses, and how many strong pairs there are.

    A pair agrees when at least half of its matches lie on their epipolar lines.

    Weak pairs are left out: tiles and windows repeat, and some false pairs pass the verification
    even where the model is right. Rays that coincide agree whatever the baseline.
    """
    strong = _strong_matches(facts)
    if not strong.any():
        return 1.0, 0
    first, second = facts.match_views[strong].T
    rays, other = facts.match_rays[strong, 0], facts.match_rays[strong, 1]
    turn, offset = _relative(facts, first, second)
    turned = np.einsum("mij,mj->mi", turn, rays)
    normal = np.cross(offset, turned)
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    off_line = np.abs((normal * other).sum(axis=1)) / length
    apart = np.linalg.norm(turned - other, axis=1)
    tolerance = _tolerance(facts, _CONFIG.pair_pixels)[strong]
    # Depths at which the rays meet, times a positive number: behind a camera they see no point.
    across = np.cross(turned, other)
    first_depth = -(np.cross(offset, other) * across).sum(axis=1)
    second_depth = -(np.cross(offset, turned) * across).sum(axis=1)
    in_front = (first_depth > 0) & (second_depth > 0)
    good = ((off_line < tolerance) & in_front) | (apart < tolerance)
    _, pair, n = np.unique(
        first * len(facts.names) + second, return_inverse=True, return_counts=True
    )
    agree = np.bincount(pair, good) >= 0.5 * n
    return float(agree.mean()), len(agree)


def _strong_matches(facts: SfmFacts) -> BoolArray:
    """Which matches (M,) are of a pair of placed views with many verified matches."""
    n = len(facts.names)
    place = {name: i for i, name in enumerate(facts.names)}
    views = np.array([place.get(name, -1) for name in facts.all_names], np.int64)
    pairs = views[facts.pairs]
    placed = (pairs >= 0).all(axis=1) & (facts.pair_matches > 0)
    if not placed.any():
        return np.zeros(len(facts.match_views), bool)
    counts = facts.pair_matches[placed]
    chosen = pairs[placed][counts >= min(_CONFIG.strong, float(np.median(counts)))]
    keys = np.concatenate([chosen[:, 0] * n + chosen[:, 1], chosen[:, 1] * n + chosen[:, 0]])
    return np.isin(facts.match_views[:, 0] * n + facts.match_views[:, 1], keys)


def _doubled(facts: SfmFacts) -> float:
    """Share of the matches of strong pairs whose two sides became points that do not coincide.

    The point of the first side, looked at from the second view, is further than the tolerance
    from where the second view saw it.
    """
    both = (facts.match_points >= 0).all(axis=1) & _strong_matches(facts)
    if not both.any():
        return 0.0
    second = facts.match_views[both, 1]
    poses = facts.poses[second]
    xyz = facts.points[facts.match_points[both, 0]]
    seen = np.einsum("mij,mj->mi", poses[:, :, :3], xyz) + poses[:, :, 3]
    seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-12)
    off = np.linalg.norm(seen - facts.match_rays[both, 1], axis=1)
    other = facts.match_points[both, 0] != facts.match_points[both, 1]
    return float((other & (off > _tolerance(facts, _CONFIG.pair_pixels)[both])).mean())


def _parts(facts: SfmFacts, shared: int) -> int:
    """Groups of views that are held together by at least ``shared`` common points."""
    if len(facts.names) == 0 or len(facts.points) == 0:
        return len(facts.names)
    common = common_points(facts)
    common.data = (common.data >= shared).astype(np.int32)
    common.eliminate_zeros()
    return int(connected_components(common, directed=False)[0])


def common_points(facts: SfmFacts) -> csr_matrix:
    """How many points each two views (V, V) have in common."""
    ones = np.ones(len(facts.seen_views), np.int32)
    shape = (len(facts.names), len(facts.points))
    sees = coo_matrix((ones, (facts.seen_views, facts.seen_points)), shape=shape).tocsr()
    return csr_matrix(sees @ sees.T)
