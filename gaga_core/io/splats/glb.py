"""glTF 2.0 (.glb, .gltf) with splats of the extension ``KHR_gaussian_splatting``.

Numbers are as the extension has them: quaternions xyzw, sizes linear, opacities 0..1, SH in the
order of a .ply. Axes are left, up, front, in which other programs write them; ours are turned half
around z. Reading takes every mesh of the scene with the places of its nodes.
Layout: github.com/KhronosGroup/glTF, extensions/2.0/Khronos/KHR_gaussian_splatting, as ratified by
the Khronos Group. ``COLOR_0`` is for viewers without the extension; readers of splats skip it.

Splats that are compressed as SPZ are read too (``KHR_gaussian_splatting_compression_spz_2``, pull
request 2531, and its two former names), but not written: it is a draft, and which way its axes
point is not settled. It says left, up, front after Niantic's library has turned them; CesiumJS and
cesium-native, the only implementations that it names, take the stored numbers for those of the
glTF. We read as they do, unless the SPZ says which way its axes point.
"""

import base64
import glob
import io
import json
import struct
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray
from gaga_core.color import linear_of_srgb, rgb_from_dc, sh_rotation
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats, multiply_quats, quats_to_matrices
from gaga_core.io.files import atomic_write, check_memory, open_file
from gaga_core.io.json_file import decode_json
from gaga_core.io.splats.packing import (
    EDGE,
    METRE,
    READS,
    damaged,
    file_inside,
    joined_splats,
    logs_of_sizes,
    parts_of,
    reading,
    row_bytes,
    sane,
    splat_reader,
    splat_writer,
    unit_quats,
    writing,
)
from gaga_core.io.splats.spz import decode_spz_stage, turned
from gaga_core.progress import Stage, portion

MAGIC = b"glTF"
# Suffixes of splats; a .ply may be a mesh, too.
_SPLATS_ALONE = (".ply", ".splat", ".spz", ".sog", ".ksplat")
JSON, BIN = b"JSON", b"BIN\0"  # kinds of chunks
_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_ASSET = {"version": "2.0", "generator": "gaga-studio"}
_MOST_BUFFERS = 100
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
MOST_DEGREE = 3  # of SH that the extension has room for
_EXTENSION = "KHR_gaussian_splatting"
_SPZ = (f"{_EXTENSION}_compression_spz_2", f"{_EXTENSION}_compression_spz")  # the draft's names
_FORMER = "KHR_spz_gaussian_splats_compression"  # of the primitive itself, before the first of them
_AXES = "LUF"
_MOST_NODES, _MOST_PARTS = 10_000, 2_000
_SPLAT_BYTES = 2 * row_bytes((MOST_DEGREE + 1) ** 2)  # while it is decoded, columns and all
_AT_ONCE = 1 << 13  # splats: 2 MB, so that each column finds them in the processor's cache
_FARTHEST = 1e15  # scene units: far beyond what float32 tells apart
FLOAT, UNSIGNED, _POINTS = 5126, 5125, 0
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
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True, eq=False)
class Buffers:
    """A glTF in memory."""

    gltf: Mapping[str, Any]
    binaries: tuple[memoryview, ...]  # by the number of the buffer

    @staticmethod
    def of(content: bytes, path: Path) -> "Buffers":
        """The content of a file at ``path``, .glb or .gltf, with the buffers next to it.

        ``GagaError``, ``OSError`` or ``ValueError`` when they do not fit or are not there.
        """
        if content.startswith(MAGIC):
            gltf, binary = _chunks(content, path.name)
        else:
            gltf = decode_json(content, dict[str, Any], path.name, "Export it again.")
            binary = memoryview(b"")
        rows = gltf.get("buffers", [])
        if len(rows) > _MOST_BUFFERS:
            raise ValueError("too many buffers")
        named = {row.get("uri"): row for row in rows}  # one that is named twice is read once
        read = {uri: _buffer(row, binary, path) for uri, row in named.items()}
        return Buffers(gltf, tuple(read[row.get("uri")] for row in rows))

    @property
    def n_stored(self) -> int:
        """Bytes of all buffers."""
        return sum(len(binary) for binary in {id(b): b for b in self.binaries}.values())

    def accessor(self, index: int, width: int) -> AnyArray:
        """Numbers (N, width) of an accessor, float where it is normalized.

        Raises ``ValueError`` when it names other numbers, or some outside of the file.
        """
        accessor = self.gltf["accessors"][_natural(index)]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ValueError("a sparse accessor")
        view = self.gltf["bufferViews"][_natural(accessor["bufferView"])]
        binary = self.binaries[_natural(view["buffer"])]
        if _WIDTHS[accessor["type"]] != width:
            raise ValueError(f"an accessor of {accessor['type']}")
        kind, n = np.dtype(_TYPES[accessor["componentType"]]), _natural(accessor["count"])
        step = _natural(view.get("byteStride", 0)) or kind.itemsize * width
        start = _natural(view.get("byteOffset", 0)) + _natural(accessor.get("byteOffset", 0))
        end = start + (n - 1) * step + kind.itemsize * width
        limit = _natural(view.get("byteOffset", 0)) + _natural(view["byteLength"])
        if n < 1 or step < kind.itemsize * width or end > min(limit, len(binary)):
            raise ValueError("an accessor that reaches beyond its buffer")
        values = np.ndarray((n, width), kind, binary, start, (step, kind.itemsize))
        if not accessor.get("normalized", False):
            return values
        most = np.float32(np.iinfo(kind).max)
        shares: AnyArray = np.maximum(values.astype(np.float32) / most, -1)
        return shares

    def view(self, index: int) -> memoryview:
        """The bytes of a buffer view; ``ValueError`` when some lie outside of the file."""
        view = self.gltf["bufferViews"][_natural(index)]
        binary = self.binaries[_natural(view["buffer"])]
        start = _natural(view.get("byteOffset", 0))
        end = start + _natural(view["byteLength"])
        if end > len(binary):
            raise ValueError("a buffer view that reaches beyond its buffer")
        return binary[start:end]


