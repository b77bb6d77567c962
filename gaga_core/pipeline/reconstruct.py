"""From photos to a scene folder with splats: every step that is not there yet.

Photos are examined, placed by structure from motion, checked, undistorted, and splats are trained
on them. What is finished of a run that was stopped lies in SCENE/.gaga-reconstruct and is taken up
the next time; when the scene is complete, that folder is gone.
"""

import itertools
import json
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from gaga_core import kernels
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras.cameras_json import write_cameras_json
from gaga_core.io.cameras.colmap import read_colmap
from gaga_core.io.cameras.poses import find_poses
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.folder.lock import forget_owner, note_owner, working_in
from gaga_core.io.folder.scene_folder import (
    WORLD,
    SceneFolder,
    find_model,
    find_sparse,
    is_scene_folder,
    open_scene_folder,
    place_aside,
)
from gaga_core.io.images import IMAGE_SUFFIXES, image_header
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.splats.packing import without_broken_rows
from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline.place import (
    WORKSPACE,
    find_photos,
    place_photos,
    read_entry,
    refuse,
    write_entry,
)
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.placing.checks import check_poses_stage
from gaga_core.placing.photos import (
    UNREAD_SUFFIXES,
    VIEWS,
    is_panorama,
    is_video,
    list_photos,
    unread_kinds,
)
from gaga_core.placing.recordings import is_recording, look_at_recording
from gaga_core.placing.undistort import ORIGINALS
from gaga_core.placing.video import expected_frames
from gaga_core.progress import TELLING, Pace, Progress, Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.orientation import estimate_up, saying_up
from gaga_core.scene.project import PROJECT_FILE, meant_in
from gaga_core.threads import n_threads
from gaga_core.training.checkpoint import iteration_of
from gaga_core.training.settings import STEREO_SIDE, STEREO_VIEWS

_RANDOM_POINTS = 100_000  # of cameras that come without points, as published
_OF_PHOTOS = ("report.json", WORLD, "cache")  # in gaga/; the cache is of their masks
SETTINGS, CHECKPOINT = "settings.json", "train.npz"  # of a training, in the workspace


@dataclass(frozen=True)
class Reconstruction:
    """Result of a reconstruction."""

    scene: Path
    stages_run: tuple[str, ...]  # of sfm, train
    notes: tuple[str, ...]  # what a person should know: photos left out, warnings of the checks
    report: dict[str, object]  # the entry "reconstruct" of report.json


def reconstruct_scene(
    photos: Path | None,
    scene: Path,
    config: ReconstructConfig | None = None,
    *,
    rasterizer: Rasterizer | None = None,
    again: bool = False,
) -> Stage[Reconstruction]:
    """Make a scene folder of ``photos``: a folder, a video, or None for what lies in ``scene``.

    Writes images/, sparse/0/, cameras.json, point_cloud.ply and the entry "reconstruct" of
    gaga/report.json. Whatever is there already is not made again, splats only where ``again`` asks
    for it: a training that was stopped, and whose splats were kept, goes on. Raises ``GagaError``
    when the photos do not do, when ``scene`` was made of others, or when the checks find the model
    wrong.
    """
    config = config or ReconstructConfig()
    scene = Path(scene)
    if photos is not None:
        require_its_photos(Path(photos), scene)
    is_team = int(os.environ.get("WORLD_SIZE", "1")) > 1
    if not is_team and (other := working_in(scene / WORKSPACE)):
        raise GagaError(f"{other} is making {scene} now. Wait for it, or end it.")
    done: list[str] = []
    notes: tuple[str, ...] = ()
    if find_sparse(scene) is None and find_model(scene) is None:
        if is_team:
            raise GagaError("Place the photos first, without torchrun: gaga reconstruct --only sfm")
        notes = yield from place_photos(photos, scene, config)
        done.append("sfm")
    if config.only == "all" and (again or find_model(scene) is None):
        notes = (*notes, *(yield from _given_poses(scene, config)))
        with replacing_splats(scene):
            yield from train_scene(open_scene_folder(scene), config, rasterizer=rasterizer)
        done.append("train")
    workspace = scene / WORKSPACE
    is_training = (workspace / CHECKPOINT).is_file() or (workspace / SETTINGS).is_file()
    if find_sparse(scene) is not None and (workspace / "task").is_file() and not is_training:
        shutil.rmtree(workspace, ignore_errors=True)  # killed after the photos were placed
    if config.only == "all" and find_model(scene) is not None and stopped_training(scene) is None:
        shutil.rmtree(scene / WORKSPACE, ignore_errors=True)  # killed between the last two steps
    return Reconstruction(scene, tuple(done), notes, read_entry(scene))


