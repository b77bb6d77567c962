"""Downloads from a hub on the loopback: whole and checked, or not at all; nothing twice."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from gaga_core.errors import GagaError
from gaga_core.progress import Progress, run_stage
from gaga_core.segmentation.models.catalogue import known_model
from gaga_core.segmentation.models.download import (
    Consent,
    Installed,
    check_against,
    check_folder,
    download,
    partial_bytes,
    read_lock,
    remove,
)
from gaga_core.segmentation.models.hub import HubConfig, list_files
from gaga_core.segmentation.models.weights import find_model
from tests.core.segmentation.models.conftest import TINY
from tests.core.segmentation.models.hub_server import COMMIT, Hub

WANTED = {"config.json", "preprocessor_config.json", "model.safetensors"}


def config_of(hub: Hub) -> HubConfig:
    return HubConfig(hub.url, timeout_s=5, retries=2, wait_s=0.01)


def get(hub: Hub) -> Installed:
    config = config_of(hub)
    listing = list_files(TINY, config)
    return run_stage(download(listing, Consent(TINY.name, "Apache-2.0"), config))


def is_untouched(models: Path) -> bool:
    """Whether no model is here, not even half."""
    return find_model(TINY) is None and not (models / TINY.name).exists()


def test_a_download_is_whole_checked_and_locked(hub: Hub, models: Path, repository: Path) -> None:
    done = get(hub)
    assert done.path == models / TINY.name
    files = {path.name for path in done.path.iterdir()}
    assert files == WANTED | {"model.lock.json"}, "safetensors and configs, no code"
    for name in WANTED:
        assert (done.path / name).read_bytes() == (repository / name).read_bytes()
    lock = read_lock(done.path)
    assert (lock.commit, lock.repository, lock.licence) == (COMMIT, TINY.hub, "Apache-2.0")
    assert lock.size == done.n_bytes
    by_name = {file.name: file for file in lock.files}
    weights = (repository / "model.safetensors").read_bytes()
    assert by_name["model.safetensors"].sha256 == hashlib.sha256(weights).hexdigest()
    assert by_name["model.safetensors"].checked == "sha256"
    assert by_name["config.json"].checked == "git"
    assert not (models / ".downloads" / TINY.name).exists()


def test_a_second_get_asks_for_no_file(hub: Hub) -> None:
    get(hub)
    before = hub.downloads()
    assert get(hub).n_bytes == 0
    assert hub.downloads() == before
    assert len(before) == len(set(before)), "nothing came twice"


def test_a_mirror_that_lists_names_only_gives_sizes_and_hashes_of_files(hub: Hub) -> None:
    full = list_files(TINY, config_of(hub))
    hub.only_names = True
    named = list_files(TINY, config_of(hub))
    assert [(f.name, f.size, f.sha256) for f in named.files] == [
        (f.name, f.size, f.sha256) for f in full.files
    ]
    get(hub)


def test_a_listing_downloads_nothing_and_names_files_of_one_folder(
    hub: Hub, models: Path, repository: Path
) -> None:
    (repository / "..config.json").write_text("{}")
    listing = list_files(TINY, config_of(hub))
    assert WANTED <= {file.name for file in listing.files} <= WANTED | {"..config.json"}
    assert not any(set("/\\") & set(file.name) for file in listing.files)
    assert listing.size == sum(file.size for file in listing.files)
    assert hub.downloads() == []
    assert not models.exists()


def test_a_hub_that_ignores_ranges_sends_all_again(hub: Hub, repository: Path) -> None:
    hub.cuts, hub.ignores_range = [100_000], True
    weights = get(hub).path / "model.safetensors"
    assert weights.read_bytes() == (repository / "model.safetensors").read_bytes()
    asked = [line.rpartition("model.safetensors")[2] for line in hub.requests if "/cdn/" in line]
    assert asked == ["", " bytes=100000-"], "the second answer is taken as it is"


def test_a_connection_that_breaks_goes_on_where_it_was(hub: Hub, repository: Path) -> None:
    hub.cuts = [100_000, 50_000]
    done = get(hub)
    assert (done.path / "model.safetensors").read_bytes() == (
        repository / "model.safetensors"
    ).read_bytes()
    asked = [line.rpartition("bytes=")[2] for line in hub.requests if "/cdn/" in line]
    assert [text for text in asked if text.endswith("-")] == ["100000-", "150000-"]
    assert hub.sent == done.n_bytes


def test_a_hub_that_falls_silent_is_asked_again(hub: Hub, repository: Path) -> None:
    hub.stalls = [1.0]
    config = HubConfig(hub.url, timeout_s=0.25, wait_s=0.01)
    stage = download(list_files(TINY, config), Consent(TINY.name, "Apache-2.0"), config)
    steps: list[Progress] = []
    done = run_stage(stage, steps.append)
    assert (done.path / "model.safetensors").read_bytes() == (
        repository / "model.safetensors"
    ).read_bytes()
    assert any("the connection broke" in step.message for step in steps)
    assert any("bytes=16384-" in line for line in hub.requests)
    shares = [step.done for step in steps]
    assert shares == sorted(shares)
    assert shares[-1] == steps[-1].total


def test_a_connection_that_stays_broken_keeps_what_came(hub: Hub, models: Path) -> None:
    hub.cuts = [100_000, 0, 0, 0]
    with pytest.raises(GagaError, match=r"cannot be reached|sends no more"):
        get(hub)
    assert is_untouched(models)
    assert partial_bytes(TINY) > 100_000
    hub.requests.clear()
    get(hub)
    assert [line for line in hub.downloads() if "config.json" in line] == []
    assert any(line.endswith("bytes=100000-") for line in hub.requests)


def test_a_cancel_in_the_middle_leaves_nothing_half_made(hub: Hub, models: Path) -> None:
    hub.pause_s = 0.005
    config = config_of(hub)
    stage = download(list_files(TINY, config), Consent(TINY.name, "Apache-2.0"), config)
    for step in stage:
        if step.done > 400:
            break
    stage.close()
    assert is_untouched(models)
    kept = partial_bytes(TINY)
    assert kept >= 100_000
    hub.sent = 0
    done = get(hub)
    assert find_model(TINY) == done.path
    assert done.n_bytes <= 300_000 + 100 - kept + (1 << 16)
    assert partial_bytes(TINY) == 0


@pytest.mark.parametrize("only_names", [False, True])
def test_other_bytes_than_stated_are_refused_and_deleted(
    hub: Hub, models: Path, only_names: bool
) -> None:
    hub.wrong_hash, hub.only_names = True, only_names
    with pytest.raises(GagaError, match=r"model\.safetensors from 127.* its hash differs"):
        get(hub)
    assert is_untouched(models)
    assert not list(models.rglob("*.safetensors*"))
    hub.wrong_hash = False
    get(hub)


def test_a_disk_that_is_too_small_is_told_before(hub: Hub, models: Path) -> None:
    hub.extra_bytes = 1 << 50
    with pytest.raises(GagaError, match=r"needs .* MB in .* are free there"):
        get(hub)
    assert hub.downloads() == []
    assert is_untouched(models)


def test_a_disk_that_fills_up_is_one_sentence(hub: Hub, models: Path, repository: Path) -> None:
    """What came is continued when there is room.

    The limit on the size of files stands in for the end of the disk: writing fails midway.
    """
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (150000, 150000));"
        "from gaga_core.segmentation.models.download import *;"
        "from gaga_core.segmentation.models.hub import list_files;"
        "from gaga_core.segmentation.models.catalogue import known_model;"
        "from gaga_core.progress import run_stage;"
        f"config = HubConfig({hub.url!r}); model = known_model({TINY.name!r});"
        "stage = download(list_files(model, config), Consent(model.name, 'Apache-2.0'), config)\n"
        "try: run_stage(stage)\n"
        "except GagaError as error: sys.exit(str(error))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "The disk is full" in done.stderr
    assert "Traceback" not in done.stderr
    assert is_untouched(models)
    assert 100_000 < partial_bytes(TINY) < 200_000
    hub.requests.clear()
    weights = get(hub).path / "model.safetensors"
    assert weights.read_bytes() == (repository / "model.safetensors").read_bytes()
    assert [line for line in hub.downloads() if "bytes=" not in line and "/cdn/" in line] == []


def test_a_gated_model_says_what_to_do(
    hub: Hub, models: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hub.gated.add(TINY.hub)
    with pytest.raises(GagaError) as caught:
        get(hub)
    for said in ("gated", TINY.page, "HF_TOKEN", str(models / TINY.name), "--weights"):
        assert said in str(caught.value)
    assert is_untouched(models)
    monkeypatch.setenv("HF_TOKEN", hub.token)
    assert get(hub).path.is_dir()


def test_offline_asks_nothing(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(GagaError, match="set to work offline"):
        list_files(TINY, HubConfig(hub.url, is_offline=True))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with pytest.raises(GagaError, match="HF_HUB_OFFLINE is set"):
        list_files(TINY, config_of(hub))
    assert hub.requests == []


@pytest.mark.parametrize(
    ("status", "said"), [(500, "answered 500"), (403, "answered 403"), (429, "answered 429")]
)
def test_a_hub_with_trouble_is_one_sentence(hub: Hub, status: int, said: str) -> None:
    hub.status = status
    with pytest.raises(GagaError, match=said):
        list_files(TINY, config_of(hub))


def test_what_is_not_on_the_hub_is_named(hub: Hub, repository: Path) -> None:
    with pytest.raises(GagaError, match="does not give facebook/sam-vit-base"):
        list_files(known_model("sam-base"), config_of(hub))
    with pytest.raises(GagaError, match="is gated"):
        list_files(known_model("sam3"), config_of(hub))
    with pytest.raises(GagaError, match="no such revision"):
        list_files(TINY, config_of(hub), revision="v9")
    (repository / "model.safetensors").unlink()
    with pytest.raises(GagaError, match="no safetensors"):
        list_files(TINY, config_of(hub))
    for address in ("ftp://127.0.0.1", "nonsense", "http://"):
        with pytest.raises(GagaError, match="no address of a hub"):
            list_files(TINY, HubConfig(address))
    with pytest.raises(GagaError, match=r"127\.0\.0\.1:9 cannot be reached"):
        list_files(TINY, HubConfig("http://127.0.0.1:9", timeout_s=2))


@pytest.mark.parametrize(
    "answer",
    [
        b"<html>",
        b"{}",
        b'{"sha": "../..", "siblings": []}',
        b'{"sha": 5}',
        b'{"sha": "5c", "siblings": [{"rfilename": "config.json", "size": -1}]}',
    ],
)
def test_an_answer_of_something_else_is_one_sentence(answer: bytes, tmp_path: Path) -> None:
    from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
    from threading import Thread

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Write nothing."""

        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(answer)

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = Thread(target=server.handle_request)
        thread.start()
        with pytest.raises(GagaError, match="is damaged"):
            list_files(TINY, HubConfig(f"http://127.0.0.1:{server.server_address[1]}"))
        thread.join()


