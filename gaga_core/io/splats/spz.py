"""SPZ, Niantic's compact format: fixed-point positions and a byte for most other numbers.

Versions 1 to 3 are one gzip stream, or are not compressed: a header of 16 bytes, each attribute of
all splats, extensions. Version 4 has a header of 32 bytes, extensions, a table of sizes, and each
attribute as a Zstandard stream. Layout: github.com/nianticlabs/spz.

Which way axes point: Niantic's page says right, up, back (RUB); its own command and other programs
store what a .ply holds: right, down, front (RDF), which is ours. The extension
``SPZ_ADOBE_coordinate_system`` says what a file holds; without it, a file is read as those programs
do. See github.com/nianticlabs/spz, extensions/README.md, and its issue 84.
"""

import gzip
import os
import struct
import zlib
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, Literal, Protocol

import numpy as np
import zstandard

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray, UInt8Array
from gaga_core.color import sh_rotation
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats, multiply_quats
from gaga_core.io.files import atomic_write, explain_os_error, open_file
from gaga_core.io.splats.packing import (
    bytes_of_logits,
    damaged,
    dc_of_bytes,
    logits_of_bytes,
    parts_of,
    quats_of_three,
    reading,
    room_for,
    row_bytes,
    splat_reader,
    splat_writer,
    three_of_quats,
    to_bytes,
    unit_quats,
    writing,
)
from gaga_core.progress import Stage

