"""Choosing a cut: which nodes are divided, so that no more splats than a budget are drawn."""

import math

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.kernels import kernel


@kernel
def node_errors(
    boxes: FloatArray,  # (M, 6) lo, hi, world
    details: FloatArray,  # (M,) scene units
    pose: DoubleArray,  # (3, 4) cam_from_world
    lens: DoubleArray,  # fx, fy, cx, cy, width, height, near, margin in pixels
    outside: float,  # factor of the error of nodes that are not in the picture
    errors: FloatArray,  # (M,) out, pixels
    seen: BoolArray,  # (M,) out
) -> None:
    """Size in pixels of what each node cannot show, and whether it can be in the picture.

    The nearest point of a node's box says how large it is drawn; it is out of the picture when all
    eight corners lie beyond one of its sides.
    """
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    width, height, near, margin = lens[4], lens[5], lens[6], lens[7]
    focal = max(fx, fy)
    eye = np.empty(3)
    for a in range(3):
        eye[a] = -(pose[0, a] * pose[0, 3] + pose[1, a] * pose[1, 3] + pose[2, a] * pose[2, 3])
    for i in range(boxes.shape[0]):
        square = 0.0
        for a in range(3):
            d = max(boxes[i, a] - eye[a], eye[a] - boxes[i, 3 + a], 0.0)
            square += d * d
        behind = left = right = above = below = 0
        for corner in range(8):
            x = boxes[i, 0 if corner & 1 == 0 else 3]
            y = boxes[i, 1 if corner & 2 == 0 else 4]
            z = boxes[i, 2 if corner & 4 == 0 else 5]
            tx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
            ty = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
            tz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
            behind += tz < near
            # Planes through the eye: also right for corners behind it.
            left += fx * tx + (cx + margin) * tz < 0
            right += fx * tx + (cx - width - margin) * tz > 0
            above += fy * ty + (cy + margin) * tz < 0
            below += fy * ty + (cy - height - margin) * tz > 0
        seen[i] = behind < 8 and left < 8 and right < 8 and above < 8 and below < 8
        error = focal * details[i] / max(math.sqrt(square), near)
        errors[i] = error if seen[i] else outside * error


@kernel
def divide(
    errors: FloatArray,  # (M,)
    seen: BoolArray,  # (M,)
    counts: IntArray,  # (M,) splats of each node
    levels: IntArray,  # (L + 1,) first node of each level, and of all
    fan: int,
    least: float,  # nodes with a greater error are divided
    divided: BoolArray,  # (M,) out
) -> tuple[int, int]:
    """Divide from the top down; splats of the cut that are seen, and all of the cut."""
    n_levels = levels.shape[0] - 1
    divided[:] = False
    n_seen = n_all = 0
    for level in range(n_levels - 1, -1, -1):
        for i in range(levels[level], levels[level + 1]):
            if level < n_levels - 1:
                parent = levels[level + 1] + (i - levels[level]) // fan
                if not divided[parent]:
                    continue
            if level > 0 and errors[i] > least:
                divided[i] = True
            else:
                n_all += counts[i]
                if seen[i]:
                    n_seen += counts[i]
    return n_seen, n_all
