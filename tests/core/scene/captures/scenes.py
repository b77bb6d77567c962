"""Two captures of one corner of a room, with photos, poses and splats of known groups."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.color import SH_C0
from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras.colmap import read_colmap, write_colmap
from gaga_core.io.cameras.transforms_json import write_transforms_json
from gaga_core.io.splats.ply import write_ply
from gaga_core.scene.bake import bake
from gaga_core.scene.edits import transform
from gaga_core.scene.frame import carried_cameras
from gaga_core.scene.scene import Scene
from tests.core.placing.photo_scenes import photographs, texture, walk_cameras

_BALLS = {  # group: middle, color
    2: ((0.0, 0.3, 0.35), (0.9, 0.1, 0.1)),
    3: ((0.8, 0.4, 0.35), (0.1, 0.1, 0.9)),
    4: ((-0.8, 0.2, 0.35), (0.9, 0.9, 0.1)),
    5: ((0.5, -0.6, 0.35), (0.1, 0.9, 0.9)),
    6: (tuple(0.75 * walk_cameras(1)[0].position), (0.5, 0.5, 0.5)),  # right before a camera
}


def any_similarity(rng: np.random.Generator) -> DoubleArray:
    world = np.eye(4)
    world[:3, :3] = np.exp(rng.uniform(-2, 2)) * Rotation.random(random_state=rng).as_matrix()
    world[:3, 3] = rng.uniform(-5, 5, 3)
    return world


def write_scene(
    folder: Path, every: int, *, n: int = 8, seed: int = 0, world: np.ndarray | None = None
) -> None:
    """Half of ``n`` photos of a corner of a room, placed: from ``every`` on each second one."""
    (folder / "images").mkdir(parents=True)
    (folder / "sparse" / "0").mkdir(parents=True)
    cameras = walk_cameras(n)[every::2]
    for camera, picture in zip(cameras, photographs(n, seed)[every::2], strict=True):
        Image.fromarray(picture).save(folder / "images" / camera.name, quality=95)
    placed = cameras if world is None else carried_cameras(cameras, world)
    write_colmap(folder / "sparse" / "0", placed, np.zeros((0, 3)), np.zeros((0, 3), np.uint8))


def write_posed(folder: Path, every: int, *, world: DoubleArray, k1: float) -> None:
    """The photos of `write_scene` with a transforms.json in place of a COLMAP model, taken by a
    lens that bends rays by ``k1`` (OpenCV's, 0 = none)."""
    write_scene(folder, every, world=world)
    cameras = read_colmap(folder / "sparse" / "0").cameras
    shutil.rmtree(folder / "sparse")
    paths = {camera.name: folder / "images" / camera.name for camera in cameras}
    for camera in cameras:
        rows, columns = np.indices((camera.height, camera.width)) + 0.5
        bent = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(camera.K).T
        x, y = bent[..., 0], bent[..., 1]
        for _ in range(50):  # the fixed point: where the pinhole sees what the lens bent there
            bend = 1 + k1 * (x**2 + y**2)
            x, y = bent[..., 0] / bend, bent[..., 1] / bend
        straight = np.stack([x, y, np.ones_like(x)], axis=-1) @ camera.K.T
        column, row = (straight[..., k].astype(int) for k in (0, 1))
        picture = np.asarray(Image.open(paths[camera.name]))
        Image.fromarray(picture[row, column]).save(paths[camera.name], quality=95)
    file = folder / "transforms.json"
    write_transforms_json(file, cameras, paths)
    values = json.loads(file.read_text())
    file.write_text(json.dumps(values | ({"camera_model": "OPENCV", "k1": k1} if k1 else {})))


def splats_of(
    balls: dict[int, tuple[float, float, float]], seed: int
) -> tuple[Gaussians, IntArray]:
    """The floor and walls (group 1) with balls at these places, and the group of each splat."""
    rng = np.random.default_rng(seed)
    means, colors, labels = [], [], []
    for k, (axis, at) in enumerate(((2, 0.0), (1, 2.0), (0, -2.0))):
        place = rng.uniform([-2, -2, 0], [3, 2, 3], (4000, 3))
        place[:, axis] = at
        means.append(place)
        colors.append(texture(np.delete(place, axis, axis=1), k))
        labels.append(np.full(len(place), 1, np.int32))
    for group, middle in balls.items():
        out = rng.normal(size=(600, 3))
        means.append(middle + 0.25 * out / np.linalg.norm(out, axis=1, keepdims=True))
        colors.append(np.tile(_BALLS[group][1], (len(out), 1)))
        labels.append(np.full(len(out), group, np.int32))
    points = np.concatenate(means).astype(np.float32)
    n = len(points)
    gaussians = Gaussians(
        points,
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.full((n, 3), np.log(0.045), np.float32),
        np.full(n, 3.0, np.float32),
        ((np.concatenate(colors)[:, None] - 0.5) / SH_C0).astype(np.float32),
    )
    return gaussians, np.concatenate(labels)


def write_furnished(folder: Path, world: DoubleArray) -> tuple[Path, Path]:
    """Two scene folders; the second lies in another world (4, 4), and in it ball 2 moved, 3 went
    and 5 came. Ball 6 is fog: one view of the first shows it, from nobody knows how far."""
    first, second = folder / "a", folder / "b"
    places = {group: ball[0] for group, ball in _BALLS.items()}
    write_scene(first, 0)
    write_scene(second, 1, world=world)
    x, y, z = places[2]
    there = {2: (x - 0.3, y - 0.9, z), 4: places[4], 5: places[5]}
    for path, balls in ((first, {g: places[g] for g in (2, 3, 4, 6)}), (second, there)):
        gaussians, labels = splats_of(balls, seed=path is second)
        if path is second:
            scene = Scene.of(gaussians)
            edit = transform(scene, np.arange(len(scene)), world[:3])
            assert edit is not None
            edit.apply(scene)
            gaussians = bake(scene)
        column = MappingProxyType({"group": labels})
        write_ply(path / "point_cloud.ply", replace(gaussians, extra=column))
    return first, second
