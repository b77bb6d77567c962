"""``model.lock.json`` next to weights: what they are, for another machine to get the same.

Only what the hub stated or what was computed from the files stands in it.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import msgspec

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.json_file import read_json
from gaga_core.models.hub import Listing, RemoteFile

LOCK_FILE = "model.lock.json"
_FORMAT, _VERSION = "gaga-model-lock", 1
_BLOCK = 1 << 22  # bytes hashed between two steps
_CURE = "Get the model again without it, or copy the file again."
_Name = Annotated[str, msgspec.Meta(pattern=r"^[\w.-]+$", max_length=200)]
_Sha256 = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


class LockedFile(msgspec.Struct, frozen=True):
    """A file of a model."""

    name: _Name
    size: Annotated[int, msgspec.Meta(ge=0)]  # bytes
    sha256: _Sha256  # of the file as it lies here
    checked: str  # what the hub stated of it: "sha256", "git" (blob name), or "size"


class ModelLock(msgspec.Struct, frozen=True):
    """Which weights lie in a folder, and whose licence was accepted."""

    format: str
    version: int
    name: str
    repository: str
    endpoint: str
    revision: str
    commit: Annotated[str, msgspec.Meta(pattern=r"^[0-9A-Za-z]{1,64}$")]
    licence: str  # that the person accepted
    licence_stated: str  # by the repository, "" when it names none
    accepted_at: str  # ISO 8601, UTC
    files: list[LockedFile]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files)


def read_lock(path: Path) -> ModelLock:
    """The lock in a file, or in the folder of a model; ``GagaError`` when it is damaged."""
    path = path / LOCK_FILE if path.is_dir() else path
    lock = read_json(path, ModelLock, _CURE)
    if lock.format != _FORMAT or lock.version > _VERSION:
        raise GagaError(f"{path} is no lock file of a model that this version reads. {_CURE}")
    return lock


def lock_of(folder: Path) -> ModelLock | None:
    """The lock next to weights; None where there is none that can be read."""
    if not (folder / LOCK_FILE).is_file():
        return None
    try:
        return read_lock(folder)
    except GagaError:  # the weights do without it
        return None


def write_lock(
    folder: Path, listing: Listing, licence: str, accepted_at: str, files: list[LockedFile]
) -> ModelLock:
    """Write the lock of ``listing`` into ``folder``."""
    lock = ModelLock(
        _FORMAT,
        _VERSION,
        listing.model.name,
        listing.model.hub,
        listing.endpoint,
        listing.revision,
        listing.commit,
        licence,
        listing.licence,
        accepted_at,
        files,
    )
    with atomic_write(folder / LOCK_FILE) as temporary:
        text = json.dumps(msgspec.to_builtins(lock), indent=1)
        temporary.write_text(text + "\n", encoding="utf-8")
    return lock


def check_file(
    path: Path, stated: RemoteFile, on_block: Callable[[], None] = lambda: None
) -> LockedFile | None:
    """Compare a file with what the hub states: size, then sha256 or the name of the git blob.

    Returns what is recorded of it; None when it is another file. ``on_block`` is called between
    two steps. Raises ``GagaError`` when it cannot be read.
    """
    try:
        size = path.stat().st_size
        sha256 = hashlib.sha256()
        blob = hashlib.sha1(b"blob %d\0" % size, usedforsecurity=False)
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK):
                sha256.update(block)
                if not stated.sha256:
                    blob.update(block)
                on_block()
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    found = sha256.hexdigest()
    checked = "sha256" if stated.sha256 else "git" if stated.git_sha1 else "size"
    is_same = size == stated.size
    if stated.sha256:
        is_same &= found == stated.sha256
    elif stated.git_sha1:
        is_same &= blob.hexdigest() == stated.git_sha1
    return LockedFile(stated.name, size, found, checked) if is_same else None


def check_against(listing: Listing, lock: ModelLock) -> Listing:
    """``listing`` with the hashes of ``lock``; ``GagaError`` when they are not the same files."""
    if lock.repository != listing.model.hub:
        raise GagaError(
            f"The lock file is of {lock.repository}, and {listing.model.name} is "
            f"{listing.model.hub}. Name the model that it belongs to."
        )
    stated = {file.name: file for file in listing.files}
    files = []
    for locked in lock.files:
        file = stated.get(locked.name)
        if (
            file is None
            or file.size != locked.size
            or (file.sha256 and file.sha256 != locked.sha256)
        ):
            raise GagaError(
                f"{locked.name} on {listing.endpoint} is not the file of the lock "
                f"({lock.commit[:12]}). Get the model without --lock, or use the hub of the lock, "
                f"{lock.endpoint}."
            )
        files.append(RemoteFile(locked.name, locked.size, locked.sha256))
    return replace(listing, files=tuple(files))


def check_folder(folder: Path, lock: ModelLock) -> None:
    """``GagaError`` unless the folder of a model holds exactly the files of ``lock``."""
    for locked in lock.files:
        path = folder / locked.name
        stated = RemoteFile(locked.name, locked.size, locked.sha256)
        if not path.is_file() or check_file(path, stated) is None:
            raise GagaError(
                f"{path} is not the file of the lock (commit {lock.commit[:12]}). Remove the model "
                f"(gaga models remove {lock.name}), then get it again with the lock."
            )
