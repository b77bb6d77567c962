"""Views from which a scene is looked at before it can be clicked: its photos', or all around."""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.geometry import look_at
from gaga_core.scene.orientation import estimate_up, upright_basis
from gaga_core.scene.selection.bounds import robust_box

_MOST = 24  # views
_EVERY = 3  # of them
_SIDE = 480  # pixels, longer side of a view
_RINGS = ((-15.0, 5), (20.0, 8), (50.0, 6))  # elevation in degrees, views around
_FIELD = np.radians(50.0)  # field of view
_ROOM = 1.15  # times the distance at which the scene's ball fills a view


def click_views(cameras: Sequence[Camera], means: FloatArray) -> tuple[Camera, ...]:
    """At most 24 views, 480 pixels or less, that show what can be clicked.

    ``cameras`` are those of the photos, taken evenly in their order; without any, views around the
    splats with centres ``means`` (N, 3).
    """
    if not cameras:
        return _around(means)
    n = min(_MOST, len(cameras))
    chosen = np.linspace(0, len(cameras) - 1, n).round().astype(int)
    return tuple(_small(cameras[i]) for i in np.unique(chosen))


def loss_views(cameras: Sequence[Camera], means: FloatArray) -> tuple[Camera, ...]:
    """Some of these views: enough to judge what fewer splats (`decimate`) lose."""
    return click_views(cameras, means)[::_EVERY]


def _small(camera: Camera) -> Camera:
    scale = min(1.0, _SIDE / max(camera.width, camera.height))
    size = (max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
    return camera.resized(*size)


def _around(means: FloatArray) -> tuple[Camera, ...]:
    """Views on rings around the box that holds nearly all splats, towards its middle."""
    low, high = robust_box(means, 0.98)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    distance = _ROOM * max(radius, 1e-6) / np.sin(_FIELD / 2)
    up = estimate_up(())
    world_from_upright = upright_basis(up).T
    focal = 0.5 * _SIDE / np.tan(_FIELD / 2)
    K = np.array([[focal, 0, _SIDE / 2], [0, focal, _SIDE / 2], [0, 0, 1.0]])
    views: list[Camera] = []
    for elevation, n in _RINGS:
        for k in range(n):
            way = world_from_upright @ _direction(np.radians(elevation), 2 * np.pi * k / n)
            pose = look_at(middle + distance * way, middle, up)
            views.append(Camera(K, pose, _SIDE, _SIDE, f"around {len(views)}"))
    return tuple(views)


def _direction(elevation: float, azimuth: float) -> DoubleArray:
    across = np.cos(elevation)
    return np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])
