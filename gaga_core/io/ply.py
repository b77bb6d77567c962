"""PLY files of 3D Gaussians: the layout of the original 3DGS work, unknown columns kept.

Reading maps the file into memory and copies the columns out in chunks; writing streams chunks into
a temporary file that replaces the target at the end. plyfile is used here alone.
"""

import logging
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import plyfile

from gaga_core.arrays import AnyArray, BoolArray, FloatArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.progress import Progress, Stage, run_stage

_CHUNK = 1 << 18  # rows
_MEANS = ("x", "y", "z")
_NORMALS = ("nx", "ny", "nz")
_SCALES = ("scale_0", "scale_1", "scale_2")
_QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_REQUIRED = (*_MEANS, *_DC, "opacity", *_SCALES, *_QUATS)
_SH_BY_REST = {0: 1, 9: 4, 24: 9, 45: 16, 72: 25}

_log = logging.getLogger(__name__)


def read_ply(path: Path) -> Gaussians:
    """Read a 3DGS .ply file; see `read_ply_stage`."""
    return run_stage(read_ply_stage(path))


def write_ply(path: Path, gaussians: Gaussians) -> None:
    """Write a 3DGS .ply file; see `write_ply_stage`."""
    run_stage(write_ply_stage(path, gaussians))


def read_ply_stage(path: Path) -> Stage[Gaussians]:
    """Read a 3DGS .ply (any byte order, or ascii) with progress.

    Standard columns become C-contiguous float32; all others are kept in ``extra`` in their own
    dtype. Splats with a position, size, rotation, opacity or color that is not finite are dropped
    with a logged warning; a file in which they are the majority is refused. Raises ``GagaError``
    with one sentence when the file is no 3DGS model.
    """
    path = Path(path)
    rows, comments = _open(path)
    names = rows.dtype.names or ()
    n_sh = _check_columns(path, names)
    rest = tuple(f"f_rest_{i}" for i in range((n_sh - 1) * 3))
    n = len(rows)
    columns = {
        "means": np.zeros((n, 3), np.float32),
        "quats": np.zeros((n, 4), np.float32),
        "log_scales": np.zeros((n, 3), np.float32),
        "logit_opacities": np.zeros(n, np.float32),
        "sh": np.zeros((n, n_sh, 3), np.float32),
    }
    standard = {*_REQUIRED, *rest}
    extra = {
        name: np.zeros(n, rows.dtype[name].newbyteorder("="))
        for name in names
        if name not in standard
    }
    for start in range(0, n, _CHUNK):
        yield Progress("Read splats", start, n, path.name)
        chunk = rows[start : start + _CHUNK]
        _copy_chunk(chunk, slice(start, start + len(chunk)), columns, rest)
        for name, column in extra.items():
            column[start : start + len(chunk)] = chunk[name]
    yield Progress("Read splats", n, n, path.name)
    gaussians = Gaussians(
        means=columns["means"],
        quats=columns["quats"],
        log_scales=columns["log_scales"],
        logit_opacities=columns["logit_opacities"],
        sh=columns["sh"],
        extra=MappingProxyType(extra),
        comments=comments,
    )
    return _without_broken_rows(path, gaussians)


def write_ply_stage(path: Path, gaussians: Gaussians) -> Stage[None]:
    """Write a binary little-endian 3DGS .ply with progress; nothing is left when it fails.

    Columns: x y z, normals (zeros when the source had none), f_dc, f_rest channel by channel,
    opacity, scale, rot, then every other extra column in its own dtype. The bits of every float
    are kept. Raises ``GagaError`` when the disk is full or the place cannot be written.
    """
    path = Path(path)
    n = len(gaussians)
    if n == 0:
        raise GagaError(f"There is nothing to write to {path.name}: no splats are visible.")
    n_rest = (gaussians.sh.shape[1] - 1) * 3
    rest = tuple(f"f_rest_{i}" for i in range(n_rest))
    head = (*_MEANS, *_NORMALS, *_DC, *rest, "opacity", *_SCALES, *_QUATS)
    fields = [(name, _dtype_of(gaussians, name)) for name in head]
    others = [name for name in gaussians.extra if name not in _NORMALS]
    fields += [(name, _dtype_of(gaussians, name)) for name in others]
    dtype = np.dtype(fields)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write(_header(dtype, n, gaussians.comments))
        for start in range(0, n, _CHUNK):
            yield Progress("Write splats", start, n, path.name)
            part = slice(start, min(start + _CHUNK, n))
            file.write(_pack(gaussians, part, dtype, rest).tobytes())
    yield Progress("Write splats", n, n, path.name)


def is_antialiased(gaussians: Gaussians) -> bool:
    """Whether the file's comments ask for the antialiased (mip) look."""
    hints = ("splatrendermode: mip", "antialiased 1", "antialiased: 1")
    return any(hint in comment.lower() for comment in gaussians.comments for hint in hints)


