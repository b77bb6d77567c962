"""Do given poses fit the photos? Asked before anything is trained on them.

Poses of another scene, of other photos or in another convention give splats of fog, and nothing in
the training says why. Here some of the photos are matched as if nothing were known, and the matches
are held against the given poses, as those of a placement made here are.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import read_arrays
from gaga_core.placing.checks import CheckConfig, Verdict, level_below
from gaga_core.placing.metrics import AGAIN, MeasureConfig, SfmFacts, pair_agreement
from gaga_core.placing.photos import prepare_photos
from gaga_core.placing.sfm import SfmConfig, run_matching, run_step
from gaga_core.progress import Stage, mapped

STAGE = "Check poses"
_MATCH_SIDE = 1000  # pixels: photos are matched at this size


@dataclass(frozen=True)
class PoseCheckConfig:
    """Number of photos to check."""

    runs: int = 8  # places in the list of photos ...
    length: int = 3  # ... and photos next to each other that are taken at each
    fewest_pairs: int = 5  # strong pairs from which a verdict is given


def check_poses_stage(
    cameras: Sequence[Camera],
    photos: Mapping[str, Path],  # of each camera's name
    workspace: Path,  # a folder of the check's own; removed at the end
    *,
    threads: int = 0,
    config: PoseCheckConfig | None = None,
) -> Stage[tuple[Verdict, ...]]:
    """What the photos say of the poses; nothing when they fit, or too few pairs match to judge."""
    config = config or PoseCheckConfig()
    chosen = [camera for camera in sampled(cameras, config) if camera.name in photos]
    shutil.rmtree(workspace, ignore_errors=True)
    try:
        facts = yield from mapped(
            _facts(chosen, photos, workspace, threads), lambda step: replace(step, stage=STAGE)
        )
    finally:
        shutil.rmtree(workspace, ignore_errors=True)
    return () if facts is None else judge_poses(facts, config)


def sampled(cameras: Sequence[Camera], config: PoseCheckConfig) -> list[Camera]:
    """Some cameras, in short runs by name, as neighbours by name mostly overlap."""
    order = sorted(cameras, key=lambda camera: camera.name)
    starts = np.linspace(0, max(len(order) - config.length, 0), config.runs).astype(int)
    indices = sorted({int(s) + k for s in starts for k in range(config.length)})
    return [order[i] for i in indices if i < len(order)]


def judge_poses(facts: SfmFacts, config: PoseCheckConfig) -> tuple[Verdict, ...]:
    """The verdict on the poses in ``facts``."""
    share, n_pairs = pair_agreement(facts, MeasureConfig())
    level = level_below(share, CheckConfig().agreeing)
    if n_pairs < config.fewest_pairs or level is None:
        return ()
    text = (
        f"{1 - share:.0%} of the photo pairs contradict the given poses: the poses belong to other "
        "photos, or are in another convention. Check sparse/0, or remove it, and the photos are "
        "placed here."
    )
    return (Verdict("pairs", level, text),)


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
    arrays = read_arrays(workspace / "pair_matches.npz", AGAIN)
    views = [posed[str(name)] for name in arrays["names"]]
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
