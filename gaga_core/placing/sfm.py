"""Structure from motion over prepared photos, each step in a process that can be ended."""

import json
import os
import re
import sqlite3
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec

from gaga_core.errors import GagaError, option
from gaga_core.io.cameras.colmap import require_pycolmap
from gaga_core.io.folder.processes import follow
from gaga_core.io.json_file import decode_json
from gaga_core.placing.photos import Photo, PhotoSet
from gaga_core.progress import Progress, Stage
from gaga_core.threads import n_threads

TITLES = {
    "features": "Find features",
    "match": "Match photos",
    "verify": "Match photos",
    "map": "Place photos",
    "map_relaxed": "Place photos",
    "given": "Place photos",
    "to_given": "Place photos",
    "likely_pairs": "Match photos",
    "learned": "Match photos",
    "export": "Match photos",
    "export_features": "Match photos",
    "undistort": "Undistort photos",
}
_BLOCK = re.compile(r"Processing (?:block|image) \[(\d+)/(\d+)(?:, (\d+)/(\d+))?\]")
UPRIGHT = "upright.json"  # in a workspace: the turn of its model to a world whose z is up
NO_MODEL = "no model"  # the worker's word for a mapping that found no pair to start from
MATCH_SIDE = 640  # pixels: learned models look at photos at this size, as published
FEW_PHOTOS = 12  # of one camera: a simple lens model holds where a rich one would run away


