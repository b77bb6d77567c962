"""Photos and masks that came later join the objects in the window; what a person did stays."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_studio.features import commands, folders
from gaga_studio.features import objects as objects_actions
from gaga_studio.features.find import association, memory_bank
from gaga_studio.session.session import Session
from tests.app.looks import finish, scene_of, snapshot


@pytest.fixture(params=["paper", "robust"])
def grown(
    request: pytest.FixtureRequest, new_session: Callable[[], Session], scene_folder: Path
) -> tuple[Session, tuple[str, ...]]:
    """Objects found in all views but the last two, whose masks came later, and these views."""
    late = open_scene_folder(scene_folder).train[-2:]
    masks = next(iter(open_scene_folder(scene_folder).mask_folders.values()))
    kept = {name: (masks / name).read_bytes() for name in late}
    for name in late:
        (masks / name).unlink()
    session = new_session()
    session.open(scene_folder)
    finish(session)
    association.associate(session, preset=request.param)
    finish(session)
    assert "took part already" in commands.command("object.add_views").enabled(session)
    for name, content in kept.items():
        (masks / name).write_bytes(content)
    return session, late


def test_masks_that_came_later_join_and_corrections_stay(
    grown: tuple[Session, tuple[str, ...]],
) -> None:
    session, late = grown
    scene = scene_of(session)
    assert commands.command("object.add_views").enabled(session) == ""
    assert memory_bank.new_views(session) == late
    ids = [int(g) for g in session.objects().ids if g > 0]
    assert objects_actions.rename(session, ids[0], "kettle")
    assert folders.put_in(session, "Kitchen", (ids[0],))
    assert folders.put_under(session, ids[0], (ids[1],))
    assert objects_actions.set_color(session, ids[1], (1, 0, 0))
    decision = session.decisions(ids[2])[-1]
    assert memory_bank.move_mask(session, decision, ids[3])
    finish(session)
    assert scene.bank is not None
    before, log, order = snapshot(scene), list(scene.bank.log), scene.folders
    labels = scene.labels.copy()
    assert memory_bank.add_views(session)
    finish(session)
    assert (scene.names[ids[0]], scene.colors[ids[1]]) == ("kettle", (1, 0, 0))
    assert scene.folders == order
    assert list(scene.bank.log[: len(log)]) == log, "with the mask that was moved by hand"
    assert {d.view for d in scene.bank.log[len(log) :]} == set(late)
    assert (scene.labels == labels).mean() > 0.9
    assert "joined the objects" in session.notices[-1].text
    assert "took part already" in commands.command("object.add_views").enabled(session)
    session.undo()
    assert snapshot(scene) == before
    assert np.array_equal(scene.labels, labels)


def test_a_cancel_leaves_the_objects(grown: tuple[Session, tuple[str, ...]]) -> None:
    session, late = grown
    before = snapshot(scene_of(session))
    assert memory_bank.add_views(session)
    session.jobs.cancel()
    session.jobs.wait()
    assert snapshot(scene_of(session)) == before
    assert memory_bank.new_views(session) == late
    assert session.live is None
    assert memory_bank.text_on_bare_photos(session) == ""
    assert session.project is not None
    assert session.project.folder is not None
    masks = session.project.folder.mask_folders[session.provider]
    next(file for file in masks.iterdir() if file.stem == Path(late[0]).stem).unlink()
    assert memory_bank.text_on_bare_photos(session) == "1 photo has no masks yet: use Make masks."