def go_on_stage(scene: Path, *, rasterizer: Rasterizer | None = None) -> Stage[Reconstruction]:
    """Go on with the training of ``scene`` that was stopped, with its settings: to the splats that
    it would have made without the stop.

    Raises ``GagaError`` when none was.
    """
    found = stopped_training(scene)
    if found is None or found.going_on is None:
        raise GagaError(f"No training of {scene} was stopped, so there is nothing to go on with.")
    config = replace(found.going_on, only="all")
    return (yield from reconstruct_scene(None, scene, config, rasterizer=rasterizer, again=True))


@contextmanager
def replacing_splats(scene: Path) -> Iterator[None]:
    """Write splats of ``scene`` inside: what was found in former ones goes aside once they are
    written, with the splats that a saved project needs. Nothing moves where there were none."""
    has_splats = find_model(scene) is not None
    _keep_former(scene)
    yield
    if has_splats:
        set_groups_aside(scene)


def _keep_former(scene: Path) -> None:
    """Link the splats of ``scene`` next to the project that was saved of them, if there is one: it
    opens with them after others have taken their name, see `set_groups_aside`."""
    model, work = find_model(scene), scene / "gaga"
    if model is None or not (work / PROJECT_FILE).is_file():
        return
    kept = work / model.name
    kept.unlink(missing_ok=True)
    try:
        kept.hardlink_to(model)  # new splats take the name, not the file
    except OSError:  # a file system without links
        shutil.copy2(model, kept)


def set_groups_aside(scene: Path) -> None:
    """Move what was found in former splats of ``scene`` from gaga/ to the next free `place_aside`:
    it does not fit others. What is known of the photos and their poses stays."""
    kept = place_aside(scene)
    found = [path for path in (scene / "gaga").glob("*") if path.name not in _OF_PHOTOS]
    if found:
        kept.mkdir()
    for path in found:
        path.rename(kept / path.name)


def _given_poses(scene: Path, config: ReconstructConfig) -> Stage[tuple[str, ...]]:
    """Check poses that were not made here, once; returns warnings.

    Raises `WrongModelError` when the photos contradict them.
    """
    entry = read_entry(scene)
    is_known = "sfm" in entry or "poses" in entry
    if is_known or find_sparse(scene) is None or int(os.environ.get("WORLD_SIZE", "1")) > 1:
        return ()
    folder = open_scene_folder(scene)
    workspace = scene / WORKSPACE / "poses"
    verdicts = yield from check_poses_stage(
        folder.cameras, folder.image_paths, workspace, threads=config.threads
    )
    refuse(verdicts, "The poses of these photos are not to be trusted.", config)
    write_entry(scene, {"poses": {"checks": [asdict(verdict) for verdict in verdicts]}})
    return tuple(verdict.text for verdict in verdicts)


