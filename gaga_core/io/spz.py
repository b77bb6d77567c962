"""SPZ, Niantic's compact format: fixed-point positions and a byte for most other numbers.

Versions 1 to 3 are one gzip stream, or are not compressed: a header of 16 bytes, each attribute of
all splats, extensions. Version 4 has a header of 32 bytes, extensions, a table of sizes, and each
attribute as a Zstandard stream. Axes: `spz_axes`; writing: `spz_writer`.
Layout: github.com/nianticlabs/spz.
"""

import gzip
import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
import zstandard

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import explain_os_error
from gaga_core.io.packing import (
    CHUNK,
    logits_of_bytes,
    quats_of_three,
    room_for,
    unit_quats,
)
from gaga_core.io.ply import without_broken_rows
from gaga_core.io.spz_axes import OURS, axes_in, turned
from gaga_core.progress import Progress, Stage

GZIP_MAGIC, MAGIC = b"\x1f\x8b", b"NGSP"
COLOR_SCALE = 0.15  # of a DC coefficient in a byte
HEAD = struct.Struct("<4sIIBBBB")
HEAD_4 = struct.Struct("<4sIIBBBBI12x")
SIZES = struct.Struct("<QQ")
AA, HAS_EXTENSIONS = 1, 2  # flags
_ANTIALIASED = "antialiased 1"
_MOST_RATIO = 1040  # deflate cannot do better, so a header that promises more is wrong
_MOST_EXTENSIONS = 1 << 20  # bytes


class _Stream(Protocol):
    def read(self, size: int, /) -> bytes: ...


@dataclass(frozen=True)
class Head:
    """What the first bytes of a file say."""

    version: int
    n: int
    degree: int
    fraction_bits: int
    flags: int

    @property
    def is_antialiased(self) -> bool:
        """Whether the splats are to be drawn antialiased."""
        return bool(self.flags & AA)

    @property
    def has_extensions(self) -> bool:
        """Whether records of extensions follow."""
        return bool(self.flags & HAS_EXTENSIONS)

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


