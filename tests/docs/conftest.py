"""A small scene folder, associated, that pages and examples run on."""

import shutil
from pathlib import Path

import pytest

from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.pipeline.associate import associate_scene
from gaga_core.progress import run_stage
from tests.app.folders import write_scene


@pytest.fixture(scope="session")
def associated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three balls on a floor, with masks and groups. Not to be written to: see `workplace`."""
    root = tmp_path_factory.mktemp("docs") / "SCENE"
    write_scene(root, n_objects=3)
    run_stage(associate_scene(open_scene_folder(root)))
    return root


@pytest.fixture
def workplace(associated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with a copy of the scene as SCENE."""
    shutil.copytree(associated, tmp_path / "SCENE")
    monkeypatch.chdir(tmp_path)
    return tmp_path
