"""Section 3.2 of the paper mask by mask, with Python sets and floats: slow, and plain to read."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.grouping.gate import GateConfig
from gaga_core.grouping.memory_bank import Decision


@dataclass(frozen=True)
class View:
    camera: Camera
    labels: IntArray  # (H, W)
    depth: FloatArray  # (H, W)
    alpha: FloatArray  # (H, W)


def behind_mask(means: FloatArray, view: View, mask: int, config: GateConfig) -> set[int]:
    """G(m), read off the paper."""
    seen = (view.labels == mask) & (view.alpha >= config.alpha_min) & (view.depth > 0)
    depths = view.depth[seen].astype(np.float64)
    if len(depths) == 0:
        return set()
    q1, q2, q3 = np.quantile(depths, [0.25, 0.5, 0.75])
    width = config.iqr_factor * max(q3 - q1, config.iqr_floor * q2)
    low, high = depths.min(), q3 + width
    if config.guard_near:
        low = min(low, q1 - width)
    r, K = view.camera.cam_from_world, view.camera.K
    result = set()
    for i, (x, y, z) in enumerate(means.astype(np.float64)):
        depth = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + r[2, 3]
        if depth <= 0.01:
            continue
        u = K[0, 0] * (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + r[0, 3]) / depth + K[0, 2]
        v = K[1, 1] * (r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + r[1, 3]) / depth + K[1, 2]
        if not (0 <= u < view.camera.width and 0 <= v < view.camera.height):
            continue
        if view.labels[int(v), int(u)] == mask and low < depth < high:
            result.add(i)
    return result


def associate(
    means: FloatArray, views: list[View], threshold: float, config: GateConfig
) -> tuple[list[set[int]], list[Decision]]:
    """Groups 1, 2, ... as sets of Gaussians, and the log: the bank grows after every mask."""
    groups: list[set[int]] = []
    log = []
    for view in views:
        for mask in sorted(set(view.labels.ravel().tolist()) - {0}):
            members = behind_mask(means, view, mask, config)
            overlaps = [len(members & group) / max(len(members), 1) for group in groups]
            ranking = sorted(range(len(groups)), key=lambda i: (-overlaps[i], i))
            ranking = [i for i in ranking if overlaps[i] > 0]
            is_new = False
            chosen = 0
            if members:
                if not ranking or overlaps[ranking[0]] < threshold:
                    groups.append(set())
                    is_new = True
                    chosen = len(groups)
                else:
                    chosen = ranking[0] + 1
                groups[chosen - 1] |= members - set().union(*groups)
            best = overlaps[ranking[0]] if ranking else 0.0
            second = ranking[1] + 1 if len(ranking) > 1 else 0
            second_overlap = overlaps[ranking[1]] if second else 0.0
            log.append(
                Decision(
                    view.camera.name,
                    mask,
                    chosen,
                    is_new,
                    best,
                    second,
                    second_overlap,
                    len(members),
                )
            )
    return groups, log
