"""Reading ``.npz`` and ``.npy`` files of plain arrays, damaged and hostile ones included.

What we write is read by `read_columns`, which knows what each array must be.
"""

import math
import tokenize
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.io.files import check_memory, explain_os_error, open_file

# What numpy and zipfile raise on files with wrong bytes, found by flipping bits: zlib.error and
# TokenError (from numpy's parse of an array header) are no ValueError, and an odd compression
# method or an "encrypted" flag is a RuntimeError; a single .npy has no .files.
_DAMAGED = (
    AttributeError,
    ValueError,
    KeyError,
    EOFError,
    TypeError,
    RuntimeError,
    SyntaxError,
    OverflowError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
    tokenize.TokenError,
)
MOST_BYTES = 4 << 30  # of the arrays of one file: a scene of 40 million splats has half of it
_MOST_ARRAYS = 100_000
_LONGEST_HEADER = 65_536
_KINDS = {"b": "b", "i": "iu", "u": "iu", "f": "fiu", "U": "U"}  # of a dtype: read as it


@dataclass(frozen=True)
class Column:
    """What an array of a file must be, and what it becomes."""

    dtype: npt.DTypeLike  # that it becomes; whole numbers, numbers and text are told apart
    shape: tuple[int | str, ...] = ()  # a letter is a length, the same wherever it stands
    # The values that there can be. Without them: those of the dtype, or finite ones of float32, in
    # which all is drawn.
    low: float | None = None
    high: float | None = None
    below: str = ""  # letter of a length: values are places in a table that is so long
    unknown: bool = False  # NaN may be there, and where no limits are given, infinities
    optional: bool = False

    def with_shape_of(self, name: str, array: AnyArray, lengths: dict[str, int]) -> None:
        """Raise ``ValueError`` unless kind and shape are right; notes new ``lengths``."""
        fits = array.ndim == len(self.shape) and all(
            got == (lengths.setdefault(want, got) if isinstance(want, str) else want)
            for want, got in zip(self.shape, array.shape, strict=True)
        )
        kind = np.dtype(self.dtype).kind
        if not fits or (array.size and array.dtype.kind not in _KINDS[kind]):
            wanted = ", ".join(f"{lengths.get(str(want), want)}" for want in self.shape)
            what = np.dtype(self.dtype).name
            raise ValueError(f"{name}: expected ({wanted}) {what}, got {array.shape} {array.dtype}")

    def converted(self, name: str, array: AnyArray, lengths: Mapping[str, int]) -> AnyArray:
        """``array`` as `dtype`, C-contiguous. Raises ``ValueError`` when a value cannot be."""
        dtype = np.dtype(self.dtype)
        if array.size == 0:  # numpy gives no values a kind of their own
            return np.zeros(array.shape, dtype)
        if dtype.kind == "U":
            "".join(array.ravel().tolist()).encode()  # raises for what is no text
            return array
        if dtype.kind != "b":
            limits = np.iinfo(dtype) if dtype.kind in "iu" else np.finfo(np.float32)
            # In Python's numbers, which compare without a cast; NaN, where there is one.
            known = array[~np.isnan(array)] if self.unknown else array
            first, last = (known.min().item(), known.max().item()) if known.size else (0, 0)
            low = np.asarray(limits.min).item() if self.low is None else self.low
            high = np.asarray(limits.max).item() if self.high is None else self.high
            high = lengths[self.below] - 1 if self.below else high
            free = self.unknown and self.low is None and self.high is None
            if known.size and not (free or (low <= first and last <= high)):
                odd = last if low <= first else first
                raise ValueError(f"{name}: {odd} is not in {low} to {high}")
        return np.asarray(array, dtype, order="C")


TEXT = Column(np.str_)


def checked(
    arrays: Mapping[str, AnyArray], columns: Mapping[str, Column], **lengths: int
) -> dict[str, AnyArray]:
    """Those of ``arrays`` that ``columns`` name, each as its column says; others are left out.

    ``lengths`` are those that letters must have. Nothing is cast before its values are known to
    fit. Raises ``ValueError`` that names the array.
    """
    for name, column in columns.items():
        if name in arrays:
            column.with_shape_of(name, arrays[name], lengths)
        elif not column.optional:
            raise ValueError(f"{name} is missing")
    found = {name: column for name, column in columns.items() if name in arrays}
    return {name: column.converted(name, arrays[name], lengths) for name, column in found.items()}


