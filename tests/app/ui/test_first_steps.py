"""The card of five steps: each ticks itself, and it stands where it covers nothing."""

import itertools
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.folder.scene_folder import find_model
from gaga_core.scene import edits
from gaga_studio.features import export, objects, selection, transform
from gaga_studio.features.commands import run
from gaga_studio.features.find import association
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings, load_settings
from gaga_studio.session.view import TrainingPreview
from gaga_studio.ui.dialogs.first_steps import _HIGH, STEPS, FirstSteps, place
from gaga_studio.ui.kit.picture_area import PictureArea
from tests.app.looks import finish
from tests.app.window.driver import Driver, drive


def test_each_step_ticks_itself_when_it_is_done(session: Session, tmp_path: Path) -> None:
    progress, none = FirstSteps(), FirstSteps()
    assert none.next == 1
    seen = []

    def look() -> None:
        progress.follow(session)
        seen.append(progress.next)

    look()
    association.associate(session)
    finish(session)
    look()
    selection.select_groups(session, (1,))
    look()
    selection.select_groups(session, (2,))
    look()  # to select is no change
    objects.hide(session)
    look()
    export.export(session, "scene", tmp_path / "out.ply")
    finish(session)
    look()
    assert seen == [2, 3, 4, 4, 5, 0]
    session.undo()
    look()
    assert progress.done == {name for name, _ in STEPS}, "what was done stays done"


@pytest.mark.parametrize("n_done", [1, 3, 5])
def test_what_was_done_is_done_after_a_restart(
    new_session: Callable[[], Session], associated: Session, tmp_path: Path, n_done: int
) -> None:
    """All five were done, and the next start stood at "Click an object"."""
    acts = (
        lambda: None,
        lambda: selection.select_groups(associated, (1,)),
        lambda: objects.hide(associated),
        lambda: export.export(associated, "scene", tmp_path / "out.ply"),
    )
    progress = FirstSteps()
    for act in acts[: max(n_done - 1, 1)]:
        act()
        finish(associated)
        progress.follow(associated)
    later, again = new_session(), FirstSteps()
    later.settings = load_settings()[0]
    assert not later.settings.first_steps_done
    again.follow(later)
    assert (again.done, again.next) == (progress.done, progress.next)
    assert later.settings.first_steps_done is (n_done == len(STEPS))
    later.change_settings(replace(later.settings, first_steps_done=False))  # from the menu Help
    again.follow(later)
    assert not later.settings.first_steps_done


def test_what_was_selected_when_it_was_saved_was_not_clicked(associated: Session) -> None:
    selection.select_groups(associated, (1,))
    progress = FirstSteps()
    progress.follow(associated)
    progress.follow(associated)
    assert "click" not in progress.done
    selection.select_none(associated)
    progress.follow(associated)
    selection.select_groups(associated, (1,))
    progress.follow(associated)
    assert "click" in progress.done


def test_a_preview_ticks_nothing_before_it_is_applied(session: Session) -> None:
    """That of *Add a scene* brought objects, and they were said to be found."""
    progress, scene = FirstSteps(), session.need().scene
    progress.follow(session)
    rows = np.arange(40, dtype=np.int32)
    changed = edits.set_labels(scene, rows, 1), edits.select(scene, rows), edits.hide(scene, rows)
    shown = edits.together("Add", changed)
    assert shown is not None
    session.need().show(shown, waits_as="Add a scene")
    progress.follow(session)
    assert progress.done == {"open"}
    session.cancel_preview()
    progress.follow(session)
    assert progress.done == {"open"}
    assert session.need().do(shown)
    progress.follow(session)
    assert progress.done >= {"open", "find"}


