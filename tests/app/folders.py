"""Scene folders on disk for window tests: balls on a floor, photos, permuted masks."""

from pathlib import Path

import numpy as np

from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.ply import write_ply
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.scenes import Synthetic, objects_scene


def write_scene(folder: Path, *, masks: bool = True, n_objects: int = 5) -> Synthetic:
    """A small scene folder; the masks are the true ones, floor included, under ids of each view."""
    scene = objects_scene(n_objects, 220, n_cameras=8)
    rng = np.random.default_rng(4)
    raster = CpuRasterizer()
    for camera in scene.cameras:
        frame = raster.render(scene.gaussians, camera)
        write_rgb(_parent(folder / "images" / camera.name), frame.image)
        if masks:
            everything = np.where(scene.labels > 0, scene.labels, n_objects + 1).astype(np.int32)
            shown = raster.label_splat(scene.gaussians, camera, everything)
            labels = np.where(shown.confidence > 0.4, shown.labels, 0)
            ids = np.concatenate([[0], rng.permutation(40)[: n_objects + 1] + 1]).astype(np.int32)
            write_labels(_parent(folder / "masks" / "made" / camera.name), ids[labels])
    points = scene.gaussians.means[::7].astype(np.float64)
    colors = np.full((len(points), 3), 128, np.uint8)
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True, exist_ok=True)
    write_colmap(sparse, scene.cameras, points, colors)
    write_ply(folder / "point_cloud.ply", scene.gaussians)
    return scene


def _parent(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path
