"""The memory bank: moved masks, split objects, quality, the replay, the splats of a mask."""

import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.grouping.memory_bank import Decision
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_studio.features import objects, selection, transform
from gaga_studio.features.commands import command, run
from gaga_studio.features.find import association, masks, memory_bank
from gaga_studio.features.find.memory_bank import Timeline
from gaga_studio.features.selection import Uncertain
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode


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
    title = f"Move mask {moved.mask} of {moved.view} to mug"
    assert memory_bank.move_mask(session, moved, 2)
    job = session.jobs.running
    assert job is not None
    assert job.title == title, "the task says what happens"
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
    assert session.history.undo_title == title  # type: ignore[union-attr]
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


def test_a_copy_made_meanwhile_is_no_part_of_a_new_object(associated: Session) -> None:
    """Both had the same id."""
    session = associated
    assert memory_bank.move_mask(session, _decision(session, 3), memory_bank.NEW)
    selection.select_groups(session, (4,))
    assert transform.duplicate(session)
    copies = session.selected_indices().copy()
    (copy,) = set(_labels(session)[copies].tolist())
    assert session.jobs.wait()
    new = session.need().focus
    assert new not in {0, copy}
    assert not np.isin(np.flatnonzero(_labels(session) == new), copies).any()
    assert set(_labels(session)[copies].tolist()) == {copy}
    assert any(decision.by_hand for decision in session.decisions(new))
    assert not session.decisions(copy)


def test_objects_that_change_meanwhile_win(associated: Session) -> None:
    session = associated
    assert memory_bank.move_mask(session, _decision(session, 3), memory_bank.NEW)
    selection.select_groups(session, (4,))
    assert objects.assign(session, 5)
    changed = _labels(session)
    assert session.jobs.wait()
    assert _labels(session) is changed
    assert "changed meanwhile" in session.notices[-1].text


def test_a_mask_makes_a_new_object_or_it_is_said_that_other_views_outvote_it(
    session: Session,
) -> None:
    """It was said to be in a group that no list had."""
    association.associate(session, preset="robust")
    assert session.jobs.wait()
    document = session.need()
    state, before = document.history.state_id, set(session.objects().ids.tolist())
    refused = []
    for decision in session.decisions(2):
        assert memory_bank.move_mask(session, decision, memory_bank.NEW)
        assert session.jobs.wait()
        new = set(session.objects().ids.tolist()) - before
        refused.append(not new)
        assert ("No new object was made" in session.notices[-1].text) == refused[-1]
        assert (document.history.state_id == state) == refused[-1]
        if new:
            assert new == {session.focus}
            document.undo()
    assert set(refused) == {True, False}


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


def test_quality_is_known_when_the_scene_is_opened_again(
    associated: Session, new_session: Callable[[], Session], tmp_path: Path
) -> None:
    """Saved or not, in place or elsewhere: an old one if splats moved, none if masks did."""
    session = associated
    assert run("object.quality", session)
    assert session.jobs.wait()
    found, _ = memory_bank.shown_quality(session)
    assert found is not None

    def opened(path: Path) -> tuple[object, bool]:
        fresh = new_session()
        fresh.open(path)
        assert fresh.jobs.wait()
        after, is_now = memory_bank.shown_quality(fresh)
        return None if after is None else dict(after.groups), is_now

    root = session.need().project.source
    assert opened(root) == (dict(found.groups), True)
    session.save(tmp_path / "elsewhere.gaga")
    assert session.jobs.wait()
    assert opened(tmp_path / "elsewhere.gaga") == (dict(found.groups), True)
    assert session.need().select(np.flatnonzero(_labels(session) == 2)[:5].astype(np.int32))
    assert objects.assign(session, 3)
    session.save()
    assert session.jobs.wait()
    assert opened(tmp_path / "elsewhere.gaga") == (dict(found.groups), False)
    selection.select_groups(session, (2,))
    assert objects.assign(session, 3), "its masks, too"
    session.save()
    assert session.jobs.wait()
    assert opened(tmp_path / "elsewhere.gaga") == (None, False)
    file = session.need().project.folder.work / "quality.json"  # type: ignore[union-attr]
    file.write_bytes(file.read_bytes()[:-9])
    assert opened(root) == (None, False)


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


