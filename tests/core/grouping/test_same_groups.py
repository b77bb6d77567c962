"""Groups are the same on every processor: computed in a process that takes its for another one."""

import json
import os
import subprocess
import sys

import pytest

_OTHER = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",  # no AVX
    "OPENBLAS_CORETYPE": "Nehalem",
    "GAGA_THREADS": "1",
}
# Set by `make test-portable`, which so compares kernels and BLAS of yet other processors: to
# compile all kernels for one takes most of a minute.
_KERNELS = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")


def _started(environment: dict[str, str]) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "tests.core.grouping.same_groups"]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_groups_repairs_and_scores_are_the_same_on_every_processor() -> None:
    other = {name: value for name, value in os.environ.items() if name not in _KERNELS} | _OTHER
    here, there = (
        json.loads(process.communicate()[0])
        for process in [_started(dict(os.environ)), _started(other)]
    )
    assert len(here) > 40
    assert [key for key in here if there[key] != here[key]] == []
