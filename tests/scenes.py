"""Small synthetic scenes that tests share: known splats, known groups, known cameras."""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at


@dataclass(frozen=True)
class Synthetic:
    gaussians: Gaussians
    labels: IntArray  # (N,) true group of each splat: 1..G, 0 = floor
    cameras: tuple[Camera, ...]


def random_gaussians(
    n: int, *, seed: int = 0, sh_degree: int = 0, extent: float = 1.0
) -> Gaussians:
    """Anisotropic splats in a cube of half-side ``extent``: opacities and sizes of all kinds."""
    rng = np.random.default_rng(seed)
    n_sh = (sh_degree + 1) ** 2
    sh = rng.normal(0, 0.25, (n, n_sh, 3))
    sh[:, 0] = rng.uniform(-1.2, 1.2, (n, 3))
    return Gaussians(
        means=rng.uniform(-extent, extent, (n, 3)).astype(np.float32),
        quats=rng.normal(size=(n, 4)).astype(np.float32),
        log_scales=np.log(rng.uniform(0.01, 0.08, (n, 3)) * extent).astype(np.float32),
        logit_opacities=rng.normal(0.5, 2.0, n).astype(np.float32),
        sh=sh.astype(np.float32),
    )


def orbit_cameras(
    n: int, *, width: int = 160, height: int = 120, radius: float = 3.2, target_height: float = 0.0
) -> tuple[Camera, ...]:
    """``n`` cameras on a ring around the origin, z up, looking inwards and down."""
    focal = 0.9 * width
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    cameras = []
    for i in range(n):
        angle = 2 * np.pi * i / n
        lift = 1.2 + 0.4 * np.sin(3 * angle)
        eye = np.array([radius * np.cos(angle), radius * np.sin(angle), lift])
        pose = look_at(eye, np.array([0, 0, target_height]), np.array([0, 0, 1.0]))
        cameras.append(Camera(K, pose, width, height, f"{i:03d}.png"))
    return tuple(cameras)


def objects_scene(
    n_objects: int = 6,
    per_object: int = 400,
    *,
    seed: int = 0,
    n_cameras: int = 8,
    sh_degree: int = 0,
) -> Synthetic:
    """Opaque balls of one color each on a floor; labels say which splat belongs to which ball."""
    rng = np.random.default_rng(seed)
    means, normals, colors, labels, sizes = [], [], [], [], []
    floor = np.c_[rng.uniform(-1.5, 1.5, (per_object * 3, 2)), np.full(per_object * 3, -0.3)]
    means.append(floor)
    normals.append(np.tile([0, 0, 1.0], (len(floor), 1)))
    colors.append(np.full((len(floor), 3), 0.35) + rng.normal(0, 0.02, (len(floor), 3)))
    labels.append(np.zeros(len(floor), np.int32))
    sizes.append(np.full(len(floor), 0.05))
    for k in range(n_objects):
        angle = 2 * np.pi * k / n_objects
        centre = np.array([0.9 * np.cos(angle), 0.9 * np.sin(angle), 0.0])
        out = rng.normal(size=(per_object, 3))
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        means.append(centre + 0.28 * out)
        normals.append(out)
        colors.append(np.tile(rng.uniform(0.15, 0.95, 3), (per_object, 1)))
        labels.append(np.full(per_object, k + 1, np.int32))
        sizes.append(np.full(per_object, 0.03))
    n = sum(len(m) for m in means)
    n_sh = (sh_degree + 1) ** 2
    sh = rng.normal(0, 0.1, (n, n_sh, 3))
    sh[:, 0] = (np.concatenate(colors) - 0.5) / 0.28209479177387814
    size = np.concatenate(sizes)
    gaussians = Gaussians(
        means=np.concatenate(means).astype(np.float32),
        quats=_facing(np.concatenate(normals)).astype(np.float32),
        log_scales=np.log(np.stack([size, size, size * 0.15], axis=1)).astype(np.float32),
        logit_opacities=np.full(n, 3.0, np.float32),
        sh=sh.astype(np.float32),
    )
    return Synthetic(gaussians, np.concatenate(labels), orbit_cameras(n_cameras))


def _facing(normals: DoubleArray) -> DoubleArray:
    """Quaternions wxyz that turn the z axis into ``normals`` (N, 3)."""
    w = 1 + normals[:, 2]
    quats = np.stack([w, -normals[:, 1], normals[:, 0], np.zeros(len(w))], axis=1)
    quats[w < 1e-6] = [0, 1, 0, 0]
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def box_on_table(gap: float = 0.0) -> Gaussians:
    """A box of 80 x 60 x 100 mm, group 1, ``gap`` over a table, group 2, in axes of a .ply."""
    rng = np.random.default_rng(0)
    face, rows = rng.integers(0, 5, 3000), np.arange(3000)
    points = rng.uniform(-0.5, 0.5, (3000, 3))
    points[rows, np.array([0, 0, 2, 2, 1])[face]] = np.array([-0.5, 0.5, -0.5, 0.5, 0.5])[face]
    points = points * [0.08, 0.1, 0.06] + [0, 0.05 + gap, 0]
    table = rng.uniform([-0.4, 0, -0.4], [0.4, 0, 0.4], (6000, 3))
    means = np.vstack([points, table]) * [1, -1, -1]
    return replace(
        random_gaussians(9000),
        means=means.astype(np.float32),
        log_scales=np.full((9000, 3), np.log(0.0025), np.float32),
        logit_opacities=np.full(9000, 4, np.float32),
        extra={"group": np.repeat([1, 2], [3000, 6000]).astype(np.int32)},
    )