def _opened(session: Session) -> Session:
    assert run("view.timeline", session)
    assert session.jobs.wait()
    assert session.document is not None
    assert session.document.feature(Timeline).is_open, session.notices
    return session


def test_a_replay_goes_from_nothing_to_the_saved_groups(associated: Session) -> None:
    before = associated.scene.labels.copy()  # type: ignore[union-attr]
    session = _opened(associated)
    timeline, cursor = memory_bank.timeline_of(session), session.history.cursor  # type: ignore[union-attr]
    growth = timeline.growth
    assert growth is not None
    assert timeline.is_playing
    assert session.view.mode is Mode.GROUPS
    seen = []
    while timeline.is_playing:
        shown = memory_bank.timeline_labels(session)
        seen.append(0 if shown is None else int((shown > 0).sum()))
        assert shown is None or shown is memory_bank.timeline_labels(
            session
        )  # sent to the card once
        view = memory_bank.view_of_step(session)
        if view:
            assert session.cameras[session.active_view].name == view  # type: ignore[index]
            bank = memory_bank.bank_at(session)
            assert bank is not None
            assert bank.log[-1].view == view
        memory_bank.tick_timeline(session, 10.0)
    assert seen[0] == 0
    assert seen[: growth.last_step] == sorted(seen[: growth.last_step])
    assert timeline.step == growth.last_step
    assert memory_bank.timeline_labels(session) is None  # the scene's own
    assert np.array_equal(growth.labels_at(timeline.step), before)
    memory_bank.close_timeline(session)
    assert session.view.mode is Mode.COLOR
    assert session.history.cursor == cursor
    assert not session.unsaved
    assert np.array_equal(session.scene.labels, before)


@pytest.mark.parametrize("n_train", [3, 6, 8])
@pytest.mark.parametrize("n_missing", [0, 2])
def test_the_end_of_a_replay_counts_the_views_among_those_that_could_have_been(
    associated: Session, n_train: int, n_missing: int
) -> None:
    """All photos have masks, those that were held out of the training too."""
    project = associated.need().project
    assert project.folder is not None
    names = tuple(camera.name for camera in associated.cameras)
    train = names[:n_train]
    project.folder = replace(project.folder, train=train)
    said = memory_bank.views_text(associated, train[n_missing:])
    kind = "photos" if n_train == len(names) else "training photos"
    n = n_train - n_missing
    assert said == (f"{n} of {n_train} {kind}" if n_missing else f"All {n_train} {kind}")
    assert memory_bank.views_text(associated, (*train, "later.png")) == f"All {n_train + 1} photos"


@pytest.mark.parametrize("is_moved", [False, True])
def test_a_closed_replay_gives_the_camera_back_unless_it_was_moved(
    associated: Session, is_moved: bool
) -> None:
    before, photo = associated.rig.eye, associated.active_view
    session = _opened(associated)
    memory_bank.go_to_step(session, 3)
    session.tick(10.0)
    there = session.rig.eye
    assert np.abs(there - before).max() > 1e-3
    if is_moved:
        session.rig.orbit(40, 0)
        there = session.rig.eye
    memory_bank.close_timeline(session)
    session.tick(10.0)
    session.tick(10.0)
    want = there if is_moved else before
    np.testing.assert_allclose(session.rig.eye, want, atol=1e-9)
    assert is_moved or session.active_view == photo


def test_a_camera_that_does_not_follow_stays(associated: Session) -> None:
    session = _opened(associated)
    memory_bank.set_follows(session, False)
    session.active_view = None
    memory_bank.go_to_step(session, 3)
    assert session.active_view is None
    memory_bank.go_to_step(session, 999)
    assert memory_bank.timeline_of(session).step == 8
    memory_bank.toggle_timeline_playing(session)
    memory_bank.toggle_timeline_playing(session)
    assert memory_bank.timeline_of(session).step == 0  # from the start again
    memory_bank.set_follows(session, True)
    memory_bank.go_to_step(session, 1)
    assert session.active_view is not None


