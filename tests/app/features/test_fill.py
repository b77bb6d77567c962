"""Delete and fill in the window: a preview to apply or cancel, and the shadow on request."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event

import numpy as np
import pytest

from gaga_core.color import rgb_from_dc
from gaga_core.progress import Progress, Stage
from gaga_core.scene import edits
from gaga_core.scene.scene import State
from gaga_studio.features import fill, folders, objects, selection
from gaga_studio.features.commands import command, run
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, Request
from gaga_studio.session.session import Session
from gaga_studio.ui.viewport.viewport import preview_badge
from tests.app.looks import finish, snapshot
from tests.core.fill import models
from tests.core.fill.tables import BOX, TABLE, table_project


@pytest.fixture
def at_table(new_session: Callable[[], Session], tmp_path: Path) -> Session:
    """A session in which the box on a table is selected."""
    session = new_session()
    session.document = Document(table_project(tmp_path / "table"))
    selection.select_groups(session, (BOX,))
    return session


def test_preview_switch_and_cancel(at_table: Session) -> None:
    session = at_table
    scene, entries = session.need().scene, session.need().history.cursor
    before = snapshot(scene)
    assert run("object.fill", session)
    finish(session)
    found = fill.shown(session)
    assert found is not None
    assert found.lighten
    assert len(found.splats) > 50
    assert fill.summary(found)[0].endswith(f", {len(found.splats):,} new")
    assert "stays open" not in " ".join(fill.summary(found))
    assert not found.is_refused
    bare = replace(
        found, splats=found.splats.take(np.zeros(0, np.int64)), stained=found.stained[:0]
    )
    assert "What is open now stays open." in " ".join(fill.summary(bare))
    assert "covered already" in " ".join(fill.summary(bare))
    refused = " ".join(fill.summary(replace(bare, is_refused=True)))
    assert "barely visible" in refused
    assert "covered already" not in refused
    assert fill.summary(bare)[-1] == "No shadow was found"
    assert preview_badge(session) == "Preview of Delete and fill"
    assert scene.has(State.DELETED)[found.removed].all(), "the preview is in the picture"
    assert command("object.fill_apply").enabled(session) == ""
    for other in ("object.associate", "file.add_splats", "file.add_scene"):  # they end in an edit
        assert command(other).enabled(session) == (
            "Apply or cancel (Esc) the preview of Delete and fill first."
        )

    run("object.fill_lighten", session)
    finish(session)
    found = fill.shown(session)
    assert found is not None
    assert not found.lighten

    go_on = Event()

    def waiting() -> Stage[None]:
        yield Progress("Wait", 0, 0)
        go_on.wait()

    session.jobs.start("Wait", waiting())
    run("object.fill_lighten", session)
    assert fill.shown(session) is found, "it stays while a job runs"
    assert "still running" in session.notices[-1].text
    go_on.set()
    assert session.jobs.wait()
    run("edit.cancel", session)
    assert fill.shown(session) is None
    assert snapshot(scene) == before
    assert session.need().history.cursor == entries


def test_a_selection_meanwhile_throws_nothing_away(at_table: Session) -> None:
    """A click while the hole was analysed threw its minute away; another edit still does."""
    session = at_table
    before = snapshot(session.need().scene)
    run("object.fill", session)
    run("select.none", session)
    finish(session)
    found = fill.shown(session)
    assert found is not None
    assert run("object.fill_apply", session)
    assert session.need().scene.has(State.DELETED)[found.removed].all()
    for _ in range(2):
        session.undo()
    assert snapshot(session.need().scene) == before
    run("object.fill", session)
    run("object.hide", session)
    finish(session)
    assert fill.shown(session) is None
    assert "changed" in session.notices[-1].text


@pytest.mark.parametrize("act", ["hide", "rename", "copy", "move", "delete", "recolor"])
def test_edits_of_other_objects_meanwhile_cost_nothing_where_the_hole_stays(
    at_table: Session, act: str
) -> None:
    """All went on freely, and at the end of the minute it was to be tried again."""
    session, document = at_table, at_table.need()
    before, (filled,) = snapshot(document.scene), session.selected_groups()
    entries = document.history.cursor
    run("object.fill", session)
    other = next(int(group) for group in session.objects().ids if group not in (0, filled))
    selection.select_groups(session, (other,))
    rows = document.selected()
    if act == "rename":
        assert objects.rename(session, other, "desk")
    elif act == "move":
        moved = np.eye(4)[:3]
        moved[2, 3] = 0.2
        assert document.do(edits.transform(document.scene, rows, moved))
    elif act == "recolor":
        affine = np.eye(4)[:3] * 0.5
        assert document.do(edits.recolor(document.scene, rows, affine, title="Darken"))
    else:
        ids = {"hide": "object.hide", "copy": "edit.duplicate", "delete": "edit.delete"}
        assert run(ids[act], session)
    finish(session)
    found = fill.shown(session)
    assert (found is not None) is (act in ("hide", "rename", "copy"))
    if found is None:
        assert "changed" in session.notices[-1].text
        return
    assert run("object.fill_apply", session)
    gone = np.flatnonzero(document.scene.has(State.DELETED))
    assert gone.tolist() == sorted([*found.removed.tolist(), *found.unseen.tolist()])
    document.go_to(entries)
    assert snapshot(document.scene) == before


def test_an_inpainting_model_colors_the_hole_until_it_is_switched_off(
    at_table: Session, tmp_path: Path
) -> None:
    session = at_table
    run("object.fill", session)
    assert session.jobs.wait()
    shown = fill.shown(session)
    assert command("object.fill_model").enabled(session) == ""
    run("object.fill_model", session)
    assert session.take_request() is Request.INPAINTING_MODEL, "the window asks for the file"

    odd = models.saved(models.Half(), tmp_path / "odd.pt")
    fill.choose_model(session, odd)
    assert session.jobs.wait()
    assert "odd.pt returned" in session.notices[-1].text
    assert fill.shown(session) is shown, "a file that fails changes nothing"
    assert session.settings.inpainting_model == ""

    red = models.saved(models.Red(), tmp_path / "red.pt")
    fill.choose_model(session, red)
    assert session.jobs.wait()
    found = fill.shown(session)
    assert found is not None
    assert found.model == "red.pt"
    assert np.median(rgb_from_dc(found.splats.sh[:, 0]), axis=0) == pytest.approx(
        [1, 0, 0], abs=0.1
    )
    assert session.settings.inpainting_model == str(red)
    assert command("object.fill_model").is_on is not None
    run("edit.confirm", session)
    assert (session.need().history.undo_title or "").endswith(", colors by red.pt")

    red.unlink()
    session.undo()
    run("object.fill", session)
    assert session.jobs.wait()
    assert fill.shown(session) is None
    assert "red.pt is not there" in session.notices[-1].text
    run("object.fill_continue", session)
    assert session.settings.inpainting_model == ""
    run("object.fill", session)
    assert session.jobs.wait()
    found = fill.shown(session)
    assert found is not None
    assert found.model == ""


def test_without_torch_no_model_can_be_chosen(at_table: Session) -> None:
    with models.no_torch():
        assert "needs PyTorch" in command("object.fill_model").enabled(at_table)


def test_what_was_deleted_is_filled_later_in_one_step(at_table: Session) -> None:
    session = at_table
    run("edit.delete", session)
    assert fill.title(session) == "Fill what was deleted"
    scene, entries = session.need().scene, session.need().history.cursor
    n, before = len(scene), snapshot(scene)
    run("object.fill", session)
    finish(session)
    run("edit.confirm", session)
    assert fill.shown(session) is None
    assert session.need().history.cursor == entries + 1
    assert session.need().unsaved
    assert len(scene) > n
    assert (scene.labels[n:] == TABLE).all()
    session.undo()
    assert snapshot(scene) == before


def test_what_lies_under_the_object_goes_with_it(at_table: Session) -> None:
    """As with Delete: nothing that lay under the object stays in the air, and undo brings all."""
    session = at_table
    document = session.need()
    scene, lid = document.scene, 1 + int(document.scene.labels.max())
    rows = np.flatnonzero(scene.labels == BOX)[::4]
    scene.labels[rows] = lid
    scene.revision.labels += 1
    assert folders.put_under(session, BOX, (lid,))
    selection.select_groups(session, (BOX,))
    before = snapshot(scene)
    run("object.fill", session)
    finish(session)
    found = fill.shown(session)
    assert found is not None
    assert set(rows) <= set(found.removed.tolist())
    run("edit.confirm", session)
    assert scene.has(State.DELETED)[rows].all()
    assert (document.history.undo_title or "").endswith(" and 1 under it")
    session.undo()
    assert snapshot(scene) == before


def test_it_says_when_there_is_nothing_to_fill(at_table: Session) -> None:
    """Also of what was deleted before: then there is no edit that could be shown."""
    session = at_table
    selection.select_all(session)
    run("edit.delete", session)
    assert fill.title(session) == "Fill what was deleted"
    run("object.fill", session)
    finish(session)
    assert fill.shown(session) is None
    assert "nothing to fill: the place is covered already" in session.notices[-1].text
    assert session.notices[-1].level is Level.HINT, "nothing was done"
    assert session.notices[-1].command == "", "it is deleted"
    session.undo()
    selection.select_all(session)
    run("object.fill", session)
    finish(session)
    assert fill.shown(session) is None
    assert session.notices[-1].command == "edit.delete"


def test_it_says_what_it_needs(new_session: Callable[[], Session], at_table: Session) -> None:
    assert "No scene" in command("object.fill").enabled(new_session())
    selection.select_none(at_table)
    assert "nothing was deleted" in command("object.fill").enabled(at_table)
    assert "no fill preview" in command("object.fill_apply").enabled(at_table)
