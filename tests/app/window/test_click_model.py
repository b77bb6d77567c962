"""The tool Object with a model, by mouse: chosen in the tool's row, asked at a click."""

from pathlib import Path

import numpy as np
import pytest

from gaga_studio.features.find.click_object import ClickState
from gaga_studio.features.find.masks import ModelsState
from gaga_studio.session.settings import Settings
from tests.app.window.driver import Driver, drive
from tests.color_oracle import ColorOracle
from tests.core.models.hub_server import fresh_models
from tests.scenes import objects_scene

pytestmark = pytest.mark.window
_TINY = "sam2.1-tiny"


def test_a_click_asks_the_model_that_is_chosen(
    display: str, scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = fresh_models(tmp_path, monkeypatch) / _TINY
    folder.mkdir(parents=True)
    (folder / "config.json").write_text('{"model_type": "sam2"}')
    (folder / "model.safetensors").write_bytes(bytes(8))
    angle = 2 * np.pi / 5
    ball = 0.9 * np.array([np.cos(angle), np.sin(angle), 0.0])

    def walk(d: Driver) -> None:
        d.session.feature(ModelsState).prompters[_TINY] = ColorOracle(
            objects_scene(5, 220, n_cameras=8)
        )
        d.click("**/###Select an object by clicks")
        d.settle()
        scene = d.session.need().scene
        d.click_picture(*d.project(ball))
        assert not d.session.need().feature(ClickState).is_asking  # as the settings say
        d.click("**/###Model of the clicks")
        d.click("**/###SAM 2.1 Hiera tiny")
        d.settle()
        entries = [entry.title for entry in d.session.need().history.entries()]
        assert entries == ["Click an object", "Ask SAM 2.1 Hiera tiny"]
        assert d.session.settings.click_model == _TINY
        away = scene.gaussians.means[d.session.selected_indices()] - ball
        assert (np.linalg.norm(away, axis=1) < 0.4).mean() > 0.9

    settings = Settings(first_steps_done=True, click_model="none")
    drive(walk, path=scene_folder, size=(1100, 600), settings=settings)
