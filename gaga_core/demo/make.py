"""The files of the demo's folder: model, photos, poses, masks, truth, all from one seed."""

import json
from collections.abc import Generator
from pathlib import Path

import numpy as np

from gaga_core.camera import Camera
from gaga_core.color import rgb_from_dc
from gaga_core.demo.build import STAGE, Model, build_stage
from gaga_core.demo.cameras import demo_cameras, split
from gaga_core.demo.config import DemoConfig
from gaga_core.demo.masks import segmenter_masks
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose


def scene_stage(folder: Path, config: DemoConfig) -> Stage[None]:
    """Write all files of the demo into the new folder ``folder``."""
    for part in ("images", "gt/instance", "masks/sim", "sparse/0"):
        (folder / part).mkdir(parents=True)
    model = yield from build_stage(config.n_splats, config.seed, config.n_views + 1)
    cameras = yield from _photographed(folder, config, model)
    _write_model(folder, config, model, cameras)


def _photographed(
    folder: Path, config: DemoConfig, model: Model
) -> Generator[Progress, None, tuple[Camera, ...]]:
    """Photos, true instances and a segmenter's masks of every view."""
    cameras = demo_cameras(config)
    rasterizer = choose("cpu")
    total = model.steps + len(cameras) + 1
    for k, camera in enumerate(cameras):
        yield Progress(STAGE, model.steps + k, total, f"Photo {k + 1}")
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


def _write_json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")
