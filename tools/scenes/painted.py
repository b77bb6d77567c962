"""Generated scenes whose objects are painted with stripes and lit from one side, with photos."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.color import dc_from_rgb
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.raster import choose
from tools.scenes.parts import parts_scene
from tools.scenes.rooms import bench_scene

PaintedKind = Literal["room", "table", "contents", "parts"]
PAINTED_KINDS: tuple[PaintedKind, ...] = get_args(PaintedKind)
_ROOM_PARTS = 3  # labels of floor and walls, after those of the objects
_N_TRAIN, _SIZE = 40, (480, 360)  # views; pixels


@dataclass(frozen=True, eq=False)
class Painted:
    """A scene with photos and truth."""

    gaussians: Gaussians  # in the colors of the photos
    labels: IntArray  # (N,) object 1.., 0 = room and floaters
    photos: Mapping[str, UInt8Array]  # (H, W, 3) of the train views
    train: tuple[Camera, ...]
    test: tuple[Camera, ...]
    truth: Mapping[str, IntArray]  # (H, W) of the test views, 0 = room


def painted_scene(kind: PaintedKind, seed: int) -> Painted:
    """The scene of one seed: rooms, tables and contents of 40 photos, objects of parts of 20."""
    made = (
        parts_scene(seed)
        if kind == "parts"
        else bench_scene(kind, seed, n_train=_N_TRAIN, size=_SIZE)
    )
    n_things = int(made.labels.max()) - _ROOM_PARTS
    labels = np.where(made.labels > n_things, 0, made.labels).astype(np.int32)
    colors = _colors(made.gaussians, labels, np.random.default_rng(seed))
    photos = {}
    for camera in made.train:
        image = choose("cpu").render(made.gaussians, camera, channels=colors).image
        photos[camera.name] = (np.clip(image, 0, 1) * 255).astype(np.uint8)
    truth = {c.name: made.truth[c.name] for c in made.test}
    objects = {name: np.where(t > n_things, 0, t).astype(np.int32) for name, t in truth.items()}
    painted = replace(made.gaussians, sh=np.ascontiguousarray(dc_from_rgb(colors)[:, None]))
    return Painted(painted, labels, photos, made.train, made.test, objects)


def _colors(gaussians: Gaussians, labels: IntArray, rng: np.random.Generator) -> FloatArray:
    """Colors (N, 3) by label, with stripes and light."""
    n = int(labels.max()) + 1
    one = rng.uniform(0.1, 0.9, (n, 3))
    two = np.clip(one + rng.normal(0, 0.2, (n, 3)), 0, 1)
    wave: DoubleArray = (gaussians.means * rng.uniform(10, 60, (n, 3))[labels]).sum(axis=1)
    thinnest = gaussians.log_scales.argmin(axis=1)
    normals = quats_to_matrices(gaussians.quats)[np.arange(len(labels)), :, thinnest]
    light = 0.45 + 0.55 * np.abs(normals @ np.array([0.3, -0.5, 0.8]))
    color = np.where(np.sin(wave)[:, None] > 0, one[labels], two[labels]) * light[:, None]
    return np.ascontiguousarray(color, dtype=np.float32)
