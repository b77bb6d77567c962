"""The programs that the tests kill: each writes version A or B of a result over the other one."""

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from gaga_core.cli.files import describe
from gaga_core.errors import GagaError
from gaga_core.export.export import export_objects_stage, export_scene_stage
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.identity.lift import LiftConfig, Mode
from gaga_core.identity.train import FILE as LIFT_CHECKPOINT
from gaga_core.identity.train import PaperConfig
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.cameras.colmap import read_colmap, write_colmap
from gaga_core.io.folder.lock import OWNER
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.folder.staging import finish_publishing
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.lift import lift_scene
from gaga_core.pipeline.place import write_entry
from gaga_core.pipeline.reconstruct import look_at_photos, reconstruct_scene, train_scene
from gaga_core.pipeline.run import RunConfig, run_missing
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import Stage, run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene.project import open_path_stage, save_project, scene_arrays
from gaga_core.scene.scene import Scene
from gaga_core.segmentation.models.catalogue import known_model
from gaga_core.segmentation.models.download import (
    LOCK_FILE,
    Consent,
    Installed,
    download,
    partial_bytes,
)
from gaga_core.segmentation.models.hub import HubConfig, list_files
from gaga_core.training.settings import TrainConfig
from tests.core.grouping.true_masks import permuted, true_map
from tests.core.placing.photo_scenes import FOCAL, write_photos
from tests.core.segmentation.models.hub_server import Hub, serve
from tests.scenes import Synthetic, objects_scene

Version = str  # "A" or "B"
_PAPER = PaperConfig(iterations=40, reg_samples=50, checkpoint_every=4)
_MODEL = known_model("sam2.1-tiny")
_PAUSE_S = 0.01  # of the hub after each 16 kB: the download takes 0.2 s


@dataclass(frozen=True)
class _OftenKept(ReconstructConfig):
    """Writes a checkpoint after each iteration."""

    def train(self) -> TrainConfig:
        return replace(super().train(), checkpoint_seconds=0.0)


_TRAIN = _OftenKept(iterations=60, max_side=64, accept_wrong=True)


@dataclass(frozen=True)
class Program:
    """Something that a person waits for."""

    make: Callable[[Path], object]  # what it needs
    run: Callable[[Path, Version], object]
    result: Callable[[Path], str]  # digest of what it wrote; "" = nothing
    has_versions: bool = True  # else B is A, and each run begins without a result
    opens: Callable[[Path], object] = lambda root: None  # what works at any time


@cache
def _balls() -> Synthetic:
    return objects_scene(n_objects=3, per_object=60, n_cameras=4)


def _scene(version: Version) -> Scene:
    scene = Scene.of(_balls().gaussians, _balls().labels)
    scene.names = {1: "one"}  # the same files in both versions
    if version == "B":
        scene.state[::7] = 8
    return scene


def _digest(root: Path, pattern: str) -> str:
    files = sorted(path for path in root.glob(pattern) if path.is_file())
    # What a killed program was writing is no result; that it goes is asked by itself.
    files = [p for p in files if p.name not in (LIFT_CHECKPOINT, OWNER) and p.suffix != ".part"]
    each = {str(p.relative_to(root)): hashlib.sha256(_stable(p)).hexdigest() for p in files}
    return json.dumps(each) if each else ""


def _stable(path: Path) -> bytes:
    """The content, without how long it took, when it was and from which port it came."""
    if path.suffix == ".npz":
        arrays = read_arrays(path, "")
        return b"".join(name.encode() + arrays[name].tobytes() for name in sorted(arrays))
    if path.name == LOCK_FILE:
        return json.dumps(json.loads(path.read_text())["files"]).encode()
    if path.name != "report.json":
        return path.read_bytes()
    report = json.loads(path.read_text())
    return json.dumps({name: sorted(entry) for name, entry in report.items()}).encode()


def _scene_folder(root: Path) -> None:
    scene, raster = _balls(), CpuRasterizer()
    write_ply(root / "point_cloud.ply", scene.gaussians)
    points, colors = scene.gaussians.means[::3].astype(np.float64), scene.gaussians.sh[::3, 0]
    rgb = np.clip(128 + 72 * colors, 0, 255).astype(np.uint8)
    write_colmap(root / "sparse" / "0", scene.cameras, points, rgb)
    (root / "masks/sim").mkdir(parents=True)
    (root / "images").mkdir()
    for i, camera in enumerate(scene.cameras):
        write_labels(root / "masks/sim" / camera.name, permuted(true_map(scene, camera), i))
        write_rgb(root / "images" / camera.name, raster.render(scene.gaussians, camera).image)
    names = [camera.name for camera in scene.cameras]
    (root / "split.json").write_text(json.dumps({"train": names[:3], "test": names[3:]}))


def _associate(root: Path, version: Version) -> None:
    config = AssociateConfig.of("paper" if version == "A" else "robust")
    run_stage(associate_scene(open_scene_folder(root), config=config))


def _associated(root: Path) -> None:
    _scene_folder(root)
    _associate(root, "A")


def _lift(root: Path, version: Version) -> None:
    mode: Mode = "vote" if version == "A" else "paper"
    config = LiftConfig(paper=_PAPER)
    run_stage(lift_scene(open_scene_folder(root), mode, config, rasterizer=CpuRasterizer()))