def _chunks(content: bytes, name: str) -> tuple[dict[str, Any], memoryview]:
    """JSON and numbers of a GLB."""
    magic, version, total = _HEAD.unpack_from(content)
    if magic != MAGIC or version != 2:
        raise GagaError(f"{name} is not a GLB of glTF 2.0. Choose another file.")
    if total > len(content):
        raise damaged(name)
    chunks: dict[bytes, memoryview] = {}
    whole = memoryview(content)
    at = _HEAD.size
    while at + _CHUNK.size <= total:
        size, kind = _CHUNK.unpack_from(content, at)
        at += _CHUNK.size
        if at + size > total:
            raise damaged(name)
        chunks.setdefault(kind, whole[at : at + size])
        at += size
    gltf = decode_json(bytes(chunks[JSON]), dict[str, Any], name, "Export it again.")
    return gltf, chunks.get(BIN, memoryview(b""))


def _buffer(row: Mapping[str, Any], binary: memoryview, path: Path) -> memoryview:
    """The bytes of one buffer: of the GLB itself, in the text, or of a file in the same folder."""
    uri = row.get("uri")
    if uri is None:
        return binary
    if not isinstance(uri, str):
        raise ValueError("a buffer whose address is no text")
    if uri.startswith("data:"):
        return memoryview(base64.b64decode(uri.partition(",")[2], validate=True))
    file = buffer_file(uri, path)
    if not file.is_file():
        raise GagaError(f"{path.name} needs {uri[:80]}, which is not next to it. Copy it, too.")
    with open_file(file) as stream:
        return memoryview(stream.read())


def buffer_file(uri: str, path: Path) -> Path:
    """The file that the .gltf at ``path`` names, in the same folder or below; it need not exist.

    Raises ``GagaError`` when it lies elsewhere.
    """
    place = unquote(uri)
    is_name = ":" not in uri and "\\" not in PurePosixPath(place).name
    return file_inside(path, place if is_name else "..")


def _natural(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} where a whole number is expected")
    return value


# --- reading


@splat_reader
def read_glb_stage(path: Path) -> Stage[Gaussians]:
    """Read the splats of a .glb or .gltf with progress; its buffers lie in its folder.

    ``GagaError`` with one sentence when it is damaged, has no splats, or has them compressed by
    another extension than SPZ.
    """
    yield reading(path, 0, 2)
    try:
        with open_file(path) as file:
            buffers = Buffers.of(file.read(), path)
        parts = yield from _splats_of(buffers, path)
    except _DAMAGED as error:
        raise GagaError(f"{path.name} is not a valid glTF ({error}). Export it again.") from error
    if not parts:
        raise GagaError(_why_no_splats(path, has_meshes=bool(buffers.gltf.get("meshes"))))
    yield reading(path, 1, 2)
    alike = parts[0].comments if len({part.comments for part in parts}) == 1 else ()
    joined = joined_splats(parts, path, path.stat().st_size + buffers.n_stored)
    del parts
    whole = turned(replace(joined, comments=alike), _AXES)
    whole = whole.with_metres(_unit_of(buffers.gltf) == METRE)
    yield reading(path, 2, 2)
    return whole


