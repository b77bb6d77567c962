"""Is a model of structure from motion right? A wrong one must not pass without a word.

Mapping can place every photo and still be wrong: two halves turned against each other, a focal
length that diverged, a wall that appears twice. The strongest witness is what the mapper did not
use up: the verified matches of every pair of photos, held against the poses of the model.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from gaga_core.arrays import BoolArray, DoubleArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, option
from gaga_core.geometry import fit_similarity
from gaga_core.io.arrays_file import TEXT, Column, read_columns
from gaga_core.io.files import refuse_links
from gaga_core.placing.metrics import (
    AGAIN,
    PAIRS,
    MeasureConfig,
    SfmFacts,
    SfmSummary,
    centres_of,
    common_points,
    pair_agreement,
)
from gaga_core.placing.photos import prepare_photos
from gaga_core.placing.sfm import SfmConfig, run_matching, run_step
from gaga_core.progress import Stage, mapped

# --- The relative placement of two clusters of cameras, by points that each sees alone.
# Where few points hold two halves of a model, an adjustment can fit all of them and be wrong: two
# rays of one view on each side meet somewhere whatever the scale between the halves. A point that
# at least two views of each side see is triangulated by each side alone, and the two places
# coincide only if the halves are placed right. The similarity between them, and how far it
# moves when other points are drawn (Efron 1979, bootstrap), tell whether the halves hold each
# other.


_BOOTSTRAP_DRAWS = 64  # of the bootstrap


@dataclass(frozen=True)
class BridgeConfig:
    """When two clusters are looked at, and what they must show."""

    fewest_views: int = 4  # of a cluster
    weak: float = 0.15  # common points of the best pair across, as a share of those inside
    fewest: int = 12  # points that both sides triangulate alone
    pixels: float = 1.0  # error of a direction, for the error of a depth
    depth_error: float = 0.03  # of the depth: points that one side knows worse do not count
    kept: float = 0.7  # share of the points that a similarity is fitted to, the best ones
    off: float = 0.1  # of the extent of all cameras: how far a cluster may lie off


_BRIDGE = BridgeConfig()


@dataclass(frozen=True, eq=False)
class Bridge:
    """The weakest joint of a model."""

    side: BoolArray  # (V,) views on the smaller side
    n_common: int  # points that the two views across have in common that have most
    n_points: int  # that both sides triangulate alone
    # Mean move of the smaller side's cameras to where its points say, x extent; inf: too few, or
    # all cameras in one place.
    off: float
    spread: float  # standard deviation of that move over draws, x extent

    def holds(self) -> bool:
        """Whether enough points of both sides agree with how the sides lie."""
        return self.off + 2 * self.spread < _BRIDGE.off


def weakest_bridge(facts: SfmFacts) -> Bridge | None:
    """The joint between two clusters that hold each other badly; None when there is none."""
    split = _weakest_split(facts)
    if split is None:
        return None
    side, n_common = split
    ours, theirs = _known_twice(facts, side)
    centres = centres_of(facts)
    extent = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    if len(ours) < _BRIDGE.fewest or extent == 0:
        return Bridge(side, n_common, len(ours), np.inf, np.inf)
    rng = np.random.default_rng(0)
    moves = []
    for draw in range(_BOOTSTRAP_DRAWS):
        rows = np.arange(len(ours)) if draw == 0 else rng.integers(0, len(ours), len(ours))
        moves.append(_moved(centres[side], theirs[rows], ours[rows]) - centres[side])
    # (draws, views, 3): by the fit to all points, and how it varies
    lengths = np.linalg.norm(np.array(moves), axis=2).mean(axis=1)
    varied = np.array(moves) - np.mean(moves, axis=0)
    spread = float(np.sqrt((varied**2).sum(axis=2).mean()))
    return Bridge(side, n_common, len(ours), float(lengths[0]) / extent, spread / extent)


def _weakest_split(facts: SfmFacts) -> tuple[BoolArray, int] | None:
    """Views (V,) behind the weakest edge of the tree of the pairs with most common points, and its
    points.

    None when that edge is not weak next to the others, or leaves too few views on a side.
    """
    n = len(facts.names)
    if n < 2 * _BRIDGE.fewest_views or not len(facts.points):
        return None
    common = common_points(facts).astype(np.float64)
    common.setdiag(0)
    common.eliminate_zeros()
    tree = minimum_spanning_tree(csr_matrix((-common.data, common.indices, common.indptr), (n, n)))
    edges = tree.tocoo()
    for number in np.argsort(-edges.data, kind="stable"):  # the weakest first
        if -edges.data[number] >= _BRIDGE.weak * float(np.median(-edges.data)):
            return None
        keep = np.arange(len(edges.data)) != number
        cut = coo_matrix((edges.data[keep], (edges.row[keep], edges.col[keep])), (n, n))
        _, labels = connected_components(cut, directed=False)
        side: BoolArray = labels == labels[edges.row[number]]
        if 2 * side.sum() > n:
            side = labels == labels[edges.col[number]]
        if side.sum() >= _BRIDGE.fewest_views:
            return side, int(-edges.data[number])
    return None


def _known_twice(facts: SfmFacts, side: BoolArray) -> tuple[DoubleArray, DoubleArray]:
    """Places (K, 3), (K, 3) of the points that both sides triangulate alone: the rest, ``side``."""
    n = len(facts.points)
    places, good = zip(*(_triangulated(facts, side == s) for s in (False, True)), strict=True)
    pairs = [np.stack([np.arange(n), np.arange(n)], axis=1)]
    for a, b in ((0, 1), (1, 0)):  # matches across whose two sides became two points
        of_rest, of_side = facts.match_points[:, a], facts.match_points[:, b]
        across = ~side[facts.match_views[:, a]] & side[facts.match_views[:, b]]
        chosen = across & (of_rest >= 0) & (of_side >= 0) & (of_rest != of_side)
        pairs.append(np.stack([of_rest[chosen], of_side[chosen]], axis=1))
    rows = np.unique(np.concatenate(pairs), axis=0)
    rows = rows[good[0][rows[:, 0]] & good[1][rows[:, 1]]]
    return places[0][rows[:, 0]], places[1][rows[:, 1]]


def _triangulated(facts: SfmFacts, views: BoolArray) -> tuple[DoubleArray, BoolArray]:
    """Points (P, 3) as the chosen ``views`` (V,) see them alone, and which are well known."""
    view, point = facts.match_views.ravel(), facts.match_points.ravel()
    rays = facts.match_rays.reshape(-1, 3)
    chosen = (point >= 0) & views[view]
    keys = point[chosen] * len(facts.names) + view[chosen]
    _, first = np.unique(keys, return_index=True)
    view, point, rays = view[chosen][first], point[chosen][first], rays[chosen][first]
    world = np.einsum("oji,oj->oi", facts.poses[view, :, :3], rays)
    across = np.eye(3) - world[:, :, None] * world[:, None, :]
    n = len(facts.points)
    normal, right = np.zeros((n, 3, 3)), np.zeros((n, 3))
    np.add.at(normal, point, across)
    np.add.at(right, point, np.einsum("oij,oj->oi", across, centres_of(facts)[view]))
    counts = np.bincount(point, minlength=n)
    least = np.linalg.eigvalsh(normal)[:, 0]
    error = _BRIDGE.pixels / float(np.median(facts.focal)) / np.sqrt(np.maximum(least, 1e-12))
    good: BoolArray = (counts >= 2) & (error < _BRIDGE.depth_error)
    places = np.zeros((n, 3))
    places[good] = np.linalg.solve(normal[good], right[good][:, :, None])[:, :, 0]
    return places, good


def _moved(points: DoubleArray, source: DoubleArray, target: DoubleArray) -> DoubleArray:
    """``points`` under the similarity that takes most of ``source`` (K, 3) to ``target``."""
    rows: LongArray = np.arange(len(source))
    for _ in range(4):
        moved = fit_similarity(source[rows], target[rows])
        off = np.linalg.norm(source @ moved[:, :3].T + moved[:, 3] - target, axis=1)
        rows = np.argsort(off, kind="stable")[: max(3, int(_BRIDGE.kept * len(source)))]
    return points @ moved[:, :3].T + moved[:, 3]


_SHARED_POINTS = MeasureConfig().shared
_NAMED = 4  # photos named in a sentence


@dataclass(frozen=True)
class CheckConfig:
    """Bounds of the checks: beyond the first a warning, beyond the second an error."""

    registered: tuple[float, float] = (0.8, 0.5)  # share of photos placed
    reprojection: tuple[float, float] = (1.2, 2.5)  # pixels, mean over observations
    track: tuple[float, float] = (3.0, 2.3)  # views, mean over points
    points_per_view: tuple[float, float] = (100, 20)  # observations
    focal_apart: tuple[float, float] = (0.2, 0.5)  # from the prior, as a share of it
    focal_range: tuple[float, float] = (0.5, 0.3)  # least focal length / longest side ...
    focal_long: tuple[float, float] = (3.5, 8.0)  # ... and the greatest
    axes_apart: float = 0.02  # fx against fy, as a share
    parallax: tuple[float, float] = (3.0, 1.0)  # degrees, median over points
    behind: tuple[float, float] = (0.0, 0.01)  # share of observations behind their camera
    agreeing: tuple[float, float] = (0.92, 0.82)  # share of strong pairs that agree with the poses
    doubled: tuple[float, float] = (0.05, 0.12)  # share of matches between two separate points


_CHECK = CheckConfig()


@dataclass(frozen=True)
class Verdict:
    """One finding: what is odd and what to try."""

    check: str
    level: Literal["warning", "error"]
    text: str


def check_model(
    facts: SfmFacts,
    summary: SfmSummary,
    priors: Mapping[str, float] | None = None,  # focal lengths in pixels by photo, where known
) -> tuple[Verdict, ...]:
    """Everything odd about a model; errors first. An empty tuple: it looks right."""
    found = [
        *_check_registered(facts, summary),
        *_check_contradictions(summary),
        *_check_shape(summary),
        *_check_focal(facts, priors or {}),
    ]
    return tuple(sorted(found, key=lambda verdict: verdict.level != "error"))


def _check_registered(facts: SfmFacts, s: SfmSummary) -> list[Verdict]:
    left = [name for name in facts.all_names if name not in set(facts.names)]
    share = s.registered / max(s.photos, 1)
    found = []
    if left:
        named = ", ".join(left[:_NAMED]) + (" ..." if len(left) > _NAMED else "")
        text = f"{s.registered} of {s.photos} photos were placed; left out: {named}."
        others = [int(n) for n in facts.model_sizes[1:]]
        if share < _CHECK.registered[0] and others:
            text += f" {others[0]} of them make a scene of their own."
        level = "error" if share <= _CHECK.registered[1] else level_below(share, _CHECK.registered)
        if level is None and share < 1:
            level = "warning"
        cure = " Add photos between these and the others, with more than half in common."
        found += _verdict("registered", level, text + cure)
    bridge = weakest_bridge(facts)
    holds = bridge is not None and bridge.holds()
    is_all = holds and s.parts == 2 and bridge is not None and bridge.n_common < _SHARED_POINTS
    if bridge is not None and not holds:
        found += _verdict(
            "clusters",
            "error",
            f"The placed photos fall into 2 groups, one of {bridge.side.sum()}. The few points "
            "that both see do not determine how the groups are placed relative to each other. Add "
            "photos in between, or reconstruct each group alone.",
        )
    elif s.parts > 1 and not is_all:
        found += _verdict(
            "clusters",
            "error",
            f"The placed photos fall into {s.parts} groups that share too few points to hold each "
            "other. Add photos that see both, or reconstruct each group alone.",
        )
    return found


def _check_contradictions(s: SfmSummary) -> list[Verdict]:
    cure = (
        f"Try {option('--quality', 'full')}, leave out photos that look alike but show another "
        "place, or add "
        "photos in between."
    )
    agree = (
        f"{1 - s.agreeing:.0%} of the photo pairs contradict the model: parts of it are turned or "
        f"moved against each other. {cure}"
    )
    twice = (
        f"{s.doubled:.0%} of the matched details are in the model twice, at different places: "
        f"walls may be doubled. {cure}"
    )
    behind = f"{s.behind:.1%} of the points are behind the camera that sees them. {cure}"
    return [
        *_verdict("pairs", level_below(s.agreeing, _CHECK.agreeing), agree),
        *_verdict("doubled", _above(s.doubled, _CHECK.doubled), twice),
        *_verdict("behind", _above(s.behind, _CHECK.behind), behind),
    ]


def _check_shape(s: SfmSummary) -> list[Verdict]:
    per_view = s.points * s.track / max(s.registered, 1)
    return [
        *_verdict(
            "reprojection",
            _above(s.reprojection, _CHECK.reprojection),
            f"Points are {s.reprojection:.1f} pixels off in the photos on average. Are there "
            "photos of another lens or zoom, or moving objects? Leave them out, or give "
            f"{option('--focal')}.",
        ),
        *_verdict(
            "track",
            level_below(s.track, _CHECK.track),
            f"A point is seen in {s.track:.1f} photos on average. Take more photos, in smaller "
            "steps, so that each detail is in at least three.",
        ),
        *_verdict(
            "points",
            level_below(per_view, _CHECK.points_per_view),
            f"A photo holds {per_view:.0f} points on average. Sharper photos or "
            f"{option('--quality', 'full')} give more; bare walls and glass give none.",
        ),
        *_verdict(
            "collapse",
            level_below(s.parallax, _CHECK.parallax),
            f"The photos see a point under {s.parallax:.1f} degrees at most: the cameras are "
            "almost at one place for what they see. Walk around the scene; turning on the spot is "
            "not enough.",
        ),
    ]


def _check_focal(facts: SfmFacts, priors: Mapping[str, float]) -> list[Verdict]:
    if not len(facts.focal):
        return []
    found = []
    mean = facts.focal.mean(axis=1)
    ratio = mean / facts.sizes.max(axis=1)
    worst = float(ratio[np.abs(np.log(ratio)).argmax()])
    level = level_below(worst, _CHECK.focal_range) or _above(worst, _CHECK.focal_long)
    found += _verdict(
        "focal",
        level,
        f"The focal length was estimated as {worst:.2f} x the photo's longer side, which few "
        f"lenses have. Give the true one in pixels with {option('--focal')}, or take photos with "
        "EXIF data.",
    )
    apart = float(np.abs(np.log(facts.focal[:, 0] / facts.focal[:, 1])).max())
    if apart > _CHECK.axes_apart:
        found += _verdict(
            "axes",
            "warning",
            f"The focal lengths across and down differ by {apart:.0%}, which no camera does. "
            f"Check the result; {option('--focal')} or photos from more heights help.",
        )
    known = [(mean[i], priors[n]) for i, n in enumerate(facts.names) if n in priors]
    if known:
        values = np.array(known)
        off = float(np.abs(values[:, 0] / values[:, 1] - 1).max())
        found += _verdict(
            "prior",
            _above(off, _CHECK.focal_apart),
            f"The focal length was estimated {off:.0%} away from what EXIF or --focal says. Check "
            f"{option('--focal')}, or leave out photos that were cropped or zoomed.",
        )
    return found


def _verdict(check: str, level: Literal["warning", "error"] | None, text: str) -> list[Verdict]:
    return [] if level is None else [Verdict(check, level, text)]


def level_below(value: float, bounds: tuple[float, float]) -> Literal["warning", "error"] | None:
    """Severity of ``value`` by the bounds of a warning and of an error; None = fine."""
    if value < bounds[1]:
        return "error"
    return "warning" if value < bounds[0] else None


def _above(value: float, bounds: tuple[float, float]) -> Literal["warning", "error"] | None:
    return level_below(-value, (-bounds[0], -bounds[1]))


# --- Do given poses fit the photos? Asked before anything is trained on them.
# Poses of another scene, of other photos or in another convention give splats of fog, and nothing
# in the training says why. Here some of the photos are matched as if nothing were known, and the
# matches are held against the given poses, as those of a placement made here are.


STAGE = "Check poses"
_MATCH_SIDE = 1000  # pixels: photos are matched at this size


@dataclass(frozen=True)
class PoseCheckConfig:
    """Number of photos to check."""

    runs: int = 8  # places in the list of photos ...
    length: int = 3  # ... and photos next to each other that are taken at each
    fewest_pairs: int = 5  # strong pairs from which a verdict is given


_POSES = PoseCheckConfig()


def check_poses_stage(
    cameras: Sequence[Camera],
    photos: Mapping[str, Path],  # of each camera's name
    workspace: Path,  # a folder of the check's own; removed at the end
    *,
    threads: int = 0,
) -> Stage[tuple[Verdict, ...]]:
    """What the photos say of the poses; nothing when they fit, or too few pairs match to judge."""
    chosen = [camera for camera in sampled(cameras) if camera.name in photos]
    if not chosen:
        return ()
    refuse_links(workspace)
    shutil.rmtree(workspace, ignore_errors=True)
    try:
        facts = yield from mapped(
            _facts(chosen, photos, workspace, threads), lambda step: replace(step, stage=STAGE)
        )
    finally:
        shutil.rmtree(workspace, ignore_errors=True)
    return () if facts is None else judge_poses(facts)


def sampled(cameras: Sequence[Camera]) -> list[Camera]:
    """Some cameras, in short runs by name, as neighbours by name mostly overlap."""
    order = sorted(cameras, key=lambda camera: camera.name)
    starts = np.linspace(0, max(len(order) - _POSES.length, 0), _POSES.runs).astype(int)
    indices = sorted({int(s) + k for s in starts for k in range(_POSES.length)})
    return [order[i] for i in indices if i < len(order)]


def judge_poses(facts: SfmFacts) -> tuple[Verdict, ...]:
    """The verdict on the poses in ``facts``."""
    share, n_pairs = pair_agreement(facts)
    level = level_below(share, _CHECK.agreeing)
    if n_pairs < _POSES.fewest_pairs or level is None:
        return ()
    text = (
        f"{1 - share:.0%} of the photo pairs contradict the given poses: the poses belong to other "
        "photos, or are in another convention. Check sparse/0, or remove it, and the photos are "
        "placed here."
    )
    return (Verdict("pairs", level, text),)


_MATCHED = PAIRS | {  # what `placing.worker` writes of pairs
    "names": replace(TEXT, shape=("A",)),
    "match_names": Column(np.int64, ("M", 2), low=0, below="A"),
    "match_places": Column(np.float64, ("M", 2, 2)),
}


def _facts(
    cameras: Sequence[Camera], photos: Mapping[str, Path], workspace: Path, threads: int
) -> Stage[SfmFacts | None]:
    """Matches of the photos with the given poses; None when they cannot be matched."""
    sources = [photos[camera.name] for camera in cameras]
    try:
        found = yield from prepare_photos(
            sources, workspace / "photos", root=_root(sources), longest_side=_MATCH_SIDE
        )
    except GagaError:  # too few, or copies: the training says so itself
        return None
    sfm = replace(SfmConfig.of("draft", threads=threads), pairs="exhaustive")
    yield from run_matching(found, workspace, sfm)
    yield from run_step("export", found, workspace, sfm)
    by_source = {str(photos[camera.name]): camera for camera in cameras}
    posed = {photo.name: by_source[photo.source] for photo in found.photos}
    arrays = read_columns(workspace / "pair_matches.npz", AGAIN, _MATCHED)
    views = [posed[name] for name in arrays["names"].tolist()]
    match_views, none = arrays["match_names"], np.zeros(0, np.int64)
    sizes = np.array([(view.width, view.height) for view in views], np.int64)
    inverse = np.array([np.linalg.inv(view.K) for view in views])
    pixels = arrays["match_places"] * sizes[match_views]
    pixels = np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], axis=-1)
    rays = np.einsum("mkij,mkj->mki", inverse[match_views], pixels)
    names = tuple(view.name for view in views)
    return SfmFacts(  # without points: poses and matches are all that is compared
        names=names,
        poses=np.array([view.cam_from_world[:3] for view in views], np.float64),
        focal=np.array([(view.K[0, 0], view.K[1, 1]) for view in views], np.float64),
        sizes=sizes,
        points=np.zeros((0, 3)),
        track_lengths=none,
        seen_points=none,
        seen_views=none,
        seen_errors=np.zeros(0),
        match_views=match_views,
        match_points=np.full(match_views.shape, -1, np.int64),
        match_rays=rays / np.linalg.norm(rays, axis=2, keepdims=True),
        all_names=names,
        pairs=arrays["pairs"],
        pair_matches=arrays["pair_matches"],
        model_sizes=np.array([len(views)], np.int64),
    )


def _root(paths: Sequence[Path]) -> Path:
    """The folder that all of ``paths`` lie in."""
    parents = [set(path.parents) for path in paths]
    return max(set.intersection(*parents), key=lambda folder: len(folder.parts))
