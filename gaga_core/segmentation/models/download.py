"""Weights from a hub, after a person has accepted the licence: whole and checked, or not at all.

Files come over plain HTTPS into ``models/.downloads/NAME/COMMIT``, and go on where they broke off,
also after a cancel: ``snapshot_download`` of huggingface_hub throws such parts away. When all are
there and have the hashes that the hub states, one rename puts the folder in its place.
"""

import hashlib
import json
import shutil
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, explain_os_error, replace_file
from gaga_core.io.folder.lock import InUseError, lock_folder
from gaga_core.io.json_file import read_json
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.models.catalogue import KnownModel
from gaga_core.segmentation.models.hub import (
    HubConfig,
    Listing,
    RemoteFile,
    ask,
    connected,
)
from gaga_core.segmentation.models.weights import find_model, is_model_folder, models_folder

if TYPE_CHECKING:
    import httpx2

# --- ``model.lock.json`` next to weights: what they are, for another machine to get the same.
# Only what the hub stated or what was computed from the files stands in it.


LOCK_FILE = "model.lock.json"
_FORMAT, _VERSION = "gaga-model-lock", 1
_BLOCK = 1 << 22  # bytes hashed between two steps
_CURE = "Get the model again without it, or copy the file again."
_Name = Annotated[str, msgspec.Meta(pattern=r"^[\w.-]+$(?!\n)", max_length=200)]
_Sha256 = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$(?!\n)")]


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
    commit: Annotated[str, msgspec.Meta(pattern=r"^[0-9A-Za-z]{1,64}$(?!\n)")]
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
    model, where = listing.model, (listing.endpoint, listing.revision, listing.commit)
    said = (licence, listing.licence, accepted_at)
    lock = ModelLock(_FORMAT, _VERSION, model.name, model.hub, *where, *said, files)
    with atomic_write(folder / LOCK_FILE) as temporary:
        text = json.dumps(msgspec.to_builtins(lock), indent=1)
        temporary.write_text(text + "\n", encoding="utf-8")
    return lock


