"""Numba tile rasterizer."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gaga_core.raster.cpu.rasterizer import CpuRasterizer as CpuRasterizer

__all__ = ["CpuRasterizer"]


def __getattr__(name: str) -> object:
    """Import the rasterizer when it is asked for: kernels of this package are used without it."""
    if name == "CpuRasterizer":
        from gaga_core.raster.cpu.rasterizer import CpuRasterizer

        return CpuRasterizer
    raise AttributeError(name)
