"""A small scene folder that is made once, and sessions that are shut down."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gaga_core.pipeline.reconstruct import reconstruct_scene
from gaga_core.pipeline.settings import IdentitySettings, ReconstructConfig
from gaga_core.progress import run_stage
from gaga_studio.features import commands
from gaga_studio.features.find import association
from gaga_studio.features.find.association import FindState
from gaga_studio.session import rates
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from tests.app.folders import write_scene
from tests.core.placing.photo_scenes import write_photos
from tests.made import made_once


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What else runs on the machine changes no time that is told."""
    monkeypatch.setattr(rates, "_STAT", tmp_path / "no stat")


@pytest.fixture(scope="session")
def made_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder as made; tests work on copies."""
    return made_once(tmp_path_factory, "scene", lambda root: write_scene(root / "table")) / "table"


@pytest.fixture
def scene_folder(made_scene: Path, tmp_path: Path) -> Path:
    """A copy of the scene folder that a test may write to."""
    folder = tmp_path / "table"
    shutil.copytree(made_scene, folder)
    return folder


@pytest.fixture(scope="session")
def placed_photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder of six photos of a room with their places, and no splats; tests copy it."""

    def make(root: Path) -> None:
        write_photos(root / "room" / "images", 6)
        config = ReconstructConfig(only="sfm", max_side=96)
        run_stage(reconstruct_scene(None, root / "room", config))

    return made_once(tmp_path_factory, "placed", make) / "room"


@pytest.fixture
def new_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Session]]:
    """Makes sessions, with a home of their own, and ends their threads."""
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")  # no test asks the real hub
    made: list[Session] = []

    def make() -> Session:
        made.append(commands.new_session(Settings(preset="paper", identities="none")))
        made[-1].feature(FindState).identities = IdentitySettings(12)
        return made[-1]

    yield make
    for session in made:
        session.shut_down()


@pytest.fixture
def session(new_session: Callable[[], Session], scene_folder: Path) -> Session:
    """A session with the small scene open, not associated."""
    made = new_session()
    made.open(scene_folder)
    assert made.jobs.wait()
    assert made.scene is not None, made.notices
    return made


@pytest.fixture(scope="session")
def grouped_scene(made_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene folder with a saved project in which the masks are associated."""

    def make(root: Path) -> None:
        shutil.copytree(made_scene, root / "table")
        made = commands.new_session(Settings(preset="paper", identities="none"))
        made.open(root / "table")
        assert made.jobs.wait()
        association.associate(made)
        assert made.jobs.wait()
        made.save()
        assert made.jobs.wait()
        made.shut_down()

    # Of this process alone: windows open it as it is.
    folder = tmp_path_factory.mktemp("grouped") / "table"
    shutil.copytree(made_once(tmp_path_factory, "grouped", make) / "table", folder)
    return folder


@pytest.fixture
def grouped_copy(grouped_scene: Path, tmp_path: Path) -> Path:
    """A copy of that folder that a test may write to."""
    folder = tmp_path / "grouped"
    shutil.copytree(grouped_scene, folder)
    return folder


@pytest.fixture
def associated(new_session: Callable[[], Session], grouped_copy: Path) -> Session:
    """A session with the small scene open and its objects found."""
    made = new_session()
    made.open(grouped_copy)
    assert made.jobs.wait()
    assert made.scene is not None, made.notices
    return made
