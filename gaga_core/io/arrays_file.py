"""Reading ``.npz`` and ``.npy`` files of plain arrays, damaged ones included."""

import math
import tokenize
import zipfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.io.files import explain_os_error

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
    with _sentences(path, "is damaged or holds Python objects", cure), path.open("rb") as file:
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
    with _sentences(path, "is damaged", cure), path.open("rb") as file:
        if zipfile.is_zipfile(file):
            _check_archive(file)
        file.seek(0)
        stored = np.load(file, allow_pickle=False)
        wanted = stored.files if names is None else names
        further = [name for name in optional if name in stored.files and name not in wanted]
        return {name: stored[name] for name in (*wanted, *further)}


def _check_archive(file: IO[bytes]) -> None:
    """Raise ``ValueError`` unless the arrays of an archive have the sizes that they announce."""
    with zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
        total = sum(entry.file_size for entry in entries)
        if len(entries) > _MOST_ARRAYS or total > MOST_BYTES:
            raise ValueError(f"{len(entries)} arrays of {total} bytes")
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
