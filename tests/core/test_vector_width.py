"""Kernels use the full vectors of a processor that has them."""

from typing import Any

import llvmlite.binding
import numpy as np
import pytest

from gaga_core.arrays import FloatArray
from gaga_core.kernels import kernel


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
