"""The files of a model that lies in several, and whether one of them has changed.

A .gltf takes its numbers from buffers next to it, the meta.json of a SOG folder from pictures, and
the lod-meta.json of a streamed SOG from such folders.
"""

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Any

from gaga_core.errors import GagaError
from gaga_core.io.files import fingerprint
from gaga_core.io.glb_buffers import buffer_file
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.sog import META
from gaga_core.io.streamed_sog import LOD_META, chunk_path

_MOST_BYTES = 1 << 30  # of a .gltf with its numbers in the text
_GONE = "gone"


def files_of_model(path: Path) -> tuple[Path, ...]:
    """``path``, then the files next to it or below it that its numbers lie in.

    None of them need exist; of a damaged model only ``path`` is known.
    """
    path = Path(path)
    if path.suffix.lower() != ".gltf" and path.name not in (META, LOD_META):
        return (path,)
    try:
        found = path.stat()
    except OSError:
        return (path,)
    parts = _parts(path, (found.st_ino, found.st_mtime_ns, found.st_size))
    if path.name == LOD_META:  # each chunk is a model of several files, too
        parts = tuple(file for chunk in parts for file in files_of_model(chunk))
    return (path, *parts)


def model_fingerprint(path: Path) -> str:
    """Digest of all files of a model; of a single file that of `fingerprint`.

    Raises ``GagaError`` when ``path`` itself cannot be read.
    """
    path = Path(path)
    files = files_of_model(path)
    if len(files) == 1:
        return fingerprint(path)
    digests = [fingerprint(file) if _is_there(file) else _GONE for file in files]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()


def _is_there(file: Path) -> bool:
    try:
        return file.is_file()
    except OSError:  # a name that no file can have
        return False


def is_same_model(path: Path, digest: str) -> bool:
    """Whether the model has this digest, which may be one of ``path`` alone as older projects have.

    Raises ``GagaError`` when ``path`` cannot be read.
    """
    return digest in (model_fingerprint(path), fingerprint(path))


@lru_cache(maxsize=4096)  # a streamed SOG may have as many chunks
def _parts(path: Path, stamp: tuple[int, int, int]) -> tuple[Path, ...]:
    """Files that a model names; ``stamp`` tells one version of it from another."""
    del stamp
    try:
        content = read_foreign_json(path, dict[str, Any], most_bytes=_MOST_BYTES)
        if path.name == LOD_META:
            return _chunks(content, path)
        return _pictures(content, path) if path.name == META else _buffers(content, path)
    except (GagaError, OSError, ValueError, TypeError, AttributeError):
        return ()  # the reader of the model says what is wrong with it


def _buffers(gltf: dict[str, Any], path: Path) -> tuple[Path, ...]:
    uris = [row.get("uri") for row in gltf.get("buffers", [])]
    named = [uri for uri in uris if isinstance(uri, str) and not uri.startswith("data:")]
    return tuple(buffer_file(uri, path) for uri in named)


def _chunks(meta: dict[str, Any], path: Path) -> tuple[Path, ...]:
    names = [*meta.get("filenames", []), *filter(None, [meta.get("environment")])]
    return tuple(chunk_path(path, str(name)) for name in names)


def _pictures(meta: dict[str, Any], path: Path) -> tuple[Path, ...]:
    parts = [part["files"] for part in meta.values() if isinstance(part, dict) and "files" in part]
    names = [str(name) for files in parts for name in files]
    return tuple(path.parent / name for name in names if Path(name).name == name)
