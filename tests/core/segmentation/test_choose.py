"""Providers by name, the list of them, and where weights are looked for."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.progress import run_stage
from gaga_core.segmentation import choose
from gaga_core.segmentation.base import Picture
from gaga_core.segmentation.choose import (
    ProviderSettings,
    available_providers,
    provider_named,
)
from gaga_core.segmentation.models.catalogue import KNOWN
from gaga_core.segmentation.models.weights import (
    find_weights,
    models_folder,
    weights_at,
    where_to_put,
)
from gaga_core.segmentation.regions import RegionsConfig

Folder = Callable[[str], Path]


@pytest.fixture
def models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of models."""
    folder = tmp_path / "models"
    folder.mkdir()
    monkeypatch.setenv("GAGA_MODELS", str(folder))
    return folder


def _entry(name: str) -> choose.ProviderEntry:
    return next(entry for entry in available_providers() if entry.name == name)


def test_what_is_missing_is_told_with_size_licence_and_place(models: Path) -> None:
    for model in KNOWN:
        entry = _entry(model.name)
        assert not entry.is_available
        for said in (str(models / model.name), f"{model.megabytes} MB", model.licence, model.page):
            assert said in entry.reason
        with pytest.raises(GagaError, match=model.title.replace("(", ".").replace(")", ".")):
            provider_named(model.name)
    assert _entry("regions").is_available
    assert "sam_vit_h_4b8939.pth" in _entry("sam-huge").reason
    assert len({model.name for model in KNOWN}) == len(KNOWN)


def test_weights_are_found_in_the_folder_of_models(models: Path, model_folder: Folder) -> None:
    (models / "sam2.1-tiny").symlink_to(model_folder("sam2"))
    (models / "sam-vit-base").symlink_to(model_folder("sam"))  # as its repository is called
    (models / "my-segmenter").symlink_to(model_folder("mask2former"))
    (models / "notes").mkdir()
    (models / "sam_vit_h_4b8939.pth").write_bytes(b"weights")
    for name in ("sam2.1-tiny", "sam-base", "sam-huge", "my-segmenter"):
        assert _entry(name).is_available
        assert _entry(name).path is not None
    assert "notes" not in {entry.name for entry in available_providers()}
    provider = provider_named("sam2.1-tiny")
    assert provider.name == "sam2.1-tiny"
    assert provider.card.licence == "Apache-2.0"
    assert provider.card.source == str(models / "sam2.1-tiny")
    assert provider_named("my-segmenter").name == "my-segmenter"


def test_given_weights_win_over_those_of_the_name(models: Path, model_folder: Folder) -> None:
    (models / "sam2.1-tiny").symlink_to(model_folder("sam2"))
    for name in ("sam2.1-tiny", "fine masks"):
        provider = provider_named(name, weights=model_folder("sam"))
        assert (provider.name, provider.card.source) == (name, str(model_folder("sam")))


def test_regions_need_no_model_and_their_settings_change_the_fingerprint() -> None:
    provider = provider_named("regions", settings=ProviderSettings(RegionsConfig(width=64)))
    image = np.zeros((48, 64, 3), np.uint8)
    image[:, 32:] = (200, 40, 40)
    labels = run_stage(provider.label_map(Picture(image)))
    assert labels.shape == (48, 64)
    assert labels[20, 5] != labels[20, 60]
    other = ProviderSettings(RegionsConfig(width=64, detail=2.0))
    assert provider_named("regions", settings=other).fingerprint() != provider.fingerprint()


def test_the_folder_of_models_follows_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("GAGA_MODELS", raising=False)
    monkeypatch.setenv("GAGA_HOME", str(tmp_path))
    assert models_folder() == tmp_path / "models"
    assert str(tmp_path) in where_to_put(KNOWN[0])


def test_weights_are_found_in_the_hub_cache(
    models: Path, model_folder: Folder, tmp_path: Path
) -> None:
    known = KNOWN[0]
    assert find_weights(known, tmp_path) is None
    repository = tmp_path / f"models--{known.hub.replace('/', '--')}"
    (repository / "refs").mkdir(parents=True)
    (repository / "refs" / "main").write_text("abc123")
    snapshot = repository / "snapshots" / "abc123"
    snapshot.mkdir(parents=True)
    (snapshot / "config.json").write_text(json.dumps({"model_type": "sam2"}))
    assert find_weights(known, tmp_path) is None  # begun, never finished
    (snapshot / "model.safetensors").write_bytes(b"weights")
    found = find_weights(known, tmp_path)
    assert found is not None
    assert found.path == snapshot
    (models / known.name).symlink_to(model_folder("sam2"))
    nearer = find_weights(known, tmp_path)
    assert nearer is not None
    assert nearer.path == models / known.name


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "does not exist"),
        ({}, "is no folder of a model"),
        ({"config.json": '{"model_type": "sam2"}'}, "needs config.json and model.safetensors"),
        ({"config.json": '{"model_type": "bert"}', "model.safetensors": ""}, "type bert"),
        ({"config.json": "{", "model.safetensors": ""}, "type unknown"),
        ({"config.json": "[]", "pytorch_model.bin": ""}, "type unknown"),
    ],
)
def test_paths_without_a_model_are_named(
    content: dict[str, str] | None, said: str, tmp_path: Path
) -> None:
    folder = tmp_path / "weights"
    if content is not None:
        folder.mkdir()
        for name, text in content.items():
            (folder / name).write_text(text)
    with pytest.raises(GagaError, match=said):
        weights_at(folder)
    (tmp_path / "a.txt").write_text("")
    with pytest.raises(GagaError, match="is no checkpoint"):
        weights_at(tmp_path / "a.txt")


@pytest.mark.parametrize("name", ["", "../x", ".hidden", "a/b", "c:d"])
def test_names_are_folder_names(name: str, model_folder: Folder) -> None:
    with pytest.raises(GagaError, match="cannot be the name"):
        provider_named(name, weights=model_folder("sam"))


def test_an_unknown_name_lists_the_known(models: Path) -> None:
    with pytest.raises(GagaError, match=r"nonsense.*regions, sam2\.1-tiny"):
        provider_named("nonsense")
    with pytest.raises(GagaError, match="takes no weights"):
        provider_named("regions", weights=models)


def test_without_transformers_only_regions_work(
    models: Path, model_folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    (models / "sam2.1-tiny").symlink_to(model_folder("sam2"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "pip install" in _entry("sam2.1-tiny").reason
    with pytest.raises(GagaError, match="pip install"):
        provider_named("sam2.1-tiny")
    assert provider_named("regions").cues == {"depth"}


def test_the_list_imports_no_torch(models: Path) -> None:
    code = (
        "import sys; from gaga_core.segmentation.choose import available_providers;"
        "available_providers(); print([m for m in ('torch', 'transformers') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
