"""Compressed PLY, as PlayCanvas' tools write it: 16 bytes a splat and 1 byte an SH coefficient.

Each 256 splats share a chunk with the least and the greatest position, log size and color; a splat
holds 32-bit words between them (11, 10 and 11 bits; color 4 x 8 bits with the opacity). Rotations
are the place of the largest part of wxyz and the other three in 10 bits each.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, LongArray, UInt8Array, UInt32Array
from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write
from gaga_core.io.splats.packing import (
    SORTS,
    bytes_of_logits,
    logits_of_bytes,
    morton_order,
    parts_of,
    quats_of_three,
    reading,
    room_for,
    sane,
    splat_reader,
    splat_writer,
    three_of_quats,
    unit_quats,
    writing,
)
from gaga_core.io.splats.ply import PlyHeader, read_header, row_blocks
from gaga_core.progress import Progress, Stage

CHUNK = 256  # splats that share a box
SH_RANGE = 4.0  # coefficients beyond +-4 are clipped
_BLOCK = 256  # chunks worked on at once
_BITS_XYZ = (11, 10, 11)
_BITS_RGBA = (8, 8, 8, 8)
_BITS_ROT = (10, 10, 10)
_AXES = ("x", "y", "z")
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_LIMITS = (
    *(f"{side}_{axis}" for side in ("min", "max") for axis in _AXES),
    *(f"{side}_scale_{axis}" for side in ("min", "max") for axis in _AXES),
    *(f"{side}_{channel}" for side in ("min", "max") for channel in "rgb"),
)
_LOG_SCALE = 20.0  # log sizes beyond +-20 are clipped, as the other writers do
_N_SH = {0: 1, 9: 4, 24: 9, 45: 16}


@splat_reader
def read_compressed_ply_stage(path: Path) -> Stage[Gaussians]:
    """Read a compressed .ply with progress; ``GagaError`` with one sentence when it is damaged."""
    yield reading(path, 0, 0)
    header = read_header(path)
    chunks, rows, rest = _checked(path, header)
    n = len(rows)
    out = room_for(path, n, 1 + rest.shape[1] // 3, rows.nbytes + rest.nbytes + chunks.nbytes)
    for part in parts_of(n, CHUNK * _BLOCK):
        yield reading(path, part.start, n)
        limits = chunks[np.arange(part.start, part.stop) // CHUNK]
        position, rotation, scale, color = (rows[part][k].astype(np.uint32) for k in _PACKED)
        out.means[part] = _between(limits[:, 0:6], _split(position, _BITS_XYZ))
        out.log_scales[part] = _between(limits[:, 6:12], _split(scale, _BITS_XYZ))
        rgb = _between(limits[:, 12:18], _split(color, _BITS_RGBA)[:, :3])
        out.sh[part, 0] = (rgb - np.float32(0.5)) / np.float32(SH_C0)
        out.logit_opacities[part] = logits_of_bytes((color & np.uint32(255)).astype(np.uint8))
        three = (_split(rotation, _BITS_ROT) - np.float32(0.5)) * np.float32(np.sqrt(2))
        out.quats[part] = quats_of_three(rotation >> np.uint32(30), three)
        out.sh[part, 1:] = _sh_of_bytes(rest[part])
    yield reading(path, n, n)
    return replace(out, comments=header.comments)


def _checked(path: Path, header: PlyHeader) -> tuple[FloatArray, AnyArray, AnyArray]:
    """Limits (C, 18), rows of packed words (N,) and SH bytes (N, K); ``GagaError`` if any lacks."""

    def rows_of(name: str) -> AnyArray | None:
        n = header.elements[name].n if name in header.elements else 0
        return next(row_blocks(header, name, n)) if n else None

    chunk, rows = rows_of("chunk"), rows_of("vertex")
    if chunk is None or rows is None or not set(_PACKED) <= set(rows.dtype.names or ()):
        raise GagaError(f"{path.name} is not a compressed PLY. Choose another file.")
    present = set(chunk.dtype.names or ())
    if any(rows.dtype[name].kind not in "iu" for name in _PACKED):
        raise GagaError(f"{path.name} is damaged: it packs other than words. Export it again.")
    if not set(_LIMITS[:12]) <= present or len(chunk) * CHUNK < len(rows):
        raise GagaError(f"{path.name} is damaged: its chunks do not fit. Copy or export it again.")
    limits = np.zeros((len(chunk), 18), np.float32)
    limits[:, 15:] = 1  # files of the first kind have no range of colors: it is 0..1
    for i, name in enumerate(_LIMITS):
        if name in present:
            limits[:, i] = sane(chunk[name])
    sh = rows_of("sh")
    names = (
        [k for k in sh.dtype.names or () if re.fullmatch(r"f_rest_\d+", k)]
        if sh is not None
        else []
    )
    if sh is None or not names:
        return limits, rows, np.zeros((len(rows), 0), np.uint8)
    fits = len(names) in _N_SH and {f"f_rest_{i}" for i in range(len(names))} == set(names)
    if not fits or len(sh) != len(rows) or any(sh.dtype[k] != np.uint8 for k in names):
        raise GagaError(f"{path.name} is damaged: its SH do not fit. Copy or export it again.")
    packed = sh.view(np.uint8).reshape(len(sh), -1)
    order = [sh.dtype.fields[f"f_rest_{i}"][1] for i in range(len(names))]  # type: ignore[index]
    in_order = order == list(range(packed.shape[1]))
    return limits, rows, packed if in_order else packed[:, order]


def _between(limits: FloatArray, t: FloatArray) -> FloatArray:
    """Numbers (N, 3) at ``t`` 0..1 between three lower and three upper limits (N, 6)."""
    result: FloatArray = limits[:, :3] * (1 - t) + limits[:, 3:] * t
    return result


def _split(words: UInt32Array, bits: tuple[int, ...]) -> FloatArray:
    """Numbers 0..1 (N, K) of the bit fields of ``words`` (N,), the last field lowest."""
    fields, shift = [], 0
    for width in reversed(bits):
        top = (1 << width) - 1
        fields.append(((words >> np.uint32(shift)) & np.uint32(top)) / np.float32(top))
        shift += width
    return np.stack(fields[::-1], axis=1).astype(np.float32)


def _joined(values: FloatArray, bits: tuple[int, ...]) -> UInt32Array:
    """The way back from `_split`: values 0..1 (N, K), rounded."""
    words = np.zeros(len(values), np.uint32)
    for i, width in enumerate(bits):
        top = (1 << width) - 1
        field = np.clip(np.floor(values[:, i] * top + 0.5), 0, top).astype(np.uint32)
        words = (words << np.uint32(width)) | field
    return words


def _sh_of_bytes(packed: AnyArray) -> FloatArray:
    """SH (N, K / 3, 3) of channel-major bytes (N, K)."""
    bins = (packed.astype(np.float32) + np.float32(0.5)) / 256
    bins = np.where(packed == 0, 0, np.where(packed == 255, 1, bins))
    values: FloatArray = (bins.astype(np.float32) - np.float32(0.5)) * np.float32(2 * SH_RANGE)
    return values.reshape(len(packed), 3, packed.shape[1] // 3).transpose(0, 2, 1)


def _bytes_of_sh(sh: FloatArray) -> UInt8Array:
    """Channel-major bytes (N, K) of SH (N, K / 3, 3)."""
    bins = np.floor((sh.transpose(0, 2, 1) / (2 * SH_RANGE) + 0.5) * 256)
    packed: UInt8Array = np.clip(bins, 0, 255).astype(np.uint8).reshape(len(sh), -1)
    return packed


# --- writing


@splat_writer
def write_compressed_ply_stage(path: Path, gaussians: Gaussians) -> Stage[None]:
    """Write a compressed .ply with progress; nothing is left when it fails.

    Splats are put in an order in which neighbours share a chunk (along a Z curve), so that the
    boxes are small. SH of degree 4 are cut to degree 3.
    """
    n = len(gaussians)
    yield Progress(SORTS, 0, n, path.name)
    order = morton_order(gaussians.means)
    n_rest = min(gaussians.sh.shape[1] - 1, 15)
    n_chunks = -(-n // CHUNK)
    limits = np.empty((n_chunks, 18), "<f4")
    words = np.empty((n, 4), "<u4")
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write(_header(n, n_chunks, n_rest, gaussians.comments))
        for part in parts_of(n, CHUNK * _BLOCK):
            yield writing(path, part.start // 2, n)
            first = part.start // CHUNK
            low_high, words[part] = _pack(gaussians, order[part])
            limits[first : first + len(low_high)] = low_high
        file.write(limits.data)
        file.write(words.data)
        for part in parts_of(n if n_rest else 0, CHUNK * _BLOCK):
            yield writing(path, (n + part.start) // 2, n)
            file.write(_bytes_of_sh(gaussians.sh[order[part], 1 : 1 + n_rest]).data)
    yield writing(path, n, n)


def _pack(gaussians: Gaussians, some: LongArray) -> tuple[FloatArray, UInt32Array]:
    """Limits (C, 18) and words (K, 4) of the splats ``some`` (K,); the last chunk may be short."""
    n_chunks = -(-len(some) // CHUNK)
    padded = np.concatenate([some, np.repeat(some[-1:], n_chunks * CHUNK - len(some))])
    sizes = np.clip(gaussians.log_scales[padded], -_LOG_SCALE, _LOG_SCALE)
    colors = gaussians.sh[padded, 0] * np.float32(SH_C0) + np.float32(0.5)
    limits, parts = [], []
    for values in (gaussians.means[padded], sizes, colors):
        chunked = values.reshape(n_chunks, CHUNK, 3)
        low, high = chunked.min(axis=1), chunked.max(axis=1)
        span = np.where(high > low, high - low, 1)
        parts.append(((chunked - low[:, None]) / span[:, None]).reshape(-1, 3)[: len(some)])
        limits += [low, high]
    opacity = bytes_of_logits(gaussians.logit_opacities[some]) / np.float32(255)
    largest, three = three_of_quats(unit_quats(gaussians.quats[some]))
    rotation = _joined(three * np.float32(np.sqrt(0.5)) + np.float32(0.5), _BITS_ROT)
    words = [
        _joined(parts[0], _BITS_XYZ),
        rotation | (largest.astype(np.uint32) << np.uint32(30)),
        _joined(parts[1], _BITS_XYZ),
        _joined(np.c_[parts[2], opacity], _BITS_RGBA),
    ]
    return np.concatenate(limits, axis=1), np.stack(words, axis=1)


def _header(n: int, n_chunks: int, n_rest: int, comments: tuple[str, ...]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {c}" for c in comments)]
    lines += [f"element chunk {n_chunks}", *(f"property float {name}" for name in _LIMITS)]
    lines += [f"element vertex {n}", *(f"property uint {name}" for name in _PACKED)]
    if n_rest:
        lines += [f"element sh {n}", *(f"property uchar f_rest_{i}" for i in range(n_rest * 3))]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii", "replace")