def train_scene(
    folder: SceneFolder,
    config: ReconstructConfig,
    *,
    rasterizer: Rasterizer | None = None,
    out: Path | None = None,
) -> Stage[Gaussians]:
    """Train splats on the training photos of ``folder`` and write them, with cameras.json and the
    report, to ``out`` (default: the scene folder itself).

    Views of neither part of the split are left out. Started by torchrun, all workers train together
    and the first one writes. For a folder without a COLMAP model ``out`` has to be named: its
    cameras come from elsewhere, and the training begins with random points.
    """
    # Loaded when there is something to train: the kernels take a good part of the launch time.
    from gaga_core.training.distributed import joined_team
    from gaga_core.training.start import first_splats_stage, random_points, with_sure_depth
    from gaga_core.training.train import Cost, report_of, train_stage
    from gaga_core.training.views import load_views_stage

    sparse = find_sparse(folder.root)
    if (sparse is None and out is None) or not folder.cameras:
        raise GagaError(f"There is no COLMAP model in {folder.root}. Place the photos first.")
    root, test = out or folder.root, folder.test if config.hold_out else ()
    wanted = {*folder.train, *folder.test}
    cameras = tuple(camera for camera in folder.cameras if camera.name in wanted)
    folder.require_image((cameras or folder.cameras)[0].name)
    start, cpu_start, settings = time.perf_counter(), time.process_time(), config.train()
    if sparse is not None:
        model = read_colmap(sparse)
        points, colors = model.points, model.point_colors
    else:
        points = random_points(cameras, _RANDOM_POINTS, config.seed)
        colors = np.full((len(points), 3), 128, np.uint8)
    engine = rasterizer or choose()
    views = yield from load_views_stage(
        cameras, folder.image_paths, test, settings.longest_side, folder.foreground, folder.depth
    )
    views = with_sure_depth(views, points)
    initial = yield from first_splats_stage(points, colors, views.train, settings, engine)
    workspace = root / WORKSPACE
    with _tidied(workspace), joined_team() as team:
        with atomic_write(workspace / SETTINGS) as temporary:
            temporary.write_text(json.dumps(asdict(config)), encoding="utf-8")
        note_owner(workspace)
        trained = yield from train_stage(
            initial, views, settings, engine, checkpoint=workspace / CHECKPOINT, team=team
        )
        if team.rank == 0:
            yield Progress("Write splats", 0, 1)
            file = root / "point_cloud.ply"
            up = folder.up or estimate_up(folder.cameras)
            whole = without_broken_rows(file, trained.gaussians)
            trained = replace(trained, gaussians=saying_up(whole, up))
            cost = Cost(time.perf_counter() - start, time.process_time() - cpu_start)
            write_cameras_json(root / "cameras.json", folder.cameras)
            write_entry(root, {"train": report_of(trained, settings, cost)})
            write_ply(file, trained.gaussians)
            shutil.rmtree(workspace, ignore_errors=True)
    return trained.gaussians


@contextmanager
def _tidied(workspace: Path) -> Iterator[None]:
    """Remove the workspace after a failure, unless there is something to take up in it.

    A disk that cannot be written becomes a ``GagaError``.
    """
    try:
        yield
    except OSError as error:
        raise GagaError(explain_os_error(error, workspace.parent)) from error
    finally:
        forget_owner(workspace)
        if workspace.is_dir() and {path.name for path in workspace.iterdir()} <= {SETTINGS}:
            shutil.rmtree(workspace, ignore_errors=True)


# --- Photos without splats: what a path holds, which run to continue, and how long it takes.


