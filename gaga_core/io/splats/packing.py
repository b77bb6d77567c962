"""Shared by the formats of splats: a frame around readers, checks of rows, small numbers.

Opacities in a byte, quaternions in three parts, tables of 256 numbers, palettes of SH, positions in
16 bits. A unit quaternion is known by its three smaller parts once the largest one is positive; the
formats differ in how they round the three, and in the order of the four.
"""

import functools
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Concatenate, ParamSpec

import numpy as np

from gaga_core.arrays import (
    AnyArray,
    BoolArray,
    DoubleArray,
    FloatArray,
    IntArray,
    LongArray,
    UInt8Array,
    UInt16Array,
)
from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import check_memory, explain_os_error
from gaga_core.progress import Progress, Stage, say

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
CHUNK = 1 << 16  # splats worked on at once
TINY = 1e-20  # scene units: a splat of size 0 has no logarithm
_BLOCK = 1 << 12  # splats: about 1 MB, so that each column finds them in the processor's cache
FARTHEST = 1e18  # of any number, scene units for a position: sums of squares are a float32
_LARGEST_LOG = np.float32(np.log(FARTHEST))  # of a size, 41.4
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
EDGE = 1e-6  # opacities of exactly 0 and 1 have no finite logit
_OPACITIES = np.clip(np.arange(256) / 255, EDGE, 1 - EDGE)
_LOGITS = np.log(_OPACITIES / (1 - _OPACITIES)).astype(np.float32)
_N_CODES = 256
_CODE_ROUNDS = 12  # of Lloyd's algorithm for a table of numbers
PALETTE = 65536  # entries at most: labels have 16 bits
_COARSE = 256  # clusters of the first level
_ROUNDS = 4  # of Lloyd's algorithm in each
_CELLS = 1 << 22  # distances that are held at once
_SAMPLE = 1 << 18  # numbers or splats that tables are made from
LEFT_OUT = "splat{s} with numbers that are not finite or out of range {were} left out"
SET = "rotation{s} of no length {were} set to none"
_P = ParamSpec("_P")


# --- the frame of readers and writers


def damaged(name: str) -> GagaError:
    """The error of a file whose sizes do not fit."""
    return GagaError(f"{name} is truncated or damaged. Copy or export it again.")


def splat_reader(
    read: Callable[Concatenate[Path, _P], Stage[Gaussians]],
) -> Callable[Concatenate[Path, _P], Stage[Gaussians]]:
    """A reader whose errors are one sentence and whose result has no broken rows."""

    @functools.wraps(read)
    def reader(path: Path, /, *args: _P.args, **options: _P.kwargs) -> Stage[Gaussians]:
        path = Path(path)
        try:
            splats = yield from read(path, *args, **options)
        except (EOFError, zlib.error, struct.error) as error:
            raise damaged(path.name) from error
        except OSError as error:
            raise GagaError(explain_os_error(error, path)) from error
        return without_broken_rows(path, splats)

    return reader


def splat_writer(
    write: Callable[Concatenate[Path, Gaussians, _P], Stage[None]],
) -> Callable[Concatenate[Path, Gaussians, _P], Stage[None]]:
    """A writer of what its reader takes back: see `writable`."""

    @functools.wraps(write)
    def writer(
        path: Path, gaussians: Gaussians, /, *args: _P.args, **options: _P.kwargs
    ) -> Stage[None]:
        path = Path(path)
        yield from write(path, writable(path, gaussians), *args, **options)

    return writer


def writable(path: Path, gaussians: Gaussians) -> Gaussians:
    """``gaussians`` with rotations of no length set to none, which is said; rows stay rows.

    Raises ``GagaError`` where a splat has numbers that cannot be computed with (`checked_rows`):
    readers would leave it out. Nothing is changed in place.
    """
    quats, n_good, n_set = gaussians.quats, 0, 0
    for part in parts_of(len(gaussians), _BLOCK):
        columns = {name: getattr(gaussians, name)[part] for name in COLUMNS}
        columns["quats"] = columns["quats"].copy()
        good, n_of_part = checked_rows(columns)
        n_good += int(good.sum())
        if n_of_part:
            quats = quats.copy() if n_set == 0 else quats
            quats[part] = columns["quats"]
            n_set += n_of_part
    if n_good < len(gaussians):
        raise GagaError(
            f"{path.name} is not written: {len(gaussians) - n_good:,} of {len(gaussians):,} splats "
            "have numbers that are not finite or out of range. Delete them, or undo what moved or "
            "scaled them so far."
        )
    say_changes(path, {SET: n_set})
    return replace(gaussians, quats=quats) if n_set else gaussians


