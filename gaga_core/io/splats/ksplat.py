"""KSPLAT, the format of the viewer GaussianSplats3D: sections of splats in buckets.

A header of 4,096 bytes, one of 1,024 for each section, then each section: sizes of its partly
filled buckets, their centres, and the splats as records. Level 0 is float32; in levels 1 and 2
positions are 16 bits within a bucket, sizes and rotations half floats; SH of level 2 are bytes.
Layout: github.com/mkkellogg/GaussianSplats3D, src/loaders/SplatBuffer.js.
"""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import open_file
from gaga_core.io.splats.packing import (
    damaged,
    dc_of_bytes,
    logits_of_bytes,
    logs_of_sizes,
    reading,
    room_for,
    row_bytes,
    sane,
    splat_reader,
    unit_quats,
)
from gaga_core.progress import Stage

_HEAD, _SECTION = 4096, 1024  # bytes
_N_RESTS = (0, 3, 8)  # SH coefficients above degree 0, by degree
_SH_RANGE = 1.5  # of SH in bytes, where the header does not say
_WORK = 64  # bytes of a splat: its bucket, what is computed of its position and rotation
_STEPS = 32767  # of positions to each side of a bucket's centre, where the section does not say


class _Section(NamedTuple):
    n: int
    room: int  # splats that the section has room for
    bucket: int  # splats of a full bucket
    n_buckets: int
    size: float  # of a bucket, scene units
    centre_bytes: int
    steps: int
    n_full: int
    n_partial: int
    degree: int


def _record(level: int, degree: int) -> np.dtype:
    """Bytes of a splat."""
    small = "<f4" if level == 0 else "<f2"
    n_rest, sh = _N_RESTS[degree], ("<f4", "<f2", "u1")[level]
    fields = [
        ("centre", "<f4" if level == 0 else "<u2", 3),
        ("scale", small, 3),
        ("quat", small, 4),
        ("color", "u1", 4),
    ]
    return np.dtype([*fields, *([("sh", sh, 3 * n_rest)] if n_rest else [])])


@splat_reader
def read_ksplat_stage(path: Path) -> Stage[Gaussians]:
    """Read a .ksplat file with progress; SH up to degree 2, as the format has them.

    Sizes in headers are checked against the file before anything is unpacked. ``GagaError`` with
    one sentence when it is damaged or of another version.
    """
    yield reading(path, 0, 1)
    with open_file(path) as file:
        content = file.read()
    if len(content) < _HEAD:
        raise damaged(path.name)
    major, minor, n_sections = struct.unpack_from("<BBxxI", content)
    n, level = struct.unpack_from("<IH", content, 16)
    if major != 0 or minor < 1 or level > 2:
        raise GagaError(f"{path.name} is a KSPLAT of another version, or damaged.")
    at = _HEAD + n_sections * _SECTION
    if at > len(content):
        raise damaged(path.name)
    sections = [
        _Section(*struct.unpack_from("<4IfHxxI4x2IH", content, start))
        for start in range(_HEAD, at, _SECTION)
    ]
    sections = [section for section in sections if section.room > 0]
    if n == 0 or n != sum(section.n for section in sections):
        raise damaged(path.name)
    if any(section.degree >= len(_N_RESTS) for section in sections):
        raise GagaError(f"{path.name} has SH of a degree that KSPLAT does not have.")
    if n * _record(level, 0).itemsize > len(content):
        raise damaged(path.name)
    n_rest = max(_N_RESTS[section.degree] for section in sections)
    out = room_for(path, n, 1 + n_rest, len(content) + n * (row_bytes(1 + n_rest) + _WORK))
    done = 0
    for section in sections:
        yield reading(path, done, n)
        at = _read_section(content, at, section, level, out, slice(done, done + section.n))
        done += section.n
    yield reading(path, n, n)
    return out


def _read_section(
    content: bytes, at: int, section: _Section, level: int, out: Gaussians, part: slice
) -> int:
    """Decode a section that begins at byte ``at``; where it ends. ``EOFError``: does not fit."""
    record = _record(level, section.degree)
    centres_at = at + 4 * section.n_partial
    first = centres_at + section.centre_bytes * section.n_buckets
    end = first + record.itemsize * section.room
    if section.n > section.room or end > len(content):
        raise EOFError
    rows = np.frombuffer(content, record, section.n, first)
    if level == 0:
        out.means[part] = rows["centre"]
    else:
        bucket = _buckets(section, np.frombuffer(content, "<u4", section.n_partial, at))
        if section.centre_bytes != 12 or (section.n > 0 and bucket.max() >= section.n_buckets):
            raise EOFError
        centres = sane(np.frombuffer(content, "<f4", 3 * section.n_buckets, centres_at))
        steps = section.steps or _STEPS
        offsets = rows["centre"].astype(np.float32) - np.float32(steps)
        width = float(sane(np.array([section.size]))[0]) / 2 / steps
        out.means[part] = offsets * np.float32(width) + centres.reshape(-1, 3)[bucket]
    out.log_scales[part] = logs_of_sizes(rows["scale"].astype(np.float32))
    out.quats[part] = unit_quats(rows["quat"].astype(np.float32))
    out.sh[part, 0] = dc_of_bytes(rows["color"][:, :3])
    out.logit_opacities[part] = logits_of_bytes(rows["color"][:, 3])
    out.sh[part, 1:] = 0
    if section.degree:
        low, high = sane(np.frombuffer(content, "<f4", 2, 36)).tolist()
        values = _rest(rows["sh"], low or -_SH_RANGE, high or _SH_RANGE)
        out.sh[part, 1 : 1 + values.shape[1]] = values
    return end


def _buckets(section: _Section, partial: AnyArray) -> AnyArray:
    """Bucket (N,) of each splat: the full ones come first."""
    in_full = np.minimum(np.arange(section.n) // max(section.bucket, 1), section.n_full)
    n_full = min(section.n_full * section.bucket, section.n)
    ends = n_full + np.cumsum(partial.astype(np.int64))
    rest = np.searchsorted(ends, np.arange(n_full, section.n), side="right")
    return np.concatenate([in_full[:n_full], section.n_full + rest])


def _rest(raw: AnyArray, low: float, high: float) -> FloatArray:
    """SH (N, S - 1, 3) of records: in each degree all of red, then green, then blue."""
    values: AnyArray = raw.astype(np.float32)
    if raw.dtype == np.uint8:
        values = low + values / 255 * (high - low)
    bands = [values[:, :9].reshape(-1, 3, 3)]
    if values.shape[1] > 9:
        bands.append(values[:, 9:24].reshape(-1, 3, 5))
    return np.concatenate(bands, axis=2).transpose(0, 2, 1)