def read_spz_stage(path: Path, silent_axes: str = OURS) -> Stage[Gaussians]:
    """Read an .spz file of version 1 to 4 with progress.

    Antialiasing becomes the comment ``antialiased 1``, as in a .ply; the axes that an extension
    names become ours, and without one (`states_axes`) they are taken for ``silent_axes``. Memory
    grows with what the streams really hold, not with what the header says. ``GagaError`` with one
    sentence when the file is damaged or newer.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            splats = yield from decode_spz_stage(path, file, silent_axes)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    return without_broken_rows(path, splats)


def decode_spz_stage(path: Path, file: BinaryIO, silent_axes: str) -> Stage[Gaussians]:
    """The splats of an SPZ that ``file`` holds, in our axes; ``path`` is named in messages.

    See `read_spz_stage`.
    """
    try:
        start = file.read(4)
        file.seek(0)
        if start[:2] != GZIP_MAGIC and start != MAGIC:
            raise GagaError(f"{path.name} is not an SPZ file. Choose another file.")
        reading = _read_4 if _is_version_4(file) else _read_stream
        head, out, records = yield from reading(path, file)
        axes = axes_in(records, path.name) or silent_axes
    except (EOFError, gzip.BadGzipFile, zlib.error, zstandard.ZstdError, struct.error) as error:
        raise GagaError(f"{path.name} is truncated or damaged. Copy or export it again.") from error
    yield Progress("Read splats", head.n, head.n, path.name)
    if head.is_antialiased:
        out = replace(out, comments=(_ANTIALIASED,))
    return turned(out, axes)


def states_axes(path: Path) -> bool:
    """Whether an .spz file says which way its axes point.

    Raises ``GagaError`` when it cannot be read.
    """
    try:
        with path.open("rb") as file:
            is_packed = file.read(2) == GZIP_MAGIC
            file.seek(0)
            with _unzipped(file, is_packed=is_packed) as stream:
                magic, *_, flags, _ = HEAD.unpack(_exactly(stream, HEAD.size))
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise GagaError(f"{path.name} is truncated or damaged. Copy or export it again.") from error
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    return bool(magic == MAGIC and flags & HAS_EXTENSIONS)


def _is_version_4(file: BinaryIO) -> bool:
    """Whether the file is a container of version 4, not a plain stream of an older one."""
    start = _exactly(file, 8)
    file.seek(0)
    version = int.from_bytes(start[4:], "little")
    return start[:4] == MAGIC and not 1 <= version <= 3


@contextmanager
def _unzipped(file: BinaryIO, *, is_packed: bool) -> Iterator[_Stream]:
    if not is_packed:
        yield file
        return
    with gzip.GzipFile(fileobj=file) as stream:
        yield stream


def _read_stream(path: Path, file: BinaryIO) -> Stage[tuple[Head, Gaussians, bytes]]:
    size = _size_of(file)
    is_packed = file.read(2) == GZIP_MAGIC
    file.seek(0)
    with _unzipped(file, is_packed=is_packed) as stream:
        magic, version, n, degree, bits, flags, _ = HEAD.unpack(_exactly(stream, HEAD.size))
        head = _checked(path, magic, Head(version, n, degree, bits, flags))
        ratio = _MOST_RATIO if is_packed else 1
        if version > 3 or n * sum(head.widths.values()) > ratio * size:
            raise GagaError(f"{path.name} is truncated or damaged. Copy or export it again.")
        out = room_for(n, 1 + head.n_rest, path.name)
        done = 0
        for name in head.widths:
            yield from _read_section(path, stream, head, name, (out, done))
            done += head.widths[name]
        records = stream.read(_MOST_EXTENSIONS) if head.has_extensions else b""
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
    n_records = min(toc - HEAD_4.size, _MOST_EXTENSIONS) if head.has_extensions else 0
    records = _exactly(file, n_records) if n_records else b""
    file.seek(toc)
    table = [SIZES.unpack(_exactly(file, SIZES.size)) for _ in widths]
    wanted = [n * width for width in widths.values()]
    if [plain for _, plain in table] != wanted or at + sum(p for p, _ in table) > size:
        raise GagaError(f"{path.name} is truncated or damaged. Copy or export it again.")
    out = room_for(n, 1 + head.n_rest, path.name)
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


def _read_section(
    path: Path, stream: _Stream, head: Head, name: str, into: tuple[Gaussians, int]
) -> Stage[None]:
    """Decode one attribute of all splats; ``into``: the target, and bytes a splat before it."""
    out, before = into
    width, total = head.widths[name], sum(head.widths.values())
    for start in range(0, head.n, CHUNK):
        done = (head.n * before + start * width) // total
        yield Progress("Read splats", done, head.n, path.name)
        k = min(CHUNK, head.n - start)
        raw = np.frombuffer(_exactly(stream, k * width), np.uint8).reshape(k, width)
        _unpack(name, raw, slice(start, start + k), (head, out))


def _unpack(name: str, raw: UInt8Array, part: slice, into: tuple[Head, Gaussians]) -> None:
    head, out = into
    if name == "means":
        out.means[part] = _positions(raw, head)
    elif name == "opacities":
        out.logit_opacities[part] = logits_of_bytes(raw[:, 0])
    elif name == "colors":
        out.sh[part, 0] = (raw / np.float32(255) - np.float32(0.5)) / np.float32(COLOR_SCALE)
    elif name == "scales":
        out.log_scales[part] = raw / np.float32(16) - 10
    elif name == "quats":
        out.quats[part] = _quats(raw) if head.version >= 3 else _quats_xyz(raw)
    else:
        sh = (raw.reshape(len(raw), -1, 3).astype(np.float32) - 128) / 128
        out.sh[part, 1:] = sh


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