# The steps that take long, in their order; kernels where they are not compiled yet.
KERNELS, FEATURES, MATCHES, PLACES, BACKGROUND, UNDISTORTS, SURFACES, TRAINS = STEPS = (
    kernels.STAGE,
    "Find features",
    "Match photos",
    "Place photos",
    "Look for the background",
    "Undistort photos",
    "Match surfaces",
    "Train splats",
)
# Photos of a room, measured on two cores: seconds of one core, a photo, a pair, or a pixel whose
# surface is matched. The training itself is counted in such seconds already.
_RATES = {
    FEATURES: 0.2, MATCHES: 0.012, PLACES: 0.15, BACKGROUND: 0.2, UNDISTORTS: 0.15,
    SURFACES: 1.3e-5, TRAINS: 1.0,
}  # fmt: skip
_LEARNED = 0.5  # weight of the newest run in a rate that is kept
_MOST_OFF = 20.0  # factor: a rate that is off by more was measured while something else was wrong
# Of what a run is off where earlier ones are known, in logarithms: what later steps share with it,
# a slower machine; the rest is of these photos. On fox, demo and sceaux the time left is off by 1.5
# times at most; at 0.3 by 1.7, at 1 by 3.
_SHARED = 0.1
_AFTERWARDS = 0.01  # of a training: the last measurement, and the files
_TIMES = {"draft": 1.0, "standard": 4.0, "full": 12.0}  # more and finer features
_VIDEO_SIZE = (1920, 1080)  # pixels: a guess, the header is not read for it


Rates = Mapping[str, float]  # by step: how many times as long as expected it took on this machine


@dataclass(frozen=True)
class PhotoFind:
    """Photos, or a video, that no splats were made of yet."""

    photos: Path | None  # where they lie; None: in the scene folder
    scene: Path  # the scene folder that is to be made, or completed
    n_photos: int  # of a video: frames that will be taken
    size: tuple[int, int]  # width, height of the first, or of its views, pixels
    is_video: bool = False
    is_placed: bool = False  # there is a COLMAP model: only the training is missing
    going_on: ReconstructConfig | None = None  # settings of a training that was stopped
    iteration: int = 0  # ... and how far it came
    poses: str = ""  # whose poses lie next to the photos, or why they cannot be used
    n_views: int = 1  # of each photo: of 360 degrees they are cut

    @property
    def name(self) -> str:
        """Its name."""
        return self.scene.name if self.photos is None else _told_name(self.photos)

    def seconds(
        self,
        config: ReconstructConfig,
        rates: Rates | None = None,
        kernels_s: float = 0.0,
        slowdown: float = 1.0,
    ) -> float:
        """Time that making splats takes here, on the processor; see `expected`."""
        return sum(self.expected(config, rates or {}, kernels_s, slowdown).values())

    def expected(
        self,
        config: ReconstructConfig,
        rates: Rates,
        kernels_s: float = 0.0,
        slowdown: float = 1.0,
    ) -> dict[str, float]:
        """Seconds of each of `STEPS` that is to be done.

        ``rates``: what they took here before; ``kernels_s``: seconds that kernels usually still
        take to compile; ``slowdown``: times as long as on a free machine.
        """
        work = {KERNELS: kernels_s} if kernels_s else {}
        rate = {step: slowdown * rates.get(step, 1.0) for step in STEPS}
        return {step: n * rate[step] for step, n in {**work, **self._work(config)}.items()}

    def _work(self, config: ReconstructConfig) -> dict[str, float]:
        """Seconds that each step would take on a machine like the one that was measured."""
        n = self.n_photos * self.n_views
        n_seen = min(n, STEREO_VIEWS)
        surfaces = _RATES[SURFACES] * n_seen * self._pixels_within(STEREO_SIDE)
        work = {SURFACES: surfaces, TRAINS: max(self._training(config), 1.0)}
        if not self.is_placed:
            sfm = config.sfm()
            neighbours = sfm.overlap * 2 * self.n_views if self.is_video else sfm.neighbours
            pairs = n * (n - 1) / 2
            if self.is_video or n > sfm.exhaustive_up_to:
                pairs = min(pairs, n * neighbours)
            times = _TIMES[config.quality]
            counts = {FEATURES: n * times, MATCHES: pairs * times, PLACES: n * times}
            counts |= {BACKGROUND: n, UNDISTORTS: n}
            work = {**{step: _RATES[step] * count for step, count in counts.items()}, **work}
        return {step: seconds / n_threads() for step, seconds in work.items()}

    def _training(self, config: ReconstructConfig) -> float:
        settings, n_pixels = config.train(), self.n_pixels(config)
        before = settings.spent(n_pixels, self.behind(config))
        return (1 - before) * settings.cpu_seconds(n_pixels)

    def behind(self, config: ReconstructConfig) -> float:
        """Share 0..1 of the training's iterations that are done; other settings begin again."""
        return self.iteration / config.train().iterations if config == self.going_on else 0.0

    def n_pixels(self, config: ReconstructConfig) -> int:
        """Pixels of a photo in the training."""
        return self._pixels_within(config.train().longest_side)

    def _pixels_within(self, longest_side: int) -> int:
        """Pixels of a photo of which no side is longer."""
        width, height = self.size
        times = min(1.0, longest_side / max(width, height))
        return round(width * height * times**2)