def _why_no_splats(path: Path, *, has_meshes: bool) -> str:
    """The sentence on a glTF without splats; of a mesh it names a file of splats next to it."""
    if not has_meshes:
        return f"{path.name} holds no splats ({_EXTENSION}). Choose another file."
    name = path.name.partition(".")[0]  # of the object: the files of an export share it
    near = sorted(path.parent.glob(f"{glob.escape(name)}.*"))
    splats = [file.name for file in near if file.suffix.lower() in _SPLATS_ALONE and file.is_file()]
    cure = "Export the object as splats (.ply, .spz, .sog, ...) and open that."
    return (
        f"{path.name} is a mesh of triangles, and gaga-studio opens splats alone. "
        f"{f'Try {splats[0]} next to it.' if splats else cure}"
    )


def _splats_of(buffers: Buffers, path: Path) -> Stage[list[Gaussians]]:
    """Splats of every primitive that has some, where its node puts them; axes of the glTF."""
    gltf, found = buffers.gltf, list[Gaussians]()
    meshes = list(_placed_meshes(gltf))  # a circle is found before memory is taken
    n_stored = n_bytes = path.stat().st_size + buffers.n_stored
    n_parts, done = sum(len(gltf["meshes"][mesh]["primitives"]) for _, mesh in meshes), 0
    if n_parts > _MOST_PARTS:
        raise ValueError("too many primitives")
    for place, mesh in meshes:
        for primitive in gltf["meshes"][mesh]["primitives"]:
            begin, done = done, done + 1
            extensions = primitive.get("extensions", {})
            inside = extensions.get(_EXTENSION, {}).get("extensions", {})
            packed = next((inside[name] for name in _SPZ if name in inside), None)
            packed = extensions.get(_FORMER) if packed is None else packed
            if packed is not None:
                inner = io.BytesIO(buffers.view(packed["bufferView"]))
                decoded = decode_spz_stage(path, inner, _AXES)
                half = 2 * n_parts  # the other half of the share is that of joining them
                stored = yield from portion(decoded, begin / half, done / half, READS)
                splats = turned(stored, _AXES)  # the half turn is its own inverse
            elif any("compression" in str(key) for key in inside):
                raise GagaError(
                    f"{path.name} holds compressed splats ({', '.join(map(str, inside))}), of "
                    "which gaga-studio reads SPZ alone in a glTF. Convert it to .ply or .spz."
                )
            elif _EXTENSION in extensions:
                n = _natural(
                    gltf["accessors"][_natural(primitive["attributes"]["POSITION"])]["count"]
                )
                taken = n_bytes + n * _SPLAT_BYTES
                check_memory(path, taken, f"{n:,} splats and more", n_stored)
                splats = _decoded(buffers, primitive["attributes"])
            else:
                continue
            # Next to them stand those of the whole, first in the axes of the file.
            n_bytes += 3 * len(splats) * row_bytes(splats.sh.shape[1])
            check_memory(path, n_bytes, f"{len(splats):,} splats and more", n_stored)
            found.append(placed(splats, place))
    return found


def _unit_of(gltf: Mapping[str, Any]) -> object:
    """The unit of which our writer says that it is known: by its standard every glTF is in metres,
    and those of splats of any scale are written all the same."""
    asset = gltf.get("asset")
    extras = asset.get("extras") if isinstance(asset, dict) else None
    return extras.get("unit") if isinstance(extras, dict) else None


def _placed_meshes(gltf: Mapping[str, Any]) -> Iterator[tuple[DoubleArray, int]]:
    """Place (4, 4) in the scene and number of every mesh of it."""
    nodes = gltf.get("nodes", [])
    scenes = gltf.get("scenes")
    roots = scenes[gltf.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    waiting = deque((np.eye(4), int(root)) for root in roots)
    seen = 0
    while waiting:
        parent, index = waiting.popleft()
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
        return sane(values)

    means = column("POSITION", 3)
    scales = column(f"{_EXTENSION}:SCALE", 3)
    opacity = np.clip(column(f"{_EXTENSION}:OPACITY", 1)[:, 0], EDGE, 1 - EDGE)  # NaN stays
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
        log_scales=scales if (scales < 0).any() else logs_of_sizes(scales),
        logit_opacities=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh=np.ascontiguousarray(np.stack(sh, axis=1)),
    )
    lengths = {len(values) for values in (means, scales, opacity, found.quats, *sh)}
    if len(lengths) != 1:
        raise ValueError("its attributes have different lengths")
    return found


