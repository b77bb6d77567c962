"""Photos of a textured room for tests of structure from motion: small, and rich in corners."""

from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import DoubleArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.geometry import look_at

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0


def walk_cameras(n: int, *, seed: int = 0) -> tuple[Camera, ...]:
    """``n`` cameras on an arc before the corner of the room."""
    rng = np.random.default_rng(seed)
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
    cameras = []
    for i, angle in enumerate(np.linspace(-0.5, 0.5, n)):
        eye = np.array([4 * np.sin(angle), -4 * np.cos(angle), 1.4]) + rng.normal(0, 0.05, 3)
        pose = look_at(eye, np.array([0, 0.4, 0.8]), np.array([0, 0, 1.0]))
        cameras.append(Camera(K, pose, WIDTH, HEIGHT, f"{i:03d}.jpg"))
    return tuple(cameras)


def photograph(camera: Camera, *, seed: int = 0) -> UInt8Array:
    """Picture (H, W, 3) of the room."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([(u - camera.K[0, 2]) / FOCAL, (v - camera.K[1, 2]) / FOCAL, 0 * u + 1], axis=2)
    return _seen(camera.position, rays @ camera.cam_from_world[:3, :3], seed)


def panorama(eye: DoubleArray, height: int) -> UInt8Array:
    """Equirectangular picture (H, 2 H, 3) of the room, with y ahead and z up."""
    v, u = (np.mgrid[0:height, 0 : 2 * height] + 0.5) * np.pi / height
    rays = [-np.sin(v) * np.sin(u), -np.sin(v) * np.cos(u), np.cos(v)]
    return _seen(eye, np.stack(rays, axis=2), 0)


def _seen(eye: DoubleArray, rays: DoubleArray, seed: int) -> UInt8Array:
    """What rays (H, W, 3) hit: three textured planes that meet in a corner, exactly."""
    nearest = np.full(rays.shape[:2], np.inf)
    picture = np.zeros(rays.shape)
    for k, (axis, at) in enumerate(((2, 0.0), (1, 2.0), (0, -2.0))):
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (at - eye[axis]) / rays[..., axis]
        hit = (distance > 0) & (distance < nearest)
        where = eye + distance[..., None] * rays
        others = [i for i in range(3) if i != axis]
        picture[hit] = texture(where[hit][:, others], seed * 10 + k)
        nearest[hit] = distance[hit]
    return np.clip(picture * 255, 0, 255).astype(np.uint8)


def write_photos(folder: Path, n: int, *, seed: int = 0) -> tuple[Camera, ...]:
    """``n`` photos in ``folder``; returns the true cameras."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = walk_cameras(n)
    for camera, picture in zip(cameras, photographs(n, seed), strict=True):
        Image.fromarray(picture).save(folder / camera.name, quality=95)
    return cameras


@cache
def photographs(n: int, seed: int) -> list[UInt8Array]:
    """Pictures of the room by `walk_cameras`, not to be changed."""
    return [photograph(camera, seed=seed) for camera in walk_cameras(n)]


def texture(places: DoubleArray, seed: int) -> DoubleArray:
    """Blocks of random color at three sizes, smoothly blended between: never the same twice."""
    result = np.zeros((*places.shape[:-1], 3))
    for level, size in enumerate((0.5, 0.2, 0.08)):
        table = np.random.default_rng(seed * 7 + level).uniform(0, 1, (64, 64, 3))
        cells = np.nan_to_num(places / size, posinf=0, neginf=0)
        low = np.floor(cells).astype(np.int64)
        mix = np.clip((cells - low) * 4 - 1.5, 0, 1)[..., None]
        corner = [
            [table[(low[..., 0] + i) % 64, (low[..., 1] + j) % 64] for j in (0, 1)] for i in (0, 1)
        ]
        across = [c[0] * (1 - mix[..., 1, :]) + c[1] * mix[..., 1, :] for c in corner]
        result += (across[0] * (1 - mix[..., 0, :]) + across[1] * mix[..., 0, :]) / 3
    return result
