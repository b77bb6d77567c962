"""A hub with one small repository, and an empty folder of models."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gaga_core.segmentation.models.catalogue import known_model
from tests.core.segmentation.models.hub_server import Hub, fresh_models, serve

TINY = known_model("sam2.1-tiny")


@pytest.fixture(autouse=True)
def models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of models; no cache, token or switch of the person who runs the tests."""
    return fresh_models(tmp_path, monkeypatch)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """Files of a model as repositories have them: weights of 300 KB, and some not wanted."""
    folder = tmp_path / "repository"
    folder.mkdir()
    (folder / "config.json").write_text(json.dumps({"model_type": "sam2"}))
    (folder / "preprocessor_config.json").write_text("{}")
    weights = np.random.default_rng(0).integers(0, 256, 300_000, np.uint8)
    (folder / "model.safetensors").write_bytes(weights.tobytes())
    (folder / "pytorch_model.bin").write_bytes(b"code")
    (folder / "README.md").write_text("A model.")
    (folder / "run.py").write_text("print('code')")
    return folder


@pytest.fixture
def hub(repository: Path) -> Iterator[Hub]:
    """A hub that has SAM 2.1 tiny."""
    with serve(Hub({TINY.hub: repository})) as served:
        yield served
