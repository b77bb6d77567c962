"""Whether gsplat runs on this machine, found out without risk to the process that asks.

A broken driver crashes, and a first import of gsplat compiles for minutes, so the question is put
to a child: ``python -m gaga_core.raster.probe`` draws four Gaussians with CUDA and with the float64
reference. Its verdict is kept in the user's cache folder until torch, gsplat or the driver changes.
Nothing here imports torch in the asking process.
"""

import ctypes
import importlib.metadata
import importlib.util
import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gaga_core.errors import GagaError

if TYPE_CHECKING:
    from gaga_core.arrays import AnyArray
    from gaga_core.raster.base import Rasterizer

QUICK_SECONDS = 60.0  # import of torch on a cold disk, then a moment on the device
COMPILE_SECONDS = 900.0  # gsplat from PyPI builds its kernels on first use
_TOLERANCE = 1e-2  # fast math; and a contribution near 1/255 may fall either side
_NO_CUDA_IN_TORCH = "the installed torch is a build without CUDA (see pytorch.org for one with it)"

_log = logging.getLogger(__name__)
_tried: dict[str, "SelfTest"] = {}  # this process's answers that are not worth keeping on disk


@dataclass(frozen=True)
class SelfTest:
    """Whether CUDA can draw here."""

    usable: bool
    reason: str  # a clause without a full stop: the device, or why not
    final: bool = True  # False: asking again may give another answer


@dataclass(frozen=True)
class _KeptVerdict:
    """Content of cuda.json."""

    key: str  # see `machine_key`
    verdict: SelfTest


def verdict(*, wait: bool = True, fresh: bool = False, may_compile: bool = False) -> SelfTest:
    """The verdict on this machine: at once when it is known, else from the self-test.

    ``wait=False`` never starts a process. ``fresh`` asks again whatever is known. ``may_compile``
    lets gsplat build its kernels (minutes); without it an unbuilt gsplat counts as unusable.
    """
    obstacle = find_obstacle()
    if obstacle:
        return SelfTest(False, obstacle)
    key = machine_key()
    if not fresh:
        known = _read(key) or (None if may_compile else _tried.get(key))
        if known is not None and (known.usable or not may_compile):
            return known
    if not wait:
        return SelfTest(False, "not tried yet (gaga doctor tries it)", final=False)
    found = _ask_child(may_compile, COMPILE_SECONDS if may_compile else QUICK_SECONDS)
    _tried[key] = found
    if found.final:
        _write(key, found)
    return found


def find_obstacle() -> str:
    """What is missing, as far as a glance tells; "" when a self-test makes sense."""
    if _driver_library() is None:
        return "there is no NVIDIA driver on this machine"
    if importlib.util.find_spec("gsplat") is None:
        return 'the package gsplat is not installed (pip install "gaga-studio[cuda]")'
    if _version("torch").endswith("+cpu"):
        return _NO_CUDA_IN_TORCH
    return ""


def machine_key() -> str:
    """Dependencies of the verdict, as one line."""
    parts = {
        "torch": _version("torch"),
        "gsplat": _version("gsplat"),
        "driver": _driver_version(),
        "devices": os.environ.get("CUDA_VISIBLE_DEVICES", "all"),
        "python": sys.version.split()[0],
    }
    return " ".join(f"{name}={value}" for name, value in parts.items())


def cache_file() -> Path:
    """Path of the saved verdict."""
    from gaga_core.cache_folder import user_cache

    return user_cache() / "cuda.json"


def self_test(*, may_compile: bool) -> SelfTest:
    """Draw four Gaussians with CUDA and the reference, and compare every operator.

    Runs in the child: it imports torch and gsplat, and may crash or hang.
    """
    import torch

    if torch.version.cuda is None:
        return SelfTest(False, _NO_CUDA_IN_TORCH)
    if not torch.cuda.is_available():
        return SelfTest(False, "no CUDA device answers", final=False)
    if not may_compile and not _is_compiled():
        return SelfTest(
            False,
            "gsplat is not compiled for this machine yet (run a command with --backend cuda once:"
            " it takes some minutes and needs the CUDA toolkit and a C++ compiler)",
            final=False,
        )
    # gsplat 1.5 leaves None here when it finds no compiler.
    backend = importlib.import_module("gsplat.cuda._backend")
    if getattr(backend, "_C", backend) is None:
        return SelfTest(False, "gsplat found no CUDA toolkit (nvcc) to compile with", final=False)
    from gaga_core.raster.cuda import CudaRasterizer

    error = largest_error(CudaRasterizer())
    if not error < _TOLERANCE:
        return SelfTest(False, f"the self-test drew another picture (off by {error:.3g})")
    return SelfTest(True, f"{torch.cuda.get_device_name(0)}, gsplat {_version('gsplat')}")


