"""The chunks of a GLB or the files of a .gltf, and the numbers that its accessors name."""

import base64
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.io.json_file import decode_json

MAGIC = b"glTF"
JSON, BIN = b"JSON", b"BIN\0"  # kinds of chunks
_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_MOST_BUFFERS = 100
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True, eq=False)
class Buffers:
    """A glTF in memory."""

    gltf: Mapping[str, Any]
    binaries: tuple[bytes, ...]  # by the number of the buffer

    @staticmethod
    def of(content: bytes, path: Path) -> "Buffers":
        """The content of a file at ``path``, .glb or .gltf, with the buffers next to it.

        ``GagaError``, ``OSError`` or ``ValueError`` when they do not fit or are not there.
        """
        if content.startswith(MAGIC):
            gltf, binary = _chunks(content, path.name)
        else:
            gltf = decode_json(content, dict[str, Any], path.name, "Export it again.")
            binary = b""
        rows = gltf.get("buffers", [])
        if len(rows) > _MOST_BUFFERS:
            raise ValueError("too many buffers")
        return Buffers(gltf, tuple(_buffer(row, binary, path) for row in rows))

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

    def view(self, index: int) -> bytes:
        """The bytes of a buffer view; ``ValueError`` when some lie outside of the file."""
        view = self.gltf["bufferViews"][_natural(index)]
        binary = self.binaries[_natural(view["buffer"])]
        start = _natural(view.get("byteOffset", 0))
        end = start + _natural(view["byteLength"])
        if end > len(binary):
            raise ValueError("a buffer view that reaches beyond its buffer")
        return binary[start:end]


def _chunks(content: bytes, name: str) -> tuple[dict[str, Any], bytes]:
    """JSON and numbers of a GLB."""
    magic, version, total = _HEAD.unpack_from(content)
    if magic != MAGIC or version != 2:
        raise GagaError(f"{name} is not a GLB of glTF 2.0. Choose another file.")
    if total > len(content):
        raise GagaError(f"{name} is truncated or damaged. Copy or export it again.")
    chunks: dict[bytes, bytes] = {}
    at = _HEAD.size
    while at + _CHUNK.size <= total:
        size, kind = _CHUNK.unpack_from(content, at)
        at += _CHUNK.size
        if at + size > total:
            raise GagaError(f"{name} is truncated or damaged. Copy or export it again.")
        chunks.setdefault(kind, content[at : at + size])
        at += size
    gltf = decode_json(chunks[JSON], dict[str, Any], name, "Export it again.")
    return gltf, chunks.get(BIN, b"")


def _buffer(row: Mapping[str, Any], binary: bytes, path: Path) -> bytes:
    """The bytes of one buffer: of the GLB itself, in the text, or of a file in the same folder."""
    uri = row.get("uri")
    if uri is None:
        return binary
    if not isinstance(uri, str):
        raise ValueError("a buffer whose address is no text")
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2], validate=True)
    file = buffer_file(uri, path)
    if not file.is_file():
        raise GagaError(f"{path.name} needs {uri[:80]}, which is not next to it. Copy it, too.")
    return file.read_bytes()


def buffer_file(uri: str, path: Path) -> Path:
    """The file that the .gltf at ``path`` names, in the same folder or below; it need not exist.

    Raises ``GagaError`` when it lies elsewhere.
    """
    place = PurePosixPath(unquote(uri))
    folder = path.parent.resolve()
    file = (folder / place).resolve()
    if ":" in uri or "\\" in place.name or not file.is_relative_to(folder) or "\0" in str(place):
        raise GagaError(f"{path.name} asks for {uri[:80]}, outside of its folder: not read.")
    return file


def heads(sizes: Sequence[tuple[bytes, int]]) -> list[bytes]:
    """What stands in a GLB before each chunk of these kinds and sizes (multiples of 4 bytes)."""
    total = _HEAD.size + sum(_CHUNK.size + size for _, size in sizes)
    found = [_CHUNK.pack(size, kind) for kind, size in sizes]
    return [_HEAD.pack(MAGIC, 2, total) + found[0], *found[1:]]


def padded(text: bytes) -> bytes:
    """JSON with spaces up to a multiple of 4 bytes."""
    return text + b" " * (-len(text) % 4)


def _natural(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} where a whole number is expected")
    return value
