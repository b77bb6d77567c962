"""From photos to a scene folder with splats: every step that is not there yet.

Photos are examined, placed by structure from motion, checked, undistorted, and splats are trained
on them. What is finished of a run that was stopped lies in SCENE/.gaga-reconstruct and is taken up
the next time; when the scene is complete, that folder is gone.
"""

import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras_json import write_cameras_json
from gaga_core.io.colmap import read_colmap
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.ply import write_ply
from gaga_core.io.scene_folder import SceneFolder, find_model, find_sparse, open_scene_folder
from gaga_core.pipeline.place import (
    WORKSPACE,
    WrongModelError,
    find_photos,
    place_photos,
    read_entry,
    refuse,
    write_entry,
)
from gaga_core.pipeline.reconstruct_settings import QUALITIES, ReconstructConfig
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.reconstruct.pose_check import check_poses_stage

__all__ = [
    "CHECKPOINT",
    "QUALITIES",
    "SETTINGS",
    "WORKSPACE",
    "ReconstructConfig",
    "Reconstruction",
    "WrongModelError",
    "find_photos",
    "place_photos",
    "read_entry",
    "reconstruct_scene",
    "train_scene",
]

_RANDOM_POINTS = 100_000  # of cameras that come without points, as published
SETTINGS, CHECKPOINT = "settings.json", "train.npz"  # of a training, in the workspace


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
        notes = (*notes, *(yield from _given_poses(scene, config)))
        yield from train_scene(open_scene_folder(scene), config, rasterizer=rasterizer)
        done.append("train")
    workspace = scene / WORKSPACE
    is_training = (workspace / CHECKPOINT).is_file() or (workspace / SETTINGS).is_file()
    if find_sparse(scene) is not None and (workspace / "task").is_file() and not is_training:
        shutil.rmtree(workspace, ignore_errors=True)  # killed after the photos were placed
    if config.only == "all" and find_model(scene) is not None:
        shutil.rmtree(scene / WORKSPACE, ignore_errors=True)  # killed between the last two steps
    return Reconstruction(scene, tuple(done), notes, read_entry(scene))


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
    from gaga_core.reconstruct.distributed import joined_team
    from gaga_core.reconstruct.first_splats import first_splats_stage
    from gaga_core.reconstruct.initial import random_points
    from gaga_core.reconstruct.report import Cost, report_of
    from gaga_core.reconstruct.train import train_stage
    from gaga_core.reconstruct.views import load_views_stage

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
    views = yield from load_views_stage(cameras, folder.image_paths, test, settings.longest_side)
    initial = yield from first_splats_stage(points, colors, views.train, settings, engine)
    workspace = root / WORKSPACE
    with _tidied(workspace), joined_team() as team:
        with atomic_write(workspace / SETTINGS) as temporary:
            temporary.write_text(json.dumps(asdict(config)), encoding="utf-8")
        trained = yield from train_stage(
            initial, views, settings, engine, checkpoint=workspace / CHECKPOINT, team=team
        )
        if team.rank == 0:
            yield Progress("Write splats", 0, 1)
            cost = Cost(time.perf_counter() - start, time.process_time() - cpu_start)
            write_cameras_json(root / "cameras.json", folder.cameras)
            write_entry(root, {"train": report_of(trained, settings, cost)})
            write_ply(root / "point_cloud.ply", trained.gaussians)
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
        if workspace.is_dir() and {path.name for path in workspace.iterdir()} <= {SETTINGS}:
            shutil.rmtree(workspace, ignore_errors=True)