class Estimate:
    """How far a reconstruction is, and how long it still takes: one estimate for all its steps.

    Each step is expected to take what it took here before, for this number of photos, pairs, and
    pixels; the longer it runs the more counts how long it takes now, see `Pace`: a machine that
    gets busy makes all slower that is left. What is to come is expected to be off by as much
    as what was done, by a part of it where earlier runs are known. The share goes on as long as
    anything does, slower where more is left than was thought; of a training that goes on it is that
    of all its iterations, as where it stopped.
    """

    def __init__(
        self,
        found: PhotoFind,
        config: ReconstructConfig,
        rates: Rates,
        clock: Callable[[], float] = time.monotonic,
        kernels_s: float = 0.0,
        slowdown: float = 1.0,
    ) -> None:
        self._expected = found.expected(config, rates, kernels_s, slowdown)
        self._known, self._clock = dict(rates), clock
        settings, n_pixels = config.train(), found.n_pixels(config)
        self._spent = partial(settings.spent, n_pixels)
        self._at = -1.0  # when the newest word came
        self._began: dict[str, tuple[float, float]] = {}  # seconds and share at its first word
        self._took: dict[str, float] = {}  # seconds
        self._now, self._part = "", 0.0  # the step that runs, and how far it is
        self._pace = Pace()
        self._share = self._behind = found.behind(config)

    def follow(self, step: Progress) -> tuple[float, float]:
        """Take the newest word of a step; returns the share 0..1 of all, and seconds left."""
        at = self._clock()
        passed = at - self._at if self._at >= 0 else 0.0
        self._at = at
        share = min(step.done / step.total, 1.0) if step.total > 0 else 0.0
        done = share if step.stage == TRAINS else 0.0
        if step.stage in self._expected:
            if step.stage == TRAINS:
                share = (1 - _AFTERWARDS) * self._spent(share)
            if step.stage != self._now:
                self._end_step(at)
                self._now = step.stage
                self._pace = Pace()
            self._began.setdefault(step.stage, (at, share))
            self._pace.hear(at, share)
            self._part = share
        elif self._now and self._now != TRAINS and step.total > 0:
            self._end_step(at)  # something between two steps
        left = self._left(at, self._part)
        if self._behind:
            self._share = max(self._share, done)
        else:  # as much of the rest as this time is of the time that was left before it
            self._share += (1 - self._share) * passed / max(passed + left, 1e-9)
        return self._share, left

    def rates(self) -> dict[str, float]:
        """The rates for the next run, when all is done, or when it was stopped."""
        # A step that was stopped, and a training that was taken up, did a part only.
        done = {step: 1 - self._began[step][1] for step in self._took}
        if self._now:
            done[self._now] = self._part - self._began[self._now][1]
        if TRAINS in done:
            whole = (1 - _AFTERWARDS) * (1 - self._spent(self._behind))
            done[TRAINS] /= max(whole, 1e-6)
        self._end_step(self._clock())
        result = dict(self._known)
        for step, seconds in self._took.items():
            if done[step] < TELLING:
                continue
            before = self._known.get(step, 1.0)
            measured = seconds * before / max(self._expected[step] * done[step], 1e-6)
            measured = min(max(measured, 1 / _MOST_OFF), _MOST_OFF)
            weight = _LEARNED if step in self._known else 1.0
            result[step] = before + weight * (measured - before)
        return result

    def _end_step(self, at: float) -> None:
        if self._now:
            self._took[self._now] = at - self._began[self._now][0]
            self._now = ""

    def _left(self, at: float, share: float) -> float:
        """Seconds that what is running and what is to come still take."""
        took, expected = sum(self._took.values()), sum(self._expected[s] for s in self._took)
        left = 0.0
        if self._now:
            began, first = self._began[self._now]
            part = (share - first) / max(1 - first, 1e-9)
            usual, trust = self._expected[self._now], self._pace.trust
            guess = max(usual * self._off(took, expected), at - began)
            whole = trust * (self._pace.seconds or 0.0) * (1 - first) + (1 - trust) * guess
            left = self._pace.expected_left(guess, at)
            took, expected = took + part * whole, expected + part * usual
        latest = max((STEPS.index(step) for step in self._began), default=-1)
        ahead = sum(self._expected.get(step, 0.0) for step in STEPS[latest + 1 :])
        return left + self._off(took, expected) * ahead

    def _off(self, took: float, expected: float) -> float:
        """By how much what is to come is off, after ``expected`` seconds that ``took`` others."""
        if expected <= 0:
            return 1.0
        weight = min(expected / (TELLING * sum(self._expected.values())), 1.0)
        off = min(max(took / expected, 1 / _MOST_OFF), _MOST_OFF)
        return float(off ** (weight * (_SHARED if self._known else 1.0)))


