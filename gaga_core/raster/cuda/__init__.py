"""The CUDA backend of `raster.base.Rasterizer`: gsplat (Ye 2024, "gsplat: an open-source library
for Gaussian splatting") blends on an NVIDIA GPU.

Projection is our own and in float64, so that the image model is that of `raster.base`; gsplat bins
and blends. What differs: gsplat 1.5 limits alpha to 0.999 instead of 0.99 and takes float32 conics,
and votes are summed with atomics, so their last digits change from run to run. Differences against
the CPU backend are single pixels and a few thousandths.

gsplat has no median depth, so `render` lists the contributions of all pixels, in bands of tile
rows, and looks where T passes 1/2: exact, at the price of a second pass.
"""

from gaga_core.raster.cuda.rasterizer import CudaRasterizer

__all__ = ["CudaRasterizer"]
