"""PLY files of 3D Gaussians: the layout of the original 3DGS work, unknown columns kept.

Reading copies the columns out of blocks that fit into the processor's cache, so that memory holds
the result and little more; writing streams blocks into a temporary file that replaces the target at
the end. plyfile is used here alone.
"""

import re
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from types import MappingProxyType

import numpy as np
import plyfile

from gaga_core.arrays import AnyArray, FloatArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.splats.packing import (
    COLUMNS,
    finite_rows,
    kept_rows,
    parts_of,
    reading,
    room_for,
    writing,
)
from gaga_core.io.splats.ply_kernels import pack_rows
from gaga_core.progress import Stage, run_stage

_BLOCK = 1 << 12  # rows: about 1 MB, so that each column finds them in the cache
_STEP = 16  # blocks between two steps of progress
_MEANS = ("x", "y", "z")
_NORMALS = ("nx", "ny", "nz")
_SCALES = ("scale_0", "scale_1", "scale_2")
_QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_REQUIRED = (*_MEANS, *_DC, "opacity", *_SCALES, *_QUATS)
_SH_BY_REST = {0: 1, 9: 4, 24: 9, 45: 16, 72: 25}


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
    out = room_for(n, n_sh, path.name)
    standard = {*_REQUIRED, *rest}
    extra = {
        name: np.empty(n, rows.dtype[name].newbyteorder("="))
        for name in names
        if name not in standard
    }
    good = np.ones(n, np.bool_)
    for start, block in _blocks(path, rows):
        if start % (_STEP * _BLOCK) == 0:
            yield reading(path, start, n)
        part = slice(start, start + len(block))
        columns = {name: getattr(out, name)[part] for name in COLUMNS}
        for column, ours in (("means", _MEANS), ("quats", _QUATS), ("log_scales", _SCALES)):
            for i, name in enumerate(ours):
                columns[column][:, i] = block[name]
        columns["logit_opacities"][:] = block["opacity"]
        for i, name in enumerate(_DC):
            columns["sh"][:, 0, i] = block[name]
        for i, name in enumerate(rest):  # all coefficients of red, then of green, then of blue
            columns["sh"][:, 1 + i % (n_sh - 1), i // (n_sh - 1)] = block[name]
        for name, values in extra.items():
            values[part] = block[name]
        good[part] = finite_rows(columns)
    yield reading(path, n, n)
    return kept_rows(path, replace(out, extra=MappingProxyType(extra), comments=comments), good)


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
    others = [name for name in gaussians.extra if name not in _NORMALS]
    extra = {k: column.dtype.newbyteorder("<").str for k, column in gaussians.extra.items()}
    dtype = np.dtype([(name, extra.get(name, "<f4")) for name in (*head, *others)])
    # One thread writes a block while the next one is packed.
    with (
        atomic_write(path) as temporary,
        temporary.open("wb") as file,
        ThreadPoolExecutor(1, thread_name_prefix="ply") as writer,
    ):
        written = writer.submit(file.write, _header(dtype, n, gaussians.comments))
        buffers = cycle([np.zeros(min(_BLOCK, n), dtype) for _ in range(2)])
        for part, buffer in zip(parts_of(n, _BLOCK), buffers, strict=False):
            if part.start % (_STEP * _BLOCK) == 0:
                yield writing(path, part.start, n)
            block = buffer[: part.stop - part.start]
            _pack(gaussians, part, block)
            written.result()  # raises what stopped it; then the other buffer is free
            written = writer.submit(file.write, block.data)
        written.result()
    yield writing(path, n, n)


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
        why = (str(error) or type(error).__name__).splitlines()[0][:100]
        raise GagaError(
            f"{path.name} is truncated or damaged ({why}). Copy or export it again."
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


def _pack(gaussians: Gaussians, part: slice, rows: AnyArray) -> None:
    """Fill ``rows``, whose normals are 0 already, with the splats of ``part``."""

    def chosen(name: str) -> FloatArray:
        return np.ascontiguousarray(getattr(gaussians, name)[part])

    pack_rows(
        chosen("means"),
        chosen("sh"),
        chosen("logit_opacities"),
        chosen("log_scales"),
        chosen("quats"),
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
