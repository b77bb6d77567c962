"""The tree of a large scene in a session: offered, built, taken when it is opened again."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gaga_core.io.ply import write_ply
from gaga_core.scene.lod.tree import level_file
from gaga_studio import commands
from gaga_studio.session import level_of_detail
from gaga_studio.session.session import Session
from tests.scenes import random_gaussians

N = 9_000


@pytest.fixture
def large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file that counts as large."""
    monkeypatch.setattr(level_of_detail, "LARGE", N - 1)
    path = tmp_path / "hall.ply"
    write_ply(path, random_gaussians(N))
    return path


def opened(make: Callable[[], Session], path: Path) -> Session:
    session = make()
    session.open(path)
    assert session.jobs.wait()
    return session


def test_tree_is_offered_built_and_taken(new_session: Callable[[], Session], large: Path) -> None:
    session = opened(new_session, large)
    assert session.notices[-1].command == level_of_detail.COMMAND
    assert level_of_detail.tree_of(session) is None
    assert "first" in commands.command("view.lod").enabled(session)
    assert commands.run(level_of_detail.COMMAND, session)
    assert session.jobs.wait()
    tree = level_of_detail.tree_of(session)
    assert tree is not None
    assert len(tree) == N
    assert not commands.run(level_of_detail.COMMAND, session)  # it is there
    assert commands.run("view.lod", session)
    assert level_of_detail.tree_of(session) is None  # switched off
    again = opened(new_session, large)
    assert again.document is not None
    assert again.document.lod is not None
    assert not [notice for notice in again.notices if notice.command]


def test_small_scenes_have_no_tree(new_session: Callable[[], Session], large: Path) -> None:
    session = opened(new_session, large)
    session.document.lod = object()  # type: ignore[union-attr]
    level_of_detail.LARGE = N
    assert level_of_detail.tree_of(session) is None
    assert "drawn whole" in commands.command("view.lod").enabled(session)
    assert "drawn whole" in commands.command(level_of_detail.COMMAND).enabled(session)


def test_damaged_tree_is_told_and_can_be_built_again(
    new_session: Callable[[], Session], large: Path
) -> None:
    session = opened(new_session, large)
    commands.run(level_of_detail.COMMAND, session)
    assert session.jobs.wait()
    tree = level_of_detail.tree_of(session)
    assert tree is not None
    (tree.folder / level_file(1)).write_bytes(b"")
    again = opened(new_session, large)
    assert "truncated" in again.notices[-1].text
    assert commands.run(level_of_detail.COMMAND, again)
    assert again.jobs.wait()
    assert level_of_detail.tree_of(again) is not None
