"""Association per view without the depth picture: cost in N, in the number of masks."""

from collections.abc import Callable

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.grouping.gate import GateConfig, ViewMasks, depth_bounds, gaussians_of_masks
from gaga_core.grouping.memory_bank import MemoryBank, add_view
from tests.bench.figures import Figure, median_ms
from tests.scenes import orbit_cameras

_WIDTH, _HEIGHT = 640, 480
_VIEWS = 6


def figures() -> list[Figure]:
    """CPU time of one view at 1M Gaussians, and how it grows."""
    large = _view_ms(1_000_000, 54)
    small = _view_ms(200_000, 54)
    few, many = _view_ms(1_000_000, 10), _view_ms(1_000_000, 100)
    return [
        Figure("associate: a view at 1M, 54 masks, without depth", large, "CPU-ms", "<= 60"),
        Figure("associate: 200k -> 1M", large / small, "x", "<= 6"),
        Figure("associate: 10 -> 100 masks at 1M", many / few, "x", "<= 1.5"),
    ]


def _view_ms(n: int, n_masks: int) -> float:
    run = _association(n, n_masks)
    return median_ms(run, runs=5) / _VIEWS


def _association(n: int, n_masks: int) -> Callable[[], MemoryBank]:
    """Associate ``_VIEWS`` views of a cloud of ``n`` points, masks as ragged tiles of the view."""
    rng = np.random.default_rng(5)
    means = rng.uniform(-1.4, 1.4, (n, 3)).astype(np.float32)
    cameras = orbit_cameras(_VIEWS, width=_WIDTH, height=_HEIGHT)
    inputs = [(camera, *_maps(rng, n_masks)) for camera in cameras]

    def run() -> MemoryBank:
        bank = MemoryBank.empty(n)
        for camera, labels, depth, alpha in inputs:
            masks = ViewMasks.of(labels)
            bounds = depth_bounds(masks, depth, alpha, GateConfig())
            mask_of = gaussians_of_masks(means, camera, masks, bounds)
            bank, _ = add_view(bank, camera.name, masks.ids, mask_of, 0.1)
        return bank

    return run


def _maps(rng: np.random.Generator, n_masks: int) -> tuple[IntArray, FloatArray, FloatArray]:
    """Nearest-seed regions with permuted ids, a wavy depth map, opaque nearly everywhere."""
    rows, columns = np.mgrid[:_HEIGHT, :_WIDTH]
    seeds = rng.uniform(0, 1, (n_masks, 2)) * [_HEIGHT, _WIDTH]
    best = np.full((_HEIGHT, _WIDTH), np.inf)
    labels = np.zeros((_HEIGHT, _WIDTH), np.int32)
    for k, (row, column) in enumerate(seeds):
        distance = (rows - row) ** 2 + (columns - column) ** 2
        labels[distance < best] = k + 1
        best = np.minimum(best, distance)
    depth = 3.2 + np.sin(rows / 40) + 0.5 * np.cos(columns / 25) + rng.normal(0, 0.02, rows.shape)
    alpha = rng.uniform(0.45, 1, rows.shape)
    return labels, depth.astype(np.float32), alpha.astype(np.float32)
