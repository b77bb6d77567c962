"""Captures made of the demo scene: pictures of it with the faults that real ones have.

Every function writes photos (or a film) and returns what a test has to know. The same seed gives
the same pictures.
"""

import subprocess
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import convolve, gaussian_filter, rotate

from gaga_core.arrays import AnyArray, FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.io.images import read_rgb
from gaga_core.io.video import ffmpeg_program
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.core.placing.photo_scenes import texture, write_photos
from tools.demo.scene import build, photo_cameras, posed

SIZE = (400, 300)  # width, height of a photo, pixels
_ON_TABLE = (
    *("teapot", "mug", "plate", "doughnut", "vase", "flowers", "fruit bowl", "apple", "orange"),
    *("green apple", "lemon", "bananas", "candle", "oil bottle", "table runner"),
)
_MIDDLE = (0.15, 0.0, 0.82)  # of what stands on the table, world

Effect = Callable[[UInt8Array, np.random.Generator], UInt8Array]


@cache
def demo_model() -> tuple[Gaussians, IntArray, tuple[str, ...]]:
    """The demo's splats, the object of each, and the objects' names."""
    model = build(120_000, 0)
    return model.gaussians, model.labels, model.names


def photograph(camera: Camera, gaussians: Gaussians | None = None) -> tuple[FloatArray, FloatArray]:
    """Picture (H, W, 3), 0..1, and alpha (H, W) of the demo, or of some of its splats."""
    frame = CpuRasterizer().render(demo_model()[0] if gaussians is None else gaussians, camera)
    return np.clip(frame.image, 0, 1), frame.alpha


def eight_bit(picture: AnyArray) -> UInt8Array:
    """A picture of 0..1 as bytes."""
    values = np.clip(np.asarray(picture, np.float64), 0, 1)
    return np.round(values * 255).astype(np.uint8)


def save(path: Path, picture: UInt8Array, quality: int = 93) -> None:
    """Write a JPEG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(path, quality=quality)


def demo_cameras(n: int) -> tuple[Camera, ...]:
    """Cameras of the demo's own sweep, without the overview."""
    return photo_cameras(n + 1, SIZE, np.random.default_rng(0))[1:]


# --- faults of single photos


