"""Numba kernels: one decorator, one compile cache. Parallel work: `gaga_core.threads`."""

import contextlib
import functools
import hashlib
import importlib.util
import math
import os
import platform
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Literal, TypeVar, cast, get_args

from gaga_core.cache_folder import user_cache

_GROUP = "gaga_core.kernels"  # entry points: packages with kernels of their own
_F = TypeVar("_F", bound=Callable[..., Any])
# No nnan/ninf: kernels test for non-finite values.
_FASTMATH = {"contract", "reassoc", "nsz", "arcp", "afn"}


def kernel_packages() -> list[Path]:
    """Folders of the packages whose ``*_kernels.py`` are compiled: this one, and those that
    register themselves as an entry point of the group ``gaga_core.kernels``. None is imported."""
    folders = [Path(__file__).resolve().parent]
    for entry in sorted(entry_points(group=_GROUP), key=lambda entry: entry.name):
        spec = importlib.util.find_spec(entry.value)
        if spec is not None:
            folders += [Path(folder) for folder in spec.submodule_search_locations or ()]
    return folders


def _source_digest() -> str:
    """Digest of every kernel file: numba alone notices a change in the kernel's own file only,
    not in a helper of another file that was inlined into it."""
    sources = [Path(__file__).resolve()]
    for folder in kernel_packages():
        sources += sorted(folder.rglob("*_kernels.py"))
    digest = hashlib.sha256()
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


_DIGEST = _source_digest()
# Set before numba is imported anywhere: site-packages may be read-only, and stale code is worse
# than a compile.
os.environ.setdefault("NUMBA_CACHE_DIR", str(user_cache() / "kernels" / _DIGEST))

import llvmlite.binding  # noqa: E402


def _cpu_features() -> str:
    """Instructions to compile for: all that this processor has, in vectors of full width.

    LLVM keeps to 256 bits where it could take 512, for the first processors that had them: they
    slowed down. Those with VBMI2 (2019 and later) do not, and a tile's row of 16 pixels is one
    vector of 512.
    """
    try:
        features = llvmlite.binding.get_host_cpu_features()
    except RuntimeError:  # LLVM does not know this processor
        return ""
    wide = ",-prefer-256-bit" if features.get("avx512vbmi2", False) else ""
    return str(features.flatten()) + wide


_PROCESSOR = llvmlite.binding.get_host_cpu_name()
if _FEATURES := _cpu_features():
    os.environ.setdefault("NUMBA_CPU_FEATURES", _FEATURES)

# Multiply and add with one rounding: every processor but those of x86 before 2013.
HAS_FMA = platform.machine().lower() in ("arm64", "aarch64") or "+fma" in os.environ.get(
    "NUMBA_CPU_FEATURES", ""
).split(",")

import numba  # noqa: E402  (the cache folder and the instructions must be known first)
import numpy as np  # noqa: E402

_F32 = np.float32


def kernel(function: _F) -> _F:
    """Compile ``function`` with numba: nogil, cached on disk, fast math without nnan/ninf.

    Division by zero gives inf or NaN as in numpy: a test for it in every division would keep loops
    from being vectorised.
    """
    compiled = numba.njit(
        nogil=True, cache=True, fastmath=_FASTMATH, boundscheck=False, error_model="numpy"
    )(function)
    return cast(_F, compiled)


def exact_kernel(function: _F) -> _F:
    """Like `kernel`, without fast math: results are the same bits as plain IEEE arithmetic."""
    return cast(
        _F, numba.njit(nogil=True, cache=True, boundscheck=False, error_model="numpy")(function)
    )


@kernel
def exp_below_zero(x: np.float32) -> np.float32:
    """exp on [-87, 0], relative error 2e-7: unlike libm's, it vectorises."""
    n = _F32(math.floor(x * _F32(1.44269504) + _F32(0.5)))
    y = (x - n * _F32(0.693359375)) + n * _F32(2.12194440e-4)  # ln 2 in two parts
    p = _F32(1.3981999507e-3) + y * _F32(1.9875691500e-4)
    p = _F32(4.1665795894e-2) + y * (_F32(8.3334519073e-3) + y * p)
    p = _F32(5.0000001201e-1) + y * (_F32(1.6666665459e-1) + y * p)
    p = _F32(1) + y + y * y * p
    return p * np.int32((np.int32(n) + 127) << 23).view(np.float32)


# What kernels are for, in the order in which a window needs them.
STAGE = "Prepare kernels"  # of progress
Part = Literal["window", "grouping", "training", "export", "lod"]
PARTS: tuple[Part, ...] = get_args(Part)


def is_compiled(part: Part = "window", step: str = "") -> bool:
    """Whether `mark_compiled` was called for these kernels, Python, numba and this processor."""
    return _stamp(part, step).is_file()


def mark_compiled(part: Part = "window", step: str = "") -> None:
    """Note on the disk that a part of the kernels is compiled, or a ``step`` of it, so that no
    later start asks again."""
    stamp = _stamp(part, step)
    with contextlib.suppress(OSError):  # a disk that is full: the next start compiles what it lacks
        stamp.parent.mkdir(parents=True, exist_ok=True)
        stamp.touch()


def _stamp(part: Part, step: str) -> Path:
    """File that is there when it is compiled: named by all that numba compiles for."""
    return Path(os.environ["NUMBA_CACHE_DIR"]) / _stamp_name(part, step, numba.__version__)


@functools.cache  # windows ask in every frame
def _stamp_name(part: Part, step: str, compiler: str) -> str:
    parts = (_DIGEST, platform.python_version(), compiler, _PROCESSOR, _FEATURES)
    name = hashlib.sha256("\n".join((*parts, step)).encode()).hexdigest()[:16]
    return f"compiled-{part}-{name}"
