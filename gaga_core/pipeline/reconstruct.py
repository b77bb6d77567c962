"""From photos to a scene folder with splats: every step that is not there yet.

Photos are examined, placed by structure from motion, checked, undistorted, and splats are trained
on them. What is finished of a run that was stopped lies in SCENE/.gaga-reconstruct and is taken up
the next time; when the scene is complete, that folder is gone.
"""

import hashlib
import json
import os
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras_json import write_cameras_json
from gaga_core.io.colmap import read_colmap
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.ply import write_ply
from gaga_core.io.scene_folder import (
    SceneFolder,
    find_model,
    find_sparse,
    open_scene_folder,
    with_entry,
)
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.reconstruct.photos import (
    PhotoSet,
    is_video,
    list_photos,
    prepare_photos,
    read_photo_set,
    unread_kinds,
)
from gaga_core.reconstruct.settings import TrainConfig
from gaga_core.reconstruct.sfm import SfmConfig, run_sfm
from gaga_core.reconstruct.sfm_checks import Verdict, check_model
from gaga_core.reconstruct.sfm_metrics import SfmFacts, SfmSummary, summarize
from gaga_core.reconstruct.undistort import ORIGINALS, require_room, undistort_into
from gaga_core.reconstruct.video import extract_frames

QUALITIES = ("draft", "standard", "full")
WORKSPACE = ".gaga-reconstruct"
SETTINGS, CHECKPOINT = "settings.json", "train.npz"  # of a training, in the workspace
_PICTURE_SIDE = 1600  # pixels of the pictures in a scene folder (Kerbl 2023)
_PREPARED_SIDE = 3200  # pixels: larger photos bring nothing to the matching


@dataclass(frozen=True)
class ReconstructConfig:
    """Settings of a reconstruction; None = what the quality says."""

    quality: Literal["draft", "standard", "full"] = "draft"
    iterations: int | None = None  # of the training
    max_side: int | None = None  # pixels, longest side of the training pictures
    focal: float | None = None  # pixels of the photos as they are; None = EXIF, else estimated
    video_fps: float | None = None  # frames taken of each second
    seed: int = 0
    threads: int = 0  # 0 = all
    only: Literal["all", "sfm"] = "all"
    accept_wrong: bool = False  # keep a model that the checks refuse
    hold_out: bool = True  # keep the test views out of the training, to measure on

    def __post_init__(self) -> None:
        if self.quality not in QUALITIES:
            raise ValueError(f"quality: {self.quality!r} is none of {QUALITIES}")
        if self.focal is not None and self.focal <= 0:
            raise GagaError("--focal is a length in pixels: it must be greater than 0.")
        if self.video_fps is not None and self.video_fps <= 0:
            raise GagaError("--video-fps must be greater than 0.")
        if self.iterations is not None and self.iterations < 1:
            raise GagaError("--iterations must be at least 1.")
        if self.max_side is not None and self.max_side < 64:
            raise GagaError("--max-side must be at least 64 pixels.")

    def sfm(self) -> SfmConfig:
        """Settings of structure from motion."""
        return SfmConfig.of(self.quality, threads=self.threads, seed=self.seed)

    def train(self) -> TrainConfig:
        """Settings of the training."""
        config = replace(TrainConfig.of(self.quality), seed=self.seed)
        if self.iterations is not None:
            config = replace(config, iterations=self.iterations)
        if self.max_side is not None:
            config = replace(config, longest_side=self.max_side)
        return config


class WrongModelError(GagaError):
    """The checks refuse the placement of the photos; ``finding`` says why and what to try."""

    def __init__(self, finding: str) -> None:
        super().__init__(f"{finding} (--accept-wrong keeps it all the same.)")
        self.finding = finding


