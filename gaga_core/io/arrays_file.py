"""Reading ``.npz`` and ``.npy`` files of plain arrays, damaged ones included."""

import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.io.files import explain_os_error

# What numpy and zipfile raise on files with wrong bytes, found by flipping bits: zlib.error and
# TokenError (from numpy's parse of an array header) are no ValueError, and an odd compression
# method or an "encrypted" flag is a RuntimeError.
_DAMAGED = (
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


def read_array(path: Path, cure: str) -> AnyArray:
    """The array of an ``.npy``; never unpickles.

    Raises ``GagaError`` when the file is missing, damaged, or holds Python objects: ``cure`` says
    what to do then.
    """
    try:
        with path.open("rb") as file:
            stored = np.load(file, allow_pickle=False)
            if isinstance(stored, np.ndarray):
                return stored
    except OSError as error:
        if error.errno is None:
            raise GagaError(f"{path} is damaged. {cure}") from error
        raise GagaError(explain_os_error(error, path)) from error
    except _DAMAGED as error:
        raise GagaError(f"{path} is damaged or holds Python objects. {cure}") from error
    raise GagaError(f"{path} is an archive of arrays, not one array. {cure}")


def read_arrays(path: Path, cure: str) -> dict[str, AnyArray]:
    """All arrays of an ``.npz`` by name; never unpickles.

    Raises ``GagaError`` when the file is missing or damaged: ``cure`` says what to do then.
    """
    try:
        # Opened here: numpy leaves the file open when its archive is damaged.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except OSError as error:
        if error.errno is None:
            raise GagaError(f"{path} is damaged. {cure}") from error
        raise GagaError(explain_os_error(error, path)) from error
    except (*_DAMAGED, AttributeError) as error:  # a single .npy is not an archive: no .files
        raise GagaError(f"{path} is damaged. {cure}") from error