def look_at_photos(path: Path) -> PhotoFind | None:
    """What ``path`` (a scene folder, photos, a video) has to make splats of; None when nothing.

    A scene folder that has splats has nothing to make. Of photos outside a scene folder that were
    begun before, what was begun is found. Raises ``GagaError`` when the folder cannot be read, or
    holds photos of kinds only that are not read.
    """
    outside, scene = source_of(path)
    scene = scene if outside is None else latest_of(scene)
    if find_model(scene) is not None:
        is_it = scene.absolute() == path.absolute()
        return None if is_it else PhotoFind(outside, scene, 0, (1, 1))
    return _photos_of(outside, scene)


def photos_again(scene: Path) -> PhotoFind | None:
    """What the photos of a finished ``scene`` have to make another scene of, in a new folder next
    to it or one that was begun: those that it was made of, where they are still there, else its
    own. None without any."""
    known = _placement_entry(scene).get("source")
    sources = [find_photos(scene)]
    if isinstance(known, str) and sources != [scene / ORIGINALS]:  # else it was made in place
        sources.insert(0, Path(known))
    first = re.sub(r"-\d+$", "", scene.name)
    name = first if scene.with_name(first).is_dir() else scene.name  # "room-12" is no twelfth
    tries = (scene.with_name(f"{name}-{i}") for i in itertools.count(2))
    target = next(path for path in tries if _is_free(path))
    found = (_photos_of(path, target) for path in sources if path is not None and path.exists())
    return next(filter(None, found), None)


def latest_of(scene: Path) -> Path:
    """The last of the finished scenes that were made again of the photos of ``scene``, else it."""
    source = _placement_entry(scene).get("source")

    def is_of_them(other: Path) -> bool:
        is_made = source is not None and find_model(other) is not None
        return is_made and _placement_entry(other).get("source") == source

    others = (scene.with_name(f"{scene.name}-{i}") for i in itertools.count(2))
    return [scene, *itertools.takewhile(is_of_them, others)][-1]