# Numbers of the extension: where x, y and z point (left, right; up, down; front, back).
AXES = (
    *("", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)
# As which files that do not say it are read: as other programs write them, or as their page says.
SilentAxes = Literal["RDF", "RUB"]
OURS: SilentAxes = "RDF"
_RECORD = struct.Struct("<II")  # type, bytes that follow
_TYPE = 0xADBE0003
_UP, _UP_TYPE = struct.Struct("<3f"), 0x47410001  # ours: which way is up, in the axes of the file
_UNIT, _UNIT_TYPE = struct.Struct("<f"), 0x47410002  # ours: metres of a unit
_UNSPECIFIED = "RUB"  # what the number 0 means: a file that has the extension but does not say
_DIRECTIONS = {
    **{"R": (1, 0, 0), "L": (-1, 0, 0)},
    **{"D": (0, 1, 0), "U": (0, -1, 0)},
    **{"F": (0, 0, 1), "B": (0, 0, -1)},
}

GZIP_MAGIC, MAGIC = b"\x1f\x8b", b"NGSP"
COLOR_SCALE = 0.15  # of a DC coefficient in a byte
HEAD = struct.Struct("<4sIIBBBB")
HEAD_4 = struct.Struct("<4sIIBBBBI12x")
SIZES = struct.Struct("<QQ")
AA, HAS_EXTENSIONS = 1, 2  # flags
_ANTIALIASED = "antialiased 1"
_DAMAGED = (EOFError, gzip.BadGzipFile, zlib.error, zstandard.ZstdError, struct.error)
_MOST_RATIO = 1040  # deflate cannot do better, so a header that promises more is wrong
_MOST_EXTENSIONS = 1 << 20  # bytes
_WORK = 64 << 20  # bytes of a part that is worked on, of SH of degree 4 as doubles
MOST_BITS = 16  # after the point of a position, when the scene is small enough
SH_BUCKETS = (8, 16)  # of 256: SH of degree 1 keep 5 bits, the others 4, as Niantic's writer does
# 5: a quarter of the time of 6 with random SH of degree 3, for files 1 % larger.
_GZIP_LEVEL, _ZSTD_LEVEL = 5, 9


def extensions_of(gaussians: Gaussians) -> bytes:
    """The records that say that the axes are ours, and which way is up and that a unit is a metre
    where that is known."""
    records = _RECORD.pack(_TYPE, 4) + struct.pack("<I", AXES.index(OURS))
    if (up := gaussians.up) is not None:
        records += _RECORD.pack(_UP_TYPE, _UP.size) + _UP.pack(*up)
    if gaussians.is_metric:
        records += _RECORD.pack(_UNIT_TYPE, _UNIT.size) + _UNIT.pack(1.0)
    return records


def _records(extensions: bytes, name: str) -> dict[int, bytes]:
    """The records of the extensions of a file by type.

    ``name`` is the file's, for the ``GagaError`` when the records are damaged.
    """
    at, found = 0, dict[int, bytes]()
    while at + _RECORD.size <= len(extensions):
        kind, size = _RECORD.unpack_from(extensions, at)
        at += _RECORD.size
        if at + size > len(extensions):
            raise GagaError(f"{name} is damaged: its extensions do not fit. Export it again.")
        found.setdefault(kind, extensions[at : at + size])
        at += size
    return found


def _axes_in(records: dict[int, bytes], name: str) -> str:
    """The axes that the records of a file say, "" when they do not."""
    said = records.get(_TYPE, b"")
    if len(said) != 4:
        return ""
    (number,) = struct.unpack("<I", said)
    if number >= len(AXES):
        raise GagaError(f"{name} has axes of an unknown kind ({number}). Export it again.")
    return AXES[number] or _UNSPECIFIED


def axes_map(axes: str) -> DoubleArray:
    """The signed permutation (3, 3) that takes points of a file with these axes to ours."""
    return np.array([_DIRECTIONS[letter] for letter in axes], np.float64).T


def turned(gaussians: Gaussians, axes: str) -> Gaussians:
    """The splats of a file with these axes in ours: centres, rotations and SH; exact but for SH.

    Axes of the other hand mirror the scene, as they do in Niantic's library.
    """
    if axes in ("", OURS):
        return gaussians
    matrix = axes_map(axes)
    signs = np.diag(matrix)
    if np.array_equal(np.diag(signs), matrix):  # no axis takes another's place
        x, y, z = signs
        quats = gaussians.quats * np.array([1, y * z, x * z, x * y], np.float32)
    else:  # a mirror and a point reflection are a rotation, and ellipsoids do not tell them apart
        proper = matrix * np.sign(np.linalg.det(matrix))
        turn = matrices_to_quats(proper[None])
        quats = multiply_quats(turn, gaussians.quats.astype(np.float64)).astype(np.float32)
    bands = np.rint(sh_rotation(matrix, gaussians.sh_degree) * 1e12) / 1e12
    own, sh = np.diag(bands), np.empty_like(gaussians.sh)
    if np.array_equal(np.diag(own), bands):  # signs alone; + 0: as a sum of products has it
        np.multiply(gaussians.sh, own[:, None].astype(np.float32), out=sh)
        sh += 0
        own = own[:0]
    for part in parts_of(len(sh) if len(own) else 0):
        sh[part] = np.einsum(
            "st,ntc->nsc", bands, gaussians.sh[part].astype(np.float64), optimize=True
        )
    return replace(
        gaussians,
        means=np.ascontiguousarray(gaussians.means @ matrix.T.astype(np.float32)),
        quats=np.ascontiguousarray(quats),
        sh=sh,
    )


class _Stream(Protocol):
    def read(self, size: int, /) -> bytes: ...


class _Sink(Protocol):
    def write(self, data: memoryview, /) -> int: ...


@dataclass(frozen=True)
class Head:
    """Header of a file."""

    version: int
    n: int
    degree: int
    fraction_bits: int
    flags: int  # `AA`, `HAS_EXTENSIONS`

    @property
    def n_rest(self) -> int:
        """Coefficients of the SH above degree 0."""
        return (self.degree + 1) ** 2 - 1

    @property
    def widths(self) -> dict[str, int]:
        """Bytes of a splat in each section, in the order of the file."""
        widths = {
            "means": 6 if self.version == 1 else 9,
            "opacities": 1,
            "colors": 3,
            "scales": 3,
            "quats": 4 if self.version >= 3 else 3,
            "sh": 3 * self.n_rest,
        }
        return {name: width for name, width in widths.items() if width}


# --- reading


@splat_reader
def read_spz_stage(path: Path, silent_axes: str = OURS) -> Stage[Gaussians]:
    """Read an .spz file of version 1 to 4 with progress.

    Antialiasing becomes the comment ``antialiased 1``, as in a .ply; the axes that an extension
    names become ours, and without one (`states_axes`) they are taken for ``silent_axes``. Which
    way is up, and that a unit is a metre, become comments where our own extensions say it.
    ``GagaError`` with one sentence when the file is damaged or newer, or needs too much memory.
    """
    with open_file(path) as file:
        return (yield from decode_spz_stage(path, file, silent_axes))


def decode_spz_stage(path: Path, file: BinaryIO, silent_axes: str) -> Stage[Gaussians]:
    """The splats of an SPZ that ``file`` holds, in our axes; ``path`` is named in messages.

    See `read_spz_stage`.
    """
    try:
        start = file.read(4)
        file.seek(0)
        if start[:2] != GZIP_MAGIC and start != MAGIC:
            raise GagaError(f"{path.name} is not an SPZ file. Choose another file.")
        read = _read_4 if _is_version_4(file) else _read_stream
        head, out, extensions = yield from read(path, file)
        records = _records(extensions, path.name)
        axes = _axes_in(records, path.name) or silent_axes
    except _DAMAGED as error:
        raise damaged(path.name) from error
    yield reading(path, head.n, head.n)
    if head.flags & AA:
        out = replace(out, comments=(_ANTIALIASED,))
    if axes == OURS and len(up := records.get(_UP_TYPE, b"")) == _UP.size:
        out = out.with_up(_UP.unpack(up))
    if records.get(_UNIT_TYPE) == _UNIT.pack(1.0):
        out = out.with_metres()
    return turned(out, axes)


def states_axes(path: Path) -> bool:
    """Whether an .spz file says which way its axes point.

    Raises ``GagaError`` when it cannot be read.
    """
    try:
        with open_file(path) as file:
            is_packed = file.read(2) == GZIP_MAGIC
            file.seek(0)
            with gzip.GzipFile(fileobj=file) if is_packed else nullcontext(file) as stream:
                magic, *_, flags, _ = HEAD.unpack(_exactly(stream, HEAD.size))
    except _DAMAGED as error:
        raise damaged(path.name) from error
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    return bool(magic == MAGIC and flags & HAS_EXTENSIONS)


def _is_version_4(file: BinaryIO) -> bool:
    """Whether the file is a container of version 4, not a plain stream of an older one."""
    start = _exactly(file, 8)
    file.seek(0)
    version = int.from_bytes(start[4:], "little")
    return start[:4] == MAGIC and not 1 <= version <= 3


def _read_stream(path: Path, file: BinaryIO) -> Stage[tuple[Head, Gaussians, bytes]]:
    size = _size_of(file)
    is_packed = file.read(2) == GZIP_MAGIC
    file.seek(0)
    with gzip.GzipFile(fileobj=file) if is_packed else nullcontext(file) as stream:
        magic, version, n, degree, bits, flags, _ = HEAD.unpack(_exactly(stream, HEAD.size))
        head = _checked(path, magic, Head(version, n, degree, bits, flags))
        ratio = _MOST_RATIO if is_packed else 1
        if version > 3 or n * sum(head.widths.values()) > ratio * size:
            raise damaged(path.name)
        out = _room(path, head)
        done = 0
        for name in head.widths:
            yield from _read_section(path, stream, head, name, (out, done))
            done += head.widths[name]
        records = stream.read(_MOST_EXTENSIONS) if head.flags & HAS_EXTENSIONS else b""
    return head, out, records


def _read_4(path: Path, file: BinaryIO) -> Stage[tuple[Head, Gaussians, bytes]]:
    size = _size_of(file)
    magic, version, n, degree, bits, flags, n_streams, toc = HEAD_4.unpack(
        _exactly(file, HEAD_4.size)
    )
    head = _checked(path, magic, Head(version, n, degree, bits, flags))
    widths = head.widths
    at = toc + n_streams * SIZES.size
    if version < 4 or n_streams != len(widths) or toc < HEAD_4.size or at > size:
        raise GagaError(f"{path.name} is damaged: its table does not fit. Export it again.")
    n_records = min(toc - HEAD_4.size, _MOST_EXTENSIONS) if head.flags & HAS_EXTENSIONS else 0
    records = _exactly(file, n_records) if n_records else b""
    file.seek(toc)
    table = [SIZES.unpack(_exactly(file, SIZES.size)) for _ in widths]
    wanted = [n * width for width in widths.values()]
    if [plain for _, plain in table] != wanted or at + sum(p for p, _ in table) > size:
        raise damaged(path.name)
    out = _room(path, head)
    done = 0
    for name, (packed, _) in zip(widths, table, strict=True):
        file.seek(at)
        with zstandard.ZstdDecompressor().stream_reader(file, closefd=False) as stream:
            yield from _read_section(path, stream, head, name, (out, done))
        at, done = at + packed, done + widths[name]
    return head, out, records


def _checked(path: Path, magic: bytes, head: Head) -> Head:
    if magic != MAGIC:
        raise GagaError(f"{path.name} is not an SPZ file. Choose another file.")
    if head.version > 4:
        raise GagaError(f"{path.name} is SPZ version {head.version}; gaga-studio reads 1 to 4.")
    if head.version < 1 or head.degree > 4 or head.fraction_bits > 24:
        raise GagaError(f"{path.name} is damaged: its header makes no sense. Export it again.")
    if head.n == 0:
        raise GagaError(f"{path.name} holds 0 splats. Choose another file.")
    return head


def _room(path: Path, head: Head) -> Gaussians:
    """Room for the splats, and for a second set of them in our axes."""
    n_sh = 1 + head.n_rest
    return room_for(path, head.n, n_sh, head.n * row_bytes(n_sh) + _WORK)


def _read_section(
    path: Path, stream: _Stream, head: Head, name: str, into: tuple[Gaussians, int]
) -> Stage[None]:
    """Decode one attribute of all splats; ``into``: the target, and bytes a splat before it."""
    out, before = into
    width, total = head.widths[name], sum(head.widths.values())
    for part in parts_of(head.n):
        yield reading(path, (head.n * before + part.start * width) // total, head.n)
        k = part.stop - part.start
        raw = np.frombuffer(_exactly(stream, k * width), np.uint8).reshape(k, width)
        if name == "means":
            out.means[part] = _positions(raw, head)
        elif name == "opacities":
            out.logit_opacities[part] = logits_of_bytes(raw[:, 0])
        elif name == "colors":
            out.sh[part, 0] = dc_of_bytes(raw, COLOR_SCALE)
        elif name == "scales":
            out.log_scales[part] = raw / np.float32(16) - 10
        elif name == "quats":
            out.quats[part] = _quats(raw) if head.version >= 3 else _quats_xyz(raw)
        else:
            out.sh[part, 1:] = (raw.reshape(k, -1, 3).astype(np.float32) - 128) / 128


def _positions(raw: UInt8Array, head: Head) -> FloatArray:
    if head.version == 1:
        halves: FloatArray = raw.view("<f2").astype(np.float32)
        return halves
    wide = np.zeros((len(raw), 3, 4), np.uint8)
    wide[:, :, 1:] = raw.reshape(-1, 3, 3)  # in the upper bytes, so that the sign is in its place
    fixed = wide.view("<i4")[:, :, 0] >> 8
    return fixed.astype(np.float32) / np.float32(1 << head.fraction_bits)


def _quats(raw: UInt8Array) -> FloatArray:
    """Quaternions (N, 4) wxyz of sign and 9 bits each of the three smaller parts of xyzw."""
    words = np.ascontiguousarray(raw).view("<u4")[:, 0]
    fields = np.stack([words >> np.uint32(shift) for shift in (20, 10, 0)], axis=1)
    three = (fields & np.uint32(511)).astype(np.float32) * np.float32(np.sqrt(0.5) / 511)
    three = np.where(fields & np.uint32(512), -three, three)
    return np.roll(quats_of_three(words >> np.uint32(30), three), 1, axis=1)


def _quats_xyz(raw: UInt8Array) -> FloatArray:
    xyz = raw / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(1 - (xyz * xyz).sum(axis=1, keepdims=True), 0))
    quats: FloatArray = np.concatenate([w, xyz], axis=1).astype(np.float32)
    return unit_quats(quats)


def _size_of(file: BinaryIO) -> int:
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    return size


def _exactly(stream: _Stream, size: int) -> bytes:
    """``size`` bytes; ``EOFError`` when the stream ends before."""
    pieces, missing = [], size
    while missing:
        piece = stream.read(missing)
        if not piece:
            raise EOFError
        pieces.append(piece)
        missing -= len(piece)
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


# --- writing


@splat_writer
def write_spz_stage(path: Path, gaussians: Gaussians, version: int = 3) -> Stage[None]:
    """Write an .spz file of version 3 (which most programs read) or 4, with progress.

    Positions get as many bits after the point as the scene's extent leaves, 16 at most; SH keep 5
    bits in degree 1 and 4 above, as Niantic's writer does. The axes are ours, as other programs
    write them, and an extension says so; others say which way is up and that a unit is a metre,
    where the comments do.
    Nothing is left when it fails.
    """
    if version not in (3, 4):
        raise ValueError(f"version: expected 3 or 4, got {version}")
    bits = fraction_bits(gaussians.means)
    flags = HAS_EXTENSIONS | (AA if gaussians.is_antialiased else 0)
    head = Head(version, len(gaussians), gaussians.sh_degree, bits, flags)
    numbers = (head.n, head.degree, head.fraction_bits, head.flags)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        if version == 3:
            with gzip.GzipFile("", "wb", _GZIP_LEVEL, file, 0) as stream:
                stream.write(HEAD.pack(MAGIC, 3, *numbers, 0))
                for name in head.widths:
                    yield from _write_section(path, stream, gaussians, head, name)
                stream.write(extensions_of(gaussians))
        else:
            records, widths = extensions_of(gaussians), head.widths
            toc = HEAD_4.size + len(records)
            file.write(HEAD_4.pack(MAGIC, 4, *numbers, len(widths), toc) + records)
            file.write(bytes(SIZES.size * len(widths)))  # the table, known at the end
            table = []
            for name, width in widths.items():
                start = file.tell()
                compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
                packed = compressor.stream_writer(file, size=head.n * width, closefd=False)
                yield from _write_section(path, packed, gaussians, head, name)
                packed.flush(zstandard.FLUSH_FRAME)  # not when cancelled: it would be too short
                table.append(SIZES.pack(file.tell() - start, head.n * width))
            file.seek(toc)
            file.write(b"".join(table))
    yield writing(path, head.n, head.n)


def _write_section(
    path: Path, stream: _Sink, gaussians: Gaussians, head: Head, name: str
) -> Stage[None]:
    """Write one attribute of all splats."""
    names, widths = list(head.widths), list(head.widths.values())
    at = names.index(name)
    for part in parts_of(head.n):
        done = head.n * sum(widths[:at]) + part.start * widths[at]
        yield writing(path, done // sum(widths), head.n)
        stream.write(np.ascontiguousarray(_pack(gaussians, head, name, part)).data)


def fraction_bits(means: FloatArray) -> int:
    """Bits after the point with which every position fits into 24 signed bits."""
    most = float(np.abs(means[np.isfinite(means)]).max(initial=0))
    fits = [bits for bits in range(MOST_BITS + 1) if most * (1 << bits) < (1 << 23) - 1]
    return max(fits, default=0)


def _pack(gaussians: Gaussians, head: Head, name: str, part: slice) -> AnyArray:
    if name == "means":
        scaled = gaussians.means[part].astype(np.float64) * (1 << head.fraction_bits)
        fixed = np.clip(np.rint(scaled), -(1 << 23), (1 << 23) - 1).astype("<i4")
        low: UInt8Array = fixed.view(np.uint8).reshape(-1, 3, 4)[:, :, :3]  # of little-endian words
        return low
    if name == "opacities":
        return bytes_of_logits(gaussians.logit_opacities[part])
    if name == "colors":
        return to_bytes(gaussians.sh[part, 0] * (COLOR_SCALE * 255) + 127.5)
    if name == "scales":
        return to_bytes((gaussians.log_scales[part] + 10) * 16)
    if name == "quats":
        return _words(gaussians.quats[part])
    buckets = np.full((head.n_rest, 1), SH_BUCKETS[1])
    buckets[:3] = SH_BUCKETS[0]
    sh = np.rint(gaussians.sh[part, 1:] * 128) + 128
    rounded = np.clip((sh + buckets // 2) // buckets * buckets, 0, 255)
    coded: UInt8Array = rounded.astype(np.uint8)
    return coded


def _words(quats: FloatArray) -> AnyArray:
    """Smallest-three words (N,) of quaternions wxyz."""
    largest, three = three_of_quats(np.roll(unit_quats(quats), -1, axis=1))
    size = np.clip(np.rint(np.abs(three) * (511 * np.sqrt(2))), 0, 511).astype(np.uint32)
    fields = size | ((three < 0).astype(np.uint32) << np.uint32(9))
    words = largest.astype(np.uint32) << np.uint32(30)
    for i, shift in enumerate((20, 10, 0)):
        words |= fields[:, i] << np.uint32(shift)
    return words.astype("<u4")
