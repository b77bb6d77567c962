"""Parts that the program folder holds compressed: unpacked into the user's cache at first use.

ffmpeg, COLMAP and the compiler of the kernels are 449 MiB, 114 of them compressed, and two of the
three are not needed to look at a scene.
"""

import sys
import tarfile
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from importlib.abc import MetaPathFinder
from pathlib import Path

import zstandard

from gaga_core.cache_folder import user_cache
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, explain_os_error

SUFFIX = ".tar.zst"  # of a package: NAME-DIGEST.tar.zst


def unpacked_file(packed: Path) -> Path:
    """The program of a .zst, which is named by its version, in the user's cache."""
    program = user_cache() / packed.stem
    if not program.is_file():
        with atomic_write(program) as temporary:
            with packed.open("rb") as source, temporary.open("wb") as target:
                zstandard.ZstdDecompressor().copy_stream(source, target)
            temporary.chmod(0o755)
    return program


def unpacked_folder(packed: Path) -> Path:
    """The content of a .tar.zst in the user's cache; what other versions left there goes.

    Raises ``GagaError`` when it cannot be written.
    """
    folder = user_cache() / packed.name.removesuffix(SUFFIX)
    if folder.is_dir():
        return folder
    try:
        user_cache().mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".unpack-", dir=user_cache()) as temporary:
            made = Path(temporary) / "made"
            with (
                packed.open("rb") as source,
                zstandard.ZstdDecompressor().stream_reader(source) as stream,
                tarfile.open(fileobj=stream, mode="r|") as archive,
            ):
                archive.extractall(made, filter="data")
            if not folder.is_dir():  # another process may have been faster
                made.rename(folder)
    except OSError as error:
        if not folder.is_dir():
            raise GagaError(explain_os_error(error, folder)) from error
    for other in user_cache().glob(f"{folder.name.rpartition('-')[0]}-*"):
        if other != folder:
            _remove_whole(other)
    return folder


def _remove_whole(folder: Path) -> None:
    """Remove a folder of the cache; one that is in use stays, and is never left in part."""
    gone = tempfile.TemporaryDirectory(
        prefix=".old-", dir=folder.parent, ignore_cleanup_errors=True
    )
    with suppress(OSError), gone as place:
        folder.rename(Path(place) / folder.name)


class _PackedPackages(MetaPathFinder):
    """Unpacks a package when it is imported first; the path finds it then."""

    def __init__(self, folder: Path) -> None:
        found = folder.glob(f"*{SUFFIX}")
        self._packed = {path.name.rpartition("-")[0]: path for path in found}

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: object = None) -> None:
        """Nothing: the import goes on with the path, to which the package's folder was added."""
        if fullname in self._packed:
            sys.path.append(str(unpacked_folder(self._packed[fullname])))
            del self._packed[fullname]  # only now: after an error the next import tries again


def import_packed(folder: Path) -> None:
    """Have packages found from now on that ``folder`` holds as NAME-DIGEST.tar.zst."""
    sys.meta_path.insert(0, _PackedPackages(folder))