@dataclass(frozen=True)
class Reconstruction:
    """What was done."""

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
) -> Stage[Reconstruction]:
    """Make a scene folder of ``photos``: a folder, a video, or None for what lies in ``scene``.

    Writes images/, sparse/0/, cameras.json, point_cloud.ply and the entry "reconstruct" of
    gaga/report.json. Whatever is there already is not made again. Raises ``GagaError`` when the
    photos do not do, or when the checks find the model wrong.
    """
    config = config or ReconstructConfig()
    scene = Path(scene)
    done: list[str] = []
    notes: tuple[str, ...] = ()
    if find_sparse(scene) is None and find_model(scene) is None:
        if int(os.environ.get("WORLD_SIZE", "1")) > 1:
            raise GagaError("Place the photos first, without torchrun: gaga reconstruct --only sfm")
        notes = yield from place_photos(photos, scene, config)
        done.append("sfm")
    if config.only == "all" and find_model(scene) is None:
        yield from train_scene(open_scene_folder(scene), config, rasterizer=rasterizer)
        done.append("train")
    return Reconstruction(scene, tuple(done), notes, read_entry(scene))


def find_photos(scene: Path) -> Path | None:
    """The photos of a scene folder: input/, images/, or the one video in it; None without any."""
    for folder in (scene / ORIGINALS, scene / "images"):
        if folder.is_dir() and list_photos(folder):
            return folder
    videos = [path for path in sorted(scene.iterdir()) if is_video(path)] if scene.is_dir() else []
    return videos[0] if len(videos) == 1 else None


def place_photos(
    photos: Path | None, scene: Path, config: ReconstructConfig
) -> Stage[tuple[str, ...]]:
    """Photos -> checked COLMAP model and undistorted pictures in ``scene``; returns notes."""
    source = photos or find_photos(scene)
    if source is None:
        raise GagaError(f"There are no photos in {scene}. Put them into {scene / 'images'}.")
    start, existed = time.perf_counter(), scene.exists()
    workspace = scene / WORKSPACE
    try:
        _claim(workspace, _fingerprint(source, config))
        require_room(scene, source, workspace)
        found = yield from _photo_set(source, workspace, config)
        facts = yield from run_sfm(found, workspace, config.sfm())
        summary = summarize(facts)
        verdicts = check_model(facts, summary, _priors(found))
        _refuse(verdicts, config)
        side = max(_PICTURE_SIDE, config.max_side or 0)
        yield from undistort_into(
            scene, found, workspace, config.sfm(), longest_side=side, replaces=source
        )
    except OSError as error:
        raise GagaError(explain_os_error(error, scene)) from error
    finally:
        if not (workspace / "photos.json").is_file():
            shutil.rmtree(workspace, ignore_errors=True)
            if not existed and scene.is_dir() and not any(scene.iterdir()):
                scene.rmdir()
    entry = _sfm_entry(source, found, facts, summary, verdicts)
    _write_entry(scene, {"sfm": entry | {"seconds": round(time.perf_counter() - start, 1)}})
    shutil.rmtree(workspace, ignore_errors=True)
    return (*found.notes, *(verdict.text for verdict in verdicts))


def train_scene(
    folder: SceneFolder,
    config: ReconstructConfig,
    *,
    rasterizer: Rasterizer | None = None,
) -> Stage[Gaussians]:
    """Train splats on the photos of ``folder`` and write them, with cameras.json and the report.

    Started by torchrun, all workers train together and the first one writes.
    """
    # Loaded when there is something to train: the kernels take a good part of the launch time.
    from gaga_core.reconstruct.distributed import joined_team
    from gaga_core.reconstruct.initial import first_splats_stage
    from gaga_core.reconstruct.report import Cost, report_of
    from gaga_core.reconstruct.train import train_stage
    from gaga_core.reconstruct.views import load_views_stage

    sparse = find_sparse(folder.root)
    if sparse is None or not folder.cameras:
        raise GagaError(f"There is no COLMAP model in {folder.root}. Place the photos first.")
    folder.require_image(folder.cameras[0].name)
    start, cpu_start, settings = time.perf_counter(), time.process_time(), config.train()
    model = read_colmap(sparse)
    engine = rasterizer or choose()
    test = folder.test if config.hold_out else ()
    views = yield from load_views_stage(
        folder.cameras, folder.image_paths, test, settings.longest_side
    )
    initial = yield from first_splats_stage(
        model.points, model.point_colors, views.train, settings, engine
    )
    workspace = folder.root / WORKSPACE
    workspace.mkdir(exist_ok=True)
    (workspace / SETTINGS).write_text(json.dumps(asdict(config)), encoding="utf-8")
    with joined_team() as team:
        trained = yield from train_stage(
            initial, views, settings, engine, checkpoint=workspace / CHECKPOINT, team=team
        )
        if team.rank == 0:
            yield Progress("Write splats", 0, 1)
            cost = Cost(time.perf_counter() - start, time.process_time() - cpu_start)
            write_cameras_json(folder.root / "cameras.json", folder.cameras)
            _write_entry(folder.root, {"train": report_of(trained, settings, cost)})
            write_ply(folder.root / "point_cloud.ply", trained.gaussians)
            shutil.rmtree(workspace, ignore_errors=True)
    return trained.gaussians


