"""Files of glTF made of ours."""

import gzip
import json
import struct
from collections.abc import Mapping
from pathlib import Path

from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.glb import Buffers
from gaga_core.io.splats.splat_files import write_splats


def glb_bytes(gltf: object, binary: bytes | memoryview) -> bytes:
    """A GLB of two chunks."""
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    binary = bytes(binary) + bytes(-len(binary) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    return head + chunks + struct.pack("<I4s", len(binary), b"BIN\0") + binary


def glb_of_spz(
    spz: bytes, name: str, node: Mapping[str, object] | None = None, n_times: int = 1
) -> bytes:
    """A GLB whose splats are an SPZ ``n_times``, of the extension ``name``: Khronos' draft."""
    packed = {name: {"bufferView": 0}}
    inside = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "extensions": packed}
    is_former = name == "KHR_spz_gaussian_splats_compression"  # of the primitive itself
    extensions = packed if is_former else {"KHR_gaussian_splatting": inside}
    gltf = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_gaussian_splatting", name],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **(node or {})}],
        "meshes": [
            {"primitives": n_times * [{"attributes": {}, "mode": 0, "extensions": extensions}]}
        ],
        "buffers": [{"byteLength": len(spz) + 3}],
        "bufferViews": [{"buffer": 0, "byteOffset": 3, "byteLength": len(spz)}],
    }
    return glb_bytes(gltf, bytes(3) + spz)


def silent_spz(content: bytes) -> bytes:
    """An .spz of version 3 of ours without the extension that says which way its axes point."""
    plain = bytearray(gzip.decompress(content))
    plain[14] &= ~2  # flags
    return gzip.compress(bytes(plain[:-12]))


def write_gltf(path: Path, gaussians: Gaussians) -> Path:
    """``path`` (.gltf) and a .bin of the same name next to it; returns ``path``."""
    glb = path.with_suffix(".glb")
    write_splats(glb, gaussians)
    whole = Buffers.of(glb.read_bytes(), glb)
    glb.unlink()
    binary = whole.binaries[0]
    path.with_suffix(".bin").write_bytes(binary)
    buffers = [{"byteLength": len(binary), "uri": f"{path.stem}.bin"}]
    path.write_text(json.dumps({**whole.gltf, "buffers": buffers}), encoding="utf-8")
    return path
