"""glTF 2.0 (.glb, .gltf) with splats of the extension ``KHR_gaussian_splatting``.

Numbers are as the extension has them: quaternions xyzw, sizes linear, opacities 0..1, SH in the
order of a .ply. Axes are left, up, front, in which other programs write them; ours are turned half
around z. Reading takes every mesh of the scene with the places of its nodes.
Layout: github.com/KhronosGroup/glTF, extensions/2.0/Khronos/KHR_gaussian_splatting.

Splats that are compressed as SPZ are read too (``KHR_gaussian_splatting_compression_spz_2``, pull
request 2531, and its two former names), but not written: it is a draft, and which way its axes
point is not settled. It says left, up, front after Niantic's library has turned them; CesiumJS and
cesium-native, the only implementations that it names, take the stored numbers for those of the
glTF. We read as they do, unless the SPZ says which way its axes point.
"""

import io
import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats, multiply_quats, quats_to_matrices
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.glb_buffers import BIN, JSON, Buffers, heads, padded
from gaga_core.io.packing import unit_quats
from gaga_core.io.ply import without_broken_rows
from gaga_core.io.spz import decode_spz_stage
from gaga_core.io.spz_axes import turned
from gaga_core.progress import Progress, Stage
from gaga_core.sh_rotation import sh_rotation

MOST_DEGREE = 3  # of SH that the extension has room for
_EXTENSION = "KHR_gaussian_splatting"
_SPZ = (f"{_EXTENSION}_compression_spz_2", f"{_EXTENSION}_compression_spz")  # the draft's names
_FORMER = "KHR_spz_gaussian_splats_compression"  # of the primitive itself, before the first of them
_AXES = "LUF"
_MOST_NODES = 10_000
_FARTHEST = 1e15  # scene units: far beyond what float32 tells apart
_FLOAT, _POINTS = 5126, 0
_TINY = 1e-20  # scene units: a splat of size 0 has no logarithm
_EDGE = 1e-6  # opacities of exactly 0 and 1 have no finite logit
# What JSON of any shape raises where it is taken for a glTF.
_DAMAGED = (
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    ValueError,
    OverflowError,
    struct.error,
)


# --- reading


def read_glb_stage(path: Path) -> Stage[Gaussians]:
    """Read the splats of a .glb or .gltf with progress; its buffers lie in its folder.

    ``GagaError`` with one sentence when it is damaged, has no splats, or has them compressed by
    another extension than SPZ.
    """
    path = Path(path)
    yield Progress("Read splats", 0, 2, path.name)
    try:
        content = path.read_bytes()
        buffers = Buffers.of(content, path)
        parts = yield from _splats_of(buffers, path)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except _DAMAGED as error:
        raise GagaError(f"{path.name} is not a valid glTF ({error}). Export it again.") from error
    if not parts:
        raise GagaError(f"{path.name} holds no splats ({_EXTENSION}). Choose another file.")
    yield Progress("Read splats", 1, 2, path.name)
    whole = turned(_joined(parts), _AXES)
    yield Progress("Read splats", 2, 2, path.name)
    return without_broken_rows(path, whole)


def _splats_of(buffers: Buffers, path: Path) -> Stage[list[Gaussians]]:
    """Splats of every primitive that has some, where its node puts them; axes of the glTF."""
    gltf, found = buffers.gltf, []
    for place, mesh in list(_placed_meshes(gltf)):  # a circle is found before memory is taken
        for primitive in gltf["meshes"][mesh]["primitives"]:
            extensions = primitive.get("extensions", {})
            inside = extensions.get(_EXTENSION, {}).get("extensions", {})
            packed = next((inside[name] for name in _SPZ if name in inside), None)
            packed = extensions.get(_FORMER) if packed is None else packed
            if packed is not None:
                splats = yield from _unpacked(buffers, packed, path)
            elif any("compression" in str(key) for key in inside):
                raise GagaError(
                    f"{path.name} holds compressed splats ({', '.join(map(str, inside))}), of "
                    "which gaga-studio reads SPZ alone in a glTF. Convert it to .ply or .spz."
                )
            elif _EXTENSION in extensions:
                splats = _decoded(buffers, primitive["attributes"])
            else:
                continue
            found.append(_moved(splats, place))
    return found


