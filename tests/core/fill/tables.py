"""A textured table with a box on it, which hides the place where it stands."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.camera import Camera
from gaga_core.color import dc_from_rgb
from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.splats.ply import write_ply
from gaga_core.scene.edits.values import joined
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene
from tests.scenes import orbit_cameras

TABLE, BOX = 1, 2
STEP, HALF = 0.03, 0.24  # between splats; half the side of the box's foot


@dataclass(frozen=True)
class Table:
    """What was photographed, and what is under the box."""

    gaussians: Gaussians  # with the box and with the hole under it
    labels: np.ndarray  # (N,) TABLE or BOX
    empty: Gaussians  # the table alone, whole
    cameras: tuple[Camera, ...]


def table_with_box(*, sh_degree: int = 0, shade: float = 0.0) -> Table:
    """A table of slowly changing color; ``shade``: how much the box darkens it at its foot."""
    n = 54
    u, v = (STEP * (np.indices((n, n)) - (n - 1) / 2)).reshape(2, -1)
    points = np.stack([u, v, np.zeros(n * n)], axis=1)
    color = np.stack([0.55 + 0.15 * u, 0.45 + 0.1 * v, 0.3 + 0.1 * np.sin(2 * u)], axis=1)
    empty = flat(points, color, sh_degree)
    inside = np.maximum(np.abs(u), np.abs(v)) < HALF
    away = np.maximum(np.maximum(np.abs(u), np.abs(v)) - HALF, 0)
    dark = color * (1 - shade * np.exp(-((away / 0.12) ** 2)))[:, None]
    table = flat(points, dark, sh_degree).take(~inside)
    box = _box(sh_degree)
    labels = np.repeat(np.array([TABLE, BOX], np.int32), [len(table), len(box)])
    whole = joined(table, box)
    cameras = orbit_cameras(12, width=128, height=96, radius=1.9)
    return Table(whole, labels, empty, cameras)


def table_project(root: Path) -> Project:
    """A new scene folder of the table with the box and the cameras that saw it, opened: views from
    all around, as of a lone file, are larger and take ten times as long to fill."""
    table = table_with_box()
    write_ply(root / "point_cloud.ply", table.gaussians)
    write_colmap(root / "sparse" / "0", table.cameras, np.zeros((1, 3)), np.zeros((1, 3), np.uint8))
    scene = Scene.of(table.gaussians, table.labels)
    return Project(scene, root / "point_cloud.ply", open_scene_folder(root))


def flat(points: DoubleArray, color: DoubleArray, sh_degree: int) -> Gaussians:
    """Level discs."""
    n = len(points)
    sh = np.zeros((n, (sh_degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = dc_from_rgb(color.astype(np.float32))
    return Gaussians(
        points.astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.tile(np.log(np.array([0.66 * STEP, 0.66 * STEP, 0.003], np.float32)), (n, 1)),
        np.full(n, 4, np.float32),
        sh,
    )


def _box(sh_degree: int) -> Gaussians:
    """An open cube's five faces, of round splats."""
    m = round(2 * HALF / STEP) + 1
    a, b = (np.linspace(-HALF, HALF, m)[i] for i in np.indices((m, m)).reshape(2, -1))
    top = np.full(m * m, 2 * HALF)
    faces = [(a, b, top)]
    faces += [(s * top / 2, a, b + HALF) for s in (1, -1)]
    faces += [(a, s * top / 2, b + HALF) for s in (1, -1)]
    points = np.concatenate([np.stack(face, axis=1) for face in faces])
    made = flat(points, np.tile([0.2, 0.3, 0.8], (len(points), 1)), sh_degree)
    return replace(made, log_scales=np.full_like(made.log_scales, np.log(0.7 * STEP)))


def psnr(a: np.ndarray, b: np.ndarray, where: BoolArray) -> float:
    """In dB, over the pixels (H, W) ``where``."""
    return float(-10 * np.log10(((a - b)[where] ** 2).mean() + 1e-12))