def test_a_replay_ends_with_its_bank_and_survives_copies(associated: Session) -> None:
    session = _opened(associated)
    memory_bank.go_to_step(session, 4)
    selection.select_groups(session, (3,))
    assert run("edit.duplicate", session)
    shown = memory_bank.timeline_labels(session)
    assert shown is not None
    assert len(shown) == len(session.scene)  # type: ignore[arg-type]
    bank = session.scene.bank  # type: ignore[union-attr]
    assert objects.rename(session, 2, "mug")
    memory_bank.tick_timeline(session, 0.0)
    assert memory_bank.timeline_of(session).is_open
    session.scene.bank = None  # type: ignore[union-attr]  # as an undone association does
    memory_bank.tick_timeline(session, 0.0)
    assert not memory_bank.timeline_of(session).is_open
    assert "Find objects" in command("view.timeline").enabled(session)
    session.scene.bank = bank  # type: ignore[union-attr]
    assert run("view.timeline", session)  # at once: the growth is known
    assert memory_bank.timeline_of(session).is_open


def test_a_replay_ends_with_its_scene(associated: Session) -> None:
    session = _opened(associated)
    session.take(session.need().project)
    assert not memory_bank.timeline_of(session).is_open
    assert session.view.mode is Mode.COLOR


def _mask(session: Session) -> Decision:
    """A mask of the object 3, its view read."""
    decision = session.decisions(3)[-1]
    while memory_bank.mask_overlaps(session, decision) is None:
        session.jobs.poll()
    return decision


