"""OpenUSD: arrays are those of the schema, what is read is what was written, validators agree."""

import builtins
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.splats.splat_files import read_splats, write_splats
from tests.scenes import random_gaussians
from tests.usd_files import complaints

pytest.importorskip("pxr.UsdVol", reason="usd-core is not installed")
from pxr import Gf, Usd, UsdGeom, UsdVol


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "usdz"])
@pytest.mark.parametrize("degree", [0, 3])
def test_what_is_read_is_what_was_written(tmp_path: Path, suffix: str, degree: int) -> None:
    g = random_gaussians(300, sh_degree=degree)
    path = tmp_path / f"a.{suffix}"
    write_splats(path, g)
    back = read_splats(path)
    assert np.array_equal(back.means, g.means)
    assert np.array_equal(back.sh, g.sh)
    unit = g.quats / np.linalg.norm(g.quats.astype(np.float64), axis=1, keepdims=True)
    assert np.abs(back.quats - unit).max() < 2e-7
    # A size and an opacity are stored as such: their float32 says to how many digits.
    sizes = np.exp(g.log_scales.astype(np.float64))
    assert np.abs(np.exp(back.log_scales.astype(np.float64)) / sizes - 1).max() < 1e-6
    assert np.abs(back.opacities - g.opacities).max() < 2e-7
    assert complaints(path) == []


def test_arrays_are_those_of_the_schema(tmp_path: Path) -> None:
    """As numpy alone has them: exp of sizes, sigmoid of opacities, SH splat by splat."""
    g = random_gaussians(50, sh_degree=2)
    write_splats(tmp_path / "a.usda", g)
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    prim = next(p for p in stage.Traverse() if p.IsA(UsdVol.ParticleField3DGaussianSplat))

    def column(name: str) -> Any:
        return np.array(prim.GetAttribute(name).Get())

    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    assert np.array_equal(column("positions"), g.means)
    assert np.allclose(column("scales"), np.exp(g.log_scales), rtol=1e-6)
    assert np.allclose(column("opacities"), 1 / (1 + np.exp(-g.logit_opacities)), atol=1e-7)
    assert prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 2
    coefficients = column("radiance:sphericalHarmonicsCoefficients")
    assert np.array_equal(coefficients.reshape(50, 9, 3), g.sh)
    first = prim.GetAttribute("orientations").Get()[7]
    w = g.quats[7] / np.linalg.norm(g.quats[7])
    assert np.allclose([first.GetReal(), *first.GetImaginary()], w, atol=1e-6)
    assert np.allclose(np.linalg.norm(column("orientations"), axis=1), 1, atol=1e-6)  # VG.035


def test_places_and_the_axis_that_is_up_count(tmp_path: Path) -> None:
    """A prim under a node of a file with z up: 2 up in the file is 2 against y in a .ply."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.Xform.Define(stage, "/node").AddTranslateOp().Set(Gf.Vec3d(0, 0, 2))
    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/node/splats")
    field.CreatePositionsAttr([(1, 0, 0)])
    field.CreateOrientationsAttr([Gf.Quatf(1, 0, 0, 0)])
    field.CreateScalesAttr([(0.1, 0.1, 0.1)])
    field.CreateOpacitiesAttr([0.5])
    field.CreateRadianceSphericalHarmonicsDegreeAttr(0)
    field.CreateRadianceSphericalHarmonicsCoefficientsAttr([(0, 0, 0)])
    stage.Save()
    assert np.allclose(read_splats(tmp_path / "a.usda").means, [[1, -2, 0]])
    field.CreateOpacitiesAttr([0.5, 0.5])
    stage.Save()
    with pytest.raises(GagaError, match="lengths"):
        read_splats(tmp_path / "a.usda")


def test_damage_and_a_missing_package_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.usdc"
    write_splats(path, random_gaussians(10))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(GagaError, match=r"damaged|no splats"):
        read_splats(path)
    empty = tmp_path / "b.usda"
    empty.write_text("#usda 1.0\n")
    with pytest.raises(GagaError, match="holds no splats"):
        read_splats(empty)
    for name in [name for name in sys.modules if name.split(".")[0] == "pxr"]:
        monkeypatch.delitem(sys.modules, name)
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Mapping[str, Any]) -> Any:
        if name.split(".")[0] == "pxr":
            raise ImportError(name)
        return real(name, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    for act in (lambda: read_splats(empty), lambda: write_splats(path, random_gaussians(10))):
        with pytest.raises(GagaError, match=r"gaga-studio\[usd\]"):
            act()
