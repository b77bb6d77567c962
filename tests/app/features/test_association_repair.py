"""Repairs as a person does them: moved masks, split objects; quality, doubt and thumbnails."""

from dataclasses import replace

import numpy as np

from gaga_core.grouping.memory_bank import Decision
from gaga_studio.features import objects, selection, transform
from gaga_studio.features.commands import run
from gaga_studio.features.find import memory_bank
from gaga_studio.features.selection import Uncertain
from gaga_studio.session.session import Session


def _decision(session: Session, group: int, place: int = -1) -> Decision:
    return session.decisions(group)[place]


def _labels(session: Session) -> np.ndarray:
    assert session.scene is not None
    return session.scene.labels


def test_a_moved_mask_is_one_edit_that_undo_takes_back(associated: Session) -> None:
    session = associated
    before, bank = _labels(session).copy(), session.scene.bank  # type: ignore[union-attr]
    assert objects.rename(session, 2, "mug")
    cursor = session.history.cursor  # type: ignore[union-attr]
    moved = _decision(session, 3)
    live = []
    assert memory_bank.move_mask(session, moved, 2)
    while session.jobs.running is not None:
        session.jobs.poll()
        if session.live is not None:
            live.append(session.live.view)
    assert live
    assert live[-1] >= moved.view
    now = next(d for d in session.decisions(2) if (d.view, d.mask) == (moved.view, moved.mask))
    assert now.by_hand
    assert session.live is None
    assert session.history.cursor == cursor + 1  # type: ignore[union-attr]
    assert session.history.undo_title == (  # type: ignore[union-attr]
        f"Move mask {moved.mask} of {moved.view} to mug"
    )
    assert session.document.name_of(2) == "mug"  # type: ignore[union-attr]
    assert not np.array_equal(_labels(session), before)
    session.undo()
    assert np.array_equal(_labels(session), before)
    assert session.scene.bank is bank  # type: ignore[union-attr]


def test_cancelled_a_repair_leaves_everything(associated: Session) -> None:
    session = associated
    before, bank = _labels(session), session.scene.bank  # type: ignore[union-attr]
    assert memory_bank.move_mask(session, _decision(session, 3), memory_bank.NEW)
    session.jobs.cancel()
    assert session.jobs.wait()
    assert session.live is None
    assert _labels(session) is before
    assert session.scene.bank is bank  # type: ignore[union-attr]


def test_objects_that_change_meanwhile_win(associated: Session) -> None:
    session = associated
    assert memory_bank.move_mask(session, _decision(session, 3), memory_bank.NEW)
    selection.select_groups(session, (4,))
    assert objects.assign(session, 5)
    changed = _labels(session)
    assert session.jobs.wait()
    assert _labels(session) is changed
    assert "changed while this ran" in session.notices[-1].text


def test_copies_in_objects_of_their_own_stay_there(associated: Session) -> None:
    session = associated
    selection.select_groups(session, (3,))
    assert transform.duplicate(session)
    n, copy = len(session.scene), int(_labels(session).max())  # type: ignore[arg-type]
    assert memory_bank.move_mask(session, _decision(session, 3, 0), memory_bank.NEW)
    assert session.jobs.wait()
    assert len(_labels(session)) == n
    assert (_labels(session) == copy).sum() == n - session.scene.source.max() - 1  # type: ignore[union-attr]
    assert (_labels(session)[: n - (_labels(session) == copy).sum()] != copy).all()


def test_a_saved_bank_is_repaired_by_its_preset_whatever_the_order_of_its_views(
    associated: Session,
) -> None:
    session, scene = associated, associated.scene
    assert scene is not None
    assert scene.bank is not None
    views = [decision.view for decision in scene.bank.log]
    assert views == sorted(views)
    scene.bank = replace(scene.bank, preset="robust")
    session.save()
    assert session.jobs.wait()
    session.open(session.project.path)  # type: ignore[union-attr,arg-type]
    assert session.jobs.wait()
    document = session.need()
    assert memory_bank.evidence_of(session, document).config.preset == "robust"
    assert document.read.overlap_is_of_points()


def test_two_objects_in_one_are_told_apart_by_their_masks(associated: Session) -> None:
    session = associated
    truth = _labels(session).copy()
    selection.select_groups(session, (2,))
    assert objects.assign(session, 3)  # whole objects: their masks go along
    assert len(session.decisions(2)) == 0
    n_masks = len(session.decisions(3))
    selection.select_groups(session, (3,))
    assert run("object.split_masks", session)
    assert session.jobs.wait()
    assert "is two now" in session.notices[-1].text
    new = int(_labels(session).max())
    assert new > truth.max()
    part = _labels(session) == new
    wanted = truth == np.bincount(truth[part]).argmax()
    assert (part == wanted).mean() > 0.97
    assert len(session.decisions(new)) + len(session.decisions(3)) == n_masks
    session.undo()
    assert (_labels(session) != new).all()


def test_quality_is_kept_for_each_state_of_the_groups(associated: Session) -> None:
    session = associated
    assert memory_bank.shown_quality(session) == (None, False)
    assert memory_bank.quality_column(session, session.objects()).tolist() == [-1.0] * len(
        session.objects()
    )
    assert run("object.quality", session)
    assert session.jobs.wait()
    found, is_now = memory_bank.shown_quality(session)
    assert found is not None
    assert is_now
    assert (memory_bank.quality_column(session, session.objects())[1:] > 0.6).all()
    selection.select_groups(session, (2,))
    assert run("object.worst_view", session)
    worst = found.groups[2].views[0].view
    assert session.cameras[session.active_view or 0].name == worst
    assert objects.assign(session, 3)
    assert memory_bank.shown_quality(session) == (found, False)
    session.undo()
    assert memory_bank.shown_quality(session) == (found, True)


def test_uncertain_splats_of_the_selected_object(associated: Session) -> None:
    session = associated
    document = session.need()
    selection.select_groups(session, (2,))
    document.feature(Uncertain).threshold = 0.9
    assert run("object.uncertain", session)
    column = session.scene.confidence_of()  # type: ignore[union-attr]
    assert column is not None
    chosen = session.selected_indices()
    assert (_labels(session)[chosen] == 2).all()
    assert (column[chosen] < 0.9 * 255).all()
    assert len(chosen) == ((_labels(session) == 2) & (column < 0.9 * 255)).sum()


def test_a_group_color_is_an_edit(associated: Session) -> None:
    session = associated
    first = session.objects().colors[2].copy()
    group = int(session.objects().ids[2])
    assert objects.set_color(session, group, (0.2, 0.4, 0.6))
    np.testing.assert_allclose(session.objects().colors[2], [0.2, 0.4, 0.6])
    assert session.unsaved
    session.undo()
    np.testing.assert_array_equal(session.objects().colors[2], first)
