"""PLY files of 3D Gaussians: the layout of the original 3DGS work, unknown columns kept.

Reading copies the columns out of blocks that fit into the processor's cache, so that memory holds
the result and little more; writing streams blocks into a temporary file that replaces the target at
the end. plyfile is used here alone.
"""

import logging
import re
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import cycle
from pathlib import Path
from types import MappingProxyType

import numpy as np
import plyfile

from gaga_core.arrays import AnyArray, BoolArray, FloatArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.splats.ply_kernels import pack_rows
from gaga_core.progress import Progress, Stage, run_stage

_BLOCK = 1 << 12  # rows: about 1 MB, so that each column finds them in the cache
_STEP = 16  # blocks between two steps of progress
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
        "means": np.empty((n, 3), np.float32),
        "quats": np.empty((n, 4), np.float32),
        "log_scales": np.empty((n, 3), np.float32),
        "logit_opacities": np.empty(n, np.float32),
        "sh": np.empty((n, n_sh, 3), np.float32),
    }
    standard = {*_REQUIRED, *rest}
    extra = {
        name: np.empty(n, rows.dtype[name].newbyteorder("="))
        for name in names
        if name not in standard
    }
    good = np.ones(n, np.bool_)
    for start, block in _blocks(path, rows):
        if start % (_STEP * _BLOCK) == 0:
            yield Progress("Read splats", start, n, path.name)
        part = slice(start, start + len(block))
        _copy_block(block, part, columns, rest)
        for name, column in extra.items():
            column[part] = block[name]
        good[part] = _finite_rows({name: column[part] for name, column in columns.items()})
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
    return _without(path, gaussians, good)


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
    # One thread writes a block while the next one is packed.
    with (
        atomic_write(path) as temporary,
        temporary.open("wb") as file,
        ThreadPoolExecutor(1, thread_name_prefix="ply") as writer,
    ):
        written = writer.submit(file.write, _header(dtype, n, gaussians.comments))
        buffers = cycle([np.zeros(min(_BLOCK, n), dtype) for _ in range(2)])
        for start, buffer in zip(range(0, n, _BLOCK), buffers, strict=False):
            if start % (_STEP * _BLOCK) == 0:
                yield Progress("Write splats", start, n, path.name)
            part = slice(start, min(start + _BLOCK, n))
            block = buffer[: part.stop - start]
            _pack(gaussians, part, block)
            written.result()  # raises what stopped it; then the other buffer is free
            written = writer.submit(file.write, block.data)
        written.result()
    yield Progress("Write splats", n, n, path.name)


def read_elements(path: Path) -> tuple[dict[str, AnyArray], tuple[str, ...]]:
    """Rows of each element of a .ply, and the comments.

    Nothing of the result is mapped: a mapped file that another program truncates would end the
    process. Raises ``GagaError`` with one sentence when the file is damaged.
    """
    data = _parsed(path)
    elements = {element.name: _in_memory(path, element.data) for element in data.elements}
    return elements, tuple(data.comments)


def _in_memory(path: Path, rows: AnyArray) -> AnyArray:
    """``rows``, read from the file when they are mapped."""
    if not isinstance(rows, np.memmap):
        return rows
    try:
        with path.open("rb", buffering=0) as file:
            file.seek(rows.offset)
            read = np.fromfile(file, rows.dtype, len(rows))
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    if len(read) != len(rows):
        raise GagaError(f"{path.name} is truncated or damaged. Copy it again.")
    return read


def _parsed(path: Path) -> plyfile.PlyData:
    if path.is_dir():
        raise GagaError(f"{path} is a folder. Choose a .ply file.")
    try:
        size = path.stat().st_size
        if size == 0:
            raise GagaError(f"{path.name} is empty (0 bytes). Choose another file.")
        with path.open("rb") as file:
            if file.read(3) != b"ply":
                raise GagaError(f"{path.name} is not a PLY file. Choose a 3DGS .ply file.")
        return plyfile.PlyData.read(str(path), mmap="r")
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


def _open(path: Path) -> tuple[AnyArray, tuple[str, ...]]:
    """Rows of the vertex element, memory-mapped where the format allows it, and the comments."""
    data = _parsed(path)
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