def test_overlaps_of_a_mask_are_looked_up_in_a_quiet_job(
    associated: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    look, asked = memory_bank._look_stage, threading.Event()

    def held(*args: Any) -> Stage[object]:  # or it can be done before the answer is given
        assert asked.wait(60)
        return (yield from look(*args))

    monkeypatch.setattr(memory_bank, "_look_stage", held)
    decision = associated.decisions(3)[-1]
    assert memory_bank.mask_overlaps(associated, decision) is None
    asked.set()
    decision = _mask(associated)
    found = memory_bank.mask_overlaps(associated, decision)
    assert found is not None
    assert memory_bank.mask_overlaps(associated, decision) is found  # counted once, not every frame
    assert next(iter(found)) == 3
    assert list(found.values()) == sorted(found.values(), reverse=True)
    assert 0.5 < found[3] <= 1
    assert sum(found.values()) == pytest.approx(1)
    behind = memory_bank.mask_overlaps(associated, decision, has_gate=False)
    assert behind is not None
    assert len(behind) >= len(found)
    assert behind[3] < found[3]  # the floor is behind every ball


def test_masks_decided_by_points_tell_what_they_show(associated: Session) -> None:
    """Splats behind the mask said 99 % where the points said 56 %, and its pixels 85 %."""
    session, document = associated, associated.need()
    assert not memory_bank.shows_pixels(document)
    assert document.scene.bank is not None
    document.scene.bank = replace(document.scene.bank, preset="robust")
    decision = _mask(session)
    evidence = memory_bank.evidence_of(session, document)
    camera = evidence.camera(decision.view)
    seen = choose().label_splat(evidence.gaussians, camera, _labels(session)).labels
    masks_of_view = evidence.masks_of(camera)
    inside = seen[masks_of_view.ids[masks_of_view.labels] == decision.mask]
    found = memory_bank.mask_overlaps(session, decision)
    assert found == {g: (inside == g).mean() for g in np.unique(inside).tolist()}
    free = memory_bank.mask_overlaps(session, decision, has_gate=False)
    splats = memory_bank.mask_splats_of(session, decision)
    assert splats is not None
    assert free is not None
    assert free[3] == (_labels(session)[splats.behind] == 3).mean()
    selection.select_groups(session, (3,))
    assert objects.assign(session, 4)  # its masks go along
    moved = next(
        d for d in session.decisions(4) if d.view == decision.view and d.mask == decision.mask
    )
    while (now := memory_bank.mask_overlaps(session, moved)) is None:
        session.jobs.poll()
    assert now[4] == pytest.approx(found[3] + found.get(4, 0))
    session.undo()
    assert memory_bank.mask_overlaps(session, decision) is found, "it is known"


def test_lit_splats_are_those_of_the_mask_and_the_gate_is_a_switch(associated: Session) -> None:
    session = associated
    decision = _mask(session)
    splats = memory_bank.mask_splats_of(session, decision)
    assert splats is not None
    gated = memory_bank.mask_tint(session, decision)
    assert gated is not None
    assert np.array_equal((gated == memory_bank.IN_GATE).all(axis=1), splats.gated)
    assert not (gated == memory_bank.CUT_OFF).all(axis=1).any()
    assert memory_bank.mask_tint(session, decision) is gated  # nothing is sent to the card again
    run("view.mask_gate", session)
    free = memory_bank.mask_tint(session, decision)
    assert free is not None
    assert np.array_equal((free == memory_bank.IN_GATE).all(axis=1), splats.gated)
    cut = (free == memory_bank.CUT_OFF).all(axis=1)
    assert np.array_equal(cut, splats.behind & ~splats.gated)
    assert cut.any()
    assert memory_bank.mask_tint(session, None) is None
    run("view.lights_masks", session)
    assert memory_bank.mask_tint(session, decision) is None


def test_copies_are_lit_with_their_originals(associated: Session) -> None:
    session = associated
    decision = _mask(session)
    before = memory_bank.mask_tint(session, decision)
    selection.select_groups(session, (3,))
    assert run("edit.duplicate", session)
    scene = session.scene
    assert scene is not None
    after = memory_bank.mask_tint(session, decision)
    assert before is not None
    assert after is not None
    assert len(after) == len(scene) > len(before)
    assert np.array_equal(after, before[scene.source])


def test_a_view_that_cannot_be_read_is_tried_once(associated: Session) -> None:
    session = associated
    decision = session.decisions(3)[-1]
    assert session.project is not None
    assert session.project.folder is not None
    (folder,) = session.project.folder.mask_folders.values()
    for path in folder.glob(f"**/{decision.view}*"):
        path.write_bytes(b"no picture")
    end = time.monotonic() + 30
    while (
        found := memory_bank.mask_overlaps(session, decision)
    ) is None and time.monotonic() < end:
        session.jobs.poll()
        time.sleep(0.01)
    assert found == {}
    assert memory_bank.mask_tint(session, decision) is None
    assert session.jobs.quiet is None, "it fails again in every frame"


def test_masks_that_were_made_again_are_read_again(associated: Session) -> None:
    session, document = associated, associated.need()
    decision = _mask(session)
    kept = memory_bank.evidence_of(session, document)
    assert memory_bank.mask_splats_of(session, decision) is not None
    assert masks.choose(session, session.provider)  # as a job that has made masks does
    assert memory_bank.evidence_of(session, document) is not kept
    assert memory_bank.mask_splats_of(session, decision) is None  # until its view is read again
    assert memory_bank.mask_overlaps(session, _mask(session))


def test_the_memory_bank_shows_the_masks_that_the_objects_are_of(associated: Session) -> None:
    """Masks that were imported since were shown, and their ids taken for those of the objects."""
    project = associated.need().project
    assert project.folder is not None
    masks_folder = project.folder.root / "masks"
    for name in ("others", "a set"):
        shutil.copytree(masks_folder / "made", masks_folder / name)
    before = associated.masks
    assert masks.choose(associated, "others")
    assert associated.masks is not before
    shown = memory_bank.masks_of_bank(associated)
    assert set(shown.loaders) == set(before.loaders)
    assert "made" in str(shown.source)
    assert "made" in str(memory_bank.evidence_of(associated, associated.need()).masks.source)
    associated.save()
    assert associated.jobs.wait()
    associated.open(project.folder.root)
    assert associated.jobs.wait()
    assert associated.provider == "made", "in use again after opening, though not the first"
    assert masks.choose(associated, "a set")
    association.associate(associated)
    assert associated.jobs.wait()
    assert memory_bank.masks_of_bank(associated) is associated.masks, "found again, of the others"
