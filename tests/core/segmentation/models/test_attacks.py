"""A hub that is not to be trusted: one sentence, and nothing of it stays or leaves its folder."""

import json
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, count, islice, repeat
from pathlib import Path
from threading import Event

import pytest

from gaga_core.errors import GagaError
from gaga_core.progress import run_stage
from gaga_core.segmentation.models.download import Consent, download, parts_folder
from gaga_core.segmentation.models.hub import HubConfig, check_redirect, list_files
from gaga_core.segmentation.models.weights import find_model
from tests.core.segmentation.models.conftest import TINY
from tests.core.segmentation.models.hub_server import COMMIT, Hub, serve

_OK = b"HTTP/1.1 200 OK\r\n"
_BLOCK = b"x" * 65536


def _config(hub: Hub, slow_s: float = 30.0) -> HubConfig:
    return HubConfig(hub.url, timeout_s=5, retries=1, wait_s=0.01, slow_s=slow_s)


def _get(config: HubConfig) -> Path:
    listing = list_files(TINY, config)
    return run_stage(download(listing, Consent(TINY.name, "Apache-2.0"), config)).path


def _drip(held: Event) -> Iterator[bytes]:
    while not held.wait(0.02):
        yield b"x"


def _attacks(url: str, held: Event) -> dict[str, Iterable[bytes]]:
    """What comes instead of weights of 300,000 bytes, or instead of the list of files."""

    def moved(place: bytes) -> bytes:
        return b"HTTP/1.1 302 F\r\nLocation: " + place + b"\r\n"

    return {
        "longer": chain([_OK + b"\r\n"], repeat(_BLOCK)),
        "shorter": [_OK + b"Content-Length: 9\r\n\r\n123456789"],
        "nothing": [b"HTTP/1.1 204 No Content\r\n\r\n"],
        "closed": [b""],
        "a byte at a time": chain([_OK + b"\r\n"], _drip(held)),
        "headers a byte at a time": chain([_OK + b"X: "], _drip(held)),
        "headers without end": chain([_OK], (b"X%d: y\r\n" % i for i in count())),
        "compressed": [_OK + b"Content-Encoding: gzip, br\r\n\r\n", b"\x1f\x8b"],
        "in circles": [moved(url.encode() + b"/api/cdn/x.safetensors") + b"\r\n"],
        "to a file": [moved(b"file:///etc/passwd") + b"\r\n"],
        "to nowhere": [moved(b"http://[") + b"\r\n"],
        "to no text": [moved(b"//\xff\xfe/\x80") + b"\r\n"],
        "elsewhere, without end": chain([moved(b"http://127.0.0.1:9/") + b"\r\n"], repeat(_BLOCK)),
        "refused without end": chain([b"HTTP/1.1 403 N\r\n\r\n"], repeat(_BLOCK)),
        "no text": [b"HTTP/1.1 200 \xff\xfe\r\n\xff: \xfe\r\nContent-Length: x\r\n\r\n"],
        "no HTTP": [b"\0" * 5000],
        "another part": [b"HTTP/1.1 206 P\r\nContent-Range: bytes 7-9/10\r\n\r\n123"],
    }


@pytest.mark.parametrize("part", [".safetensors", "/api/"])
@pytest.mark.parametrize("name", list(_attacks("", Event())))
def test_a_hostile_answer_is_one_sentence(
    name: str, part: str, hub: Hub, models: Path, tmp_path: Path
) -> None:
    held, before = Event(), set(tmp_path.rglob("*"))
    hub.raw = lambda path: _attacks(hub.url, held)[name] if part in path else None
    with pytest.raises(GagaError):
        _get(_config(hub, slow_s=0.5))
    held.set()
    made = {path for path in set(tmp_path.rglob("*")) - before if path.is_file()}
    lock = models / ".downloads" / f"{TINY.name}.lock"
    assert all(lock == path.parent or parts_folder(TINY) in path.parents for path in made)
    assert find_model(TINY) is None
    hub.raw = lambda path: None
    assert _get(_config(hub)) == models / TINY.name, "what has come is in no way"
    assert not parts_folder(TINY).exists()


def test_of_a_longer_body_no_more_is_taken_than_was_stated(hub: Hub) -> None:
    sent: list[int] = []

    def longer() -> Iterator[bytes]:
        yield _OK + b"\r\n"
        for _ in range(1000):
            sent.append(len(_BLOCK))
            yield _BLOCK

    config = _config(hub)
    stage = download(list_files(TINY, config), Consent(TINY.name, "Apache-2.0"), config)
    hub.raw = lambda path: longer() if ".safetensors" in path else None
    part, sizes = parts_folder(TINY) / COMMIT / "model.safetensors.part", [0]
    with pytest.raises(GagaError, match=r"sends more of model\.safetensors than it states"):
        run_stage(stage, lambda _: sizes.append(part.stat().st_size if part.exists() else 0))
    assert max(sizes) <= 300_001, "one byte shows that it is another file"
    assert sum(sent) < 40e6, "of 2 x 65 MB; the system's buffers hold some"
    assert not part.exists()


