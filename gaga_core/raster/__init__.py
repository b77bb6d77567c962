"""Rasterizers of Gaussians behind one protocol."""

import logging
import os

from gaga_core.errors import GagaError
from gaga_core.raster.base import Rasterizer, SpatialChunks

NAMES = ("auto", "cpu", "cuda", "reference")

_log = logging.getLogger(__name__)


def choose(name: str = "auto") -> Rasterizer:
    """The backend called ``name``: "cpu", "cuda", "reference" (float64, tiny scenes), or "auto".

    "auto" is what the environment variable GAGA_BACKEND says, else CUDA where a self-test has shown
    that it draws right (see `raster.probe`), else the CPU. "cuda" asks again and lets gsplat
    compile, which takes minutes once. Raises `GagaError` when there is no such backend here.
    """
    wanted = _wanted(name)
    # Imported when needed: importing numba takes a large part of the launch time, torch more.
    if wanted == "auto":
        from gaga_core.raster import probe

        if probe.verdict().usable:
            try:
                return _cuda()
            except GagaError as error:
                _log.warning("CUDA passed its self-test but is not available now: %s", error)
        wanted = "cpu"
    if wanted == "cpu":
        from gaga_core.raster.cpu.rasterizer import CpuRasterizer

        return CpuRasterizer()
    if wanted == "reference":
        from gaga_core.raster.reference import ReferenceRasterizer

        return ReferenceRasterizer()
    if wanted == "cuda":
        from gaga_core.raster import probe

        found = probe.verdict(may_compile=True)
        if not found.usable:
            raise GagaError(f"CUDA cannot draw here: {found.reason}. Choose the backend cpu.")
        return _cuda()
    raise GagaError(f"There is no rendering backend {wanted!r}. Choose one of {', '.join(NAMES)}.")


def for_many_views(rasterizer: Rasterizer, chunks: SpatialChunks | None) -> Rasterizer:
    """``rasterizer`` for many views of the scene of ``chunks``: on the processor it projects what a
    view may show, elsewhere all of it. Its results are the same."""
    if rasterizer.name != "cpu" or chunks is None:
        return rasterizer
    from gaga_core.raster.cpu.rasterizer import CpuRasterizer

    return CpuRasterizer(chunks)


def backend_report(*, wait: bool = True, fresh: bool = False) -> tuple[str, str]:
    """What `choose("auto")` gives here, and a clause about CUDA: the device, or why not.

    ``wait=False`` starts no process and answers at once (for a status bar); ``fresh`` runs the
    self-test again whatever is known.
    """
    wanted = _wanted("auto")
    if wanted != "auto":
        return wanted, "GAGA_BACKEND says so"
    from gaga_core.raster import probe

    found = probe.verdict(wait=wait, fresh=fresh)
    return ("cuda" if found.usable else "cpu"), found.reason


def _wanted(name: str) -> str:
    return (os.environ.get("GAGA_BACKEND") or name) if name == "auto" else name


def _cuda() -> Rasterizer:
    from gaga_core.raster.cuda import CudaRasterizer

    return CudaRasterizer()
