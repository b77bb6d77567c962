"""KSPLAT, the format of the viewer GaussianSplats3D: sections of splats in buckets.

A header of 4,096 bytes, one of 1,024 for each section, then each section: sizes of its partly
filled buckets, their centres, and the splats as records. Level 0 is float32; in levels 1 and 2
positions are 16 bits within a bucket, sizes and rotations half floats; SH of level 2 are bytes.
Layout: github.com/mkkellogg/GaussianSplats3D, src/loaders/SplatBuffer.js.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray
from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import explain_os_error
from gaga_core.io.splats.packing import logits_of_bytes, room_for, unit_quats
from gaga_core.io.splats.ply import without_broken_rows
from gaga_core.progress import Progress, Stage

_HEAD, _SECTION = 4096, 1024  # bytes
_N_RESTS = (0, 3, 8)  # SH coefficients above degree 0, by degree
_SH_RANGE = 1.5  # of SH in bytes, where the header does not say
_TINY = 1e-20  # scene units: a splat of size 0 has no logarithm


@dataclass(frozen=True)
class _Level:
    """Bytes of a record, but for SH."""

    float_type: str  # of sizes and rotations
    centre: int
    sh_type: str
    steps: int  # of positions to each side of a bucket's centre, where the section does not say

    def record(self, n_rest: int) -> np.dtype:
        position = ("<f4", 3) if self.centre == 12 else ("<u2", 3)
        fields = [
            ("centre", *position),
            ("scale", self.float_type, 3),
            ("quat", self.float_type, 4),
            ("color", "u1", 4),
        ]
        return np.dtype([*fields, *([("sh", self.sh_type, 3 * n_rest)] if n_rest else [])])


_LEVELS = (
    _Level("<f4", 12, "<f4", 1),
    _Level("<f2", 6, "<f2", 32767),
    _Level("<f2", 6, "u1", 32767),
)


@dataclass(frozen=True)
class _Section:
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

    @staticmethod
    def of(raw: bytes) -> "_Section":
        n, room, bucket, n_buckets, size, centre_bytes = struct.unpack_from("<4IfH", raw)
        steps, _, n_full, n_partial, degree = struct.unpack_from("<4IH", raw, 24)
        return _Section(
            n, room, bucket, n_buckets, size, centre_bytes, steps, n_full, n_partial, degree
        )


def read_ksplat_stage(path: Path) -> Stage[Gaussians]:
    """Read a .ksplat file with progress; SH up to degree 2, as the format has them.

    Sizes in headers are checked against the file before anything is unpacked. ``GagaError`` with
    one sentence when it is damaged or of another version.
    """
    path = Path(path)
    yield Progress("Read splats", 0, 1, path.name)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    damaged = GagaError(f"{path.name} is truncated or damaged. Copy or export it again.")
    if len(content) < _HEAD:
        raise damaged
    major, minor, n_sections = struct.unpack_from("<BBxxI", content)
    (n,) = struct.unpack_from("<I", content, 16)
    (level,) = struct.unpack_from("<H", content, 20)
    if major != 0 or minor < 1 or level >= len(_LEVELS):
        raise GagaError(f"{path.name} is a KSPLAT of another version, or damaged.")
    at = _HEAD + n_sections * _SECTION
    if at > len(content):
        raise damaged
    heads = (content[_HEAD + i * _SECTION :][:_SECTION] for i in range(n_sections))
    sections = [section for section in map(_Section.of, heads) if section.room > 0]
    if n == 0 or n != sum(section.n for section in sections):
        raise damaged
    if any(section.degree >= len(_N_RESTS) for section in sections):
        raise GagaError(f"{path.name} has SH of a degree that KSPLAT does not have.")
    n_rest = max(_N_RESTS[section.degree] for section in sections)
    if n * _LEVELS[level].record(0).itemsize > len(content):
        raise damaged
    out, done = room_for(n, 1 + n_rest, path.name), 0
    sh_range = _sh_range(content)
    for section in sections:
        yield Progress("Read splats", done, n, path.name)
        end = _read_section(content, at, (section, _LEVELS[level], sh_range), out, done)
        if end < 0:
            raise damaged
        at, done = end, done + section.n
    yield Progress("Read splats", n, n, path.name)
    return without_broken_rows(path, out)


def _sh_range(content: bytes) -> tuple[float, float]:
    low, high = struct.unpack_from("<2f", content, 36)
    return low or -_SH_RANGE, high or _SH_RANGE


def _read_section(
    content: bytes,
    at: int,
    how: tuple[_Section, _Level, tuple[float, float]],
    out: Gaussians,
    done: int,
) -> int:
    """Decode a section that begins at byte ``at``; where it ends, -1 when it does not fit."""
    section, level, sh_range = how
    record = level.record(_N_RESTS[section.degree])
    centres_at = at + 4 * section.n_partial
    first = centres_at + section.centre_bytes * section.n_buckets
    end = first + record.itemsize * section.room
    if section.n > section.room or end > len(content):
        return -1
    rows = np.frombuffer(content, record, section.n, first)
    part = slice(done, done + section.n)
    if level.centre == 12:
        out.means[part] = rows["centre"]
    else:
        partial = np.frombuffer(content, "<u4", section.n_partial, at)
        bucket = _buckets(section, partial)
        if section.centre_bytes != 12 or (section.n > 0 and bucket.max() >= section.n_buckets):
            return -1
        centres = np.frombuffer(content, "<f4", 3 * section.n_buckets, centres_at).reshape(-1, 3)
        steps = section.steps or level.steps
        offsets = rows["centre"].astype(np.float32) - np.float32(steps)
        out.means[part] = offsets * np.float32(section.size / 2 / steps) + centres[bucket]
    out.log_scales[part] = np.log(np.maximum(rows["scale"].astype(np.float32), _TINY))
    out.quats[part] = unit_quats(rows["quat"].astype(np.float32))
    color = rows["color"]
    out.sh[part, 0] = (color[:, :3] / np.float32(255) - np.float32(0.5)) / np.float32(SH_C0)
    out.logit_opacities[part] = logits_of_bytes(color[:, 3])
    out.sh[part, 1:] = 0
    if section.degree:
        values = _rest(rows["sh"], sh_range)
        out.sh[part, 1 : 1 + values.shape[1]] = values
    return end


def _buckets(section: _Section, partial: AnyArray) -> AnyArray:
    """Bucket (N,) of each splat: the full ones come first."""
    in_full = np.minimum(np.arange(section.n) // max(section.bucket, 1), section.n_full)
    n_full = min(section.n_full * section.bucket, section.n)
    ends = n_full + np.cumsum(partial.astype(np.int64))
    rest = np.searchsorted(ends, np.arange(n_full, section.n), side="right")
    return np.concatenate([in_full[:n_full], section.n_full + rest])


def _rest(raw: AnyArray, sh_range: tuple[float, float]) -> FloatArray:
    """SH (N, S - 1, 3) of records: in each degree all of red, then green, then blue."""
    values: AnyArray = raw.astype(np.float32)
    if raw.dtype == np.uint8:
        low, high = sh_range
        values = low + values / 255 * (high - low)
    bands = [values[:, :9].reshape(-1, 3, 3)]
    if values.shape[1] > 9:
        bands.append(values[:, 9:24].reshape(-1, 3, 5))
    rest: FloatArray = np.concatenate(bands, axis=2).transpose(0, 2, 1)
    return rest