def test_a_slow_drip_is_given_up(hub: Hub) -> None:
    hub.raw = lambda path: (
        chain([_OK + b"\r\n"], islice(_drip(Event()), 100)) if ".safetensors" in path else None
    )
    with pytest.raises(GagaError, match=r"sends less than 1,000 bytes a second"):
        _get(_config(hub, slow_s=0.5))


@pytest.mark.parametrize("least_rate", [1e3, 1e7])
def test_the_least_rate_is_what_the_config_says(hub: Hub, least_rate: float) -> None:
    hub.pause_s = 0.05  # of 16 kB: 0.3 MB/s
    config = HubConfig(hub.url, timeout_s=5, retries=1, slow_s=0.3, least_rate=least_rate)
    if least_rate < 1e6:
        assert _get(config).is_dir()
    else:
        with pytest.raises(GagaError, match="sends less than 10,000,000 bytes a second"):
            _get(config)


def test_a_cancel_waits_for_no_answer(hub: Hub) -> None:
    held = Event()
    config = HubConfig(hub.url, timeout_s=600)
    listing = list_files(TINY, config)
    hub.raw = lambda path: (b"x" * held.wait(600) for _ in range(1))
    stage = download(listing, Consent(TINY.name, "Apache-2.0"), config)
    for _ in range(3):
        next(stage)
    stage.close()
    held.set()


def _listing(*siblings: Mapping[str, object], sha: str = COMMIT) -> bytes:
    return json.dumps({"sha": sha, "siblings": siblings}).encode()


_CONFIG: dict[str, object] = {"rfilename": "config.json", "size": 2}
_WEIGHTS: dict[str, object] = {"rfilename": "model.safetensors", "size": 10**18}


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (_listing(_CONFIG, {"rfilename": "../../model.safetensors", "size": 5}), "no safetensors"),
        (_listing(_CONFIG, {"rfilename": "/tmp/a.safetensors", "size": 5}), "no safetensors"),
        (_listing(_CONFIG, {"rfilename": "a.safetensors\n", "size": 5}), "no safetensors"),
        (_listing(_CONFIG, _WEIGHTS), "are free there"),
        (_listing(*({"rfilename": f"config{i}.json"} for i in range(5000))), "lists 5,000 files"),
        (_listing(*({"rfilename": f"{i}"} for i in range(1_000_000))), "too long"),
        (_listing(_CONFIG, sha=f"{COMMIT}\n"), "is damaged"),
        (b"[" * 1_000_000, "is damaged"),
    ],
    ids=["above", "absolute", "line", "large", "many", "most", "commit", "deep"],
)
def test_a_hostile_listing_is_one_sentence(answer: bytes, said: str, hub: Hub) -> None:
    body = _OK + b"Content-Length: %d\r\n\r\n" % len(answer) + answer
    hub.raw = lambda path: [body] if "/api/" in path else None
    with pytest.raises(GagaError, match=said):
        _get(_config(hub))
    assert hub.downloads() == []


_PUBLIC = "https://8.8.8.8/x"  # an address that is read, never asked


@pytest.mark.parametrize(
    "target",
    [
        "http://8.8.8.8/x", "file:///etc/passwd", "ftp://8.8.8.8/x", "https://127.0.0.1/x",
        "https://10.0.0.1/x", "https://169.254.169.254/x", "https://[::1]/x",
        "https://[::ffff:127.0.0.1]/x", "https://localhost/x", "https://2130706433/x",
    ],
)  # fmt: skip
def test_a_hub_in_the_internet_sends_only_there(target: str) -> None:
    check_redirect(_PUBLIC, "https://1.1.1.1/x")
    with pytest.raises(GagaError, match="sends to"):
        check_redirect(_PUBLIC, target)


def test_another_host_gets_no_token(
    hub: Hub, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_TOKEN", hub.token)
    with serve(Hub({TINY.hub: repository})) as storage:
        place = f"{storage.url}/cdn/{TINY.hub}/model.safetensors".encode()
        moved = b"HTTP/1.1 302 F\r\nLocation: " + place + b"\r\n\r\n"
        hub.raw = lambda path: [moved] if "safetensors" in path else None
        assert _get(_config(hub)).is_dir()
        assert hub.tokens
        assert storage.requests
        assert storage.tokens == []


def test_what_another_mirror_brought_is_not_taken_over(hub: Hub) -> None:
    left = parts_folder(TINY) / COMMIT / "other.safetensors"
    left.parent.mkdir(parents=True)
    left.write_bytes(b"x")
    assert not (_get(_config(hub)) / left.name).exists()