def _unpacked(buffers: Buffers, extension: Mapping[str, Any], path: Path) -> Stage[Gaussians]:
    """The splats of an SPZ in a buffer view, with the axes of the glTF."""
    content = io.BytesIO(buffers.view(extension["bufferView"]))
    splats = yield from decode_spz_stage(path, content, _AXES)
    return turned(splats, _AXES)  # the half turn is its own inverse


def _placed_meshes(gltf: Mapping[str, Any]) -> Iterator[tuple[DoubleArray, int]]:
    """Place (4, 4) in the scene and number of every mesh of it."""
    nodes = gltf.get("nodes", [])
    scenes = gltf.get("scenes")
    roots = scenes[gltf.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    waiting = [(np.eye(4), int(root)) for root in roots]
    seen = 0
    while waiting:
        parent, index = waiting.pop(0)
        seen += 1
        if seen > _MOST_NODES:
            raise ValueError("its nodes are a circle, or too many")
        node = nodes[index]
        place = parent @ _place_of(node)
        if not np.abs(place).max() < _FARTHEST:  # nor NaN
            raise ValueError("a node lies or scales out of all range")
        if "mesh" in node:
            yield place, int(node["mesh"])
        waiting += [(place, int(child)) for child in node.get("children", [])]


def _place_of(node: Mapping[str, Any]) -> DoubleArray:
    if "matrix" in node:
        matrix: DoubleArray = _numbers(node["matrix"], 16).reshape(4, 4).T
        return matrix
    place = np.eye(4)
    x, y, z, w = _numbers(node.get("rotation", (0, 0, 0, 1)), 4)
    if not x * x + y * y + z * z + w * w > 0:
        raise ValueError("a node's rotation has no length")
    scale = _numbers(node.get("scale", (1, 1, 1)), 3)
    place[:3, :3] = quats_to_matrices(np.array([[w, x, y, z]]))[0] * scale
    place[:3, 3] = _numbers(node.get("translation", (0, 0, 0)), 3)
    return place


def _numbers(values: Sequence[float], n: int) -> DoubleArray:
    """``n`` finite numbers (n,) of a size that can be multiplied; ``ValueError`` otherwise."""
    found = np.array(values, np.float64)
    if found.shape != (n,) or not np.abs(found).max() < _FARTHEST:
        raise ValueError("a node lies or scales out of all range")
    return found


def _decoded(buffers: Buffers, attributes: Mapping[str, int]) -> Gaussians:
    def column(name: str, width: int) -> FloatArray:
        values = buffers.accessor(attributes[name], width)
        return np.ascontiguousarray(values, np.float32)

    means = column("POSITION", 3)
    scales = column(f"{_EXTENSION}:SCALE", 3)
    opacity = np.clip(column(f"{_EXTENSION}:OPACITY", 1)[:, 0], _EDGE, 1 - _EDGE)
    sh = [column(f"{_EXTENSION}:SH_DEGREE_0_COEF_0", 3)]
    for degree in range(1, MOST_DEGREE + 1):
        names = [f"{_EXTENSION}:SH_DEGREE_{degree}_COEF_{k}" for k in range(2 * degree + 1)]
        if not all(name in attributes for name in names):
            break
        sh += [column(name, 3) for name in names]
    found = Gaussians(
        means=means,
        quats=unit_quats(np.roll(column(f"{_EXTENSION}:ROTATION", 4), 1, axis=1)),
        # Sizes are linear; programs of before the extension was settled wrote logarithms.
        log_scales=scales if (scales < 0).any() else np.log(np.maximum(scales, _TINY)),
        logit_opacities=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh=np.ascontiguousarray(np.stack(sh, axis=1)),
    )
    lengths = {len(values) for values in (means, scales, opacity, found.quats, *sh)}
    if len(lengths) != 1:
        raise ValueError("its attributes have different lengths")
    return found


def _moved(gaussians: Gaussians, place: DoubleArray) -> Gaussians:
    """The splats in the scene of their node; a node may turn and scale, but not stretch."""
    if np.array_equal(place, np.eye(4)):
        return gaussians
    linear = place[:3, :3]
    scale = float(np.cbrt(abs(np.linalg.det(linear))))
    if scale <= 0 or not np.allclose(linear @ linear.T, scale**2 * np.eye(3), atol=1e-4 * scale**2):
        raise ValueError("a node stretches its splats")
    rotation = linear / scale
    proper = rotation * np.sign(np.linalg.det(rotation))
    quats = multiply_quats(matrices_to_quats(proper[None]), gaussians.quats.astype(np.float64))
    bands = sh_rotation(rotation, gaussians.sh_degree)
    return replace(
        gaussians,
        means=(gaussians.means @ linear.T + place[:3, 3]).astype(np.float32),
        quats=quats.astype(np.float32),
        log_scales=gaussians.log_scales + np.float32(np.log(scale)),
        sh=np.einsum("st,ntc->nsc", bands, gaussians.sh).astype(np.float32),
    )


def _joined(parts: Sequence[Gaussians]) -> Gaussians:
    n_sh = max(part.sh.shape[1] for part in parts)
    sh = [np.pad(p.sh, ((0, 0), (0, n_sh - p.sh.shape[1]), (0, 0))) for p in parts]
    return Gaussians(
        means=np.concatenate([part.means for part in parts]),
        quats=np.concatenate([part.quats for part in parts]),
        log_scales=np.concatenate([part.log_scales for part in parts]),
        logit_opacities=np.concatenate([part.logit_opacities for part in parts]),
        sh=np.ascontiguousarray(np.concatenate(sh)),
        comments=parts[0].comments if len({part.comments for part in parts}) == 1 else (),
    )


# --- writing


def write_glb_stage(path: Path, gaussians: Gaussians) -> Stage[None]:
    """Write a .glb with progress: float32 throughout, SH up to degree 3. Whole or not at all."""
    there = turned(gaussians, _AXES)  # the half turn is its own inverse
    columns = _columns(there)
    views: list[object] = []
    accessors: list[object] = []
    offset = 0
    for name, values in columns.items():
        width = values.shape[1]
        view = {"buffer": 0, "byteOffset": offset, "byteLength": values.nbytes, "target": 34962}
        accessor: dict[str, object] = {
            "bufferView": len(views),
            "componentType": _FLOAT,
            "count": len(values),
            "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[width],
        }
        if name == "POSITION":
            accessor["min"] = [float(v) for v in values.min(axis=0)]
            accessor["max"] = [float(v) for v in values.max(axis=0)]
        views.append(view)
        accessors.append(accessor)
        offset += values.nbytes
    if offset > 0xFFFFFFFF - (1 << 20):
        raise GagaError(f"{len(there):,} splats do not fit into a GLB (4 GB). Export objects.")
    gltf = _gltf(views, accessors, dict(zip(columns, range(len(columns)), strict=True)), offset)
    text = padded(json.dumps(gltf, separators=(",", ":")).encode())
    head, middle = heads([(JSON, len(text)), (BIN, offset)])
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write(head + text + middle)
        for i, values in enumerate(columns.values()):
            yield Progress("Write splats", i, len(columns), path.name)
            file.write(np.ascontiguousarray(values, "<f4").data)
    yield Progress("Write splats", len(columns), len(columns), path.name)


def _columns(there: Gaussians) -> dict[str, FloatArray]:
    """The attributes (N, 1 to 4) by name, in the order of the file."""
    columns: dict[str, AnyArray] = {
        "POSITION": there.means,
        f"{_EXTENSION}:ROTATION": np.roll(unit_quats(there.quats), -1, axis=1),
        f"{_EXTENSION}:SCALE": np.exp(there.log_scales),
        f"{_EXTENSION}:OPACITY": there.opacities[:, None],
    }
    for degree in range(min(there.sh_degree, MOST_DEGREE) + 1):
        for k in range(2 * degree + 1):
            name = f"{_EXTENSION}:SH_DEGREE_{degree}_COEF_{k}"
            columns[name] = there.sh[:, degree * degree + k]
    return {name: np.ascontiguousarray(values, np.float32) for name, values in columns.items()}


def _gltf(
    views: Sequence[object], accessors: Sequence[object], attributes: Mapping[str, int], n: int
) -> dict[str, object]:
    kernel = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "sortingMethod": "cameraDistance",
        "projection": "perspective",
    }
    primitive = {"attributes": attributes, "mode": _POINTS, "extensions": {_EXTENSION: kernel}}
    return cast(
        dict[str, object],
        {
            "asset": {"version": "2.0", "generator": "gaga-studio"},
            "extensionsUsed": [_EXTENSION],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": "splats"}],
            "meshes": [{"primitives": [primitive]}],
            "buffers": [{"byteLength": n}],
            "bufferViews": views,
            "accessors": accessors,
        },
    )
