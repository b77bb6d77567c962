"""Where the balls of the small scene are in the picture, and how much of them is selected."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_studio.session.session import Session
from tests.app.tools.hand import H, W

BALL = 0.28  # radius


def balls(session: Session) -> tuple[DoubleArray, DoubleArray]:
    """Pixels (2, 2) of the nearest two balls, and their centres (2, 3)."""
    angles = 2 * np.pi * np.arange(5) / 5
    centres = np.stack([0.9 * np.cos(angles), 0.9 * np.sin(angles), 0 * angles], axis=1)
    pixels, depth = session.rig.camera(W, H).project(centres)
    nearest = np.argsort(depth)[:2]
    return pixels[nearest], centres[nearest]


def chosen_in_balls(session: Session) -> list[int]:
    """How many of the selected splats lie in each of the two balls, and outside of both."""
    assert session.scene is not None
    means = session.scene.gaussians.means[session.selected_indices()]
    away = np.linalg.norm(means[:, None] - balls(session)[1], axis=2)
    inside = away < 1.1 * BALL
    return [*inside.sum(axis=0).tolist(), int((~inside.any(axis=1)).sum())]