def parts_of(n: int, step: int = CHUNK) -> Iterator[slice]:
    """The rows 0..n in slices of ``step``."""
    return (slice(start, min(start + step, n)) for start in range(0, n, step))


METRE = "metre"  # what our .sog, .glb and .usd call their unit where it is one
READS, SORTS, WRITES = "Read splats", "Sort splats", "Write splats"


def reading(path: Path, done: int, n: int) -> Progress:
    """A step of a reader: ``done`` of ``n``."""
    return Progress(READS, done, n, path.name)


def writing(path: Path, done: int, n: int) -> Progress:
    """A step of a writer: ``done`` of ``n``."""
    return Progress(WRITES, done, n, path.name)


def sane(values: AnyArray) -> FloatArray:
    """Numbers as float32 that can be computed with: those beyond `FARTHEST` become NaN.

    A new array. `kept_rows` drops what becomes of a NaN.
    """
    with_nan: AnyArray = np.where(np.abs(values) <= FARTHEST, values, np.nan)
    return with_nan.astype(np.float32)


def logs_of_sizes(sizes: AnyArray, smallest: float = TINY) -> FloatArray:
    """Logarithms of sizes, of which a negative one becomes NaN, and 0 is ``smallest``."""
    return np.log(np.where(sizes >= 0, np.maximum(sizes, np.float32(smallest)), np.nan))


def without_broken_rows(path: Path, gaussians: Gaussians) -> Gaussians:
    """``gaussians`` without the splats that hold `broken` numbers, see `kept_rows`."""
    good = np.ones(len(gaussians), np.bool_)
    n_set = 0
    for part in parts_of(len(good), _BLOCK):
        columns = {name: getattr(gaussians, name)[part] for name in COLUMNS}
        good[part], n_of_part = checked_rows(columns)
        n_set += n_of_part
    return kept_rows(path, gaussians, good, n_set)


def checked_rows(columns: Mapping[str, FloatArray]) -> tuple[BoolArray, int]:
    """Rows (N,) of the five columns by name that can be computed with, and rotations set.

    A number must be finite, and within `FARTHEST` so that its square is; so must a size be whose
    logarithm is stored. An opacity of +-inf is a legal logit (exactly 0 or 1), so only NaN is
    broken there. A rotation of no length is set to none, in place.
    """
    good: BoolArray = ~np.isnan(columns["logit_opacities"])
    for name in ("means", "quats", "log_scales", "sh"):
        flat = columns[name].reshape(len(good), -1)
        # A sum of squares is below the square if all numbers are (or look closely): one fast pass.
        if not np.vdot(flat, flat) < FARTHEST**2:
            good &= (np.abs(flat) <= FARTHEST).all(axis=1)
    sizes = columns["log_scales"] if good.all() else columns["log_scales"][good]
    if sizes.max(initial=-np.inf) > _LARGEST_LOG:
        good &= (columns["log_scales"] <= _LARGEST_LOG).all(axis=1)
    quats = columns["quats"]
    if (quats[:, 0] != 0).all():
        return good, 0
    lengthless = good & (quats == 0).all(axis=1)
    quats[lengthless, 0] = 1
    return good, int(lengthless.sum())


def kept_rows(path: Path, gaussians: Gaussians, good: BoolArray, n_set: int = 0) -> Gaussians:
    """The splats that are ``good`` (N,), and a sentence (`say`) on what was dropped and set.

    The columns of ``gaussians`` are reused: none is copied. Raises ``GagaError`` when most splats
    are dropped.
    """
    n_bad = int((~good).sum())
    if 2 * n_bad > len(good):
        raise GagaError(
            f"{path.name} is damaged: {n_bad:,} of {len(good):,} splats have numbers that are not "
            "finite or out of range. Train or export the model again."
        )
    say_changes(path, {LEFT_OUT: n_bad, SET: n_set})
    if n_bad == 0:
        return gaussians
    m, q, s, o, sh = (_closed_up(getattr(gaussians, name), good) for name in COLUMNS)
    extra = {name: _closed_up(column, good) for name, column in gaussians.extra.items()}
    return Gaussians(m, q, s, o, sh, MappingProxyType(extra), gaussians.comments)