def motion_blurred(length: int) -> Effect:
    """The camera moved while the shutter was open: along a line of ``length`` pixels."""

    def effect(picture: UInt8Array, rng: np.random.Generator) -> UInt8Array:
        line = np.zeros((length, length))
        line[length // 2] = 1
        kernel = rotate(line, rng.uniform(0, 180), reshape=False, order=1)
        kernel /= kernel.sum()
        values = convolve(picture / 255.0, kernel[..., None], mode="nearest")
        return eight_bit(values)

    return effect


def out_of_focus(sigma: float) -> Effect:
    """A Gaussian of ``sigma`` pixels."""

    def effect(picture: UInt8Array, rng: np.random.Generator) -> UInt8Array:
        return eight_bit(gaussian_filter(picture / 255.0, (sigma, sigma, 0)))

    return effect


def exposed(least: float, most: float) -> Effect:
    """Another gain and another white balance in each photo, with its highlights clipped."""

    def effect(picture: UInt8Array, rng: np.random.Generator) -> UInt8Array:
        gain = np.exp(rng.uniform(np.log(least), np.log(most)))
        return eight_bit(picture / 255.0 * gain * rng.uniform(0.92, 1.08, 3))

    return effect


def walk(
    folder: Path,
    n: int = 16,
    *,
    effect: Effect | None = None,
    share: float = 1.0,  # of the photos that the effect is applied to, evenly spread
    seed: int = 0,
) -> tuple[str, ...]:
    """``n`` photos of a walk around the table; returns the names of those with the effect."""
    rng, changed = np.random.default_rng(seed), []
    for k, camera in enumerate(demo_cameras(n)):
        picture = eight_bit(photograph(camera)[0])
        if effect is not None and int((k + 1) * share) > int(k * share):
            picture = effect(picture, rng)
            changed.append(camera.name)
        save(folder / camera.name, picture)
    return tuple(changed)


def with_copies(folder: Path, n: int = 12, copies: int = 6) -> tuple[str, ...]:
    """A walk of which some photos lie there twice: smaller and compressed again, as from a chat."""
    walk(folder, n)
    names = []
    for path in sorted(folder.iterdir())[:copies]:
        with Image.open(path) as image:
            small = image.resize((SIZE[0] * 3 // 4, SIZE[1] * 3 // 4), Image.Resampling.LANCZOS)
        names.append(f"{path.stem}-sent.jpg")
        small.save(folder / names[-1], quality=55)
    return tuple(names)


def two_scenes(folder: Path, n: int = 12) -> None:
    """``n`` photos of the demo and as many of the corner of a room: a_*.jpg and b_*.jpg."""
    walk(folder, n)
    for path in sorted(folder.iterdir()):
        path.rename(path.with_name(f"a_{path.name}"))
    write_photos(folder / "room", n, seed=3)
    for path in sorted((folder / "room").iterdir()):
        path.rename(folder / f"b_{path.name}")
    (folder / "room").rmdir()


def equal_walls(folder: Path, n: int = 24) -> None:
    """``n`` photos all around a square room of four walls with the same pattern.

    Only the floor tells one side from another.
    """
    width, height = SIZE
    v, u = np.mgrid[0:height, 0:width] + 0.5
    for k in range(n):
        angle = 2 * np.pi * (k + 0.23 * np.sin(7 * k)) / n
        eye = (1.3 * np.cos(angle), 1.3 * np.sin(angle), 1.2 + 0.2 * np.sin(3 * angle + k))
        camera = posed(eye, (-np.cos(angle), -np.sin(angle), 0.8), 50.0, SIZE)
        rays = np.stack([u, v, np.ones_like(u)], axis=2) @ np.linalg.inv(camera.K).T
        rays = rays @ camera.cam_from_world[:3, :3]
        picture, nearest = np.zeros((height, width, 3)), np.full((height, width), np.inf)
        for axis, at in ((2, 0.0), (0, 2.0), (0, -2.0), (1, 2.0), (1, -2.0)):
            with np.errstate(divide="ignore", invalid="ignore"):
                far = (at - eye[axis]) / rays[..., axis]
            hit = (far > 0) & (far < nearest)
            x, y, z = np.moveaxis(eye + far[..., None] * rays, 2, 0)
            turn = np.sign(at) if axis == 0 else -np.sign(at)
            wall = np.stack([turn * (y if axis == 0 else x), z], axis=2)
            floor = np.stack([x, y], axis=2)
            shade = texture(floor, 5) if axis == 2 else texture(wall, 1)
            picture[hit], nearest[hit] = shade[hit], far[hit]
        save(folder / f"{k:03d}.jpg", eight_bit(picture))


# --- objects without their room


def _objects() -> Gaussians:
    gaussians, labels, names = demo_model()
    wanted = [k for k, name in enumerate(names, start=1) if name in _ON_TABLE]
    return gaussians.take(np.isin(labels, wanted))


def _ring(n: int, radius: float, height: float, fov: float) -> tuple[Camera, ...]:
    """``n`` cameras all around what stands on the table."""
    found = []
    for k in range(n):
        angle = 2 * np.pi * k / n
        up = _MIDDLE[2] + height + 0.12 * np.sin(3 * angle)
        eye = (_MIDDLE[0] + radius * np.cos(angle), _MIDDLE[1] + radius * np.sin(angle), up)
        found.append(posed(eye, _MIDDLE, fov, SIZE, f"{k:03d}.jpg"))
    return tuple(found)


def on_white(folder: Path, n: int = 24, *, fov: float = 46.0) -> tuple[Camera, ...]:
    """Objects on featureless white, all around; returns the true cameras."""
    objects, cameras = _objects(), _ring(n, 1.1, 0.65, fov)
    for camera in cameras:
        picture, alpha = photograph(camera, objects)
        save(folder / camera.name, eight_bit(picture + (1 - alpha[..., None])))
    return cameras


def turntable(folder: Path, masks: Path | None = None, n: int = 36) -> tuple[Camera, ...]:
    """Objects turned in front of a room that stands still, with a camera that stands still.

    To ``masks`` go pictures of where the objects are, white on black. Returns the true cameras as
    seen from the objects.
    """
    gaussians, labels, names = demo_model()
    objects = _objects()
    wanted = [k for k, name in enumerate(names, start=1) if name in _ON_TABLE]
    room = gaussians.take(~np.isin(labels, wanted))
    still = posed((0.75, -1.75, 1.55), (0.05, 0.1, 0.95), 60.0, SIZE)
    background = photograph(still, room)[0]
    cameras = _ring(n, 1.1, 0.65, 42.0)
    for camera in cameras:
        picture, alpha = photograph(camera, objects)
        save(folder / camera.name, eight_bit(picture + (1 - alpha[..., None]) * background))
        if masks is not None:
            masks.mkdir(parents=True, exist_ok=True)
            Image.fromarray(eight_bit(alpha > 0.5)).save(masks / f"{Path(camera.name).stem}.png")
    return cameras


# --- films


def film(path: Path, pictures: Sequence[UInt8Array], fps: float) -> Path:
    """Write ``pictures`` (H, W, 3), all of one size, as an H.264 film."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = pictures[0].shape[:2]
    command = [ffmpeg_program(), "-nostdin", "-v", "error", "-y", "-f", "rawvideo"]
    command += ["-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "pipe:0"]
    command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", str(path)]
    subprocess.run(command, input=b"".join(p.tobytes() for p in pictures), check=True)
    return path


def photos_of(folder: Path, n: int) -> list[UInt8Array]:
    """The first ``n`` pictures of a folder."""
    return [read_rgb(path) for path in sorted(folder.iterdir())[:n]]


def shaken(pictures: Sequence[UInt8Array], seed: int = 0) -> list[UInt8Array]:
    """The same film from an unsteady hand: most frames are smeared, some hardly."""
    rng, found = np.random.default_rng(seed), []
    for picture in pictures:
        length = int(rng.choice([3, 5, 9, 13], p=[0.35, 0.25, 0.2, 0.2]))
        found.append(motion_blurred(length)(picture, rng))
    return found


def pan_film(path: Path, n: int = 48, fps: float = 6.0) -> Path:
    """A film along an arc in front of the table; for a quarter of its time it rests."""
    pictures = []
    share = np.concatenate([np.linspace(0, 0.5, n * 3 // 8), np.full(n // 4, 0.5)])
    share = np.concatenate([share, np.linspace(0.5, 1, n - len(share))])
    for t in share:
        angle = np.radians(-115 + 100 * t)
        eye = (1.7 * np.cos(angle), 1.7 * np.sin(angle), 1.5 + 0.2 * np.sin(7 * t))
        pictures.append(eight_bit(photograph(posed(eye, (0.05, 0, 0.85), 50.0, SIZE))[0]))
    return film(path, pictures, fps)


def two_arcs(folder: Path, n: int = 8, gap: float = 50.0) -> tuple[Camera, ...]:
    """Two arcs of ``n`` photos in front of the table, ``gap`` degrees apart, and none between."""
    cameras = []
    for name, first in (("a", -91.0 - gap / 2), ("b", -51.0 + gap / 2)):
        for k in range(n):
            angle = np.radians(first + 40.0 * k / (n - 1))
            distance = 1.6 + 0.25 * ((k * 0.618) % 1)
            eye = (
                distance * np.cos(angle),
                distance * np.sin(angle),
                1.2 + 0.35 * ((k * 0.382) % 1),
            )
            camera = posed(eye, (0.05, 0.02, 0.85), 50.0, SIZE, f"{name}_{k:02d}.jpg")
            save(folder / camera.name, eight_bit(photograph(camera)[0]))
            cameras.append(camera)
    return tuple(cameras)
