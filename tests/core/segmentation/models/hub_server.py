"""A small hub of models on the loopback: the interface of the Hugging Face hub, and its faults.

Folders of models are served as repositories. Safetensors are LFS files as on the hub: a redirect to
another path, with the linked size and hash in the headers.
"""

import hashlib
import json
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

COMMIT = "5c3e1f0a9b8d7c6e5f4a3b2c1d0e9f8a7b6c5d4e"
_BLOCK = 1 << 14


@dataclass
class Hub:
    """What it serves, how badly, and what was asked."""

    repositories: dict[str, Path] = field(default_factory=dict)  # "facebook/sam2.1-hiera-tiny"
    gated: set[str] = field(default_factory=set)  # only for those with the token
    token: str = "hf_test"
    licences: dict[str, str] = field(default_factory=dict)
    cuts: list[int] = field(default_factory=list)  # bytes after which the next answers break off
    wrong_hash: bool = False
    extra_bytes: int = 0  # that the listing adds to sizes: more than any disk has
    only_names: bool = False  # a mirror that lists no sizes
    ignores_range: bool = False
    pause_s: float = 0.0  # between two blocks of 16 KB
    stalls: list[float] = field(default_factory=list)  # seconds of silence in the next answers
    status: int = 0  # answers everything so, if set
    raw: Callable[[str], Iterable[bytes] | None] = lambda path: None  # bytes instead of an answer
    tokens: list[str] = field(default_factory=list)  # that came with requests
    requests: list[str] = field(default_factory=list)  # "GET /path", "GET /path bytes=5-"
    sent: int = 0  # bytes of files
    url: str = ""

    def downloads(self) -> list[str]:
        """The requests for the content of files."""
        return [
            line
            for line in self.requests
            if "/cdn/" in line or ("GET" in line and "/resolve/" in line)
        ]


@contextmanager
def serve(hub: Hub) -> Iterator[Hub]:
    """Serve ``hub`` on a free port until the block ends; sets its ``url``."""

    class Handler(_Handler):
        served = hub

    # A window test before this one has left the toolkit's handler, which takes a client that hangs
    # up for a crash.
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    hub.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield hub
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def fresh_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of models, without cache, token or switches of whoever runs the tests."""
    folder = tmp_path / "models"
    monkeypatch.setenv("GAGA_MODELS", str(folder))
    if find_spec("huggingface_hub") is not None:
        monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    for name in ("HF_TOKEN", "HF_ENDPOINT", "HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE"):
        monkeypatch.delenv(name, raising=False)
    return folder


class _Handler(BaseHTTPRequestHandler):
    served: Hub
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        """Write nothing."""

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def _answer(self, *, with_body: bool) -> None:
        hub, path = self.served, unquote(urlsplit(self.path).path)
        asked = self.headers.get("range", "")
        hub.requests.append(f"{self.command} {path} {asked}".strip())
        if "authorization" in self.headers:
            hub.tokens.append(self.headers["authorization"])
        raw = hub.raw(path)
        if raw is not None:
            self.close_connection = True
            with suppress(OSError):  # the other side has gone
                for block in raw:
                    self.wfile.write(block)
            return None
        if hub.status:
            return self._refuse(hub.status, "")
        if path.startswith("/api/models/"):
            return self._info(path.removeprefix("/api/models/"))
        if path.startswith("/cdn/"):
            repository, _, name = path.removeprefix("/cdn/").rpartition("/")
            return self._send(hub.repositories[repository] / name, with_body)
        repository, _, rest = path.strip("/").partition("/resolve/")
        revision, _, name = rest.partition("/")
        folder = hub.repositories.get(repository)
        if folder is None:
            return self._refuse(404, "RepoNotFound")
        if repository in hub.gated and self.headers.get("authorization") != f"Bearer {hub.token}":
            return self._refuse(401, "GatedRepo")
        if revision not in ("main", COMMIT):
            return self._refuse(404, "RevisionNotFound")
        if not (folder / name).is_file():
            return self._refuse(404, "EntryNotFound")
        if name.endswith(".safetensors"):
            return self._redirect(folder / name, f"/cdn/{repository}/{name}")
        return self._send(folder / name, with_body)

    def _info(self, asked: str) -> None:
        hub = self.served
        repository, _, revision = asked.partition("/revision/")
        folder = hub.repositories.get(repository)
        if folder is None:
            return self._refuse(401, "RepoNotFound")
        if revision not in ("", "main", COMMIT):
            return self._refuse(404, "RevisionNotFound")
        siblings = [self._sibling(path) for path in sorted(folder.iterdir())]
        info = {
            "id": repository,
            "sha": COMMIT,
            "gated": "manual" if repository in hub.gated else False,
            "cardData": {"license": hub.licences.get(repository, "apache-2.0")},
            "siblings": siblings,
        }
        return self._respond(json.dumps(info).encode(), "application/json")

    def _sibling(self, path: Path) -> dict[str, object]:
        hub, raw = self.served, path.read_bytes()
        if hub.only_names:
            return {"rfilename": path.name}
        size = len(raw) + hub.extra_bytes
        blob = hashlib.sha1(b"blob %d\0" % len(raw) + raw).hexdigest()
        found: dict[str, object] = {"rfilename": path.name, "size": size, "blobId": blob}
        if path.suffix == ".safetensors":
            found["lfs"] = {"sha256": self._sha256(raw), "size": size, "pointerSize": 134}
        return found

    def _sha256(self, raw: bytes) -> str:
        return hashlib.sha256(raw + b"!" * self.served.wrong_hash).hexdigest()

    def _redirect(self, file: Path, to: str) -> None:
        raw = file.read_bytes()
        self.send_response(302)
        self.send_header("Location", self.served.url + to)
        self.send_header("X-Repo-Commit", COMMIT)
        self.send_header("X-Linked-Size", str(len(raw)))
        self.send_header("X-Linked-Etag", f'"{self._sha256(raw)}"')
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _send(self, file: Path, with_body: bool) -> None:
        hub, raw = self.served, file.read_bytes()
        asked = self.headers.get("range", "")
        start = int(asked.removeprefix("bytes=").rstrip("-")) if asked else 0
        start = 0 if hub.ignores_range else start
        self.send_response(206 if start else 200)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{len(raw) - 1}/{len(raw)}")
        self.send_header("Content-Length", str(len(raw) - start))
        self.send_header("X-Repo-Commit", COMMIT)
        self.send_header("ETag", f'"{hashlib.sha1(raw).hexdigest()}"')
        self.end_headers()
        if not with_body:
            return
        left = hub.cuts.pop(0) if hub.cuts and file.suffix == ".safetensors" else len(raw)
        stall = hub.stalls.pop(0) if hub.stalls and file.suffix == ".safetensors" else 0.0
        for at in range(start, min(len(raw), start + left), _BLOCK):
            if at > start:  # after the first block
                time.sleep(stall)
                stall = 0.0
            block = raw[at : min(at + _BLOCK, start + left)]
            try:
                self.wfile.write(block)
            except OSError:  # the other side has gone
                return
            hub.sent += len(block)
            time.sleep(hub.pause_s)
        if left < len(raw) - start:
            self.close_connection = True

    def _refuse(self, status: int, code: str) -> None:
        self.send_response(status)
        if code:
            self.send_header("X-Error-Code", code)
            self.send_header("X-Error-Message", code)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _respond(self, raw: bytes, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(raw)))
        self.end_headers()
        self.wfile.write(raw)