def _closed_up(column: AnyArray, good: BoolArray) -> AnyArray:
    """The rows that are ``good``, moved to the front in place."""
    n = 0
    for part in parts_of(len(good)):
        kept = column[part][good[part]]
        column[n : n + len(kept)] = kept
        n += len(kept)
    return column[:n]


def file_inside(path: Path, name: str) -> Path:
    """The file ``name`` in the folder of ``path`` or below, which need not exist.

    Raises ``GagaError`` when it lies elsewhere, be it by a link.
    """
    folder = path.parent.resolve()
    try:
        file = (folder / name).resolve()
    except (OSError, ValueError, RuntimeError):  # no name of a file, or a circle of links
        file = Path()
    if not file.is_relative_to(folder):
        raise GagaError(f"{path.name} asks for {name[:80]}, outside of its folder: not read.")
    return file


def say_changes(path: Path, counts: Mapping[str, int]) -> None:
    """`say` how often what was done to the content of ``path``; nothing of zeros.

    What it is leaves places for the forms of one and of many: "splat{s} {were} left out".
    """
    one, many = {"s": "", "were": "was", "are": "is"}, {"s": "s", "were": "were", "are": "are"}
    said = [f"{n:,} {what.format(**(one if n == 1 else many))}" for what, n in counts.items() if n]
    if said:
        say(f"{path.name}: {', and '.join(said)}.")


def row_bytes(n_sh: int) -> int:
    """Bytes of a splat in memory with so many coefficients of SH."""
    return 4 * (3 + 4 + 3 + 1 + 3 * n_sh)


def room_for(path: Path, n: int, n_sh: int, further: float = 0, n_stored: int = 0) -> Gaussians:
    """Gaussians of ``n`` splats to be filled in; ``GagaError`` when memory does not hold them.

    ``further``: bytes that reading takes next to them at its peak; ``n_stored``: of the files that
    hold them when ``path`` is not the only one.
    """
    check_memory(path, n * row_bytes(n_sh) + further, f"{n:,} splats", n_stored)
    try:
        return Gaussians(
            means=np.empty((n, 3), np.float32),
            quats=np.empty((n, 4), np.float32),
            log_scales=np.empty((n, 3), np.float32),
            logit_opacities=np.empty(n, np.float32),
            sh=np.empty((n, n_sh, 3), np.float32),
        )
    except (MemoryError, ValueError, OverflowError) as error:
        raise GagaError(
            f"{path.name} says that it holds {n:,} splats, more than fit into memory. Split it, or "
            "get it again."
        ) from error


def joined_splats(pieces: Sequence[Gaussians], path: Path, n_stored: int = 0) -> Gaussians:
    """All pieces, without extra columns and comments; those of fewer SH get zeros.

    ``GagaError`` that names ``path`` when memory does not hold them, see `room_for`.
    """
    n_sh = max(piece.sh.shape[1] for piece in pieces)
    held = sum(len(piece) * row_bytes(piece.sh.shape[1]) for piece in pieces)
    out = room_for(path, sum(len(piece) for piece in pieces), n_sh, held, n_stored)
    first = 0
    for piece in pieces:
        part = slice(first, first + len(piece))
        for column in COLUMNS[:-1]:
            getattr(out, column)[part] = getattr(piece, column)
        out.sh[part, : piece.sh.shape[1]] = piece.sh
        out.sh[part, piece.sh.shape[1] :] = 0
        first += len(piece)
    return out


def dc_of_bytes(rgb: UInt8Array, scale: float = SH_C0) -> FloatArray:
    """DC coefficients (N, 3) of colors in bytes; ``scale``: what a coefficient of 1 adds to 0.5."""
    unit = rgb.astype(np.float32) / np.float32(255)
    return (unit - np.float32(0.5)) / np.float32(scale)


def logits_of_bytes(opacities: UInt8Array) -> FloatArray:
    """Logits of opacities 0..255; the two ends become 1e-6 and 1 - 1e-6."""
    return _LOGITS[opacities]


def bytes_of_logits(logits: FloatArray) -> UInt8Array:
    """Opacities 0..255, rounded."""
    with np.errstate(over="ignore"):
        return to_bytes(255 / (1 + np.exp(-logits.astype(np.float32))))


