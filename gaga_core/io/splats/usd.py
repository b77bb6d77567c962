"""OpenUSD (.usd, .usda, .usdc, .usdz) with splats of the schema ``ParticleField3DGaussianSplat``.

The schema is of OpenUSD 26.03; ``usd-core``, an extra, has it. Sizes are linear, opacities 0..1, SH
in the order of a .ply, all of a splat next to each other. Reading takes every such prim with the
place of its node. The world of a file has y or z up, as it says; ours is that of a .ply, y down.
"""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray
from gaga_core.errors import GagaError, cure_without
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, check_memory
from gaga_core.io.splats.glb import placed
from gaga_core.io.splats.packing import (
    EDGE,
    METRE,
    damaged,
    joined_splats,
    logs_of_sizes,
    reading,
    row_bytes,
    sane,
    splat_reader,
    splat_writer,
    unit_quats,
    writing,
)
from gaga_core.progress import Stage

MAGIC = b"PXR-USDC"  # of a .usdc
TEXT = b"#usda"  # of a .usda
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
_KIND = "ParticleField3DGaussianSplat"
_MOST_PRIMS = 2_000
# From right, down, front of a .ply to y up, and to z up: half and a quarter around x.
_Y_UP = np.diag([1.0, -1.0, -1.0, 1.0])
_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def is_usdz(path: Path) -> bool:
    """Whether ``path`` is a package of OpenUSD, by its name: it is a .zip, as a .sog is."""
    return path.suffix.lower() == ".usdz" and path.is_file()


def usd() -> ModuleType:
    """The package ``pxr``; ``GagaError`` with one sentence when it is missing or too old."""
    try:
        import pxr
        from pxr import UsdVol
    except ImportError as error:
        raise GagaError(
            f"OpenUSD needs the package usd-core. Install it: {cure_without('usd')}."
        ) from error
    if not hasattr(UsdVol, _KIND):
        raise GagaError(
            "This usd-core does not know splats yet. Install 26.3 or later: "
            "pip install -U 'gaga-studio[usd]'."
        )
    return pxr


@splat_reader
def read_usd_stage(path: Path) -> Stage[Gaussians]:
    """Read the splats of an OpenUSD file with progress.

    ``GagaError`` with one sentence when it is damaged, has no splats, or the extra is missing.
    """
    usd()
    from pxr import Tf, Usd, UsdGeom, UsdVol

    yield reading(path, 0, 2)
    try:
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
        # What references and instances show is there as often as they do.
        every = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
        prims = [p for p in every if p.IsA(UsdVol.ParticleField3DGaussianSplat)]
    except Tf.ErrorException as error:
        raise damaged(path.name) from error
    if not prims:
        raise GagaError(f"{path.name} holds no splats ({_KIND}). Choose another file.")
    if len(prims) > _MOST_PRIMS:
        raise GagaError(f"{path.name} holds {len(prims):,} fields of splats, which is too many.")
    up = _Z_UP if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else _Y_UP
    places = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    parts, n_stored = list[Gaussians](), path.stat().st_size
    n_bytes = n_stored
    for prim in prims:
        try:
            part = _decoded(UsdVol.ParticleField3DGaussianSplat(prim), Usd.TimeCode.EarliestTime())
            n_bytes += 3 * len(part) * row_bytes(part.sh.shape[1])
            check_memory(path, n_bytes, f"{len(part):,} splats and more", n_stored)
            matrix = np.array(places.GetLocalToWorldTransform(prim), np.float64).T
            parts.append(placed(part, up.T @ matrix))
        except ValueError as error:
            raise GagaError(
                f"{path.name} is not a valid OpenUSD file of splats ({error}). Export it again."
            ) from error
    yield reading(path, 1, 2)
    joined = joined_splats(parts, path, n_bytes).with_metres(_is_in_metres(stage))
    yield reading(path, 2, 2)
    return joined


def _is_in_metres(stage: Any) -> bool:
    """Whether our writer says that the unit is known: those of splats of any scale say metres."""
    from pxr import UsdGeom

    unit = stage.GetRootLayer().customLayerData.get("unit")
    return bool(unit == METRE and UsdGeom.GetStageMetersPerUnit(stage) == 1)


