"""A promptable model that knows the truth: tells things by their colors, in any picture of them."""

from collections.abc import Callable

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray, UInt8Array
from gaga_core.color import rgb_from_dc
from gaga_core.segmentation.sam import Candidates
from tests.scenes import Synthetic

Answer = Callable[[IntArray, FloatArray, BoolArray], BoolArray]  # of things' map, points, signs


def clicked_things(things: IntArray, points: FloatArray, is_on: BoolArray) -> BoolArray:
    """The things that are clicked on, without those that are clicked off."""
    columns, rows = points.astype(np.int64).T
    met = things[rows, columns]
    return np.isin(things, np.setdiff1d(met[is_on], met[~is_on]))


class ColorOracle:
    """Answers about the floor (0) and the balls (1..) of `objects_scene`, -1 where nothing is."""

    def __init__(self, scene: Synthetic, answer: Answer = clicked_things) -> None:
        rgb = rgb_from_dc(scene.gaussians.sh[:, 0])
        n = int(scene.labels.max()) + 1
        means = np.array([rgb[scene.labels == k].mean(axis=0) for k in range(n)], np.float32)
        self._colors, self._answer = np.clip(means, 0, 1) * 255, answer
        self.n_asked = 0

    def __call__(self, image: UInt8Array, points: FloatArray, is_on: BoolArray) -> Candidates:
        self.n_asked += 1
        away = np.linalg.norm(image[:, :, None].astype(np.float32) - self._colors, axis=3)
        things = np.where(image.any(axis=2), away.argmin(axis=2), -1).astype(np.int32)
        mask = self._answer(things, points, is_on)
        nothing = np.zeros_like(mask)
        return Candidates(np.stack([nothing, mask]), np.array([0.9, 0.8], np.float32))