def _blocks(path: Path, rows: AnyArray) -> Iterator[tuple[int, AnyArray]]:
    """Blocks of ``rows`` with the place of their first; each lives until the next is asked for.

    Rows that are mapped into memory are read from the file instead: mapped pages that were touched
    would count as memory in use, and the file is as large as the result.
    """
    n = len(rows)
    if not isinstance(rows, np.memmap) or not rows.flags.c_contiguous:
        for start in range(0, n, _BLOCK):
            yield start, rows[start : start + _BLOCK]
        return
    buffer = np.empty(min(_BLOCK, n), rows.dtype)
    try:
        with path.open("rb", buffering=0) as file:
            file.seek(rows.offset)
            for start in range(0, n, _BLOCK):
                block = buffer[: n - start]
                if file.readinto(block.view(np.uint8).data) != block.nbytes:
                    raise GagaError(f"{path.name} is truncated or damaged. Copy it again.")
                yield start, block
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error


def _copy_block(
    block: AnyArray, part: slice, columns: Mapping[str, FloatArray], rest: tuple[str, ...]
) -> None:
    for i, name in enumerate(_MEANS):
        columns["means"][part, i] = block[name]
    for i, name in enumerate(_QUATS):
        columns["quats"][part, i] = block[name]
    for i, name in enumerate(_SCALES):
        columns["log_scales"][part, i] = block[name]
    columns["logit_opacities"][part] = block["opacity"]
    sh = columns["sh"][part]
    for i, name in enumerate(_DC):
        sh[:, 0, i] = block[name]
    per_channel = len(rest) // 3
    for i, name in enumerate(rest):  # channel-major: all coefficients of red, then green, blue
        sh[:, 1 + i % per_channel, i // per_channel] = block[name]


def without_broken_rows(path: Path, gaussians: Gaussians) -> Gaussians:
    """``gaussians`` without the splats that hold numbers which are not finite, as `read_ply` does.

    Raises ``GagaError`` when they are the majority.
    """
    good = np.ones(len(gaussians), np.bool_)
    columns = ("means", "quats", "log_scales", "logit_opacities", "sh")
    for start in range(0, len(good), _BLOCK):
        part = slice(start, start + _BLOCK)
        good[part] = _finite_rows({name: getattr(gaussians, name)[part] for name in columns})
    return _without(path, gaussians, good)


def _without(path: Path, gaussians: Gaussians, good: BoolArray) -> Gaussians:
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


def _finite_rows(columns: Mapping[str, FloatArray]) -> BoolArray:
    # An opacity of +-inf is a legal logit (exactly 0 or 1), so only NaN is broken there.
    good: BoolArray = ~np.isnan(columns["logit_opacities"])
    for name in ("means", "quats", "log_scales", "sh"):
        flat = columns[name].reshape(len(good), -1)
        # A sum is finite if all terms are (or overflows, then look closely): one fast pass.
        with np.errstate(invalid="ignore", over="ignore"):
            if np.isfinite(flat.sum()):
                continue
        good &= np.isfinite(flat).all(axis=1)
    return good


def _dtype_of(gaussians: Gaussians, name: str) -> str:
    if name in gaussians.extra:
        return gaussians.extra[name].dtype.newbyteorder("<").str
    return "<f4"


def _pack(gaussians: Gaussians, part: slice, rows: AnyArray) -> None:
    """Fill ``rows``, whose normals are 0 already, with the splats of ``part``."""
    pack_rows(
        np.ascontiguousarray(gaussians.means[part]),
        np.ascontiguousarray(gaussians.sh[part]),
        np.ascontiguousarray(gaussians.logit_opacities[part]),
        np.ascontiguousarray(gaussians.log_scales[part]),
        np.ascontiguousarray(gaussians.quats[part]),
        _side_by_side(rows, "x", 3),
        _side_by_side(rows, "f_dc_0", 3 * gaussians.sh.shape[1] + 8),
    )
    for name, column in gaussians.extra.items():
        rows[name] = column[part]


def _side_by_side(rows: AnyArray, first: str, n: int) -> FloatArray:
    """View (B, n) of ``n`` float columns of ``rows`` that begin with the column ``first``."""
    fields = rows.dtype.fields
    assert fields is not None
    shape, strides = (len(rows), n), (rows.dtype.itemsize, 4)
    view: FloatArray = np.ndarray(shape, "<f4", rows.data, fields[first][1], strides)
    return view


def _header(dtype: np.dtype[np.void], n: int, comments: tuple[str, ...]) -> bytes:
    element = plyfile.PlyElement.describe(np.zeros(0, dtype), "vertex")
    data = plyfile.PlyData([element], byte_order="<", comments=list(comments))
    text: str = data.header.replace("element vertex 0", f"element vertex {n}")
    return (text + "\n").encode("ascii", "replace")


def _short(error: Exception) -> str:
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return text[:100]
