"""The rows of a tile that training walks over: all that a splat draws in, and few others."""

import numpy as np

from gaga_core.raster.cpu.backward_kernels import (
    AT_ONCE,
    N_COLUMNS,
    N_LISTS,
    REST,
    ROW,
    ROWS,
    SHIFT,
    SMALL_S,
    list_rows,
)
from gaga_core.raster.cpu.prepare import prepare
from tests.scenes import orbit_cameras, random_gaussians

TILE = 16


def test_rows_hold_every_pixel_that_a_splat_draws_and_few_are_empty() -> None:
    gaussians = random_gaussians(400, seed=5)
    camera = orbit_cameras(3, width=109, height=83)[1]
    view = prepare(gaussians, camera)
    colors = np.ones((len(view.order), 3), np.float32)
    listed = np.zeros((AT_ONCE, N_COLUMNS), np.float32)
    rows, spans = np.zeros((N_LISTS, ROWS), np.float32), np.zeros((AT_ONCE, 2), np.int64)
    x, n_tiles_x = np.arange(TILE), -(-camera.width // TILE)
    n_listed, n_needed = 0, 0
    for tile in range(0, view.n_tiles, 3):
        left, top = tile % n_tiles_x * TILE, tile // n_tiles_x * TILE
        for start in range(view.offsets[tile], view.offsets[tile + 1], AT_ONCE):
            stop = min(start + AT_ONCE, view.offsets[tile + 1])
            list_rows(view.splats, colors, view.ids, start, stop, left, top, listed, rows, spans)
            for q, k in enumerate(view.ids[start:stop]):
                u, v, s, r, h, opacity, y0, y1 = view.splats[k].astype(np.float64)
                dx = left + x + 0.5 - u
                dy = (top + x + 0.5 - v)[:, None]
                alpha = opacity * np.exp(-((s * (dx - r * dy)) ** 2) - h * dy**2)
                inside = (top + x >= y0) & (top + x < y1)
                needed = np.flatnonzero(inside & (alpha > 1.0001 / 255).any(axis=1))
                span = slice(*spans[q]) if spans[q, 0] < spans[q, 1] else slice(0, 0)
                assert set(needed) <= set(rows[ROW, span].astype(int))
                n_listed, n_needed = n_listed + len(rows[ROW, span]), n_needed + len(needed)
                row, shift, rest = rows[[ROW, SHIFT, REST], span][:, :, None]
                got = opacity * np.exp(8 * (rest - (listed[q, SMALL_S] * x + shift) ** 2))
                assert np.abs(got - alpha[row[:, 0].astype(int)]).max(initial=0) < 1e-4
    assert 500 < n_needed <= n_listed < 1.1 * n_needed