@dataclass(frozen=True)
class SfmConfig:
    """Settings of structure from motion; COLMAP's own defaults otherwise."""

    feature_side: int = 1600  # pixels: photos are shrunk to this to look for features
    n_features: int = 4096  # at most, in a photo
    doubled: bool = True  # look at twice that size too: more and finer features, 4 x the time;
    # small photos always, see `doubles`
    affine: bool = False  # affine shape and domain-size pooling: wider baselines, 5 x the time
    least_contrast: float = 0.02 / 3  # of a feature, brightness 0..1: lower finds fainter ones
    guided: bool = False  # match again along the epipolar lines that the first matches give
    moving_only: bool = False  # drop matches that stand still in the picture: a turntable
    camera_model: Literal["auto", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PINHOLE"] = "auto"
    # listed: those in the workspace's pairs.txt
    pairs: Literal["auto", "exhaustive", "sequential", "similar", "listed"] = "auto"
    exhaustive_up_to: int = 120  # photos: beyond, those that look alike are matched
    neighbours: int = 24  # photos that each is matched with, when they look alike
    overlap: int = 10  # frames before and after that each frame of a video is matched with
    threads: int = 0  # 0 = as many as the kernels use; the mapping has one whatever is set
    seed: int = 0

    def __post_init__(self) -> None:
        if self.feature_side < 64 or self.n_features < 64:
            raise ValueError("feature_side and n_features: at least 64")
        if min(self.exhaustive_up_to, self.neighbours, self.overlap) < 1:
            raise ValueError("exhaustive_up_to, neighbours, overlap: at least 1")
        if not 0 < self.least_contrast < 1:
            raise ValueError("least_contrast: must be between 0 and 1")

    def doubles(self, group: "CameraGroup") -> bool:
        """Whether features are looked for in the photos of ``group`` at twice their size, too:
        where that is nearer to `feature_side` than the photos as they are."""
        return self.doubled or 2 * max(group.width, group.height) ** 2 < self.feature_side**2

    @staticmethod
    def of(quality: str, *, threads: int = 0, seed: int = 0) -> "SfmConfig":
        """The settings called ``quality``: draft, standard or full."""
        if quality == "draft":
            return SfmConfig(
                feature_side=1000, n_features=2048, doubled=False, threads=threads, seed=seed
            )
        if quality == "standard":
            return SfmConfig(threads=threads, seed=seed)
        if quality == "full":
            return SfmConfig(feature_side=3200, n_features=8192, threads=threads, seed=seed)
        raise ValueError(f"quality: {quality!r} is none of draft, standard, full")


@dataclass(frozen=True)
class CameraGroup:
    """Photos of one camera: same size, same focal length."""

    names: tuple[str, ...]
    width: int  # pixels
    height: int
    focal: float | None  # pixels, from EXIF or the user
    model: str  # COLMAP's name of the lens model
    params: tuple[float, ...] = ()  # COLMAP's, where the whole lens is known
    view: int | None = None  # of panoramas: these cameras are mounted together


@dataclass(frozen=True)
class StepSettings:
    """Settings of the worker."""

    step: str  # one of `worker.STEPS`
    workspace: str
    pictures: str  # folder of the prepared photos
    groups: tuple[CameraGroup, ...]
    picture_side: int  # longest side of undistorted pictures
    config: SfmConfig  # nothing is "auto" but the lens model, which the groups say


def run_matching(
    photos: PhotoSet,
    workspace: Path,
    config: SfmConfig,
    *,
    groups: Sequence[CameraGroup] = (),  # the cameras, where they are known
) -> Stage[None]:
    """Find features and match them: writes workspace/database.db and matches.npz."""
    yield from run_step("features", photos, workspace, config, groups=groups)
    yield from run_step("match", photos, workspace, config, groups=groups)


def run_step(
    step: str,
    photos: PhotoSet,
    workspace: Path,
    config: SfmConfig,
    *,
    picture_side: int = 1600,
    groups: Sequence[CameraGroup] = (),
) -> Stage[None]:
    """One step of `sfm_worker`; ``picture_side`` is the longest side of undistorted pictures."""
    finished = workspace / f"{step}.finished"
    if finished.is_file():
        return
    require_pycolmap()
    config = _decided(photos, config)
    if step in ("map", "map_relaxed", "given"):
        # On several, COLMAP 4 starts from the pair of photos that a thread finds first, and adds
        # up large adjustments in any order: the same photos gave other poses from run to run.
        config = replace(config, threads=1)
    settings = StepSettings(
        step,
        str(workspace),
        str(pictures_of(workspace)),
        tuple(groups) or tuple(_group(group, config) for group in photos.cameras()),
        picture_side,
        config,
    )
    file = workspace / f"{step}.json"
    file.write_text(json.dumps(asdict(settings)), encoding="utf-8")
    command = [sys.executable, "-m", "gaga_core.placing.worker", str(file)]
    environment = os.environ | {"OMP_NUM_THREADS": str(config.threads)}
    listener = _Listener(step, len(photos.photos))
    lines = follow(command, environment)
    try:
        while True:
            listener.hear(next(lines))
            yield listener.progress
    except StopIteration as end:
        status = int(end.value)
    finally:
        lines.close()
    if listener.failed or status != 0:
        why = listener.failed or listener.problem or f"status {status}"
        raise GagaError(_explain(step, why))
    finished.touch()


def pictures_of(workspace: Path) -> Path:
    """The prepared photos: in the workspace, or in that of which this is one attempt."""
    own = workspace / "photos"
    return own if own.is_dir() else workspace.parent / "photos"


class WorkerLine(msgspec.Struct, frozen=True):
    """A line of the worker: how far it is, or why it failed."""

    done: int = 0
    total: int = 0
    message: str = ""
    failed: str = ""


class _Listener:
    """Makes progress of what the worker and COLMAP's log say.

    The database is not looked at while COLMAP writes it: a reader may lock it for a moment, and
    then COLMAP aborts.
    """

    def __init__(self, step: str, n_photos: int) -> None:
        self.progress = Progress(TITLES[step], 0, 0)
        self.failed = ""  # the worker's own word
        self.problem = ""  # COLMAP's
        self._n_photos = n_photos
        self._photos_done = 0

    def hear(self, line: str) -> None:
        """Take in one line."""
        if line.startswith("{"):
            self._hear_worker(line)
        elif "Processed file [" in line:
            self._photos_done += 1
            self._set(self._photos_done, self._n_photos, "photos")
        elif block := _BLOCK.search(line):
            i, n, j, m = (int(part or 1) for part in block.groups())
            self._set((i - 1) * m + j - 1, n * m, "groups of pairs")
        elif "what():" in line or line.startswith(("E2", "F2")):
            self.problem = line.split("]")[-1].split("what():")[-1].strip()[:150]

    def _hear_worker(self, line: str) -> None:
        try:
            said = decode_json(line.encode(), WorkerLine, "The worker's line", "")
        except GagaError:  # mixed with a line of the log
            return
        if said.failed:
            self.failed = said.failed
        else:
            self._set(said.done, said.total, said.message)

    def _set(self, done: int, total: int, what: str) -> None:
        self.progress = Progress(self.progress.stage, min(done, total), total, what)


def _decided(photos: PhotoSet, config: SfmConfig) -> SfmConfig:
    """``config`` without "auto" among its pairs and threads."""
    pairs = config.pairs
    if pairs == "auto" and photos.ordered:
        pairs = "sequential"
    elif pairs == "auto":
        pairs = "exhaustive" if len(photos.photos) <= config.exhaustive_up_to else "similar"
    return replace(config, pairs=pairs, threads=config.threads or n_threads())


def _group(photos: Sequence[Photo], config: SfmConfig) -> CameraGroup:
    model: str = config.camera_model
    first = photos[0]
    names = tuple(photo.name for photo in photos)
    if first.view is not None:
        width, height = first.width, first.height
        lens = (width / 2, width / 2, height / 2)  # as they were cut
        return CameraGroup(names, width, height, lens[0], "SIMPLE_PINHOLE", lens, first.view)
    if model == "auto":  # without a focal length simple at first: see `worker._widened`
        is_known = len(photos) >= FEW_PHOTOS and first.focal is not None
        model = "OPENCV" if is_known else "SIMPLE_RADIAL"
    return CameraGroup(names, first.width, first.height, first.focal, model)


def _explain(step: str, why: str) -> str:
    if step.startswith("map") and why == NO_MODEL:
        return (
            "The photos overlap, but no two of them show enough from two places to start from. "
            "Take photos from more places, a step apart, of textured surfaces; or try "
            f"{option('--quality', 'full')}."
        )
    return (
        f"{TITLES[step]} failed ({why}). Try again with fewer or smaller photos; what was "
        "finished is kept."
    )


def require_overlap(workspace: Path, n_photos: int) -> None:
    """``GagaError`` when no pair of photos has verified matches."""
    pairs = verified_pairs(workspace / "database.db")
    if not pairs:
        raise GagaError(
            f"No two of the {n_photos} photos show the same place. Take photos that overlap by "
            "more than half, in a walk around the scene."
        )


def verified_pairs(database: Path) -> Sequence[int]:
    """Number of verified matches of each pair of photos that has any."""
    query = "SELECT rows FROM two_view_geometries WHERE rows > 0"
    connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True)
    try:
        return [int(row[0]) for row in connection.execute(query)]
    finally:
        connection.close()