def _open(path: Path) -> tuple[AnyArray, tuple[str, ...]]:
    """Rows of the vertex element, memory-mapped where the format allows it, and the comments."""
    if path.is_dir():
        raise GagaError(f"{path} is a folder. Choose a .ply file.")
    try:
        size = path.stat().st_size
        if size == 0:
            raise GagaError(f"{path.name} is empty (0 bytes). Choose another file.")
        with path.open("rb") as file:
            if file.read(3) != b"ply":
                raise GagaError(f"{path.name} is not a PLY file. Choose a 3DGS .ply file.")
        data = plyfile.PlyData.read(str(path), mmap="r")
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except UnicodeDecodeError as error:
        raise GagaError(
            f"{path.name} has letters outside ASCII in its header, which PLY does not allow. "
            "Remove them, or export the model again."
        ) from error
    except (plyfile.PlyParseError, ValueError, IndexError, OverflowError, MemoryError) as error:
        raise GagaError(
            f"{path.name} is truncated or damaged ({_short(error)}). Copy or export it again."
        ) from error
    if "vertex" not in data:
        raise GagaError(
            f"{path.name} has no vertex element, so no splats. Choose a 3DGS .ply file."
        )
    vertex = data["vertex"]
    if len(vertex.data) == 0:
        raise GagaError(f"{path.name} holds 0 splats. Choose another file.")
    lists = [p.name for p in vertex.properties if isinstance(p, plyfile.PlyListProperty)]
    if lists:
        raise GagaError(f"{path.name} has list columns ({lists[0]}): this is no 3DGS model.")
    return vertex.data, tuple(data.comments)


def _check_columns(path: Path, names: Iterable[str]) -> int:
    """Number of SH coefficients; ``GagaError`` when a standard column is missing."""
    present = set(names)
    missing = [name for name in _REQUIRED if name not in present]
    if len(missing) > 4:
        raise GagaError(
            f"{path.name} is a PLY file but no 3DGS model: it has no {missing[0]}, "
            f"{missing[1]}, ... columns. Choose the .ply that a splat trainer wrote."
        )
    if missing:
        raise GagaError(
            f"{path.name} has no {', '.join(missing)} column. Export the model again with all "
            "3DGS columns."
        )
    n_rest = sum(1 for name in present if re.fullmatch(r"f_rest_\d+", name))
    gaps = [i for i in range(n_rest) if f"f_rest_{i}" not in present]
    if n_rest not in _SH_BY_REST or gaps:
        lacks = f", without f_rest_{gaps[0]}" if gaps else ""
        raise GagaError(
            f"{path.name} has {n_rest} f_rest columns{lacks}; a full SH degree has 0, 9, 24, 45 "
            "or 72. Export the model again."
        )
    return _SH_BY_REST[n_rest]


def _copy_chunk(
    chunk: AnyArray, part: slice, columns: Mapping[str, FloatArray], rest: tuple[str, ...]
) -> None:
    for i, name in enumerate(_MEANS):
        columns["means"][part, i] = chunk[name]
    for i, name in enumerate(_QUATS):
        columns["quats"][part, i] = chunk[name]
    for i, name in enumerate(_SCALES):
        columns["log_scales"][part, i] = chunk[name]
    columns["logit_opacities"][part] = chunk["opacity"]
    sh = columns["sh"]
    for i, name in enumerate(_DC):
        sh[part, 0, i] = chunk[name]
    per_channel = len(rest) // 3
    for i, name in enumerate(rest):  # channel-major: all coefficients of red, then green, blue
        sh[part, 1 + i % per_channel, i // per_channel] = chunk[name]


def _without_broken_rows(path: Path, gaussians: Gaussians) -> Gaussians:
    good = _finite_rows(gaussians)
    n_bad = int((~good).sum())
    if n_bad == 0:
        return gaussians
    if 2 * n_bad > len(good):
        raise GagaError(
            f"{path.name} is damaged: {n_bad:,} of {len(good):,} splats are not finite numbers. "
            "Train or export the model again."
        )
    _log.warning("%s: %s splats with values that are not finite were left out", path.name, n_bad)
    return gaussians.take(good)


def _finite_rows(gaussians: Gaussians) -> BoolArray:
    # An opacity of +-inf is a legal logit (exactly 0 or 1), so only NaN is broken there.
    good: BoolArray = ~np.isnan(gaussians.logit_opacities)
    for column in (gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.sh):
        flat = column.reshape(len(good), -1)
        # A sum is finite if all terms are (or overflows, then look closely): one fast pass.
        with np.errstate(invalid="ignore", over="ignore"):
            suspicious = ~np.isfinite(flat.sum(axis=1))
        if suspicious.any():
            suspicious[suspicious] = ~np.isfinite(flat[suspicious]).all(axis=1)
            good &= ~suspicious
    return good


def _dtype_of(gaussians: Gaussians, name: str) -> str:
    if name in gaussians.extra:
        return gaussians.extra[name].dtype.newbyteorder("<").str
    return "<f4"


def _pack(
    gaussians: Gaussians, part: slice, dtype: np.dtype[np.void], rest: tuple[str, ...]
) -> AnyArray:
    rows = np.zeros(part.stop - part.start, dtype)
    for i, name in enumerate(_MEANS):
        rows[name] = gaussians.means[part, i]
    for i, name in enumerate(_DC):
        rows[name] = gaussians.sh[part, 0, i]
    per_channel = len(rest) // 3
    for i, name in enumerate(rest):
        rows[name] = gaussians.sh[part, 1 + i % per_channel, i // per_channel]
    rows["opacity"] = gaussians.logit_opacities[part]
    for i, name in enumerate(_SCALES):
        rows[name] = gaussians.log_scales[part, i]
    for i, name in enumerate(_QUATS):
        rows[name] = gaussians.quats[part, i]
    for name, column in gaussians.extra.items():
        rows[name] = column[part]
    return rows


def _header(dtype: np.dtype[np.void], n: int, comments: tuple[str, ...]) -> bytes:
    element = plyfile.PlyElement.describe(np.zeros(0, dtype), "vertex")
    data = plyfile.PlyData([element], byte_order="<", comments=list(comments))
    text: str = data.header.replace("element vertex 0", f"element vertex {n}")
    return (text + "\n").encode("ascii", "replace")


def _short(error: Exception) -> str:
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return text[:100]
