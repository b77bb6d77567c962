"""The sheet of models, by mouse: terms, consent, progress, here, removed."""

from dataclasses import replace
from pathlib import Path

import pytest

from gaga_core.segmentation.models.catalogue import known_model
from gaga_studio.features.find.masks import ModelsState
from tests.app.window.driver import Driver, drive
from tests.core.models.hub_server import Hub, fresh_models, serve

pytestmark = pytest.mark.window
TINY = known_model("sam2.1-tiny")


def test_get_asks_downloads_and_remove_asks(
    display: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = fresh_models(tmp_path, monkeypatch)
    repository = tmp_path / "repository"
    repository.mkdir()
    (repository / "config.json").write_text('{"model_type": "sam2"}')
    (repository / "model.safetensors").write_bytes(bytes(100_000))

    def walk(d: Driver) -> None:
        d.session.change_settings(replace(d.session.settings, hub_mirror=hub.url))
        d.menu("Find/###Models…")
        d.click(f"**/{TINY.name}/###Get")
        d.until(lambda: d.session.feature(ModelsState).offered is not None, "the terms are there")
        d.frames(3)
        assert hub.downloads() == []
        d.click("**/###Accept")
        d.until((folder / TINY.name / "model.lock.json").is_file, "it is here")
        d.settle()
        d.click(f"**/{TINY.name}/###Remove")
        assert (folder / TINY.name).is_dir()
        d.click("**/###Delete")
        d.until(lambda: not (folder / TINY.name).exists(), "it is gone")
        d.click("Models/###Close")

    with serve(Hub({TINY.hub: repository})) as hub:
        drive(walk)