def require_its_photos(photos: Path, scene: Path) -> None:
    """Raise ``GagaError`` where ``scene`` is there, and was made of something else than ``photos``:
    nothing of them would come into it."""
    if find_sparse(scene) is None and find_model(scene) is None:
        return
    if not photos.exists():
        raise GagaError(f"{photos} does not exist. Check the path.")
    if not _is_made_of(photos, scene):
        source = _placement_entry(scene).get("source")
        was = "is there already" if source is None else f"was made of {source}"
        raise GagaError(f"{scene} {was}, so nothing is made of {photos}. Name a new scene folder.")


def _is_made_of(photos: Path, scene: Path) -> bool:
    """Whether ``photos`` are those of ``scene``: by where they are, else by their names."""
    place = photos.resolve()
    own = (scene, scene / "images", scene / ORIGINALS)
    if any(place.is_relative_to(folder.resolve()) for folder in own):
        return True
    entry = _placement_entry(scene)
    source, files = Path(str(entry.get("source", ""))), entry.get("files")
    if is_recording(photos):  # it was unpacked into the scene
        return source.resolve() == (scene / ORIGINALS).resolve()
    if "source" in entry and source.exists():
        return source.resolve() == place
    if not photos.is_dir():
        return source.name == photos.name
    known = {*map(str, files)} if isinstance(files, list) else set()
    if "source" not in entry:  # another program placed them
        known = {camera.name for camera in open_scene_folder(scene).cameras}
    there = {path.relative_to(photos).as_posix() for path in list_photos(photos)}
    return 2 * len(known & there) >= max(len(known), 1)  # some were left out, or removed


def _is_free(scene: Path) -> bool:
    return not scene.exists() or (_is_begun(scene) and find_model(scene) is None)


def photos_since(scene: Path, photos: Path) -> int:
    """How many of the ``photos`` of a folder were not there when ``scene`` was made of it."""
    known = _placement_entry(scene).get("files")
    if not isinstance(known, list) or not photos.is_dir():
        return 0
    return len(
        {path.relative_to(photos).as_posix() for path in list_photos(photos)} - {*map(str, known)}
    )


def _placement_entry(scene: Path) -> Mapping[str, object]:
    entry = read_entry(scene).get("sfm")
    return entry if isinstance(entry, dict) else {}


def stopped_training(scene: Path) -> PhotoFind | None:
    """The training of a scene folder that was stopped before its end, whether or not its splats
    were kept; None where there is none."""
    if not (scene / WORKSPACE / CHECKPOINT).is_file() or find_sparse(scene) is None:
        return None
    found = _photos_of(None, scene)
    if found is None or found.going_on is None:
        return None
    return found if found.iteration < found.going_on.train().iterations else None