def test_only_what_was_done_is_ticked_and_photos_count(session: Session, tmp_path: Path) -> None:
    """Making an object, naming it and an export change nothing that is seen."""
    progress = FirstSteps()
    progress.follow(session)
    session.need().select(np.arange(40, dtype=np.int32), "set", "Forty")
    objects.separate(session)
    progress.follow(session)
    assert progress.done >= {"open", "find", "click"}
    objects.rename(session, session.focus, "ball")
    export.export(session, "scene", tmp_path / "out.ply")
    finish(session)
    progress.follow(session)
    assert "export" in progress.done
    transform.duplicate(session)
    progress.follow(session)
    assert "change" not in progress.done, "a copy is none of the three"
    session.edit(lambda scene: edits.set_scale(scene, 1.0, 2.0, np.zeros(3)))
    progress.follow(session)
    assert "change" not in progress.done, "nor is the scale of the scene"
    objects.hide(session)
    progress.follow(session)
    assert progress.next == 0

    photos, session.settings = FirstSteps(), Settings()
    session.photos = session.document = None
    photos.follow(session)
    assert photos.next == 1
    session.training = TrainingPreview("photos", 100)
    photos.follow(session)
    assert [name for name, _ in photos.steps][:2] == ["open", "train"]
    assert photos.next == 2


def test_objects_that_a_project_brought_are_found_already(associated: Session) -> None:
    progress = FirstSteps()
    progress.follow(associated)
    assert progress.next == 3
    assert "change" not in progress.done


def test_a_file_without_photos_has_nothing_to_find(
    new_session: Callable[[], Session], scene_folder: Path, tmp_path: Path
) -> None:
    model, path = find_model(scene_folder), tmp_path / "alone.ply"
    assert model is not None
    shutil.copy(model, path)
    session, progress = new_session(), FirstSteps()
    session.open(path)
    finish(session)
    session.need().scene.labels[:] = 0
    session.need().scene.revision.labels += 1
    progress.follow(session)
    assert [name for name, _ in progress.steps] == ["open", "click", "change", "export"]
    assert progress.next == 2
    session.need().select(np.arange(5, dtype=np.int32), "set", "Click")
    progress.follow(session)
    assert progress.next == 3


@pytest.mark.parametrize("unit", [10.5, 15.0, 30.0])
@pytest.mark.parametrize("size", [(300, 200), (500, 400), (700, 485), (1180, 790), (2000, 1300)])
def test_the_card_covers_neither_the_offer_nor_the_middle_nor_curves(
    unit: float, size: tuple[int, int]
) -> None:
    left, top, (width, height) = 40.0, 60.0, size
    for offer, training in itertools.product((0.0, 3.5, 6.0), (0.0, 0.6, 0.95)):
        foot = top + height - offer * unit if offer else float("inf")
        live_bottom = top + training * height if training else 0.0
        area = PictureArea(left, top, width, height, live_bottom=live_bottom)
        where = place(area, foot, unit)
        if where is None:
            assert min(size) < 27 * unit or training > 0.7, "only a tiny picture has no room"
            continue
        high = (_HIGH if where.is_whole else 2.2) * unit
        assert where.bottom <= min(foot, top + height)
        assert where.bottom - high >= max(top, live_bottom)
        assert left <= where.left
        assert where.left + where.width <= left + width
        right, upper = where.left + where.width, where.bottom - high
        assert right <= left + width / 3 or upper >= top + height * 2 / 3 - 1


def test_help_brings_it_back(associated: Session) -> None:
    assert not associated.settings.first_steps_done
    run("help.first_steps", associated)
    assert load_settings()[0].first_steps_done, "put away for good"
    run("help.first_steps", associated)
    assert not load_settings()[0].first_steps_done


@pytest.mark.window
@pytest.mark.parametrize("size", [(800, 500), (1440, 900)], ids=["one line", "five lines"])
def test_the_card_in_the_window(display: str, scene_folder: Path, size: tuple[int, int]) -> None:
    def walk(d: Driver) -> None:
        d.settle()
        card = d.engine.get_window_by_ref("//First steps")
        below = association.stage_offer(d.session)
        assert below is not None
        assert card.pos.y + card.size.y <= d.studio.ui.area.offer_top
        d.click("**/###Find objects")
        d.settle()
        d.click("First steps/###Put away")
        assert d.session.settings.first_steps_done
        assert not d.engine.get_window_by_ref("//First steps").active
        d.menu("Help/###First steps")
        assert not d.session.settings.first_steps_done
        d.frames(3)
        assert d.engine.get_window_by_ref("//First steps").active

    drive(walk, path=scene_folder, size=size, settings=Settings(preset="paper", identities="none"))
