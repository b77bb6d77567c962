"""The tree of a large scene in a session: offered, built, taken when it is opened again."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline.level_of_detail import is_of, rows_of_files
from gaga_core.scene import edits
from gaga_core.scene.lod import edited
from gaga_core.scene.lod.edited import node_facts
from gaga_core.scene.lod.tree import level_file
from gaga_core.scene.project import save_project
from gaga_studio.features import commands, files, level_of_detail
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
    assert again.need().tree is not None
    assert not [notice for notice in again.notices if notice.command]


def test_small_scenes_have_no_tree(new_session: Callable[[], Session], large: Path) -> None:
    session = opened(new_session, large)
    commands.run(level_of_detail.COMMAND, session)
    assert session.jobs.wait()
    assert level_of_detail.tree_of(session) is not None
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


def test_files_that_are_added_get_a_tree_with_the_model(
    new_session: Callable[[], Session], large: Path, tmp_path: Path
) -> None:
    session = opened(new_session, large)
    document = session.need()
    commands.run(level_of_detail.COMMAND, session)
    assert session.jobs.wait()
    alone = level_of_detail.tree_of(session)
    assert alone is not None
    document.do(edits.duplicate(document.scene, np.arange(50)))  # rows behind all files
    document.undo()
    write_ply(tmp_path / "chair.ply", random_gaussians(4_000, seed=5))
    files.add_splats(session, tmp_path / "chair.ply")
    assert session.jobs.wait()
    assert "4,000 splats of added files" in session.notices[-1].text
    assert level_of_detail.tree_of(session) is alone  # the others are drawn as they are
    assert commands.run(level_of_detail.COMMAND, session)
    assert session.jobs.wait()
    both = level_of_detail.tree_of(session)
    assert both is not None
    assert len(both) == rows_of_files(document.scene) == N + 4_000
    assert not commands.run(level_of_detail.COMMAND, session)  # it is there
    document.undo()
    assert level_of_detail.tree_of(session) is alone
    document.do(edits.duplicate(document.scene, np.arange(4_000)))
    assert level_of_detail.tree_of(session) is alone  # as many rows, and others
    document.undo()
    files.add_splats(session, tmp_path / "chair.ply")
    assert session.jobs.wait()
    assert level_of_detail.tree_of(session) is both
    again = opened(new_session, save_project(document.settled(), tmp_path / "two.gaga"))
    tree = level_of_detail.tree_of(again)
    assert tree is not None
    assert len(tree) == N + 4_000
    assert is_of(tree, again.need().project)


def test_rows_of_files_end_at_copies(new_session: Callable[[], Session], large: Path) -> None:
    session = opened(new_session, large)
    document = session.need()
    document.do(edits.duplicate(document.scene, np.arange(10)))
    files.add_splats(session, large)
    assert session.jobs.wait()
    assert len(document.scene) == 2 * N + 10
    assert rows_of_files(document.scene) == N


def test_boxes_for_clicks_are_looked_up_by_the_thread_of_the_mouse(
    new_session: Callable[[], Session], large: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = opened(new_session, large)
    document = session.need()
    commands.run(level_of_detail.COMMAND, session)
    assert session.jobs.wait()
    who: list[threading.Thread] = []
    look = node_facts

    def noted(*given: Any) -> Any:
        who.append(threading.current_thread())
        return look(*given)

    monkeypatch.setattr(edited, "node_facts", noted)
    up = np.eye(3, 4)
    up[2, 3] = 0.1
    document.do(edits.transform(document.scene, np.arange(N // 2), up))
    who.clear()
    end = time.monotonic() + 10
    while not who and time.monotonic() < end:
        session.hover(20.5, 20.5, 40, 40)
        session.tick(0.01)
        time.sleep(0.01)
    assert who
    assert threading.main_thread() not in who
