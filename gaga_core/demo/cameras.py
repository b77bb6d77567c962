"""Where the demo's photos are taken: one overview, then a half ring around the open side."""

import numpy as np

from gaga_core.camera import Camera
from gaga_core.demo.config import DemoConfig
from gaga_core.geometry import look_at

OVERVIEW = ((0.75, -2.05, 1.62), (0.02, 0.05, 0.93), 42.0)  # eye, target, field of view (degrees)
_GOLDEN = 0.6180339887498949
_UP = np.array([0.0, 0.0, 1.0])


def posed(
    eye: tuple[float, float, float],
    target: tuple[float, float, float],
    fov: float,
    size: tuple[int, int],
    name: str = "",
) -> Camera:
    """Camera with vertical field of view ``fov`` (degrees) and ``size`` (width, height)."""
    width, height = size
    focal = 0.5 * height / np.tan(np.radians(fov) / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(K, look_at(np.array(eye), np.array(target), _UP), width, height, name)


def demo_cameras(config: DemoConfig | None = None) -> tuple[Camera, ...]:
    """The cameras of the demo's photos, before there is a folder of it."""
    wanted = config or DemoConfig()
    rng = np.random.default_rng((wanted.seed, 1))
    return photo_cameras(wanted.n_views, (wanted.width, wanted.height), rng)


def photo_cameras(n: int, size: tuple[int, int], rng: np.random.Generator) -> tuple[Camera, ...]:
    """``n`` cameras named ``view_000.jpg`` ...: the overview, then a sweep from the left wall round
    the front to the back wall. Height and distance walk by the golden ratio, so that neighbours
    differ; every camera stands inside the room's open side and looks at the table."""
    eye, target, fov = OVERVIEW
    found = [posed(eye, target, fov + 6, size, "view_000.jpg")]
    for k in range(n - 1):
        azimuth = np.radians(-124 + 146 * (k + 0.5) / (n - 1))
        distance = 1.35 + 0.75 * ((k * _GOLDEN) % 1.0)
        height = 1.02 + 1.0 * ((k * _GOLDEN * _GOLDEN + 0.35) % 1.0)
        place = (distance * np.cos(azimuth), distance * np.sin(azimuth), height)
        aim = rng.uniform((-0.22, -0.08, 0.78), (0.28, 0.16, 1.00))
        look = (float(aim[0]), float(aim[1]), float(aim[2]))
        found.append(posed(place, look, 50.0, size, f"view_{k + 1:03d}.jpg"))
    return tuple(found)


def split(names: list[str]) -> dict[str, list[str]]:
    """Every eighth view, from the fifth on, is for testing; the overview is for training."""
    test = names[4::8]
    return {"train": [n for n in names if n not in test], "test": test}
