"""The demo's scene folder: model, photos, poses, masks, truth, all from one seed."""

import json
import shutil
from collections.abc import Generator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gaga_core.camera import Camera
from gaga_core.color import rgb_from_dc
from gaga_core.demo.build import STAGE, Model, build_stage
from gaga_core.demo.cameras import photo_cameras, split
from gaga_core.demo.masks import segmenter_masks
from gaga_core.errors import GagaError
from gaga_core.io.colmap import write_colmap
from gaga_core.io.images import write_rgb
from gaga_core.io.masks import write_labels
from gaga_core.io.ply import write_ply
from gaga_core.io.staging import publish, staging_folder
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose

VERSION = 1  # grows whenever another scene comes out of the same seed
STAMP = "demo.json"
_OWN = {"images", "gt", "masks", "sparse", "point_cloud.ply", "objects.json", "split.json", STAMP}


@dataclass(frozen=True)
class DemoConfig:
    """What is made."""

    n_splats: int = 120_000  # about
    n_views: int = 40
    width: int = 640
    height: int = 480
    seed: int = 0

    def __post_init__(self) -> None:
        if self.n_splats < 100 or self.n_views < 2 or min(self.width, self.height) < 16:
            raise ValueError(f"demo: too little to make a scene of: {self}")


def make_demo_stage(
    folder: Path, seed: int = 0, *, config: DemoConfig | None = None
) -> Stage[Path]:
    """Write the demo's scene folder (DESIGN section 7) and return it.

    It is made beside ``folder`` and renamed at the end: a cancelled demo leaves nothing. An older
    demo there is replaced; what was worked out in its ``gaga`` folder is kept as ``gaga-before``.
    Raises `GagaError` when ``folder`` holds other things.
    """
    wanted = config or DemoConfig(seed=seed)
    _refuse_other_files(folder)
    with staging_folder(folder.parent) as staging:
        made = staging / folder.name
        for part in ("images", "gt/instance", "masks/sim", "sparse/0"):
            (made / part).mkdir(parents=True)
        model = yield from build_stage(wanted.n_splats, wanted.seed, wanted.n_views + 1)
        cameras = yield from _photographed(made, wanted, model, model.steps)
        _write_model(made, wanted, model, cameras)
        pass
        publish(staging, folder.name, folder.parent)
    return folder


def ensure_demo(folder: Path, *, config: DemoConfig | None = None) -> Stage[Path]:
    """Make the demo in ``folder`` unless this version of it is there already, whole."""
    wanted = config or DemoConfig()
    if not is_complete(folder, wanted):
        yield from make_demo_stage(folder, config=wanted)
    return folder


def is_complete(folder: Path, config: DemoConfig) -> bool:
    """Whether ``folder`` holds this version of the demo with all its files."""
    try:
        stamp = json.loads((folder / STAMP).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    if stamp != {"version": VERSION, **asdict(config)}:
        return False
    names = [f"view_{k:03d}" for k in range(config.n_views)]
    files = ["point_cloud.ply", "split.json", "objects.json"]
    files += [f"sparse/0/{n}.txt" for n in ("cameras", "images", "points3D")]
    files += [f"images/{n}.jpg" for n in names]
    files += [f"{kind}/{n}.png" for kind in ("masks/sim", "gt/instance") for n in names]
    return all((folder / file).is_file() for file in files)


def _photographed(
    folder: Path, config: DemoConfig, model: Model, done: int
) -> Generator[Progress, None, tuple[Camera, ...]]:
    """Photos, true instances and a segmenter's masks of every view."""
    rng = np.random.default_rng((config.seed, 1))
    cameras = photo_cameras(config.n_views, (config.width, config.height), rng)
    rasterizer = choose("cpu")
    for k, camera in enumerate(cameras):
        yield Progress(STAGE, done + k, done + len(cameras) + 1, f"Photo {k + 1}")
        stem = Path(camera.name).stem
        write_rgb(folder / "images" / camera.name, rasterizer.render(model.gaussians, camera).image)
        truth = rasterizer.label_splat(model.gaussians, camera, model.labels).labels
        write_labels(folder / "gt" / "instance" / f"{stem}.png", truth)
        masks = segmenter_masks(truth, camera, np.random.default_rng((config.seed, 2, k)))
        write_labels(folder / "masks" / "sim" / f"{stem}.png", masks)
    return cameras


def _write_model(
    folder: Path, config: DemoConfig, model: Model, cameras: tuple[Camera, ...]
) -> None:
    write_ply(folder / "point_cloud.ply", model.gaussians)
    rng = np.random.default_rng((config.seed, 3))
    n_points = min(8000, len(model.labels))
    chosen = np.sort(rng.choice(len(model.labels), n_points, replace=False))
    colors = np.clip(rgb_from_dc(model.gaussians.sh[chosen, 0]), 0, 1) * 255
    points = model.gaussians.means[chosen].astype(np.float64)
    write_colmap(folder / "sparse" / "0", cameras, points, np.round(colors).astype(np.uint8))
    objects = [{"id": k, "name": name} for k, name in enumerate(model.names, start=1)]
    _write_json(folder / "objects.json", {"background_id": 0, "objects": objects})
    _write_json(folder / "split.json", split([camera.name for camera in cameras]))
    _write_json(folder / STAMP, {"version": VERSION, **asdict(config)})


def _write_json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def _refuse_other_files(folder: Path) -> None:
    if folder.exists() and not (folder.is_dir() and _is_demo_or_empty(folder)):
        raise GagaError(
            f"{folder} holds other files. Choose an empty or a new folder for the demo scene."
        )


def _is_demo_or_empty(folder: Path) -> bool:
    return (folder / STAMP).is_file() or not any(folder.iterdir())


def _keep_others(old: Path, new: Path) -> None:
    """Copy what a person put into or worked out in an older demo; its groups no longer fit the new
    splats and go to ``gaga-before``."""
    if not old.is_dir():
        return
    for entry in sorted(old.iterdir()):
        if entry.name in _OWN:
            continue
        target = new / ("gaga-before" if entry.name == "gaga" else entry.name)
        if entry.is_dir():
            shutil.copytree(entry, target, dirs_exist_ok=True)
        else:
            shutil.copy2(entry, target)
