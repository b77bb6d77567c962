"""The small scene, looked at for clicks: once, because that takes seconds."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene.project import open_path_stage
from gaga_core.scene.selection.click import ClickGraph, click_graph_stage, click_views
from gaga_studio.features.commands import run
from gaga_studio.features.find.click_object import ClickState, key_of
from gaga_studio.session.session import Session
from tests.app import told
from tests.shares import falls


@pytest.fixture(autouse=True)
def no_share_falls() -> Iterator[None]:
    """Whatever runs here: each job tells one share of all its steps, and it never goes back."""
    with told.by_job() as heard:
        yield
    assert [found for said in heard.values() for found in falls(said)] == []


@pytest.fixture(scope="session")
def graph(made_scene: Path) -> ClickGraph:
    """What clicks choose among."""
    project = run_stage(open_path_stage(made_scene))
    assert project.folder is not None
    views = click_views(project.folder.cameras, project.scene.gaussians.means)
    return run_stage(click_graph_stage(project.scene, views, choose("cpu")))


@pytest.fixture
def looked(session: Session, graph: ClickGraph) -> Session:
    """A session with the tool Object, and the scene looked at."""
    document = session.need()
    document.feature(ClickState).take(graph, key_of(document.scene))
    assert run("tool.object", session)
    assert session.jobs.running is None
    return session
