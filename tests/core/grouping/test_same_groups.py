"""Groups are the same on every processor: computed in processes that take their for another one."""

import json
import os
import subprocess
import sys

import pytest

_OTHERS = {
    "no AVX in numpy and BLAS, one thread": {
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
        "OPENBLAS_CORETYPE": "Nehalem",
        "GAGA_THREADS": "1",
    },
    "BLAS of Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
}
_KERNELS = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")  # set by `make test-portable`


def _started(extra: dict[str, str]) -> "subprocess.Popen[str]":
    """With kernels of this processor; where those of another one are asked for, only "this one"
    has them: to compile all of them takes most of a minute."""
    own = {name: value for name, value in os.environ.items() if not extra or name not in _KERNELS}
    command = [sys.executable, "-m", "tests.core.grouping.same_groups"]
    return subprocess.Popen(command, env=own | extra, stdout=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_groups_repairs_and_scores_are_the_same_on_every_processor() -> None:
    running = {name: _started(extra) for name, extra in {"this one": {}, **_OTHERS}.items()}
    found = {name: json.loads(process.communicate()[0]) for name, process in running.items()}
    here = found.pop("this one")
    assert len(here) > 40
    for name, there in found.items():
        assert [key for key in here if there[key] != here[key]] == [], name
