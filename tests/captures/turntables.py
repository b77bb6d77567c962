"""Scanned objects on a turntable: a camera that stands still, a room that stands still with it.

The light belongs to the room, so shading and highlights do not turn along. Each photo comes with
the true mask of the object, and the true cameras as seen from the object.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.captures.scenes import _ON_TABLE, demo_model, eight_bit, photograph, save
from tools.demo.scene import posed
from tools.scenes.draw import Discs, gaussians_of
from tools.scenes.scans import read_scan

_SIZE = (640, 480)  # width, height of a photo, pixels
_DISCS = 60_000  # of an object
_PLATE = 24_000  # ... and of the plate it stands on
_LIGHT = np.array([0.4, -0.7, -0.6])  # towards it, camera frame


@dataclass(frozen=True)
class Turntable:
    """One capture."""

    scan: str  # name of the mesh
    backdrop: Literal["room", "white", "black", "blurred"] = "room"
    drift: float = 0.0  # how far brightness and white balance wander, as a share
    shine: float = 0.0  # strength of the highlights
    dark: float = 1.0  # x albedo
    hand: int = 0  # photos that a hand reaches into
    plate: bool = True  # whether a plate with a print turns along
    turned_over: bool = False  # second half of the photos: the object on its side
    n: int = 40  # photos
    fov: float = 30.0  # degrees across


TWELVE = {
    "box in a room": Turntable("003_cracker_box"),
    "bottle, drift": Turntable("006_mustard_bottle", drift=0.3),
    "dark drill": Turntable("035_power_drill", dark=0.45, shine=0.2, drift=0.1),
    "bottle on white": Turntable("021_bleach_cleanser", backdrop="white", plate=False),
    "tin, blurred": Turntable("010_potted_meat_can", backdrop="blurred", drift=0.1),
    "box and a hand": Turntable("004_sugar_box", hand=5),
    "airplane on white": Turntable("072-d_toy_airplane", backdrop="white", drift=0.15),
    "shiny can": Turntable("005_tomato_soup_can", shine=0.6),
    "long lens": Turntable("008_pudding_box", fov=14.0, backdrop="white"),
    "can on black": Turntable("009_gelatin_box", backdrop="black", plate=False),
    "bricks": Turntable("073-f_lego_duplo", drift=0.2, n=48),
    "box turned over": Turntable("003_cracker_box", turned_over=True, n=60),
}


def _object(spec: Turntable, scans: Path) -> Discs:
    """Surfaces of the object with its plate: label 1 and 0; the longest side is 1 long."""
    rng = np.random.default_rng(0)
    mesh = read_scan(scans, spec.scan).mesh
    points, normals, colors = mesh.sample(_DISCS, rng)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    length = float((high - low).max())
    points = (points - (*(low + high)[:2] / 2, low[2])) / length
    size = np.full(_DISCS, np.sqrt(mesh.area / _DISCS) / length)
    angle, radius = rng.uniform(0, 2 * np.pi, _PLATE), 0.7 * np.sqrt(rng.uniform(0, 1, _PLATE))
    flat = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * radius], axis=1)
    cells = rng.uniform(0.3, 0.8, (8, 32))
    gray = cells[(radius * 11).astype(int) % 8, (angle * 5).astype(int)]
    n = _PLATE if spec.plate else 0
    return Discs(
        np.concatenate([points, flat[:n]]),
        np.concatenate([normals, np.tile([0.0, 0, 1], (n, 1))]),
        np.concatenate([colors * spec.dark, gray[:n, None] * np.ones(3)]),
        np.concatenate([size, np.full(n, 0.7 * np.sqrt(np.pi / _PLATE))]),
        np.repeat(np.array([1, 0], np.int32), [_DISCS, n]),
    )


def _cameras(spec: Turntable, middle: DoubleArray) -> list[tuple[Camera, bool]]:
    """Cameras as seen from the object, and whether it lies on its side then."""
    found, away = [], 0.8 / np.tan(np.radians(spec.fov) / 2)
    for k in range(spec.n):
        half = spec.n // 2 if spec.turned_over else spec.n
        angle, up = 2 * np.pi * (k % half) / half, np.radians(28.0)
        ray = np.array([np.cos(angle) * np.cos(up), np.sin(angle) * np.cos(up), np.sin(up)])
        camera = posed(tuple(middle + away * ray), tuple(middle), spec.fov, _SIZE, f"{k:03d}.jpg")
        found.append((camera, spec.turned_over and k >= half))
    return found


def _backdrop(spec: Turntable) -> FloatArray:
    gaussians, labels, names = demo_model()
    width, height = _SIZE
    if spec.backdrop in ("white", "black"):
        v, u = np.mgrid[0:height, 0:width]
        shade = 1 - 0.12 * np.hypot(u / width - 0.5, v / height - 0.5)
        level = 0.97 if spec.backdrop == "white" else 0.03
        return np.repeat((level * shade)[..., None], 3, axis=2).astype(np.float32)
    wanted = [k for k, name in enumerate(names, start=1) if name in _ON_TABLE]
    room = gaussians.take(~np.isin(labels, wanted))
    still = posed((0.75, -1.75, 1.55), (0.05, 0.1, 0.95), 60.0, _SIZE)
    picture = photograph(still, room)[0]
    return gaussian_filter(picture, (7, 7, 0)) if spec.backdrop == "blurred" else picture


def _hand(rng: np.random.Generator) -> BoolArray:
    """An arm from a side to near the middle (H, W)."""
    width, height = _SIZE
    v, u = np.mgrid[0:height, 0:width]
    side, end = rng.choice([-1, 1]), rng.uniform(0.32, 0.42)
    x = (u if side < 0 else width - u) / width
    middle = rng.uniform(0.55, 0.75) + 0.2 * (end - x)
    return (x < end) & (np.abs(v / height - middle) < 0.06)


def photograph_turntable(
    spec: Turntable, scans: Path, folder: Path, masks: Path, seed: int = 0
) -> tuple[Camera, ...]:
    """Write photos to ``folder`` and masks of the object to ``masks``; return the true cameras."""
    rng, draw = np.random.default_rng(seed), CpuRasterizer()
    surface, backdrop = _object(spec, scans), _backdrop(spec)
    gaussians, labels = gaussians_of(surface, 0.0, rng)
    is_object = labels == 1
    middle = np.array([0.0, 0.0, float(surface.points[is_object, 2].max()) / 2])
    side = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from lying to standing
    with_hand = set(rng.choice(spec.n, spec.hand, replace=False).tolist())
    wander = np.cumsum(rng.normal(0, 1, (spec.n, 4)), axis=0)
    wander = (
        spec.drift * (wander - wander.mean(axis=0)) / np.abs(wander - wander.mean(axis=0)).max()
    )
    masks.mkdir(parents=True, exist_ok=True)
    true = []
    for k, (camera, lies) in enumerate(_cameras(spec, middle)):
        pose = camera.cam_from_world.copy()
        placed = gaussians
        if lies:  # the object lies, the camera sees it from where it would be if it stood
            turned = np.eye(4)
            turned[:3, :3], turned[:3, 3] = side, middle - side @ middle
            pose = pose @ turned
            placed = gaussians.take(is_object)
        true.append(replace(camera, cam_from_world=pose))
        normals = surface.normals[: len(placed)] @ pose[:3, :3].T
        towards = placed.means - true[-1].position
        towards = towards / np.linalg.norm(towards, axis=1, keepdims=True) @ pose[:3, :3].T
        light = _LIGHT / np.linalg.norm(_LIGHT)
        facing = np.clip(normals @ light, 0, 1)[:, None]
        mirrored = towards - 2 * (towards * normals).sum(axis=1, keepdims=True) * normals
        glint = spec.shine * np.clip(mirrored @ light, 0, 1)[:, None] ** 25
        colors = surface.colors[: len(placed)] * (0.55 + 0.5 * facing) + glint
        frame = draw.render(placed, true[-1], channels=np.clip(colors, 0, 1).astype(np.float32))
        picture = frame.image + (1 - frame.alpha[..., None]) * backdrop
        own = draw.render(
            placed, true[-1], channels=is_object[: len(placed), None].astype(np.float32)
        ).image[..., 0]
        if k in with_hand:
            arm = _hand(rng)
            picture[arm], own[arm] = (0.75, 0.55, 0.45), 0
        gain = (1 + wander[k, 3]) * (1 + 0.2 * wander[k, :3])
        noise = rng.normal(0, 0.006, picture.shape)
        save(folder / camera.name, eight_bit(picture * gain + noise))
        Image.fromarray(eight_bit(own > 0.5)).save(masks / f"{Path(camera.name).stem}.png")
    return tuple(true)