def to_bytes(values: AnyArray) -> UInt8Array:
    """Rounded to 0..255, clipped."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def unit_quats(quats: AnyArray) -> FloatArray:
    """Quaternions (N, 4) wxyz of length 1; one of length 0 stays so.

    One that is not finite, or so long that its length is not, becomes NaN: readers drop its row.
    """
    is_sane = np.abs(quats).max(axis=1, initial=0) < FARTHEST  # False for NaN
    inside = quats if is_sane.all() else np.where(is_sane[:, None], quats, np.float32(0))
    length = np.linalg.norm(inside, axis=1, keepdims=True)
    result: FloatArray = (inside / np.where(length > 0, length, 1)).astype(np.float32)
    result[~is_sane] = np.nan
    return result


def three_of_quats(quats: FloatArray) -> tuple[LongArray, FloatArray]:
    """Place (N,) of the largest part of unit quaternions (N, 4), and the other three in order.

    The three are those of the quaternion whose largest part is positive: within sqrt(1/2).
    """
    largest = np.abs(quats).argmax(axis=1)
    top = np.take_along_axis(quats, largest[:, None], 1)
    three = np.take_along_axis(quats, _OTHERS[largest], 1)
    return largest, np.where(top < 0, -three, three)


def quats_of_three(largest: AnyArray, three: AnyArray) -> FloatArray:
    """The way back from `three_of_quats`: quaternions (N, 4)."""
    quats = np.empty((len(three), 4), np.float32)
    np.put_along_axis(quats, _OTHERS[largest], three, 1)
    rest = np.sqrt(np.maximum(1 - (three * three).sum(axis=1), 0))
    np.put_along_axis(quats, np.asarray(largest, np.int64)[:, None], rest[:, None], 1)
    return quats


def morton_order(means: FloatArray) -> LongArray:
    """Rows along a Z curve of 21 bits an axis; what is not finite comes where it falls."""
    low, high = means.min(axis=0), means.max(axis=0)
    span = np.where(high > low, high - low, 1).astype(np.float64)
    codes = np.zeros(len(means), np.uint64)
    for axis in range(3):
        with np.errstate(invalid="ignore"):
            cells = (means[:, axis].astype(np.float64) - low[axis]) / span[axis] * ((1 << 21) - 1)
        codes |= _spread(np.nan_to_num(cells, nan=0).astype(np.uint64)) << np.uint64(axis)
    return np.argsort(codes, kind="stable")


def _spread(cells: AnyArray) -> AnyArray:
    """Bits of 21-bit numbers, two zeros between each (Morton's interleaving)."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        cells = (cells | (cells << np.uint64(shift))) & np.uint64(mask)
    return cells


# --- rounding that suits a scene, for SOG and web pages


def log_words(means: FloatArray) -> tuple[UInt16Array, DoubleArray, DoubleArray]:
    """Positions (N, 3) in 16 bits on a scale of sign(x) ln(1 + |x|), and its ends (3,)."""
    logs = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    low, high = logs.min(axis=0), logs.max(axis=0)
    words = np.rint((logs - low) / np.where(high > low, high - low, 1) * 65535)
    return words.astype(np.uint16), low, high


def quat_bytes(quats: FloatArray) -> tuple[UInt8Array, UInt8Array]:
    """Place (N,) of the largest part of quaternions (N, 4), and the other three as bytes (N, 3)."""
    largest, three = three_of_quats(unit_quats(quats))
    parts = to_bytes((three * np.float32(np.sqrt(2)) * 0.5 + 0.5) * 255)
    return largest.astype(np.uint8), parts


def table_of(values: FloatArray) -> FloatArray:
    """256 numbers, ascending, near which the values lie: Lloyd's algorithm from quantiles."""
    # Sorted first: a step through channels that take turns could meet one of them alone.
    ordered = np.sort(values, axis=None)
    flat = np.append(_sampled(ordered), ordered[-1]).astype(np.float64)
    distinct = np.unique(flat)
    if len(distinct) <= _N_CODES:
        return np.pad(distinct, (0, _N_CODES - len(distinct)), mode="edge").astype(np.float32)
    even = np.linspace(flat[0], flat[-1], _N_CODES)
    table = (np.quantile(flat, np.linspace(0, 1, _N_CODES)) + even) / 2  # rare values count, too
    sums = np.concatenate([[0.0], np.cumsum(flat)])
    for _ in range(_CODE_ROUNDS):
        edges = np.concatenate([[0], np.searchsorted(flat, (table[1:] + table[:-1]) / 2)])
        ends = np.concatenate([edges[1:], [len(flat)]])
        counts = ends - edges
        means = (sums[ends] - sums[edges]) / np.maximum(counts, 1)
        table = np.sort(np.where(counts > 0, means, table))
    return table.astype(np.float32)


def nearest(table: FloatArray, values: FloatArray) -> UInt8Array:
    """Place 0..255 of the nearest number of an ascending table."""
    between = (table[1:] + table[:-1]) / 2
    return np.searchsorted(between, values).astype(np.uint8)


def palette_of(rest: FloatArray) -> tuple[FloatArray, IntArray]:
    """Entries (E, S - 1, 3) and the one (N,) of each splat.

    Splats with few different SH keep them all. Else k-means in two levels: each of a few coarse
    clusters is divided into its share of the entries, so that the time grows with N alone.
    """
    few = _few_rows(rest)
    if few is not None:
        return few
    rng = np.random.default_rng(0)
    coarse = _closest(_means_of(_flat(_sampled(rest)), _COARSE, rng), rest)
    order = np.argsort(coarse, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(coarse, minlength=_COARSE))[:-1])
    room = PALETTE - _COARSE  # a cluster has one entry at least
    found: list[FloatArray] = []
    labels, n_before = np.zeros(len(rest), np.int64), 0
    for part in (part for part in parts if len(part)):
        rows = _flat(rest[part])
        means = _means_of(rows, 1 + room * len(part) // len(rest), rng)
        labels[part] = n_before + _closest(means, rows)
        found.append(means)
        n_before += len(means)
    return np.concatenate(found).reshape(-1, *rest.shape[1:]), labels.astype(np.int32)


def _flat(rows: FloatArray) -> FloatArray:
    return np.ascontiguousarray(rows.reshape(len(rows), -1), np.float32)


def _few_rows(rest: FloatArray) -> tuple[FloatArray, IntArray] | None:
    """The different rows, and the one of each splat, by their hashes, which take little memory;
    None where there are more than the palette has room for."""
    factors = np.random.default_rng(1).integers(
        1, 1 << 62, rest.shape[1] * 3, np.uint64
    ) | np.uint64(1)
    hashes = np.empty(len(rest), np.uint64)
    for part in parts_of(len(rest)):
        words = _flat(rest[part]).view(np.uint32).astype(np.uint64)
        hashes[part] = (words * factors).sum(axis=1, dtype=np.uint64)
    _, first, labels = np.unique(hashes, return_index=True, return_inverse=True)
    if len(first) > PALETTE:
        return None
    entries = rest[first]
    same = all(np.array_equal(entries[labels[p]], rest[p]) for p in parts_of(len(rest)))
    return (entries, labels.astype(np.int32)) if same else None


def _means_of(rows: FloatArray, k: int, rng: np.random.Generator) -> FloatArray:
    """At most ``k`` rows (K, D) near which the rows (R, D) lie: Lloyd's algorithm."""
    # Loaded when it is its turn: each step of placing photos would load it at its start.
    from scipy.sparse import csr_array

    if len(rows) <= k:
        return rows
    means = rows[rng.permutation(len(rows))[:k]]
    for _ in range(_ROUNDS):
        near = _closest(means, rows)
        counts = np.bincount(near, minlength=k)
        belongs = csr_array((np.ones(len(rows), np.float32), (near, np.arange(len(rows)))))
        sums = belongs @ rows
        sums = np.pad(sums, ((0, k - len(sums)), (0, 0)))
        means = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], means)
        means = means.astype(np.float32)
    return means


def _closest(means: FloatArray, rows: FloatArray) -> IntArray:
    """The nearest of ``means`` (K, D) to each row (R, D) or (R, S - 1, 3)."""
    lengths = (means * means).sum(axis=1)
    step = max(_CELLS // len(means), 1)
    pieces = [
        (lengths - 2 * (_flat(rows[at : at + step]) @ means.T)).argmin(axis=1)
        for at in range(0, len(rows), step)
    ]
    return np.concatenate([*pieces, np.zeros(0, np.int64)]).astype(np.int32)


def _sampled(rows: AnyArray) -> AnyArray:
    """At most `_SAMPLE` rows, evenly taken."""
    return rows[:: -(-len(rows) // _SAMPLE)]