def placed(gaussians: Gaussians, place: DoubleArray) -> Gaussians:
    """The splats moved by ``place`` (4, 4), which may turn and scale, but not stretch."""
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


# --- writing


@splat_writer
def write_glb_stage(path: Path, gaussians: Gaussians) -> Stage[None]:
    """Write a .glb with progress: float32 throughout, SH up to degree 3. Whole or not at all."""
    n, nothing = len(gaussians), np.float32(0)
    columns: dict[str, AnyArray] = {
        name: np.broadcast_to(nothing, (n, values.shape[1]))  # of that size, without memory
        for name, values in _columns(gaussians.bare(slice(0, 1))).items()
    }
    if sum(values.nbytes for values in columns.values()) > 0xFFFFFFFF - (1 << 20):
        raise GagaError(f"{len(gaussians):,} splats do not fit into a GLB (4 GB). Export objects.")
    columns["POSITION"] = turned(replace(gaussians, sh=gaussians.sh[:, :1]), _AXES).means
    kernel = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "sortingMethod": "cameraDistance",
        "projection": "perspective",
    }
    primitive = {
        "attributes": dict(zip(columns, range(len(columns)), strict=True)),
        "mode": _POINTS,
        "extensions": {_EXTENSION: kernel},
    }
    described = {
        "asset": {**_ASSET, **({"extras": {"unit": METRE}} if gaussians.is_metric else {})},
        "extensionsUsed": [_EXTENSION],
        "nodes": [{"mesh": 0, "name": "splats"}],
        "meshes": [{"primitives": [primitive]}],
    }
    head = glb_head(described, columns)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write(head)
        for part in parts_of(n, _AT_ONCE):
            start = len(head)
            # The half turn is its own inverse.
            for values in _columns(turned(gaussians.bare(part), _AXES)).values():
                file.seek(start + part.start * values.strides[0])
                file.write(values.data)
                start += n * values.strides[0]
            yield writing(path, part.stop, n)


def glb_head(described: Mapping[str, object], columns: Mapping[str, AnyArray]) -> bytes:
    """A GLB of one scene with one node, as far as to its numbers: those of one column, then those
    of the next.

    ``described`` holds the properties of its JSON but for those of numbers; ``columns`` are float32
    (N, 1 to 4) attributes in order, or uint32 (N, 1) indices, which come last.
    """
    views: list[object] = []
    accessors: list[object] = []
    offset = 0
    for name, values in columns.items():
        is_index = values.dtype.kind == "u"
        place = {"buffer": 0, "byteOffset": offset, "byteLength": values.nbytes}
        views.append({**place, "target": 34963 if is_index else 34962})
        accessor: dict[str, object] = {
            "bufferView": len(accessors),
            "componentType": UNSIGNED if is_index else FLOAT,
            "count": len(values),
            "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1]],
        }
        if name == "POSITION":
            accessor["min"] = [float(v) for v in values.min(axis=0)]
            accessor["max"] = [float(v) for v in values.max(axis=0)]
        accessors.append(accessor)
        offset += values.nbytes
    gltf = {
        "asset": _ASSET,
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        **described,
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(gltf, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    total = _HEAD.size + 2 * _CHUNK.size + len(text) + offset
    first = _HEAD.pack(MAGIC, 2, total) + _CHUNK.pack(len(text), JSON)
    return first + text + _CHUNK.pack(offset, BIN)


def _columns(there: Gaussians) -> dict[str, FloatArray]:
    """The attributes (N, 1 to 4) by name, in the order of the file."""
    shown = linear_of_srgb(np.clip(rgb_from_dc(there.sh[:, 0]), 0, 1))
    columns: dict[str, AnyArray] = {
        "POSITION": there.means,
        # What viewers without the extension draw: points in the color of degree 0, linear light.
        "COLOR_0": np.column_stack([shown, there.opacities]),
        f"{_EXTENSION}:ROTATION": np.roll(unit_quats(there.quats), -1, axis=1),
        f"{_EXTENSION}:SCALE": np.exp(there.log_scales),
        f"{_EXTENSION}:OPACITY": there.opacities[:, None],
    }
    for degree in range(min(there.sh_degree, MOST_DEGREE) + 1):
        for k in range(2 * degree + 1):
            name = f"{_EXTENSION}:SH_DEGREE_{degree}_COEF_{k}"
            columns[name] = there.sh[:, degree * degree + k]
    return {name: np.ascontiguousarray(values, "<f4") for name, values in columns.items()}
