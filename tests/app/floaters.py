"""A scene with an object that has floaters."""

from dataclasses import replace

import numpy as np

from gaga_core.scene.scene import Scene
from tests.scenes import objects_scene

GROUP, PER = 3, 400


def planted(n: int = 20) -> tuple[Scene, np.ndarray]:
    """Balls of which the third has floaters high above it; their rows."""
    made = objects_scene(4, PER)
    rows = np.flatnonzero(made.labels == GROUP)[:n]
    means = made.gaussians.means.copy()
    means[rows] += np.array([0, 0, 2.5], np.float32)
    means[rows, :2] += np.random.default_rng(1).uniform(-1, 1, (n, 2)).astype(np.float32)
    return Scene.of(replace(made.gaussians, means=means), made.labels), rows