def read_entry(scene: Path) -> dict[str, object]:
    """The entry "reconstruct" of the scene's report.json; empty when there is none."""
    try:
        report = json.loads((scene / "gaga" / "report.json").read_text(encoding="utf-8"))
        entry = report.get("reconstruct", {})
    except (OSError, ValueError, AttributeError):
        return {}
    return entry if isinstance(entry, dict) else {}


def _write_entry(scene: Path, values: dict[str, object]) -> None:
    path = scene / "gaga" / "report.json"
    text = with_entry(path, "reconstruct", read_entry(scene) | values)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _claim(workspace: Path, fingerprint: str) -> None:
    """Make the workspace this task's: what another left in it is removed."""
    mark = workspace / "task"
    if not (mark.is_file() and mark.read_text(encoding="ascii") == fingerprint):
        shutil.rmtree(workspace, ignore_errors=True)
        workspace.mkdir(parents=True)
        mark.write_text(fingerprint, encoding="ascii")


def _fingerprint(source: Path, config: ReconstructConfig) -> str:
    """Digest of the photos' names, sizes and times and of the settings that change their places."""
    files: Sequence[Path] = (source,) if source.is_file() else list_photos(source)
    stats = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    settings = asdict(replace(config.sfm(), threads=0))
    task = [stats, settings, config.focal, config.video_fps]
    return hashlib.sha256(json.dumps(task).encode()).hexdigest()


def _photo_set(source: Path, workspace: Path, config: ReconstructConfig) -> Stage[PhotoSet]:
    """The photos, ready in workspace/photos."""
    file = workspace / "photos.json"
    if file.is_file():
        return read_photo_set(file)
    shutil.rmtree(workspace / "photos", ignore_errors=True)
    root, sources = source, tuple[Path, ...]()
    if is_video(source):
        root = workspace / "frames"
        shutil.rmtree(root, ignore_errors=True)
        sources = yield from extract_frames(
            source, root, fps=config.video_fps, longest_side=_PREPARED_SIDE
        )
    else:
        sources = list_photos(source)
    found = yield from prepare_photos(
        sources,
        workspace / "photos",
        root=root,
        longest_side=_PREPARED_SIDE,
        focal=config.focal,
        ordered=is_video(source),
    )
    if source.is_dir():
        found = replace(found, notes=(*found.notes, *unread_kinds(source)))
    shutil.rmtree(workspace / "frames", ignore_errors=True)
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(found.to_json()), encoding="utf-8")
    return found


def _priors(photos: PhotoSet) -> dict[str, float]:
    return {photo.name: photo.focal for photo in photos.photos if photo.focal is not None}


def _refuse(verdicts: Sequence[Verdict], config: ReconstructConfig) -> None:
    errors = [verdict.text for verdict in verdicts if verdict.level == "error"]
    if errors and not config.accept_wrong:
        raise WrongModelError("The model of these photos is not to be trusted. " + " ".join(errors))


def _sfm_entry(
    source: Path,
    photos: PhotoSet,
    facts: SfmFacts,
    summary: SfmSummary,
    verdicts: Sequence[Verdict],
) -> dict[str, object]:
    placed = set(facts.names)
    return summary.to_json() | {
        "source": str(source),
        "left_out": [photo.name for photo in photos.photos if photo.name not in placed],
        "notes": list(photos.notes),
        "checks": [asdict(verdict) for verdict in verdicts],
    }