def _decoded(field: Any, time: Any) -> Gaussians:
    """The splats of one prim, its own axes; ``ValueError`` when lengths or a degree are wrong."""
    prim = field.GetPrim()

    def column(name: str, width: int) -> FloatArray:
        value = prim.GetAttribute(name).Get(time)
        if value is None or len(value) == 0:  # a half-precision twin stands for it
            value = prim.GetAttribute(f"{name}h").Get(time)
        if value is None:
            raise ValueError(f"no {name}")
        return sane(np.asarray(value, np.float32).reshape(-1, width))

    means = column("positions", 3)
    n = len(means)
    # Of a GfQuat numpy gets x, y, z, w.
    quats = np.roll(column("orientations", 4), 1, axis=1)
    opacity = np.clip(column("opacities", 1)[:, 0].astype(np.float64), EDGE, 1 - EDGE)
    degree = int(prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get(time))
    if not 0 <= degree <= 4:
        raise ValueError(f"SH of degree {degree}")
    sh = column("radiance:sphericalHarmonicsCoefficients", 3)
    if len(sh) != n * (degree + 1) ** 2:
        raise ValueError("its SH do not fit its degree")
    if {len(quats), len(opacity), len(column("scales", 3))} != {n}:
        raise ValueError("its arrays have different lengths")
    return Gaussians(
        means=means,
        quats=unit_quats(quats),
        log_scales=logs_of_sizes(column("scales", 3)),
        logit_opacities=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh=np.ascontiguousarray(sh.reshape(n, -1, 3)),
    )


def add_splats(stage: Any, path: str, gaussians: Gaussians) -> Any:
    """Define a prim of splats at ``path`` of a stage, in their own axes; returns the schema object.

    float32 throughout; quaternions of unit length, as NVIDIA's rule VG.035 has them.
    """
    usd()
    from pxr import UsdVol, Vt

    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, path)
    columns = usd_columns(gaussians)
    field.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(columns["positions"]))
    quats = Vt.QuatfArray.FromNumpy(columns["orientations"])
    field.CreateOrientationsAttr(quats)
    field.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(columns["scales"]))
    field.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(columns["opacities"]))
    field.CreateRadianceSphericalHarmonicsDegreeAttr(gaussians.sh_degree)
    field.CreateRadianceSphericalHarmonicsCoefficientsAttr(
        Vt.Vec3fArray.FromNumpy(columns["coefficients"])
    )
    reach = 3 * columns["scales"].max(axis=1, keepdims=True)
    lo = (columns["positions"] - reach).min(axis=0)
    hi = (columns["positions"] + reach).max(axis=0)
    field.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([lo, hi]).astype(np.float32)))
    return field


def usd_columns(gaussians: Gaussians) -> dict[str, AnyArray]:
    """The arrays of the schema, float32: quaternions x, y, z, w as numpy hands them to OpenUSD."""
    quats = gaussians.quats.astype(np.float64)
    quats = quats / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-30)
    opacities = 1 / (1 + np.exp(-gaussians.logit_opacities.astype(np.float64)))
    return {
        "positions": np.ascontiguousarray(gaussians.means),
        "orientations": np.ascontiguousarray(np.roll(quats, -1, axis=1), np.float32),
        "scales": np.exp(gaussians.log_scales.astype(np.float64)).astype(np.float32),
        "opacities": opacities.astype(np.float32),
        "coefficients": np.ascontiguousarray(gaussians.sh.reshape(-1, 3)),
    }


@splat_writer
def write_usd_stage(path: Path, gaussians: Gaussians) -> Stage[None]:
    """Write an OpenUSD file with progress: y up, lengths as they are. Whole or not at all."""
    yield writing(path, 0, 1)
    usd()
    from pxr import Gf, Usd, UsdGeom

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    if gaussians.is_metric:
        stage.GetRootLayer().customLayerData = {"unit": METRE}
    root = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(root.GetPrim())
    matrix: DoubleArray = _Y_UP
    root.AddTransformOp().Set(Gf.Matrix4d(matrix.T.tolist()))
    add_splats(stage, "/World/splats", gaussians)
    with atomic_write(path) as temporary:
        export(stage, temporary, path.suffix)
        yield writing(path, 1, 1)


def export(stage: Any, temporary: Path, suffix: str) -> None:
    """Write a stage to ``temporary`` as a file of ``suffix``, whatever its own name ends in."""
    kind = ".usdc" if suffix.lower() in (".usd", ".usdz") else suffix.lower()
    plain = temporary.with_name(f"{temporary.name}{kind}")
    try:
        if not stage.GetRootLayer().Export(str(plain)):
            raise OSError(f"{temporary} cannot be written")
        if suffix.lower() == ".usdz":
            from pxr import UsdUtils

            whole = temporary.with_name(f"{temporary.name}.usdz")
            if not UsdUtils.CreateNewUsdzPackage(str(plain), str(whole)):
                raise OSError(f"{temporary} cannot be written")
            whole.replace(temporary)
        else:
            plain.replace(temporary)
    finally:
        plain.unlink(missing_ok=True)
