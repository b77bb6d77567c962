"""A closed background: a sphere of splats behind everything that photos show.

Between few photos a new view looks past the splats of all of them, into directions that no photo
shows, and there is nothing but black. A far shell closes these gaps with the colors of what is seen
next to them. Where photos do show something it is behind that, or is trained like any other splat.
"""

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray
from gaga_core.color import rgb_from_dc
from gaga_core.gaussians import Gaussians
from gaga_core.reconstruct.cover import CameraBall
from gaga_core.reconstruct.initial import round_gaussians

_OUTSIDE = 1.5  # x distance of the farthest camera: splats beyond are background
_OUTERMOST = 0.995  # quantile of the distances of all splats that the shell encloses
_MARGIN = 1.2  # radius of the shell, x that distance or the radius of the ball of the cameras
_NEIGHBOURS = 16  # background splats whose colors a splat of the shell mixes
_GAP = 30.0  # degrees from the nearest of them: no shell beyond
_OVERLAP = 0.6  # standard deviation, x the distance from one splat of the shell to the next
_SOFT = 1e-3  # squared distance on the unit sphere that nearer neighbours do not count more for
_OPACITY = 0.95  # nothing may be seen through it: where no photo looks it stays as it is


def far_shell(splats: Gaussians, ball: CameraBall, most: int) -> Gaussians:
    """At most ``most`` splats on a sphere around ``splats`` and all cameras.

    They lie in the directions, seen from the middle of ``ball``, within `_GAP` of a background
    splat, and have the colors of these, nearer ones counting more. None at all where there is no
    background.
    """
    away = splats.means - ball.middle
    distances = np.linalg.norm(away, axis=1)
    is_background = distances > _OUTSIDE * ball.farthest
    if is_background.sum() < _NEIGHBOURS or most == 0:
        return splats.take(np.zeros(0, np.int64))
    radius = _MARGIN * max(float(np.quantile(distances, _OUTERMOST)), ball.radius)
    known = cKDTree(away[is_background] / distances[is_background, None])
    directions = even_directions(most)
    found = known.query(directions, _NEIGHBOURS)
    apart, neighbours = np.asarray(found[0]), np.asarray(found[1])
    is_near = apart[:, 0] < 2 * np.sin(np.radians(_GAP) / 2)
    weights = 1 / (apart[is_near] ** 2 + _SOFT)
    weights /= weights.sum(axis=1, keepdims=True)
    rgb = np.clip(rgb_from_dc(splats.sh[is_background, 0]), 0, 1)
    colors = (weights[..., None] * rgb[neighbours[is_near]]).sum(axis=1)
    size = _OVERLAP * np.sqrt(4 * np.pi / most) * radius
    return round_gaussians(
        ball.middle + radius * directions[is_near],
        np.full(int(is_near.sum()), size),
        colors.astype(np.float32),
        _OPACITY,
    )


def even_directions(n: int) -> DoubleArray:
    """Unit vectors (n, 3) spread evenly over the sphere: a spiral of golden angles."""
    k = np.arange(n) + 0.5
    height = 1 - 2 * k / n
    turn = np.pi * (1 + np.sqrt(5)) * k
    width = np.sqrt(1 - height**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), height], axis=1)
