"""The backends that every operator is tested with."""

import pytest

from gaga_core.raster import base, probe
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests import gsplat_stand_in


@pytest.fixture(params=["cpu", "stand-in", pytest.param("gsplat", marks=pytest.mark.cuda)])
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> base.Rasterizer:
    """The CPU; gsplat where a CUDA device is (else skipped); and everywhere the CUDA backend with a
    stand-in of gsplat in plain torch, several bands of pixels and pieces of Gaussians."""
    if request.param == "cpu":
        return CpuRasterizer()
    from gaga_core.raster.cuda import CudaRasterizer

    if request.param == "gsplat":
        found = probe.verdict(may_compile=True)
        if not found.usable:
            pytest.skip(f"CUDA cannot draw here: {found.reason}")
        return CudaRasterizer()
    gsplat_stand_in.install(monkeypatch)
    monkeypatch.setattr("gaga_core.raster.cuda.rasterizer._ENTRIES", 100_000)
    monkeypatch.setattr("gaga_core.raster.cuda.rasterizer._ROWS", 300)
    return CudaRasterizer("cpu")
