"""Writing SPZ, versions 3 and 4: our own axes, and an extension that says so. See `spz`."""

import gzip
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
import zstandard

from gaga_core.arrays import AnyArray, FloatArray, UInt8Array
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write
from gaga_core.io.packing import CHUNK, bytes_of_logits, three_of_quats, to_bytes, unit_quats
from gaga_core.io.spz import AA, COLOR_SCALE, HAS_EXTENSIONS, HEAD, HEAD_4, MAGIC, SIZES, Head
from gaga_core.io.spz_axes import extension
from gaga_core.progress import Progress, Stage

MOST_BITS = 16  # after the point of a position, when the scene is small enough
SH_BUCKETS = (8, 16)  # of 256: SH of degree 1 keep 5 bits, the others 4, as Niantic's writer does
_GZIP_LEVEL, _ZSTD_LEVEL = 6, 9


def write_spz_stage(path: Path, gaussians: Gaussians, version: int = 3) -> Stage[None]:
    """Write an .spz file of version 3 (which most programs read) or 4, with progress.

    Positions get as many bits after the point as the scene's extent leaves, 16 at most; SH keep 5
    bits in degree 1 and 4 above, as Niantic's writer does. The axes are ours, as other programs
    write them, and an extension says so. Nothing is left when it fails.
    """
    if version not in (3, 4):
        raise ValueError(f"version: expected 3 or 4, got {version}")
    bits = fraction_bits(gaussians.means)
    flags = HAS_EXTENSIONS | (AA if gaussians.is_antialiased else 0)
    head = Head(version, len(gaussians), gaussians.sh_degree, bits, flags)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        if version == 3:
            with gzip.GzipFile("", "wb", _GZIP_LEVEL, file, 0) as stream:
                stream.write(HEAD.pack(MAGIC, 3, *_numbers(head), 0))
                done = 0
                for name, width in head.widths.items():
                    for piece, raw in enumerate(_packed(gaussians, head, name)):
                        yield _step(path, head, done, piece * CHUNK * width)
                        stream.write(raw)
                    done += width
                stream.write(extension())
        else:
            yield from _write_4(path, file, gaussians, head)
    yield Progress("Write splats", head.n, head.n, path.name)


def _write_4(path: Path, file: BinaryIO, gaussians: Gaussians, head: Head) -> Stage[None]:
    widths = head.widths
    records = extension()
    toc = HEAD_4.size + len(records)
    file.write(HEAD_4.pack(MAGIC, 4, *_numbers(head), len(widths), toc) + records)
    file.write(bytes(SIZES.size * len(widths)))  # the table, known at the end
    table, done = [], 0
    for name, width in widths.items():
        start = file.tell()
        compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
        stream = compressor.stream_writer(file, size=head.n * width, closefd=False)
        for piece, raw in enumerate(_packed(gaussians, head, name)):
            yield _step(path, head, done, piece * CHUNK * width)
            stream.write(raw)
        stream.flush(zstandard.FLUSH_FRAME)  # not when cancelled: the frame would be too short
        table.append((file.tell() - start, head.n * width))
        done += width
    file.seek(toc)
    file.write(b"".join(SIZES.pack(*sizes) for sizes in table))


def _numbers(head: Head) -> tuple[int, int, int, int]:
    return head.n, head.degree, head.fraction_bits, head.flags


def _step(path: Path, head: Head, before: int, done: int) -> Progress:
    total = sum(head.widths.values())
    return Progress("Write splats", (head.n * before + done) // total, head.n, path.name)


def fraction_bits(means: FloatArray) -> int:
    """Bits after the point with which every position fits into 24 signed bits."""
    most = float(np.abs(means[np.isfinite(means)]).max(initial=0))
    fits = [bits for bits in range(MOST_BITS + 1) if most * (1 << bits) < (1 << 23) - 1]
    return max(fits, default=0)


def _packed(gaussians: Gaussians, head: Head, name: str) -> Iterator[memoryview]:
    """One attribute of all splats, in pieces of bytes."""
    for start in range(0, head.n, CHUNK):
        part = slice(start, min(start + CHUNK, head.n))
        yield np.ascontiguousarray(_pack(gaussians, head, name, part)).data


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
