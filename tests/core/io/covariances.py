"""Covariances: what rotations and sizes say together, whatever they are called."""

import numpy as np

from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices


def covariances(g: Gaussians) -> np.ndarray:
    """(N, 3, 3) world."""
    axes = quats_to_matrices(g.quats) * np.exp(g.log_scales.astype(np.float64))[:, None, :]
    return axes @ axes.transpose(0, 2, 1)