def test_consent_for_another_model_counts_nothing(hub: Hub) -> None:
    listing = list_files(TINY, config_of(hub))
    with pytest.raises(ValueError, match="consent"):
        run_stage(download(listing, Consent("sam-base", "Apache-2.0"), config_of(hub)))
    assert hub.downloads() == []


def test_a_lock_asks_for_the_same_files(hub: Hub, repository: Path, tmp_path: Path) -> None:
    lock = read_lock(get(hub).path)
    kept = tmp_path / "model.lock.json"
    kept.write_bytes((find_model(TINY) or tmp_path).joinpath("model.lock.json").read_bytes())
    remove(TINY)
    listing = list_files(TINY, config_of(hub), revision=lock.commit)
    assert check_against(listing, read_lock(kept)).size == lock.size
    (repository / "model.safetensors").write_bytes(b"x" * 300_000)
    changed = list_files(TINY, config_of(hub), revision=lock.commit)
    with pytest.raises(GagaError, match="is not the file of the lock"):
        check_against(changed, lock)
    done = get(hub)
    with pytest.raises(GagaError, match="is not the file of the lock"):
        check_folder(done.path, lock)
    kept.write_text(json.dumps({"format": "other"}))
    with pytest.raises(GagaError):
        read_lock(kept)


def test_remove_deletes_the_folder_of_models_alone(hub: Hub, models: Path, tmp_path: Path) -> None:
    get(hub)
    assert remove(TINY) == models / TINY.name
    assert find_model(TINY) is None
    assert remove(TINY) is None
    cached = tmp_path / "cache" / f"models--{TINY.hub.replace('/', '--')}"
    snapshot = cached / "snapshots" / "abc"
    snapshot.mkdir(parents=True)
    (cached / "refs").mkdir()
    (cached / "refs" / "main").write_text("abc")
    (snapshot / "config.json").write_text("{}")
    (snapshot / "model.safetensors").write_bytes(b"w")
    assert get(hub).path == snapshot, "what other programs have brought is used"
    with pytest.raises(GagaError, match="other programs use too"):
        remove(TINY)
    assert find_model(TINY) == snapshot


def test_a_folder_that_is_no_whole_model_is_never_overwritten(hub: Hub, models: Path) -> None:
    (models / TINY.name).mkdir(parents=True)
    (models / TINY.name / "notes.txt").write_text("mine")
    with pytest.raises(GagaError, match="holds no complete model"):
        get(hub)
    assert (models / TINY.name / "notes.txt").read_text() == "mine"
    (models / TINY.name / "notes.txt").unlink()
    assert get(hub).path == models / TINY.name


def test_two_programs_do_not_get_the_same_at_once(hub: Hub, models: Path) -> None:
    code = (
        "import sys; from gaga_core.io.folder.lock import lock_folder; from pathlib import Path;"
        f"lock_folder(Path({str(models / '.downloads' / f'{TINY.name}.lock')!r}));"
        "print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline().strip() == b"held"
        with pytest.raises(GagaError, match="is downloading or removing"):
            get(hub)
        assert other.stdin is not None
        other.stdin.close()
    get(hub)
