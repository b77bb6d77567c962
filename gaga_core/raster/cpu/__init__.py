"""Numba tile rasterizer."""
