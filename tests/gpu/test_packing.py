"""How splats are packed: what the bytes hold, and which rows are sent again."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import AnyArray, FloatArray
from gaga_studio.gpu.buffers import changed_range, pack_sh, pieces
from tests.scenes import random_gaussians


def _unpacked(color: AnyArray, layers: AnyArray, n_sh: int) -> FloatArray:
    """Coefficients (K, S, 3), as project.frag reads them."""
    n = len(color)
    bytes_ = np.ascontiguousarray(layers.T).view(np.int8).reshape(n, -1)[:, : 3 * (n_sh - 1)]
    rest = bytes_ * (color[:, 3:].astype(np.float32) / 127)
    flat = np.concatenate([color[:, :3].astype(np.float32), rest], axis=1)
    return flat.reshape(n, n_sh, 3).astype(np.float32)


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3, 4])
def test_coefficients_come_back_within_a_step(sh_degree: int) -> None:
    gaussians = random_gaussians(500, sh_degree=sh_degree)
    sh = gaussians.sh.copy()
    sh[:100] *= 1e-3  # small ones have a scale of their own
    sh[100:110, 1:] = 0
    color, layers = pack_sh(replace(gaussians, sh=sh), 0, 500)
    found = _unpacked(color, layers, sh.shape[1])
    assert np.allclose(found[:, 0], sh[:, 0], rtol=1e-3, atol=1e-6)
    largest = np.abs(sh[:, 1:]).max(axis=(1, 2), initial=0)
    error = np.abs(found - sh)[:, 1:].max(axis=(1, 2), initial=0)
    assert (error <= 0.51 * largest / 127 + 1e-3 * largest).all()


def test_a_coefficient_that_is_not_finite_spoils_its_own_splat_only() -> None:
    gaussians = random_gaussians(4, sh_degree=3)
    sh = gaussians.sh.copy()
    sh[1, 5, 0], sh[2, 15, 2] = np.nan, np.inf
    color, layers = pack_sh(replace(gaussians, sh=sh), 0, 4)
    assert np.isfinite(color[:, 3].astype(np.float32)).tolist() == [True, False, False, True]
    with np.errstate(invalid="ignore"):
        found = _unpacked(color, layers, 16)
    assert np.allclose(found[[0, 3]], sh[[0, 3]], atol=0.01)


def test_the_changed_range_is_the_shortest_one() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 5, 65536, 200_000):
        before = rng.integers(0, 5, n).astype(np.int32)
        assert changed_range(before, before.copy()) == (0, 0)
        for rows in ([0], [n - 1], [0, n - 1], sorted(rng.integers(0, n, 2)), [n // 2]):
            after = before.copy()
            after[rows] += 1
            assert changed_range(before, after) == (rows[0], rows[-1] + 1)


def test_rows_that_were_added_are_changed_and_rows_cut_off_are_not() -> None:
    before = np.arange(100_000, dtype=np.int32)
    assert changed_range(before[:70_000], before) == (70_000, 100_000)
    assert changed_range(before, before[:70_000]) == (0, 0)
    after = before.copy()
    after[10] = -1
    assert changed_range(before[:70_000], after) == (10, 100_000)
    assert changed_range(before, after[:70_000]) == (10, 11)


def test_pieces_are_rectangles_that_cover_every_row_once() -> None:
    for start, n in ((0, 5000), (2047, 2), (100, 9000), (4096, 2048)):
        rows = np.arange(start, start + n)
        seen = np.concatenate([piece for *_, piece in pieces(rows, start)])
        assert np.array_equal(seen, rows)
        for first, width, height, piece in pieces(rows, start):
            assert first == piece[0]
            assert width * height == len(piece)
            assert first % 2048 + width <= 2048
