"""Masks of synthetic scenes: the true ones, and with ids mixed up view by view."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.masks import MaskSet
from gaga_core.raster import choose
from tests.scenes import Synthetic


def true_map(scene: Synthetic, camera: Camera) -> IntArray:
    """True label map: balls 1..G, the floor G + 1, background 0."""
    top = int(scene.labels.max()) + 1
    labels = np.where(scene.labels > 0, scene.labels, top).astype(np.int32)
    frame = choose().label_splat(scene.gaussians, camera, labels)
    return np.where(frame.confidence < 0.5, np.int32(0), frame.labels)


def permuted(labels: IntArray, seed: int, top: int = 900) -> IntArray:
    """The same regions under random ids up to ``top``, as a segmenter of single views gives."""
    ids = np.random.default_rng(seed).permutation(np.arange(1, top + 1))
    lookup = np.concatenate([[0], ids]).astype(np.int32)
    return lookup[labels]


def masks_of(scene: Synthetic, cameras: Sequence[Camera]) -> MaskSet:
    maps = {c.name: permuted(true_map(scene, c), i) for i, c in enumerate(cameras)}
    return MaskSet({name: partial(maps.__getitem__, name) for name in maps}, "test masks")
