"""A repository on a hub of models: the commit, its files, their sizes and hashes.

The hub is that of Hugging Face or a mirror with the same interface. Nothing here downloads weights.
"""

import ipaddress
import os
import queue
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated
from urllib.parse import quote, urlsplit

import msgspec

from gaga_core.errors import GagaError, cure_without
from gaga_core.io.json_file import decode_json
from gaga_core.segmentation.models.catalogue import KnownModel
from gaga_core.segmentation.models.weights import models_folder
from gaga_core.version import __version__

if TYPE_CHECKING:
    import httpx2

HUB = "https://huggingface.co"
_TRUE = {"1", "ON", "YES", "TRUE"}  # as huggingface_hub reads its switches
_MOST_JSON = 16 << 20  # bytes of an answer about a repository
_MOST_FILES = 1000  # of a model: the largest on the hub come in 200 parts
_MOST_REDIRECTS = 5  # of one file: the hub takes one, to its storage
_AHEAD, _TICK_S = 8, 0.1  # blocks that are read before they are asked for; wait between two looks
# Weights that hold tensors and no code, and what transformers reads next to them.
_WANTED = re.compile(
    r"[\w.-]+\.safetensors|[\w.-]*(?:config|tokenizer|vocab|special_tokens_map|added_tokens"
    r"|index)[\w.-]*\.json|vocab\.txt|merges\.txt|(?:spiece|sentencepiece[\w.]*)\.model",
    re.ASCII,
)


@dataclass(frozen=True)
class HubConfig:
    """Which hub is asked, and how patiently."""

    endpoint: str = ""
    """Address of a mirror; "" = HF_ENDPOINT, else the hub of Hugging Face."""
    is_offline: bool = False
    """Ask nothing; HF_HUB_OFFLINE in the environment does the same."""
    timeout_s: float = 15.0
    """Longest silence of the other side in seconds, also the longest wait for a cancel."""
    retries: int = 5
    """How often a connection may break without a byte in between."""
    wait_s: float = 1.0
    """Pause before it is opened again, in seconds."""
    least_rate: float = 1000.0
    """Bytes a second below which a download ends: a gigabyte would take twelve days."""
    slow_s: float = 30.0
    """Seconds over which that is measured, as curl does."""

    @property
    def address(self) -> str:
        """The address without a slash at its end; ``GagaError`` when it is none."""
        found = (self.endpoint or os.environ.get("HF_ENDPOINT") or HUB).strip().rstrip("/")
        parts = urlsplit(found)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise GagaError(
                f"{found!r} is no address of a hub. Give one such as {HUB}, "
                "or none for the hub of Hugging Face."
            )
        return found

    @property
    def host(self) -> str:
        """ "huggingface.co", for sentences."""
        return urlsplit(self.address).netloc.rpartition("@")[2]

    def why_offline(self) -> str:
        """The reason not to contact the hub; "" when there is none."""
        if self.is_offline:
            return "the program is set to work offline"
        for name in ("HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE"):
            if os.environ.get(name, "").upper() in _TRUE:
                return f"{name} is set"
        return ""


@dataclass(frozen=True)
class RemoteFile:
    """A file of a repository as the hub states it."""

    name: str
    size: int  # bytes
    sha256: str = ""  # of files that the hub keeps outside git (LFS); "" for small ones
    git_sha1: str = ""  # name of the blob in git


@dataclass(frozen=True)
class Listing:
    """The files of a model to download."""

    model: KnownModel
    endpoint: str
    revision: str  # that was asked for
    commit: str
    licence: str  # as the repository states it; "" when it does not
    files: tuple[RemoteFile, ...]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files)

    @property
    def licence_name(self) -> str:
        """The licence that a person accepts: what the repository states, else what is known."""
        known = self.model.licence
        is_same = self.licence.casefold() == known.casefold()
        return known if is_same or not self.licence else self.licence

    def url(self, file: RemoteFile) -> str:
        """Address of a file at this commit."""
        return f"{self.endpoint}/{self.model.hub}/resolve/{self.commit}/{quote(file.name)}"


def list_files(
    model: KnownModel, config: HubConfig | None = None, *, revision: str = "main"
) -> Listing:
    """Ask the hub for the files of ``model`` at a branch, tag or commit.

    Only safetensors, configurations and the files of tokenizers count. Raises ``GagaError`` that
    says what to do: offline, no connection, gated, no such repository or revision, no safetensors.
    """
    config = config or HubConfig()
    address = f"/api/models/{model.hub}/revision/{quote(revision, safe='')}?blobs=true"
    with connected(model, config) as client:
        raw = _read_bounded(client, config.address + address, config)
        info = decode_json(raw, _Info, f"The answer of {config.host}", "Try again later.")
        draft = Listing(model, config.address, revision, info.sha, info.licence, ())
        wanted = {i.rfilename: i for i in info.siblings if _WANTED.fullmatch(i.rfilename)}
        if len(wanted) > _MOST_FILES:
            raise GagaError(
                f"{config.host} lists {len(wanted):,} files of {model.hub}. Use a mirror."
            )
        files = [_remote_file(client, draft, wanted[name], config) for name in sorted(wanted)]
    files.sort(key=lambda file: file.size)  # the weights last
    has_weights = any(file.name.endswith(".safetensors") for file in files)
    if not has_weights or "config.json" not in wanted:
        raise GagaError(
            f"{model.hub} has no safetensors with a config.json at {revision}, and other forms of "
            f"weights can hold code. Choose another model, or another revision of {model.page}."
        )
    return replace(draft, files=tuple(files))


