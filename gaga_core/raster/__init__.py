"""Rasterizers of Gaussians behind one protocol."""

from gaga_core.errors import GagaError
from gaga_core.raster.base import Rasterizer

NAMES = ("auto", "cpu", "reference")


def choose(name: str = "auto") -> Rasterizer:
    """The backend called ``name``: "cpu", "reference" (float64, tiny scenes), or the best one.

    Raises `GagaError` when there is no such backend here.
    """
    # Imported when asked for: numba alone takes a good part of the launch time.
    if name in ("auto", "cpu"):
        from gaga_core.raster.cpu import CpuRasterizer

        return CpuRasterizer()
    if name == "reference":
        from gaga_core.raster.reference import ReferenceRasterizer

        return ReferenceRasterizer()
    if name == "cuda":
        raise GagaError("Rendering with CUDA is not part of this version. Choose the backend cpu.")
    raise GagaError(f"There is no rendering backend {name!r}. Choose one of {', '.join(NAMES)}.")
