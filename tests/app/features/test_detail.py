"""The level of detail of objects that no model made: seen while dragged, one edit at the end."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.grouping.memory_bank import MemoryBank, at_level
from gaga_core.scene.scene import Scene
from gaga_studio.features import object_list, objects
from gaga_studio.features.find import association, memory_bank
from gaga_studio.session.session import Session


@pytest.fixture
def session(new_session: Callable[[], Session], grouped_scene: Path, tmp_path: Path) -> Session:
    """The small scene with objects found from masks that no model made."""
    folder = tmp_path / "regions"
    shutil.copytree(grouped_scene, folder)
    (masks,) = (folder / "masks").iterdir()
    (masks / "provider.json").write_text(json.dumps({"provider": "regions", "views": {}}))
    made = new_session()
    made.open(folder)
    assert made.jobs.wait()
    association.associate(made, preset="robust")
    assert made.jobs.wait(), made.notices
    return made


def _scene(session: Session) -> Scene:
    assert session.scene is not None
    return session.scene


def _bank(session: Session) -> MemoryBank:
    bank = _scene(session).bank
    assert bank is not None
    return bank


def test_a_chosen_level_is_one_edit_that_undo_takes_back(session: Session) -> None:
    levels = object_list.levels_of(session)
    assert levels is not None
    before, bank, cursor = _scene(session).labels.copy(), _bank(session), session.need().history
    place, finest = cursor.cursor, len(levels.labels) - 1
    objects.choose_level(session, finest)
    assert cursor.cursor == place + 1
    assert np.array_equal(_scene(session).labels, levels.labels[finest])
    assert _bank(session).levels is not None
    assert _bank(session).levels.chosen == finest  # type: ignore[union-attr]
    session.undo()
    assert np.array_equal(_scene(session).labels, before)
    assert _bank(session) is bank


def test_a_preview_changes_nothing_of_the_scene(session: Session) -> None:
    before, place = _scene(session).labels.copy(), session.need().history.cursor
    objects.preview_level(session, 0)
    assert session.live_labels is not None
    assert np.array_equal(session.live_labels, _bank(session).levels.labels[0])  # type: ignore[union-attr]
    objects.cancel_level(session)
    assert session.live is None
    assert np.array_equal(_scene(session).labels, before)
    assert session.need().history.cursor == place


def test_names_and_masks_stay_with_groups_that_are_there_at_both_levels(session: Session) -> None:
    levels = object_list.levels_of(session)
    assert levels is not None
    group = int(np.bincount(levels.labels[0])[1:].argmax()) + 1
    assert objects.rename(session, group, "floor")
    objects.choose_level(session, 0)
    assert _scene(session).names[group] == "floor"
    assert {d.group for d in _bank(session).log} <= set(range(levels.labels[0].max() + 1))
    assert session.decisions(group)


def test_masks_follow_their_groups_to_a_coarser_level(session: Session) -> None:
    bank = _bank(session)
    assert bank.levels is not None
    coarse = at_level(bank, 0)
    for before, after in zip(bank.log, coarse.log, strict=True):
        if before.group > 0:
            own = bank.levels.labels[0][bank.group == before.group]
            assert after.group == np.bincount(own).argmax()


def test_a_moved_mask_leaves_other_objects_as_they_are(session: Session) -> None:
    before = _scene(session).labels.copy()
    groups = [d.group for d in _bank(session).log if d.group > 0]
    one, other = np.argsort(-np.bincount(groups))[1:3].tolist()
    moved = session.decisions(one)[-1]
    assert memory_bank.move_mask(session, moved, other)
    assert session.jobs.wait()
    assert any(d.by_hand for d in session.decisions(other))
    rest = (before != one) & (before != other) & (before > 0)
    assert (_scene(session).labels[rest] == before[rest]).mean() > 0.9


def test_scenes_without_levels_have_no_detail(associated: Session) -> None:
    assert object_list.levels_of(associated) is None
    with pytest.raises(ValueError, match="no levels"):
        objects.choose_level(associated, 0)