def read_columns(
    path: Path, cure: str, columns: Mapping[str, Column], **lengths: int
) -> dict[str, AnyArray]:
    """The arrays of an ``.npz`` that ``columns`` name, each as its column says: see `checked`.

    Raises ``GagaError`` with one sentence when the file is missing, or an array is or holds what
    it must not: ``cure`` says what to do then.
    """
    optional = [name for name, column in columns.items() if column.optional]
    arrays = read_arrays(path, cure, columns.keys() - optional, optional)
    with damage(path, cure):
        return checked(arrays, columns, **lengths)


@contextmanager
def damage(path: Path, cure: str) -> Iterator[None]:
    """Turn what is raised about the values of a file into one sentence."""
    try:
        yield
    except (ValueError, TypeError, LookupError, OverflowError, MemoryError) as error:
        raise GagaError(f"{path} is damaged ({error}). {cure}") from error


@contextmanager
def _sentences(path: Path, why: str, cure: str) -> Iterator[None]:
    """Turn what numpy and the disk raise into one sentence."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise GagaError(f"{path} is damaged. {cure}") from error
        raise GagaError(explain_os_error(error, path)) from error
    except _DAMAGED as error:
        raise GagaError(f"{path} {why}. {cure}") from error


def read_array(path: Path, cure: str) -> AnyArray:
    """The array of an ``.npy``; never unpickles.

    Raises ``GagaError`` when the file is missing, damaged, or holds Python objects: ``cure`` says
    what to do then.
    """
    with _sentences(path, "is damaged or holds Python objects", cure), open_file(path) as file:
        if file.read(len(np.lib.format.MAGIC_PREFIX)) == np.lib.format.MAGIC_PREFIX:
            file.seek(0)
            _check_header(file, path.stat().st_size)
        file.seek(0)
        stored = np.load(file, allow_pickle=False)
        if isinstance(stored, np.ndarray):
            return stored
    raise GagaError(f"{path} is an archive of arrays, not one array. {cure}")


def read_arrays(
    path: Path,
    cure: str,
    names: Collection[str] | None = None,
    optional: Collection[str] = (),
) -> dict[str, AnyArray]:
    """The arrays of an ``.npz`` by name, or only those of ``names``; never unpickles.

    Those of ``optional`` that are there come, too.
    Sizes that the headers announce are compared with those of the archive before memory is taken.
    Raises ``GagaError`` when the file is missing or damaged: ``cure`` says what to do then.
    """
    # Opened here: numpy leaves the file open when its archive is damaged.
    with _sentences(path, "is damaged", cure), open_file(path) as file:
        if zipfile.is_zipfile(file):
            _check_archive(file, path)
        file.seek(0)
        stored = np.load(file, allow_pickle=False)
        wanted = stored.files if names is None else names
        further = [name for name in optional if name in stored.files and name not in wanted]
        return {name: stored[name] for name in (*wanted, *further)}


def _check_archive(file: IO[bytes], path: Path) -> None:
    """Raise ``ValueError`` unless the arrays of an archive have the sizes that they announce.

    ``GagaError`` when they would take too much memory.
    """
    with zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
        total = sum(entry.file_size for entry in entries)
        if len(entries) > _MOST_ARRAYS or total > MOST_BYTES:
            raise ValueError(f"{len(entries)} arrays of {total} bytes")
        check_memory(path, total, f"arrays of {total:,} bytes")
        for entry in entries:
            with archive.open(entry) as stored:
                _check_header(stored, entry.file_size)


def _check_header(file: IO[bytes], n_bytes: int) -> None:
    """Raise ``ValueError`` unless an array of ``n_bytes`` in all has the size of its header."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of the array format")
    read = np.lib.format.read_array_header_1_0
    if version == (2, 0):
        read = np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file, max_header_size=_LONGEST_HEADER)
    announced = math.prod(shape) * dtype.itemsize
    if dtype.hasobject or min(shape, default=0) < 0 or announced != n_bytes - file.tell():
        raise ValueError(f"an array {dtype} {shape} in {n_bytes} bytes")