def _run(root: Path, _: Version) -> None:
    run_stage(run_missing(open_scene_folder(root), RunConfig(reconstruct=_TRAIN)))


def _untrained(root: Path) -> None:
    _scene_folder(root)
    (root / "point_cloud.ply").unlink()


def _ungrouped(root: Path) -> None:
    """Photos whose poses were checked, which takes longest, and masks."""
    _untrained(root)
    write_entry(root, {"poses": {"checks": []}})


def _train(root: Path, _: Version) -> None:
    run_stage(train_scene(open_scene_folder(root), _TRAIN, rasterizer=CpuRasterizer()))


def _save(root: Path, version: Version) -> None:
    project = run_stage(open_path_stage(root / "point_cloud.ply"))
    project.scene.names[1] = version
    project.scene.state[:: 2 if version == "A" else 3] = 8
    save_project(project, root / "it.gaga", overwrites=True)


def _saved(root: Path) -> str:
    if not (root / "it.gaga").exists():
        return ""
    scene = run_stage(open_path_stage(root / "it.gaga")).scene
    arrays = scene_arrays(scene)
    digests = {name: hashlib.sha256(arrays[name].tobytes()).hexdigest() for name in arrays}
    return json.dumps([scene.names, digests])


def _repository(root: Path) -> None:
    folder = root / "repository"
    folder.mkdir()
    (folder / "config.json").write_text("{}")
    weights = np.random.default_rng(0).integers(0, 256, 300_000, np.uint8)
    (folder / "model.safetensors").write_bytes(weights.tobytes())


def download_stage(root: Path) -> Stage[Installed]:
    """Download a model from a hub of its own."""
    with serve(Hub({_MODEL.hub: root / "repository"}, pause_s=_PAUSE_S)) as hub:
        config = HubConfig(hub.url)
        consent = Consent(_MODEL.name, _MODEL.licence)
        return (yield from download(list_files(_MODEL, config), consent, config))


def _photos(root: Path) -> None:
    write_photos(root / "photos", 6)


def _place(root: Path, _: Version) -> None:
    config = ReconstructConfig(only="sfm", max_side=64, focal=FOCAL, threads=1)
    run_stage(reconstruct_scene(root / "photos", root / "scene", config))


def _placed(root: Path) -> str:
    """Names of all files of the scene, and where the photos were taken, to three digits."""
    scene = root / "scene"
    if not (scene / "sparse" / "0").is_dir():
        return ""
    poses = {
        c.name: (c.position + 0.0).round(3).tolist()
        for c in read_colmap(scene / "sparse" / "0").cameras
    }
    return json.dumps([sorted(str(p.relative_to(scene)) for p in scene.rglob("*")), poses])


def _of_groups(root: Path) -> str:
    return _digest(root, "gaga/**/*")


def _of_run(root: Path) -> str:
    """Of everything, once its last stage has ended."""
    is_done = any((root / "gaga/renders").rglob("*.png"))
    return _digest(root, "point_cloud.ply") + _of_groups(root) if is_done else ""


def _described(root: Path) -> object:
    return run_stage(describe(root))


PROGRAMS: Mapping[str, Program] = {
    "export": Program(
        lambda root: None,
        lambda root, v: run_stage(export_scene_stage(_scene(v), root / "out.ply")),
        lambda root: _digest(root, "out.ply"),
    ),
    "export objects": Program(
        lambda root: None,
        lambda root, v: run_stage(export_objects_stage(_scene(v), root / "objects")),
        lambda root: _digest(root, "objects/*"),
    ),
    "save": Program(_scene_folder, _save, _saved),
    "associate": Program(_scene_folder, _associate, _of_groups, opens=_described),
    "lift": Program(_associated, _lift, _of_groups, opens=_described),
    "train": Program(
        _untrained,
        _train,
        lambda root: _digest(root, "point_cloud.ply"),
        has_versions=False,
        opens=look_at_photos,
    ),
    "run": Program(_ungrouped, _run, _of_run, has_versions=False, opens=look_at_photos),
    "place": Program(
        _photos,
        _place,
        _placed,
        has_versions=False,
        opens=lambda root: look_at_photos(root / "photos"),
    ),
    "model": Program(
        _repository,
        lambda root, _: run_stage(download_stage(root)),
        lambda root: _digest(root, "home/models/*/*"),
        has_versions=False,
        opens=lambda root: partial_bytes(_MODEL),
    ),
}


def run_program(name: str, root: Path, version: Version, said: Connection) -> None:
    """Run one in a process of its own; says "begun", then "ended" or what went wrong."""
    os.environ["GAGA_HOME"] = str(root / "home")
    program = PROGRAMS[name]
    said.send("begun")
    try:
        program.run(root, version)
    except GagaError as error:
        said.send(str(error))
    else:
        said.send("ended")


def make_program(name: str, root: Path, said: Connection) -> None:
    """Make what a program needs."""
    root.mkdir(parents=True)
    PROGRAMS[name].make(root)
    said.send("ended")


def finish(root: Path) -> None:
    """What opening a folder does to results that were not moved to their places."""
    for folder in [root, *(path for path in root.iterdir() if path.is_dir())]:
        finish_publishing(folder)