@contextmanager
def connected(model: KnownModel, config: HubConfig) -> "Iterator[httpx2.Client]":
    """A client of the hub; its errors become sentences about ``model``.

    A token (HF_TOKEN, or the one of ``hf auth login``) goes to the hub of Hugging Face; a mirror
    gets only HF_TOKEN.
    """
    reason = config.why_offline()
    if reason:
        raise GagaError(f"{model.title} is not downloaded: {reason}. {by_hand(model)}")
    if find_spec("huggingface_hub") is None or find_spec("httpx2") is None:
        raise GagaError(
            f"Downloads need the package huggingface_hub. Install it: {cure_without('models')}."
        )
    import httpx2
    from huggingface_hub import get_token

    headers = {"user-agent": f"gaga-studio/{__version__}", "accept-encoding": "identity"}
    token = get_token() if config.address == HUB else os.environ.get("HF_TOKEN")
    if token:
        headers["authorization"] = f"Bearer {token}"
    try:
        with httpx2.Client(headers=headers, timeout=config.timeout_s) as client:
            yield client
    except _RefusedError as error:
        if error.code == "GatedRepo":
            raise GagaError(gated(model)) from error
        if error.code == "RevisionNotFound":
            raise GagaError(f"{model.hub} has no such revision on {config.host}.") from error
        if error.code == "RepoNotFound" or error.status == 401:
            text = f"{config.host} does not give {model.hub}: it is not there, or needs a login. "
            text = gated(model) if model.is_gated else text + by_hand(model)
            raise GagaError(text) from error
        raise GagaError(
            f"{config.host} answered {error.status} for {model.hub}. "
            "Try again later, or use a mirror."
        ) from error
    except (httpx2.HTTPError, httpx2.InvalidURL) as error:
        raise GagaError(
            f"{config.host} cannot be reached ({_short(error)}). Check the connection and try "
            f"again, or use a mirror. {by_hand(model)}"
        ) from error


def terms(model: KnownModel, listing: Listing | None) -> str:
    """Size, licence and page of a model, for the person who is asked for consent.

    Without a listing the size is about.
    """
    size, licence, source = f"about {model.megabytes:,} MB", model.licence, HUB
    if listing is not None:
        size, licence = f"{listing.size / 1e6:,.1f} MB", listing.licence_name
        source = listing.endpoint
    return f"{model.title} is {size} from {source}, licence {licence}, see {model.page}."


def gated(model: KnownModel) -> str:
    """Advice for a model whose page asks for an account."""
    return (
        f"{model.title} is gated: {model.page} asks for your name and consent. Ask for access "
        "there, then set HF_TOKEN (or use hf auth login) and get it again. "
        f"Or take its files from another place. {by_hand(model)}"
    )


def by_hand(model: KnownModel) -> str:
    """The way without this program's download: a local folder."""
    return (
        f"Put all its files into {models_folder() / model.name}, "
        "or name any folder that holds them (--weights)."
    )


_Size = Annotated[int, msgspec.Meta(ge=0)]  # bytes


class _Lfs(msgspec.Struct):
    sha256: Annotated[str, msgspec.Meta(pattern=r"^([0-9a-f]{64})?$(?!\n)")] = ""
    size: _Size | None = None


class _Sibling(msgspec.Struct):
    rfilename: str
    size: _Size | None = None
    blobId: str | None = None  # noqa: N815  the hub's name
    lfs: _Lfs | None = None


class _Info(msgspec.Struct):
    sha: Annotated[
        str, msgspec.Meta(pattern=r"^[0-9A-Za-z]{1,64}$(?!\n)")
    ]  # becomes a part of paths
    siblings: list[_Sibling] = []
    cardData: dict[str, object] | None = None  # noqa: N815  the hub's name
    tags: list[str] = []

    @property
    def licence(self) -> str:
        """The licence of the model card, "" when it names none."""
        card = self.cardData or {}
        name = card.get("license_name") if card.get("license") == "other" else card.get("license")
        if isinstance(name, str) and name:
            return name
        tags = (tag.partition("license:")[2] for tag in self.tags if tag.startswith("license:"))
        return next(tags, "")


