"""PLY files of 3D Gaussians: the layout of the original 3DGS work, unknown columns kept.

Reading copies the columns out of blocks that fit into the processor's cache, so that memory holds
the result and little more; writing streams blocks into a temporary file that replaces the target at
the end. A header is compared with the size of its file before anything is read.
"""

import io
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import cycle, islice
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, FloatArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, explain_os_error, open_file
from gaga_core.io.splats.packing import (
    COLUMNS,
    FARTHEST,
    checked_rows,
    kept_rows,
    parts_of,
    reading,
    room_for,
    sane,
    say_changes,
    splat_writer,
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
_MOST_HEADER, _DIGITS = 1 << 20, 18  # bytes of a header; of a count, which fits 64 bits
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_KINDS = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
SWAPPED = "number{s} {are} in the other byte order than the header says: read so"
_SENSE = 0.9  # share of splats with numbers that make sense in the right byte order
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
    and said (`gaga_core.progress.say`); a file in which they are the majority is refused. Raises
    ``GagaError`` with one sentence when the file is no 3DGS model.
    """
    header = read_header(Path(path))
    path = header.path
    if "vertex" not in header.elements:
        raise GagaError(
            f"{path.name} has no vertex element, so no splats. Choose a 3DGS .ply file."
        )
    vertex = header.element("vertex")
    assert vertex.row is not None
    n, names = vertex.n, vertex.row.names or ()
    if n == 0:
        raise GagaError(f"{path.name} holds 0 splats. Choose another file.")
    n_sh = _check_columns(path, names)
    rest = tuple(f"f_rest_{i}" for i in range((n_sh - 1) * 3))
    standard = {*_REQUIRED, *rest}
    others = [name for name in names if name not in standard]
    out = room_for(path, n, n_sh, n * sum(vertex.row[name].itemsize for name in others))
    extra = {name: np.empty(n, vertex.row[name].newbyteorder("=")) for name in others}
    good = np.ones(n, np.bool_)
    n_set = 0
    for part, block in zip(parts_of(n, _BLOCK), row_blocks(header, "vertex", _BLOCK), strict=True):
        if part.start % (_STEP * _BLOCK) == 0:
            yield reading(path, part.start, n)
        columns = {name: getattr(out, name)[part] for name in COLUMNS}
        for column, ours in (("means", _MEANS), ("quats", _QUATS), ("log_scales", _SCALES)):
            for i, name in enumerate(ours):
                columns[column][:, i] = _single(block[name])
        columns["logit_opacities"][:] = _single(block["opacity"], np.inf)
        for i, name in enumerate(_DC):
            columns["sh"][:, 0, i] = _single(block[name])
        for i, name in enumerate(rest):  # all coefficients of red, then of green, then of blue
            columns["sh"][:, 1 + i % (n_sh - 1), i // (n_sh - 1)] = _single(block[name])
        for name, values in extra.items():
            values[part] = block[name]
        good[part], n_of_part = checked_rows(columns)
        n_set += n_of_part
    yield reading(path, n, n)
    extra_columns = MappingProxyType(extra)
    whole = replace(out, extra=extra_columns, comments=header.comments)
    return kept_rows(path, whole, good, n_set)


def _single(values: AnyArray, most: float = FARTHEST) -> AnyArray:
    """Numbers that a float32 takes: those of a double that are too large become NaN."""
    if values.dtype.itemsize <= 4:
        return values
    return sane(values) if most < np.inf else np.clip(values, -FARTHEST, FARTHEST)


@splat_writer
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


@dataclass(frozen=True)
class Element:
    """What a header says of an element."""

    n: int
    row: np.dtype[np.void] | None  # None: of lists, or of no property
    start: int  # bytes (ascii: lines) before its rows, after the header
    lists: tuple[str, ...]


@dataclass(frozen=True)
class PlyHeader:
    """The header of a .ply whose elements fit into its file."""

    path: Path
    size: int  # bytes of the header
    is_ascii: bool
    elements: Mapping[str, Element]
    comments: tuple[str, ...]

    def element(self, name: str) -> Element:
        """An element with numbers alone; ``GagaError`` when it has lists."""
        element = self.elements[name]
        if element.row is None:
            lists = element.lists or ("no",)
            raise GagaError(
                f"{self.path.name} has list columns ({lists[0]}) or no columns in its element "
                f"{name[:40]}: this is no 3DGS model."
            )
        return element


def read_header(path: Path) -> PlyHeader:
    """Read the header of a .ply and compare it with the file.

    Raises ``GagaError`` with one sentence when there is none, or it says what cannot be.
    """
    try:
        with open_file(path) as file:
            start, size = file.read(_MOST_HEADER), path.stat().st_size
    except OSError as error:
        folder = f"{path} is a folder. Choose a .ply file."
        raise GagaError(folder if path.is_dir() else explain_os_error(error, path)) from error
    if size == 0:
        raise GagaError(f"{path.name} is empty (0 bytes). Choose another file.")
    if not start.startswith(b"ply"):
        raise GagaError(f"{path.name} is not a PLY file. Choose a 3DGS .ply file.")
    end = _END.search(start)
    try:
        if end is None:
            raise ValueError("its header has no end")
        return _header_of(path, start[: end.end()], size)
    except UnicodeDecodeError as error:
        raise GagaError(
            f"{path.name} has letters outside ASCII in its header, which PLY does not allow. "
            "Remove them, or export the model again."
        ) from error
    except (ValueError, KeyError, IndexError) as error:
        raise _damaged(path, str(error)) from error


def _damaged(path: Path, why: str) -> GagaError:
    return GagaError(f"{path.name} is truncated or damaged ({why[:100]}). Copy or export it again.")


def _header_of(path: Path, header: bytes, size: int) -> PlyHeader:
    """``ValueError``, ``KeyError`` or ``IndexError`` when the lines are none of a header."""
    form, name, comments = "", "", list[str]()
    described: dict[str, tuple[int, list[list[str]]]] = {}
    for line in header.decode("ascii").splitlines()[1:-1]:
        word, _, rest = line.strip().partition(" ")
        if word == "format":
            form = rest.split()[0]
        elif word == "comment":
            comments.append(rest)
        elif word == "element":
            name, count = rest.split()
            if name in described or not count.isdecimal() or len(count) > _DIGITS:
                raise ValueError(f"its element {rest}")
            described[name] = int(count), []
        elif word == "property":
            described[name][1].append(rest.split())
    order, n_bytes = _ORDERS[form], len(header)
    is_ascii = order == ""
    elements: dict[str, Element] = {}
    start = least = 0
    for name, (n, properties) in described.items():
        lists = tuple(words[-1] for words in properties if words[0] == "list")
        kinds = [
            (words[-1], (order or "<") + _KINDS[words[0]])
            for words in properties
            if words[0] != "list"
        ]
        row = np.dtype(kinds) if kinds and not lists else None
        elements[name] = Element(n, row, start, lists)
        start += n if is_ascii else n * np.dtype(kinds).itemsize
        # A number and what parts it from the next, and a list's length, take a byte at least.
        least += n * (
            max(2 * len(properties), 1) if is_ascii else np.dtype(kinds).itemsize + len(lists)
        )
        if lists and not is_ascii:
            break  # where the next one begins is not known
    if n_bytes + least > size + is_ascii:  # the last line may lack its end
        raise ValueError(f"it has {size:,} of at least {n_bytes + least:,} bytes")
    return PlyHeader(path, n_bytes, is_ascii, elements, tuple(comments))


def row_blocks(header: PlyHeader, name: str, step: int) -> Iterator[AnyArray]:
    """Rows of an element, ``step`` at a time; each block lives until the next is asked for.

    Nothing is mapped: a mapped file that another program truncates would end the process. Numbers
    in the other byte order than the header says are read right, and said. Raises
    ``GagaError`` when the file is damaged.
    """
    element, path = header.element(name), header.path
    row = element.row
    assert row is not None
    try:
        with open_file(path) as file:
            file.seek(header.size)
            if header.is_ascii:
                yield from _lines(file, element, row, step)
                return
            file.seek(element.start, os.SEEK_CUR)
            assert isinstance(file, io.BufferedReader)
            buffer = np.empty(min(step, element.n), row)
            for start in range(0, element.n, step):
                block = buffer[: element.n - start]
                if file.readinto(block.view(np.uint8).data) != block.nbytes:
                    raise EOFError
                if start == 0 and _is_swapped(block):
                    say_changes(path, {SWAPPED: element.n * len(row.names or ())})
                    buffer = buffer.view(row.newbyteorder())
                    block = buffer[: len(block)]
                yield block
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except (ValueError, EOFError, OverflowError) as error:
        raise _damaged(path, str(error) or "it ends early") from error


def _lines(
    file: BinaryIO, element: Element, row: np.dtype[np.void], step: int
) -> Iterator[AnyArray]:
    for _ in range(element.start):
        file.readline()
    for start in range(0, element.n, step):
        n = min(step, element.n - start)
        block = np.loadtxt(islice(file, n), row, comments=None, ndmin=1, encoding="ascii")
        if len(block) != n:
            raise EOFError
        yield block


def _is_swapped(rows: AnyArray) -> bool:
    """Whether most of these splats make sense in the other byte order alone."""
    if not {*_SCALES, *_QUATS} <= set(rows.dtype.names or ()) or rows.dtype["rot_0"].kind != "f":
        return False
    stated, swapped = (_sense(r) for r in (rows, rows.view(rows.dtype.newbyteorder())))
    return swapped > _SENSE > 1 - _SENSE > stated


def _sense(rows: AnyArray) -> float:
    """Share of splats whose log sizes are within 50, and quaternions within 1/1000 to 1000."""
    with np.errstate(invalid="ignore"):  # in the wrong byte order some are signaling NaN
        sizes, parts = (np.stack([np.abs(rows[k]) for k in names]) for names in (_SCALES, _QUATS))
    longest = parts.max(axis=0)  # False for NaN
    sensible: BoolArray = (sizes <= 50).all(axis=0) & (longest >= 1e-3) & (longest <= 1e3)
    return float(sensible.mean())


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
    return np.ndarray(shape, "<f4", rows.data, fields[first][1], strides)


def _header(dtype: np.dtype[np.void], n: int, comments: tuple[str, ...]) -> bytes:
    kinds = {kind: name for name, kind in reversed(_KINDS.items())}
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines.append(f"element vertex {n}")
    lines += [f"property {kinds[dtype[name].str[1:]]} {name}" for name in dtype.names or ()]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii", "replace")