def largest_error(rasterizer: "Rasterizer") -> float:
    """Largest difference of any operator's result from the reference's, on four Gaussians."""
    import numpy as np

    from gaga_core.camera import Camera
    from gaga_core.gaussians import Gaussians
    from gaga_core.raster.reference import ReferenceRasterizer

    def everything(engine: "Rasterizer") -> "list[AnyArray]":
        frame = engine.render(four, camera, background=np.array([0.1, 0.2, 0.3]))
        rows = engine.weights(four, camera, np.arange(300, 340))
        sums = np.bincount(np.repeat(np.arange(40), np.diff(rows.indptr)), rows.weights, 40)
        histogram = np.zeros((4, 3), np.float32)
        engine.vote(four, camera, halves, histogram)
        confidence = engine.label_splat(four, camera, np.arange(4, dtype=np.int32)).confidence
        return [frame.image, frame.alpha, frame.expected_depth, sums, histogram / 100, confidence]

    four = Gaussians(
        means=np.array([[-0.3, 0, 2], [0.3, 0.1, 2.5], [0, 0.3, 3], [0, -0.2, 4]], np.float32),
        quats=np.array([[1, 0, 0, 0], [1, 0.5, 0, 0], [1, 0, 0.5, 0], [1, 0, 0, 0.5]], np.float32),
        log_scales=np.log(np.tile([0.4, 0.2, 0.3], (4, 1))).astype(np.float32),
        logit_opacities=np.array([0.5, 1.0, 0.0, 2.0], np.float32),
        sh=((np.arange(48).reshape(4, 4, 3) % 7 - 3) / 6).astype(np.float32),
    )
    K = np.array([[30, 0, 20], [0, 30, 15], [0, 0, 1.0]])
    camera = Camera(K, np.eye(4), 40, 30)
    halves = np.tile(np.repeat([-1, 0, 1, 2], 10), (30, 1)).astype(np.int32)
    got, want = everything(rasterizer), everything(ReferenceRasterizer())
    return float(np.max([np.abs(a - b).max() for a, b in zip(got, want, strict=True)]))


def main(arguments: list[str]) -> int:
    """Write the verdict as one line of JSON."""
    obstacle = find_obstacle()
    may_compile = "--compile" in arguments
    found = SelfTest(False, obstacle) if obstacle else self_test(may_compile=may_compile)
    sys.stdout.write(json.dumps(asdict(found)) + "\n")
    return 0


def _ask_child(may_compile: bool, seconds: float) -> SelfTest:
    """Run the self-test in a process of its own, and end it and its compilers at the limit."""
    command = [sys.executable, "-m", "gaga_core.raster.probe", *["--compile"] * may_compile]
    # Files, not pipes: a compiler that outlives its parent would keep a pipe open forever.
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        try:
            child = subprocess.Popen(command, stdout=out, stderr=err, start_new_session=True)
        except OSError as error:
            return SelfTest(False, f"the self-test could not start ({error})", final=False)
        try:
            status = child.wait(seconds)
        except subprocess.TimeoutExpired:
            return SelfTest(
                False, f"the self-test did not finish within {seconds:.0f} s", final=False
            )
        finally:
            _end(child)
        out.seek(0)
        err.seek(0)
        said, complaint = _lines(out.read()), _lines(err.read())
    from gaga_core.io.json_file import decode_json

    try:
        found = decode_json(said[-1].encode(), SelfTest, "The self-test", "")
    except (GagaError, IndexError):
        _log.warning("CUDA self-test, exit status %s: %s", status, "\n".join(complaint))
        why = complaint[-1][:200] if complaint else f"exit status {status}"
        return SelfTest(False, f"the self-test failed: {why}")
    return found


def _end(child: "subprocess.Popen[bytes]") -> None:
    if sys.platform != "win32":
        try:
            os.killpg(child.pid, signal.SIGKILL)
        except ProcessLookupError:
            return  # it has ended, and left no compiler behind
    else:
        child.kill()
    child.wait()


def _lines(raw: bytes) -> list[str]:
    return [line for line in raw.decode(errors="replace").splitlines() if line.strip()]


def _is_compiled() -> bool:
    """Whether gsplat's kernels exist: in a prebuilt wheel, or built by an earlier run."""
    from torch.utils import cpp_extension

    if importlib.util.find_spec("gsplat.csrc") is not None:
        return True
    roots = [os.environ.get("TORCH_EXTENSIONS_DIR"), cpp_extension.get_default_build_root()]
    return any(
        path.suffix in (".so", ".pyd", ".lib")
        for root in roots
        if root
        for path in Path(root).glob("**/gsplat_cuda*")
    )


def _driver_library() -> ctypes.CDLL | None:
    """NVIDIA's driver library, loaded but not initialised."""
    try:
        return ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return None


def _driver_version() -> str:
    version = ctypes.c_int(0)
    library = _driver_library()
    if library is not None:
        library.cuDriverGetVersion(ctypes.byref(version))
    try:
        text = Path("/proc/driver/nvidia/version").read_text(encoding="utf-8")
        exact = next((word for word in text.split() if word[:1].isdigit()), "")
    except OSError:
        exact = ""
    return f"{version.value}/{exact}"


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def _read(key: str) -> SelfTest | None:
    from gaga_core.io.json_file import read_json

    try:
        kept = read_json(cache_file(), _KeptVerdict, "")
    except GagaError:  # there is none yet, or it is damaged: it is found again
        return None
    return kept.verdict if kept.key == key else None


def _write(key: str, found: SelfTest) -> None:
    from gaga_core.io.files import atomic_write

    try:
        with atomic_write(cache_file()) as path:
            text = json.dumps({"key": key, "verdict": asdict(found)}, indent=1)
            path.write_text(text, encoding="utf-8")
    except GagaError as error:
        _log.info("The verdict on CUDA is not kept: %s", error)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
