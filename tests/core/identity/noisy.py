"""A scene of known groups: how large it is, and how an identity field is scored on it."""

from collections.abc import Sequence

import numpy as np

from gaga_core.camera import Camera
from gaga_core.identity.field import IdentityField, decode_view
from gaga_core.identity.rows import RowConfig
from gaga_core.raster import choose
from tests.core.grouping.true_masks import true_map
from tests.scenes import Synthetic

Views = Sequence[Camera]
G = 6  # five balls and the floor
ROWS = RowConfig(per_view=1500)
HELD_OUT = (3, 7)  # views


def right_pixels(scene: Synthetic, field: IdentityField) -> float:
    """Share of right pixels on the two views left out, against the true maps."""
    right = []
    for camera in (scene.cameras[i] for i in HELD_OUT):
        truth = true_map(scene, camera)
        shown = decode_view(field, scene.gaussians, camera, choose(), void_below=0.3).labels
        right.append((shown == truth)[truth > 0].mean())
    return float(np.mean(right))
