"""Many small views with many masks each: a floor of tiles seen from above, a process of its own.

``python -m tests.bench.small_views VIEWS [PRESET]`` prints one line of JSON (`hall.Cost`). A view
of 320 x 240 pixels shows 768 tiles, each 10 pixels wide and with a mask of its own; masks have the
faults of those of the hall: a tile is cut in two, melts with its neighbour or is missed.
"""

import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from tests.bench.hall import MERGE, MISS, SPLIT, associate_views

WIDTH, HEIGHT = 320, 240
_SHOWN = (32, 24)  # tiles of a view along x and y
_TILES = (48, 36)  # of the floor
_SPLATS = 20  # of a tile
_PIXELS = WIDTH // _SHOWN[0]  # of a tile
_FOCAL = 224.0


def floor() -> tuple[Gaussians, IntArray]:
    """The splats, thin and flat on the floor, and the tile 1.. of each."""
    rng = np.random.default_rng(0)
    n_tiles = _TILES[0] * _TILES[1]
    labels = np.repeat(np.arange(1, n_tiles + 1, dtype=np.int32), _SPLATS)
    corner = np.stack(np.divmod(labels - 1, _TILES[0])[::-1], axis=1)
    n = len(labels)
    means = np.zeros((n, 3), np.float32)
    means[:, :2] = corner + rng.uniform(0.08, 0.92, (n, 2))
    gaussians = Gaussians(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.tile(np.log(np.array([0.12, 0.12, 0.01], np.float32)), (n, 1)),
        logit_opacities=np.full(n, 3.0, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )
    return gaussians, labels


def corners(n_views: int) -> IntArray:
    """The tile (V, 2) at the upper left corner of each view."""
    rng = np.random.default_rng(1)
    room = np.array(_TILES, np.int64) - np.array(_SHOWN, np.int64) + 1
    return rng.integers(0, room, (n_views, 2)).astype(np.int32)


def cameras(n_views: int) -> tuple[Camera, ...]:
    """Straight down, as high as makes a tile `_PIXELS` wide."""
    K = np.array([[_FOCAL, 0, WIDTH / 2], [0, _FOCAL, HEIGHT / 2], [0, 0, 1]])
    found = []
    for i, corner in enumerate(corners(n_views)):
        x, y = corner + np.array(_SHOWN) / 2
        eye = np.array([x, y, -_FOCAL / _PIXELS])
        pose = look_at(eye, np.array([x, y, 0.0]), np.array([0.0, -1.0, 0.0]))
        found.append(Camera(K, pose, WIDTH, HEIGHT, f"{i:05d}.png"))
    return tuple(found)


def draw_masks(corner: IntArray, rng: np.random.Generator) -> IntArray:
    """The label map (H, W) of a segmenter that errs, under ids of this view."""
    wide, high = _SHOWN
    n = wide * high
    fault = rng.uniform(size=n)
    ids = rng.permutation(2 * n).astype(np.int32) + 1
    left, right = ids[:n].copy(), ids[:n].copy()
    is_cut = (fault >= MERGE + MISS) & (fault < MERGE + MISS + SPLIT)
    right[is_cut] = ids[n:][is_cut]
    melts = np.flatnonzero((fault < MERGE) & (np.arange(n) % wide > 0))
    left[melts] = right[melts] = right[melts - 1]
    missed = (fault >= MERGE) & (fault < MERGE + MISS)
    left[missed] = right[missed] = 0
    rows, columns = np.divmod(np.arange(WIDTH * HEIGHT), WIDTH)
    tile = rows // _PIXELS * wide + columns // _PIXELS
    is_left = columns % _PIXELS < _PIXELS // 2
    return np.where(is_left, left[tile], right[tile]).reshape(HEIGHT, WIDTH)


def main(arguments: list[str]) -> None:
    """Associate so many views and print what it took."""
    n_views, preset = int(arguments[0]), (arguments[1] if len(arguments) > 1 else "robust")
    gaussians, truth = floor()
    at = corners(n_views)

    def draw(i: int) -> IntArray:
        return draw_masks(at[i], np.random.default_rng((2, i)))

    with tempfile.TemporaryDirectory() as folder:
        views = cameras(n_views)
        cost = associate_views(gaussians, truth, views, draw, preset, Path(folder))
    sys.stdout.write(json.dumps(asdict(cost)) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