def _remote_file(
    client: "httpx2.Client", listing: Listing, item: _Sibling, config: HubConfig
) -> RemoteFile:
    size, sha256 = item.size, item.lfs.sha256 if item.lfs is not None else ""
    if size is None and item.lfs is not None:
        size = item.lfs.size
    if size is None:  # a mirror that lists names only
        url = listing.url(RemoteFile(item.rfilename, 0))
        head = next(news for news in ask(client, url, config, method="HEAD") if news is not None)
        assert not isinstance(head, bytes)
        said: dict[str, str] = {}
        for answer in (head, *reversed(head.history)):  # redirects name LFS files: they win
            said |= dict(answer.headers)
        stated = said.get("x-linked-size") or head.headers.get("content-length") or ""
        if not re.fullmatch(r"[0-9]{1,18}", stated):
            raise GagaError(
                f"{urlsplit(url).hostname} does not say how long {item.rfilename} is. "
                "Use another mirror."
            )
        size = int(stated)
        etag = said.get("x-linked-etag") or head.headers.get("etag") or ""
        found = re.fullmatch(r'(?:W/)?"?([0-9a-f]{64})"?', etag)
        sha256 = sha256 or (found[1] if found else "")
    return RemoteFile(item.rfilename, size, sha256, item.blobId or "")


def _read_bounded(client: "httpx2.Client", url: str, config: HubConfig) -> bytes:
    raw = bytearray()
    for news in ask(client, url, config):
        raw += news if isinstance(news, bytes) else b""
        if len(raw) > _MOST_JSON:
            raise GagaError(
                f"The answer of {urlsplit(url).hostname} is too long for a list of files."
            )
    return bytes(raw)


# --- One question to the hub: no answer of it is longer, slower, or elsewhere than it may be.


class _RefusedError(Exception):
    """The hub answered with another status than success."""

    def __init__(self, response: "httpx2.Response") -> None:
        self.status = response.status_code
        self.code = response.headers.get("x-error-code", "")
        super().__init__(f"{self.status} {self.code}")


def ask(
    client: "httpx2.Client",
    url: str,
    config: HubConfig,
    headers: dict[str, str] | None = None,
    *,
    method: str = "GET",
) -> "Iterator[httpx2.Response | bytes | None]":
    """The answer without its content, then that in blocks; None after a tenth of a second without.

    A thread reads, so that whoever closes this waits for nothing. Raises what `connected` makes a
    sentence, and ``GagaError`` for an answer that is too slow, compressed, or sends elsewhere.
    """
    news: queue.Queue[httpx2.Response | bytes | Exception] = queue.Queue(_AHEAD)
    is_over = threading.Event()

    def tell(item: "httpx2.Response | bytes | Exception") -> None:
        while not is_over.is_set():
            try:
                news.put(item, timeout=_TICK_S)
            except queue.Full:
                continue
            return

    def read() -> None:
        try:
            with _followed(client, method, url, headers) as response:
                tell(response)
                for block in response.iter_raw():
                    if block:
                        tell(block)
                    if is_over.is_set():
                        return
            tell(b"")
        except Exception as error:  # noqa: BLE001  raised again by whoever asks
            tell(error)

    threading.Thread(target=read, daemon=True, name="hub").start()
    n_bytes, waited = 0, 0.0
    try:
        while True:
            begin = time.monotonic()
            try:
                item = news.get(timeout=_TICK_S)
            except queue.Empty:
                item = None
            waited += time.monotonic() - begin
            if isinstance(item, Exception):
                raise item
            if item == b"":
                return
            n_bytes += len(item) if isinstance(item, bytes) else 0
            if waited > config.slow_s:
                if n_bytes < config.least_rate * waited:
                    raise GagaError(
                        f"{urlsplit(url).hostname} sends less than {config.least_rate:,.0f} "
                        "bytes a second. What has come is kept. Try again later, or use a mirror."
                    )
                n_bytes, waited = 0, 0.0
            yield item
    finally:
        is_over.set()


@contextmanager
def _followed(
    client: "httpx2.Client", method: str, url: str, headers: dict[str, str] | None
) -> "Iterator[httpx2.Response]":
    """The answer behind all redirects, whose own content is never read."""
    request = client.build_request(method, url, headers=headers)
    history: list[httpx2.Response] = []
    while len(history) <= _MOST_REDIRECTS:
        response = client.send(request, stream=True, follow_redirects=False)
        with closing(response):
            if response.next_request is None:
                response.history = history
                if not response.is_success:
                    raise _RefusedError(response)
                if response.headers.get("content-encoding", "identity").lower() != "identity":
                    raise GagaError(f"{request.url.host} compresses files. Use another mirror.")
                yield response
                return
        check_redirect(str(request.url), str(response.next_request.url))
        history.append(response)
        request = response.next_request
    raise GagaError(f"{request.url.host} sends in circles. Try again later, or use a mirror.")


def check_redirect(source: str, target: str) -> None:
    """``GagaError`` unless an answer of ``source`` may send this program to ``target``.

    Never from https to anything else, and not from the internet to a network that only this
    machine may reach.
    """
    old, new = urlsplit(source), urlsplit(target)
    is_known = new.scheme == "https" or (new.scheme == "http" and old.scheme == "http")
    if not is_known or (_is_private(new.hostname) and not _is_private(old.hostname)):
        raise GagaError(
            f"{old.hostname} sends to {target}, where no models are taken from. Use another mirror."
        )


def _is_private(host: str | None) -> bool:
    try:
        found = {str(info[4][0]).partition("%")[0] for info in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError):  # connecting says why
        return False
    return not all(ipaddress.ip_address(address).is_global for address in found)


def _short(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return text[0][:120] if text else type(error).__name__
