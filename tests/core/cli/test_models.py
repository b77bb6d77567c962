"""``gaga models``: nothing comes without consent, and what comes is used by ``gaga masks``."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from gaga_core.cli.main import main
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.segmentation.models.catalogue import CATALOGUE, known_model
from gaga_core.segmentation.models.download import read_lock
from tests.app.folders import write_scene
from tests.core.cli.calls import answer, refusal
from tests.core.segmentation.models.hub_server import COMMIT, Hub, fresh_models, serve

Capture = pytest.CaptureFixture[str]
TINY = known_model("sam2.1-tiny")
_ACCEPT = ("--accept-licence", TINY.name)


@pytest.fixture(scope="module")
def repository(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny random SAM 2 as a repository."""
    pytest.importorskip("transformers", reason="transformers is not installed")
    from tests.core.segmentation.tiny_models import save_tiny

    folder = tmp_path_factory.mktemp("hub") / "sam2"
    save_tiny("sam2", folder)
    return folder


@pytest.fixture
def models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of models."""
    return fresh_models(tmp_path, monkeypatch)


@pytest.fixture
def hub(repository: Path, models: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    """A hub that has SAM 2.1 tiny, at HF_ENDPOINT."""
    with serve(Hub({TINY.hub: repository})) as served:
        monkeypatch.setenv("HF_ENDPOINT", served.url)
        yield served


def test_without_consent_nothing_comes_and_the_status_is_2(
    hub: Hub, models: Path, capsys: Capture
) -> None:
    for given in ((), ("--accept-licence", "MIT"), ("--accept-licence", "sam-base")):
        assert main(["models", "get", TINY.name, *given]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        for said in ("Apache-2.0", " MB", TINY.page, f"--accept-licence {TINY.name}"):
            assert said in captured.err
    hub.status = 500  # the size is then that of the catalogue
    assert main(["models", "get", TINY.name]) == 2
    assert "about 156 MB" in capsys.readouterr().err
    assert hub.downloads() == []
    assert not models.exists()


def test_a_licence_that_is_not_the_known_one_must_be_accepted_itself(
    hub: Hub, capsys: Capture
) -> None:
    hub.licences[TINY.hub] = "cc-by-nc-4.0"
    assert main(["models", "get", TINY.name, "--accept-licence", "Apache-2.0"]) == 2
    assert "cc-by-nc-4.0" in capsys.readouterr().err
    found = answer(capsys, "models", "get", TINY.name, "--accept-licence", "CC-BY-NC-4.0")
    assert read_lock(Path(found["models"][0]["path"])).licence == "cc-by-nc-4.0"  # type: ignore[index]


def test_from_get_to_masks(hub: Hub, models: Path, tmp_path: Path, capsys: Capture) -> None:
    found = answer(capsys, "models", "get", TINY.name, *_ACCEPT)
    assert found["models"][0]["commit"] == COMMIT  # type: ignore[index]
    assert answer(capsys, "models", "where", TINY.name)["models"] == {
        TINY.name: str(models / TINY.name)
    }
    scene = tmp_path / "scene"
    write_scene(scene, masks=False)
    view = open_scene_folder(scene).train[0]
    arguments = ("masks", str(scene), "--provider", TINY.name, "--points-per-side", "2")
    report = answer(capsys, *arguments, "--views", view)
    assert report["views_made"] == 1
    rows = {row["name"]: row for row in answer(capsys, "models", "list")["models"]}  # type: ignore[attr-defined]
    assert rows.keys() == {model.name for model in CATALOGUE}
    row = rows[TINY.name]
    assert row["is_here"]
    assert row["is_measured"]
    assert 0 < row["seconds_a_photo"] < 600
    assert not rows["sam-huge"]["is_here"]
    n = len(hub.downloads())
    assert answer(capsys, "models", "get", TINY.name)["models"][0]["downloaded_bytes"] == 0  # type: ignore[index]
    assert len(hub.downloads()) == n
    assert answer(capsys, "models", "remove", TINY.name)["removed"] == {
        TINY.name: str(models / TINY.name)
    }
    assert not (models / TINY.name).exists()


def test_a_lock_file_asks_for_its_commit(
    hub: Hub, models: Path, tmp_path: Path, capsys: Capture
) -> None:
    answer(capsys, "models", "get", TINY.name, *_ACCEPT)
    lock = tmp_path / "model.lock.json"
    lock.write_bytes((models / TINY.name / "model.lock.json").read_bytes())
    answer(capsys, "models", "get", TINY.name, "--lock", str(lock))
    assert main(["models", "remove", TINY.name]) == 0
    hub.requests.clear()
    assert answer(capsys, "models", "get", "--lock", str(lock), *_ACCEPT)["models"]
    assert any(f"/revision/{COMMIT}" in line for line in hub.requests)
    content = json.loads(lock.read_text())
    content["files"][-1]["sha256"] = "0" * 64
    lock.write_text(json.dumps(content))
    assert "is not the file of the lock" in refusal(
        capsys, "models", "get", TINY.name, "--lock", str(lock)
    )


def test_offline_and_gated_are_sentences(hub: Hub, capsys: Capture) -> None:
    offline = refusal(capsys, "models", "get", TINY.name, *_ACCEPT, "--offline")
    assert "offline" in offline
    assert hub.requests == []
    hub.gated.add(TINY.hub)
    assert "is gated" in refusal(capsys, "models", "get", TINY.name, *_ACCEPT)
    assert "no known model" in refusal(capsys, "models", "get", "nonsense")
    assert "is not here" in refusal(capsys, "models", "where", TINY.name)
