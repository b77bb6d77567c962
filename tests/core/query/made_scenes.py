"""Scenes of boxes and balls in known colors, and cameras that look at them."""

import numpy as np

from gaga_core.camera import Camera
from gaga_core.color import dc_from_rgb
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.scene.scene import Scene

Boxes = list[tuple[tuple[float, float, float], tuple[float, float, float], str]]
UP = np.array([0.0, 0.0, 1.0])


def boxes_scene(boxes: Boxes, per_box: int = 300) -> Scene:
    """Solid boxes (centre, sides, color as hex) as groups 1.., splats all over them."""
    rng = np.random.default_rng(0)
    means, colors, labels = [], [], []
    for k, (centre, sides, color) in enumerate(boxes, start=1):
        means.append(np.array(centre) + (rng.random((per_box, 3)) - 0.5) * sides)
        rgb = [int(color[i : i + 2], 16) / 255 for i in (0, 2, 4)]
        colors.append(np.tile(rgb, (per_box, 1)))
        labels.append(np.full(per_box, k, np.int32))
    n = per_box * len(boxes)
    gaussians = Gaussians(
        means=np.concatenate(means).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.full((n, 3), -4.0, np.float32),
        logit_opacities=np.full(n, 3.0, np.float32),
        sh=dc_from_rgb(np.concatenate(colors).astype(np.float32))[:, None, :],
    )
    return Scene.of(gaussians, np.concatenate(labels))


def shells(boxes: Boxes, per_box: int = 400) -> Scene:
    """`boxes_scene` with the splats on the faces."""
    scene = boxes_scene(boxes, per_box)
    rng = np.random.default_rng(1)
    for k, (centre, sides, _) in enumerate(boxes, start=1):
        means = scene.gaussians.means
        own = np.flatnonzero(scene.labels == k)
        axis = rng.integers(0, 3, len(own))
        out = rng.choice((-0.5, 0.5), len(own))
        means[own, axis] = np.array(centre)[axis] + out * np.array(sides)[axis]
    return scene


def camera_at(eye: tuple[float, float, float], name: str = "front.png") -> Camera:
    K = np.array([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]])
    return Camera(K, look_at(np.array(eye), np.zeros(3), UP), 640, 480, name)


FRONT, BACK = camera_at((0, -4, 1)), camera_at((0, 4, 1), "zback.png")
# A red cube left, a large blue box in the middle, a yellow cube right, a small green one on the
# blue box, a red slab behind, and the floor.
TABLE: Boxes = [
    ((-1.0, 0, 0.1), (0.2, 0.2, 0.2), "c81414"),
    ((0.0, 0, 0.25), (0.5, 0.4, 0.5), "1e50c8"),
    ((0.9, 0, 0.15), (0.3, 0.3, 0.3), "f0d010"),
    ((0.0, 0, 0.55), (0.1, 0.1, 0.1), "209030"),
    ((0.4, 1.2, 0.2), (0.6, 0.1, 0.4), "a01010"),
    ((0.0, 0, -0.01), (6.0, 6.0, 0.02), "8a8a8a"),
]


def ball(n: int, radius: float) -> Scene:
    """Grey splats all over a sphere, as group 1."""
    out = np.random.default_rng(0).normal(size=(n, 3))
    out *= radius / np.linalg.norm(out, axis=1, keepdims=True)
    scene = boxes_scene([((0, 0, 0), (1.0,) * 3, "808080")], n)
    g = scene.gaussians
    moved = Gaussians(out.astype(np.float32), g.quats, g.log_scales, g.logit_opacities, g.sh)
    return Scene.of(moved, scene.labels)
