"""The programs that the tests kill: each writes version A or B of a result over the other one."""

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.export.export import export_objects_stage, export_scene_stage
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.cameras.colmap import read_colmap, write_colmap
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.folder.staging import finish_publishing
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.reconstruct import reconstruct_scene, train_scene
from gaga_core.pipeline.run import run_missing
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene.scene import Scene
from tests.core.grouping.true_masks import permuted, true_map
from tests.core.placing.photo_scenes import FOCAL, write_photos
from tests.scenes import Synthetic, objects_scene

Version = str  # "A" or "B"
_TRAIN = ReconstructConfig(iterations=40, max_side=64)


@dataclass(frozen=True)
class Program:
    """Something that a person waits for."""

    make: Callable[[Path], object]  # what it needs
    run: Callable[[Path, Version], object]
    result: Callable[[Path], str]  # digest of what it wrote; "" = nothing
    has_versions: bool = True  # else B is A, and each run begins without a result


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
    each = {str(p.relative_to(root)): hashlib.sha256(_stable(p)).hexdigest() for p in files}
    return json.dumps(each) if each else ""


def _stable(path: Path) -> bytes:
    """The content, without how long it took."""
    if path.suffix == ".npz":
        arrays = read_arrays(path, "")
        return b"".join(name.encode() + arrays[name].tobytes() for name in sorted(arrays))
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


def _run(root: Path, _: Version) -> None:
    run_stage(run_missing(open_scene_folder(root)))


def _untrained(root: Path) -> None:
    _scene_folder(root)
    (root / "point_cloud.ply").unlink()


def _train(root: Path, _: Version) -> None:
    run_stage(train_scene(open_scene_folder(root), _TRAIN, rasterizer=CpuRasterizer()))


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
    "associate": Program(_scene_folder, _associate, lambda root: _digest(root, "gaga/**/*")),
    "run": Program(
        _scene_folder, _run, lambda root: _digest(root, "gaga/**/*"), has_versions=False
    ),
    "train": Program(
        _untrained, _train, lambda root: _digest(root, "point_cloud.ply"), has_versions=False
    ),
    "place": Program(_photos, _place, _placed, has_versions=False),
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
