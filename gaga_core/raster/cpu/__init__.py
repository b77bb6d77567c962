"""Numba tile rasterizer."""

from gaga_core.raster.cpu.rasterizer import CpuRasterizer

__all__ = ["CpuRasterizer"]