def check_file(path: Path, stated: RemoteFile) -> LockedFile | None:
    """Compare a file with what the hub states: size, then sha256 or the name of the git blob.

    Returns what is recorded of it; None when it is another file. Raises ``GagaError`` when it
    cannot be read.
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
        if file is None or file.size != locked.size or file.sha256 not in ("", locked.sha256):
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


STAGE = "Download"
_STEPS = 1000
_SPARE = 64 << 20  # bytes of the disk that are left free
_PARTS = ".downloads"


@dataclass(frozen=True)
class Consent:
    """That a person accepted the licence of a model. Nothing is downloaded without one."""

    model: str  # its name
    licence: str  # as it was shown
    accepted_at: str = field(
        default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds")
    )


@dataclass(frozen=True)
class Installed:
    """A model that is here."""

    model: KnownModel
    path: Path
    n_bytes: int  # downloaded now; 0 = it was here

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        lock = lock_of(self.path) if self.path.is_dir() else None
        return {
            "name": self.model.name,
            "path": str(self.path),
            "downloaded_bytes": self.n_bytes,
            "commit": lock.commit if lock is not None else "",
            "licence": self.model.licence,
        }


@dataclass
class _Meter:
    """Bytes of all files that are here, and their rate."""

    title: str
    total: int
    done: int
    fetched: int = 0  # by this run
    started: float = field(default_factory=time.monotonic)

    def step(self, text: str) -> Progress:
        """One step of the progress bar."""
        seconds = max(time.monotonic() - self.started, 1e-3)
        speed = f", {self.fetched / 1e6 / seconds:.1f} MB/s" if self.fetched else ""
        share = round(_STEPS * self.done / max(self.total, 1))
        amount = f"{self.done / 1e6:.1f} of {self.total / 1e6:.1f} MB{speed}"
        return Progress(STAGE, min(share, _STEPS), _STEPS, f"{text}: {amount}")


def download(
    listing: Listing, consent: Consent, config: HubConfig | None = None
) -> Stage[Installed]:
    """Put the files of ``listing`` into the folder of models; nothing comes twice.

    Closing the stage keeps what has come; the next one goes on there. Raises ``GagaError``: no
    room, no connection, gated, other bytes than the hub states, another program at work;
    ``ValueError`` when the consent is for another model.
    """
    model, config = listing.model, config or HubConfig()
    if consent.model != model.name:
        raise ValueError(f"consent: expected one for {model.name}, got {consent.model}")
    here = find_model(model)
    if here is not None:
        return Installed(model, here, 0)
    parts = parts_folder(model)
    with _one_at_a_time(model):
        here = find_model(model)  # another program may have brought it
        if here is not None:
            return Installed(model, here, 0)
        staging = parts / listing.commit
        _make_room(listing, staging)
        meter = _Meter(model.title, listing.size, _bytes_in(staging))
        locked = []
        try:
            with connected(model, config) as client:
                for file in listing.files:
                    fetched = _fetch(client, listing, file, staging, meter, config)
                    locked.append((yield from fetched))
            write_lock(staging, listing, consent.licence, consent.accepted_at, locked)
            if not is_model_folder(staging):
                raise GagaError(
                    f"The files of {model.hub} are not a complete model. Get it again later."
                )
            path = models_folder() / model.name
            replace_file(staging, path)
        except OSError as error:
            raise GagaError(explain_os_error(error, staging)) from error
        shutil.rmtree(parts, ignore_errors=True)
    return Installed(model, path, meter.fetched)


def parts_folder(model: KnownModel) -> Path:
    """The folder of an unfinished download."""
    return models_folder() / _PARTS / model.name


def partial_bytes(model: KnownModel) -> int:
    """Bytes of an unfinished download that are here."""
    folder = parts_folder(model)
    commits = [path for path in folder.iterdir() if path.is_dir()] if folder.is_dir() else []
    return sum(_bytes_in(path) for path in commits)


def remove(model: KnownModel) -> Path | None:
    """Delete a model from the folder of models, and what an unfinished download left.

    Returns the folder that went, None when there was none. Raises ``GagaError`` when the model
    lies elsewhere (in the hub's cache, which other programs use too), or cannot be deleted.
    """
    with _one_at_a_time(model):
        shutil.rmtree(parts_folder(model), ignore_errors=True)
        found = find_model(model)
        if found is None:
            return None
        if found.parent != models_folder():
            raise GagaError(
                f"{model.title} is in {found}, which other programs use too. "
                "Delete it there, or with hf cache rm."
            )
        try:
            if found.is_symlink() or found.is_file():
                found.unlink()
            else:
                shutil.rmtree(found)
        except OSError as error:
            raise GagaError(explain_os_error(error, found)) from error
    return found


@contextmanager
def _one_at_a_time(model: KnownModel) -> Iterator[None]:
    folder = models_folder() / _PARTS
    try:
        lock = lock_folder(folder / f"{model.name}.lock")
    except InUseError as error:
        raise GagaError(
            f"{error.owner or 'Another program'} is downloading or removing {model.title}. "
            "Wait until it is done."
        ) from error
    with lock:
        yield


def _bytes_in(folder: Path) -> int:
    files = folder.iterdir() if folder.is_dir() else ()
    return sum(file.stat().st_size for file in files if file.is_file())


def _make_room(listing: Listing, staging: Path) -> None:
    """Make the folder; ``GagaError`` when the disk is too small for what is still to come."""
    model = listing.model
    target = models_folder() / model.name
    try:
        if target.is_dir() and not any(target.iterdir()):
            target.rmdir()
        if target.exists():
            raise GagaError(
                f"{target} exists but holds no complete model. Complete it, or move it away."
            )
        for other in parts_folder(model).glob("*"):
            if other.name != staging.name:  # of another commit
                shutil.rmtree(other)
        staging.mkdir(parents=True, exist_ok=True)
        stated = {name for file in listing.files for name in (file.name, f"{file.name}.part")}
        for path in staging.iterdir():
            if path.name not in stated:  # another mirror's
                path.unlink()
        need = listing.size - _bytes_in(staging)
        free = shutil.disk_usage(staging).free
    except OSError as error:
        raise GagaError(explain_os_error(error, staging)) from error
    if need + _SPARE > free:
        raise GagaError(
            f"{model.title} needs {need / 1e6:,.0f} MB in {models_folder()}, and only "
            f"{free / 1e6:,.0f} MB are free there. Free some space, or set GAGA_MODELS to a folder "
            "on another disk."
        )


def _fetch(
    client: "httpx2.Client",
    listing: Listing,
    file: RemoteFile,
    staging: Path,
    meter: _Meter,
    config: HubConfig,
) -> Stage[LockedFile]:
    """Bring one file, from where it broke off, and check it; once more whole where that differs."""
    path, part = staging / file.name, staging / f"{file.name}.part"
    was_begun = path.is_file() or part.is_file()
    for _ in range(1 + was_begun):
        if not path.is_file():
            yield from _fill(client, listing.url(file), part, file, meter, config)
            replace_file(part, path)
        yield meter.step(f"check {file.name}")
        locked = check_file(path, file)
        if locked is not None:
            return locked
        meter.done -= path.stat().st_size
        path.unlink()
    raise GagaError(
        f"{file.name} from {config.host} is not the file that the hub states: its size or its "
        "hash differs. It was deleted. Get the model again, or use another mirror."
    )


def _fill(
    client: "httpx2.Client",
    url: str,
    part: Path,
    file: RemoteFile,
    meter: _Meter,
    config: HubConfig,
) -> Stage[None]:
    """Append to ``part`` until it has the size of ``file``; a broken connection is opened again."""
    import httpx2

    failures = 0
    while True:
        have = part.stat().st_size if part.is_file() else 0
        if have == file.size:
            part.touch()  # of an empty file
            return
        if have > file.size:
            meter.done -= have
            part.unlink()
            failures += 1
            if failures > config.retries:
                raise GagaError(
                    f"{config.host} sends more of {file.name} than it states. Use another mirror."
                )
            continue
        try:
            yield from _append(client, url, part, have, file, meter, config)
        except httpx2.TransportError as error:
            if isinstance(error, httpx2.UnsupportedProtocol | httpx2.ProxyError):
                raise
            failures = 0 if _size(part) > have else failures + 1
            if failures > config.retries:
                raise
            yield meter.step(f"{file.name}: the connection broke, again")
            time.sleep(config.wait_s)
            continue
        if _size(part) <= have:  # an answer that ended early, without an error
            failures += 1
        if failures > config.retries:
            raise GagaError(
                f"{config.host} sends no more of {file.name}. What has come is kept: "
                "get the model again to continue."
            )


def _append(
    client: "httpx2.Client",
    url: str,
    part: Path,
    have: int,
    file: RemoteFile,
    meter: _Meter,
    config: HubConfig,
) -> Stage[None]:
    """One answer of the hub, to the end of ``part``; from its start when it sends everything."""
    headers = {"range": f"bytes={have}-"} if have else {}
    news = ask(client, url, config, headers)
    with closing(news):  # type: ignore[type-var]  # it is a generator
        while (response := next(news)) is None:
            yield meter.step(file.name)
        assert not isinstance(response, bytes)
        is_rest = response.status_code == 206
        if is_rest and not response.headers.get("content-range", "").startswith(f"bytes {have}-"):
            raise GagaError(f"{config.host} sends another part of {file.name}. Use another mirror.")
        if not is_rest:
            meter.done -= have
            have = 0
        with part.open("ab" if is_rest else "wb") as out:
            for block in news:
                if isinstance(block, bytes):
                    out.write(block[: file.size + 1 - have])  # one more shows that it is another
                    have += len(block)
                    meter.done += len(block)
                    meter.fetched += len(block)
                yield meter.step(file.name)
                if have > file.size:
                    return


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0
