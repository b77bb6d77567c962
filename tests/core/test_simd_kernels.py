"""Vectors of 16 numbers in kernels: each function against numpy, lane by lane."""

from typing import Any

import llvmlite.binding
import numpy as np
import pytest

from gaga_core.arrays import FloatArray
from gaga_core.kernels import kernel
from gaga_core.raster.cpu.backward_kernels import exp8
from gaga_core.raster.cpu.simd_kernels import (
    fill,
    lane_numbers,
    larger,
    load,
    log2_above,
    minus_abs,
    prefetch,
    reciprocal,
    run_at_least,
    smaller,
    store,
    store_totals,
    total,
    where_at_least,
)

F = np.float32


@kernel
def all_of_it(a: FloatArray, b: FloatArray, out: FloatArray, sums: FloatArray) -> tuple[int, int]:
    """Every function of two vectors, a row of ``out`` each."""
    x, y, n = load(a, 0), load(b, 0), lane_numbers()
    prefetch(a, 1000)
    store(out, 0, x + y * a[2] - n)
    store(out, 16, smaller(x, y))
    store(out, 32, larger(x, y))
    store(out, 48, where_at_least(x, y, n, fill(b[0])))
    store(out, 64, minus_abs(x))
    store(out, 80, exp8(x))
    store(out, 96, reciprocal(b[3] - x))
    store_totals(sums, 1, (x, y, n, x * y, x + n, y + n, x - y, n * n))
    sums[9] = total(x * n)
    sums[10] = log2_above(b[1])
    first, end = run_at_least(x, y)
    return first, end


@pytest.fixture
def pair() -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(3)
    return -0.7 * rng.random(16, F), (rng.random(16) - 0.5).astype(F) ** 2 + F(0.05)


def test_each_function_does_in_every_lane_what_it_says(pair: tuple[FloatArray, FloatArray]) -> None:
    a, b = pair
    b[5:9] = a[5:9] - F(0.1)  # a is the larger one in these
    b[6] = a[6]
    out, sums, n = np.zeros((7, 16), F), np.zeros(12, F), np.arange(16, dtype=F)
    run = all_of_it(a, b, out, sums)
    want = [
        a + b * a[2] - n,
        np.minimum(a, b),
        np.maximum(a, b),
        np.where(a >= b, n, b[0]),
        -np.abs(a),
        np.exp(8 * a.astype(np.float64)),
        1 / (b[3].astype(np.float64) - a),
    ]
    for row, right in zip(out, want, strict=True):
        np.testing.assert_allclose(row, right, rtol=1e-5, atol=1e-6)
    totals = [a, b, n, a * b, a + n, b + n, a - b, n * n, a * n]
    np.testing.assert_allclose(sums[1:10], [t.sum() for t in totals], rtol=1e-5, atol=1e-5)
    assert sums[0] == sums[11] == 0
    assert 0 < sums[10] - np.log2(b[1]) <= 0.0901
    assert run == (5, 9)


def test_a_run_of_no_lane_is_empty(pair: tuple[FloatArray, FloatArray]) -> None:
    a, b = pair
    assert all_of_it(a, b, np.zeros((7, 16), F), np.zeros(12, F)) == (16, 0)


@kernel
def reciprocals(values: FloatArray, out: FloatArray) -> None:
    """1 / values, 16 at once."""
    for k in range(0, len(values), 16):
        store(out, k, reciprocal(load(values, k)))


def test_a_reciprocal_is_right_over_all_magnitudes() -> None:
    values = np.geomspace(1e-20, 1e20, 16 * 4000).astype(F)
    out = np.zeros_like(values)
    reciprocals(values, out)
    np.testing.assert_allclose(out * values.astype(np.float64), 1, atol=1e-5)


# --- Kernels use the full vectors of a processor that has them.


@kernel
def _double(values: FloatArray) -> None:
    for x in range(len(values)):
        values[x] *= np.float32(2)


def test_sixteen_numbers_are_one_vector_where_the_processor_has_such() -> None:
    if not llvmlite.binding.get_host_cpu_features().get("avx512vbmi2", False):
        pytest.skip("this processor has no vectors of 512 bits, or slows down with them")
    _double(np.ones(16, np.float32))
    compiled: Any = _double
    compiled.recompile()  # code from the cache cannot be looked at
    assert "zmm" in compiled.inspect_asm(compiled.signatures[0])