def _photos_of(outside: Path | None, scene: Path) -> PhotoFind | None:
    is_placed = find_sparse(scene) is not None
    source = scene / "images" if is_placed else outside or find_photos(scene)
    if source is None:
        return None
    going_on, iteration = _left_training(scene) if is_placed else (None, 0)
    outside = None if is_placed else outside
    poses = "" if is_placed else _poses_near(source)
    if is_video(source):
        n, is_round = expected_frames(source)
        n_views = len(VIEWS) if is_round else 1
        return PhotoFind(outside, scene, n, _VIDEO_SIZE, is_video=True, n_views=n_views)
    if is_recording(source):
        seen = look_at_recording(source)
        return PhotoFind(outside, scene, len(seen.frames), seen.size, poses=f"{seen.told}.")
    files = list_photos(source) if source.is_dir() else ()
    if not files:
        unread = unread_kinds(source) if source.is_dir() else ()
        if unread:
            raise GagaError(unread[0])
        return None
    size, n_views = _VIDEO_SIZE, 1
    for file in files[:5]:  # the first that can be read
        with suppress(GagaError), image_header(file) as image:
            size = image.size
            if is_panorama(file, *size):
                size, n_views = (size[0] // 4, size[0] // 4), len(VIEWS)
            break
    kept = (False, is_placed, going_on, iteration, poses, n_views)
    return PhotoFind(outside, scene, len(files), size, *kept)


def _poses_near(source: Path) -> str:
    """A sentence about the poses of other programs next to photos; "" without any."""
    try:
        given = find_poses(source) if source.is_dir() else None
    except GagaError as error:
        return str(error)
    return "" if given is None else f"{given.told}."


def scene_of(photos: Path) -> Path:
    """Scene folder for photos or a video that lie outside one, where the user names none.

    Next to them, with "-scene" behind the name; for SCENE/images and SCENE/input it is SCENE, where
    that was begun. A folder whose name says nothing, as THING/photos, has that of the folder that
    it is in before it; one that was begun under its own stays.
    """
    photos = photos.absolute()
    if photos.is_dir() and photos.name in ("images", ORIGINALS):
        if _is_begun(photos.parent):
            return photos.parent
        if photos.name == "images" and _is_of_others(photos.parent):
            return _next_to(photos.parent)
    if photos.is_file():
        return photos.with_name(f"{photos.stem}-scene")
    own = photos.with_name(f"{photos.name}-scene")
    told = _told_name(photos)
    is_own = own.is_dir() or told == photos.name
    return own if is_own else photos.with_name(f"{told}-{own.name}")


def _next_to(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}-scene")


def _is_begun(folder: Path) -> bool:
    """Whether a scene was begun in ``folder``: its pictures and cameras are written there."""
    return find_sparse(folder) is not None or (folder / WORKSPACE).is_dir()


def _is_of_others(folder: Path) -> bool:
    """Whether another program's poses are of ``folder``/images: they would not fit pictures without
    distortion, which a scene folder has there."""
    if _is_begun(folder) or not (folder / "images").is_dir() or find_model(folder) is not None:
        return False
    try:
        return find_poses(folder / "images") is not None
    except GagaError:  # there are some, which is said when they are to be read
        return True


# What cameras and programs call a folder of photos, whatever they show.
_SAYS_NOTHING = {
    "color", "dcim", "frames", "image", "images", "img", "input", "jpg", "jpeg", "photo", "photos",
    "pictures", "png", "rgb",
}  # fmt: skip


def _told_name(photos: Path) -> str:
    """The name of a folder of photos, or of a video, or of the folder that says what they show."""
    folders = (photos.absolute(), *photos.absolute().parents)
    telling = (one.name for one in folders if one.name.lower() not in _SAYS_NOTHING)
    return next(filter(None, telling), photos.name)


def source_of(path: Path) -> tuple[Path | None, Path]:
    """The photos and the scene folder that a user means by ``path``.

    Photos are None for a scene folder, or one to be that holds its photos or its video, and for a
    folder whose pictures are part of something else: the textures of a SOG. A folder of another
    program, with poses next to images/, is left as it is: the scene is made next to it.
    """
    if is_video(path) or is_recording(path):
        return path, scene_of(path)
    if _is_of_others(path):
        return path / "images", _next_to(path.absolute())
    if not path.is_dir() or is_scene_folder(path) or meant_in(path) is not None:
        return None, path
    kinds = (*IMAGE_SUFFIXES, *UNREAD_SUFFIXES)
    direct = any(p.suffix.lower() in kinds for p in path.iterdir() if p.is_file())
    if not direct:
        return None, path
    scene = scene_of(path)
    return (None if scene == path.absolute().parent else path), scene


def _left_training(scene: Path) -> tuple[ReconstructConfig | None, int]:
    """Settings of the training of ``scene`` that was stopped, and how far it came."""
    iteration = iteration_of(scene / WORKSPACE / CHECKPOINT)
    if iteration is None or working_in(scene / WORKSPACE):  # the other has not stopped
        return None, 0
    try:
        config = read_foreign_json(scene / WORKSPACE / SETTINGS, ReconstructConfig)
    except GagaError:
        return None, 0
    return config, iteration
