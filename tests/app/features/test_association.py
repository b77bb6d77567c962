"""Identities in the session: trained after the paper's groups, chosen, undone, saved."""

import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.grouping.add_views import with_decisions
from gaga_core.grouping.associate import AssociateConfig, Association
from gaga_core.identity.field import load_identity
from gaga_core.identity.train import FILE as CHECKPOINT
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.pipeline.compile_kernels import usual_seconds
from gaga_core.pipeline.settings import GroupSettings, IdentitySettings
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.scene import edits
from gaga_core.scene.project import decided_groups
from gaga_core.scene.scene import Scene, Weight
from gaga_studio.features import commands, folders, objects, selection
from gaga_studio.features.commands import command, run
from gaga_studio.features.find import association, masks, memory_bank
from gaga_studio.features.find.association import FindState, lift_mode
from gaga_studio.session.jobs import Job
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode
from tests.app.looks import finish, scene_of, snapshot, true_labels


def _quickly(session: Session, iterations: int = 12) -> None:
    """As the preset paper has it, but for fewer steps."""
    session.settings = replace(session.settings, identities="preset")
    session.feature(FindState).identities = IdentitySettings(iterations)


def _scene(session: Session) -> Scene:
    assert session.scene is not None
    return session.scene


def test_what_the_presets_ask_for() -> None:
    assert lift_mode(Settings(preset="paper")) == "paper"
    assert lift_mode(Settings(preset="released")) == "paper"
    assert lift_mode(Settings(preset="robust")) is None
    assert lift_mode(Settings(preset="robust", identities="vote")) == "vote"
    config = GroupSettings(threshold=0.3, inlier_factor=2.0, order="coverage").config("paper")
    assert (config.threshold, config.gate.iqr_factor, config.order) == (0.3, 2.0, "coverage")
    assert GroupSettings().config("paper").depth == "expected"


def _forget_kernels(monkeypatch: pytest.MonkeyPatch, empty: Path) -> None:
    """As in a new installation; what opening a scene prepares would note there what it finds."""
    for thread in threading.enumerate():
        if thread.name == "job: Prepare kernels":
            thread.join()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(empty))  # where it is noted what is compiled


def test_kernels_that_are_not_compiled_count_in_the_time_and_in_the_bar(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new installation promised 15 s, and stood a minute at a bar without a share."""
    _forget_kernels(monkeypatch, tmp_path)
    usual, first = usual_seconds("window", "grouping"), association.stage_offer(session)
    assert usual > 30
    project, config = session.need().project, AssociateConfig.of("paper")
    finding = association.finding_seconds(project.scene, len(session.masks), "paper")
    assert first is not None
    assert first.seconds == pytest.approx(usual + finding)
    stage = association.associate_project_stage(project, session.masks, config, session.rates)
    steps: list[Progress] = []
    run_stage(stage, steps.append)
    assert {step.stage for step in steps} == {association.TITLE}
    shares = [step.done / step.total for step in steps[1:]]
    assert shares == sorted(shares)
    is_kernel = ["Prepare kernels" in step.message for step in steps[1:]]
    assert shares[is_kernel.index(False)] == pytest.approx(usual / (usual + finding), abs=0.02)
    lefts = [step.left_s for step, is_one in zip(steps[1:], is_kernel, strict=True) if is_one]
    assert lefts[0] == pytest.approx(usual + finding)
    assert None not in lefts, "and the time that is left is that of both"
    assert 0.95 < shares[-1] <= 1
    later = association.stage_offer(session)
    assert later is not None
    assert later.seconds == pytest.approx(finding * session.rates.of("Find objects, paper"))


def test_a_new_installation_expects_of_finding_what_its_kernels_told(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """*Find objects* said 45 s and took 130, on a machine that had taken three times as long as
    usual for the first kernels."""
    _forget_kernels(monkeypatch, tmp_path)
    finding = association.finding_seconds(_scene(session), len(session.masks), "paper")

    at = 0.0

    def kernels() -> Stage[None]:
        nonlocal at
        for k in range(5):
            at = 9.0 * k
            yield Progress("Prepare kernels", k, 4)

    with monkeypatch.context() as clock:
        clock.setattr("gaga_studio.session.rates.time.monotonic", lambda: at)
        run_stage(session.rates.timed_kernels(kernels(), 12.0))
    offer, usual = association.stage_offer(session), usual_seconds("window", "grouping")
    assert offer is not None
    assert offer.seconds == pytest.approx(3 * (usual + finding))
    session.rates.keep(session.rates.rates | {"Find objects, paper": 2.0})
    offer = association.stage_offer(session)
    assert offer is not None
    assert offer.seconds == pytest.approx(3 * usual + 2 * finding), "it was measured itself"


def _split(session: Session) -> None:
    """Split the largest object by its masks."""
    selection.select_groups(session, (int(session.objects().ids[-1]),))
    memory_bank.split_by_masks(session)


@pytest.mark.parametrize("start", [association.lift, _split])
def test_kernels_have_a_share_of_the_bar_and_of_the_time_of_what_waits_for_them(
    associated: Session,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    start: Callable[[Session], None],
) -> None:
    """A new installation stood at a bar without a share for a minute."""
    _quickly(associated)
    _forget_kernels(monkeypatch, tmp_path)
    start(associated)
    shown: list[Job] = []
    while (job := associated.jobs.running) is not None:
        shown += [job] if not shown or job != shown[-1] else []
        associated.jobs.poll()
    shares = [job.fraction for job in shown if job.fraction >= 0]
    kernels = [job for job in shown if "Prepare kernels" in job.message]
    assert shares == sorted(shares)
    assert 0 <= kernels[0].fraction < 0.5
    assert kernels[-1].fraction < 1
    assert len({job.fraction for job in kernels}) > 5
    assert all(job.eta_s is not None for job in kernels)


def test_the_papers_groups_are_lifted_and_labels_are_the_classifiers(session: Session) -> None:
    groups_only = association.stage_offer(session)
    _quickly(session, 10_000)
    whole = association.stage_offer(session)
    assert groups_only is not None
    assert whole is not None
    n_pixels = session.cameras[0].width * session.cameras[0].height
    training = whole.seconds - groups_only.seconds  # is in the estimate
    assert training == pytest.approx(10_000 * 2.4e-6 * n_pixels)
    _quickly(session)
    association.associate(session)
    assert session.jobs.wait(), session.notices
    scene, document = _scene(session), session.need()
    assert scene.identities.source == "identities"
    folder = document.project.folder
    assert folder is not None
    stored = load_identity(folder.work / "identity.npz")
    assert np.array_equal(scene.labels, stored.labels)
    assert not (folder.work / CHECKPOINT).exists()
    run("view.identity", session)
    assert session.view.mode is Mode.IDENTITY
    assert scene.identities.other is not None
    votes = scene.identities.other.labels
    assert not np.array_equal(votes, scene.labels)
    run("object.labels_votes", session)
    assert np.array_equal(scene.labels, votes)
    assert command("object.labels_votes").is_on(session)  # type: ignore[misc]
    for _ in range(2):  # the choice, then the lift
        session.undo()
    assert scene.identities.other is None
    assert np.array_equal(scene.labels, votes)
    assert "Lift the groups" in command("view.identity").enabled(session)
    for _ in range(2):
        session.redo()
    association.associate(session, preset="robust")
    assert session.jobs.wait()
    assert scene.identities.source == "votes"
    assert scene.identities.other is None


def test_a_choice_of_labels_is_saved(session: Session, scene_folder: Path) -> None:
    _quickly(session)
    association.associate(session)
    assert session.jobs.wait()
    association.use_labels(session, "votes")
    before = _scene(session)
    session.save()
    assert session.jobs.wait()
    session.open(scene_folder)
    assert session.jobs.wait()
    after = _scene(session)
    assert after is not before
    assert after.identities.source == "votes"
    assert np.array_equal(after.labels, before.labels)
    association.use_labels(session, "identities")
    assert before.identities.other is not None
    assert np.array_equal(after.labels, before.identities.other.labels)


def test_cancel_keeps_the_groups_and_a_next_training_goes_on(session: Session) -> None:
    _quickly(session, 100_000)
    association.associate(session)
    while (job := session.jobs.running) is None or "loss" not in job.message:
        session.jobs.poll()
    session.jobs.cancel()
    assert session.jobs.wait()
    scene, folder = _scene(session), session.need().project.folder
    assert folder is not None
    assert scene.labels.max() > 0
    assert scene.identities.other is None
    assert (folder.work / CHECKPOINT).is_file()
    _quickly(session)  # fewer steps than it has: they are done at once
    association.lift(session)
    assert session.jobs.wait()
    assert scene.identities.source == "identities"


def _pair(session: Session) -> BoolArray:
    """Splats of two balls, which every search for objects finds as two."""
    return np.isin(true_labels(), (1, 2))[: len(_scene(session))]


def _make(session: Session, rows: BoolArray) -> int:
    """An object of these splats, made by hand; its id."""
    assert session.edit(lambda scene: edits.separate(scene, rows, "Make object"))
    (group,) = np.unique(_scene(session).labels[rows]).tolist()
    return int(group)


def _is_whole(session: Session, rows: BoolArray) -> bool:
    """Whether these splats and no others are one object."""
    labels = _scene(session).labels
    return labels[rows][0] > 0 and bool(np.array_equal(labels == labels[rows][0], rows))


@pytest.mark.parametrize("is_named", [False, True])
@pytest.mark.parametrize("presets", ["paper robust", "robust paper", "released paper"])
def test_what_a_person_made_stays_when_objects_are_found(
    session: Session, presets: str, is_named: bool
) -> None:
    """Without a memory bank, and with that of a published preset, it was dissolved."""
    rows = _pair(session)
    group = _make(session, rows)
    assert not is_named or objects.rename(session, group, "pair")
    assert objects.set_color(session, group, (1, 0, 0))
    assert session.edit(lambda scene: edits.set_weight(scene, group, Weight("mass", 2.0)))
    before = snapshot(_scene(session))
    for preset in presets.split():
        association.associate(session, preset=preset)
        finish(session)
        assert _is_whole(session, rows)
        assert "1 of them stay" in session.notices[-1].text
        scene = _scene(session)
        now = int(scene.labels[rows][0])
        assert scene.names == ({now: "pair"} if is_named else {})
        assert (scene.colors, scene.weights) == ({now: (1, 0, 0)}, {now: Weight("mass", 2.0)})
    for _ in presets.split():
        session.undo()
    assert snapshot(_scene(session)) == before
    assert set(_scene(session).colors) == {group}


def test_what_a_person_made_stays_when_labels_come_from_identities(session: Session) -> None:
    _quickly(session)
    association.associate(session)
    finish(session)
    rows = _pair(session)
    _make(session, rows)
    for _ in range(2):
        association.associate(session)
        finish(session)
        assert _scene(session).identities.source == "identities"
        assert _is_whole(session, rows)


def test_groups_of_a_file_are_replaced_but_those_that_were_changed(
    new_session: Callable[[], Session], scene_folder: Path
) -> None:
    splats = scene_folder / "point_cloud.ply"
    truth = true_labels()
    groups = np.where(truth == 5, 4, truth).astype(np.int32)  # 4 and 5 as one: wrong
    write_ply(splats, replace(read_ply(splats), extra={"group": groups}))
    session = new_session()
    session.open(scene_folder)
    finish(session)
    assert np.array_equal(_scene(session).labels, groups)
    session.edit(lambda scene: edits.merge_groups(scene, (1, 2)))
    rows, untouched = groups == 1, truth == 4
    rows |= groups == 2
    association.associate(session, preset="robust")
    finish(session)
    assert _is_whole(session, rows)
    assert "1 of them stay" in session.notices[-1].text
    labels = _scene(session).labels
    owners = [int(np.bincount(labels[part]).argmax()) for part in (untouched, truth == 5)]
    assert owners[0] != owners[1]


def test_an_object_with_a_name_is_improved_where_it_is_found_and_stays_where_not(
    associated: Session,
) -> None:
    """Names went with what was found again, and with the object where nothing was."""
    session = associated
    scene = _scene(session)
    ids = [int(g) for g in session.objects().ids if g > 0]
    found, gone = ids[0], ids[1]
    owned = scene.labels == found
    assert objects.rename(session, found, "found")
    assert objects.rename(session, gone, "gone")
    rows = scene.labels == gone
    fresh = np.where(rows, 0, scene.labels).astype(np.int32)
    fresh[np.flatnonzero(owned)[:3]] = 0
    labels, new_ids = with_decisions(
        scene.labels, fresh, decided_groups(session.need().project), scene.names
    )
    assert new_ids[found] == found
    assert np.array_equal(labels == found, fresh == found)
    assert np.array_equal(labels == new_ids[gone], rows)


@pytest.mark.parametrize("name", ["object.lift", "object.labels_identities"])
def test_without_groups_the_reason_is_said(session: Session, name: str) -> None:
    assert "Find objects" in command(name).enabled(session) or "Lift" in command(name).enabled(
        session
    )


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
    assert "are used already" in commands.command("object.add_views").enabled(session)
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
    assert objects.rename(session, ids[0], "kettle")
    assert folders.put_in(session, "Kitchen", (ids[0],))
    assert folders.put_under(session, ids[0], (ids[1],))
    assert objects.set_color(session, ids[1], (1, 0, 0))
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
    assert "are used already" in commands.command("object.add_views").enabled(session)
    session.undo()
    assert snapshot(scene) == before
    assert np.array_equal(scene.labels, labels)


def test_masks_of_another_set_do_not_join(grown: tuple[Session, tuple[str, ...]]) -> None:
    """All was found again without what the masks of the objects had said: names went to others."""
    session, late = grown
    assert session.project is not None
    assert session.project.folder is not None
    made, path = session.provider, session.project.folder.mask_folders[session.provider]
    other = path.with_name("other")
    other.mkdir()
    for name in late:
        (path / f"{Path(name).stem}.png").rename(other / f"{Path(name).stem}.png")
    assert masks.choose(session, "other")
    reason = commands.command("object.add_views").enabled(session)
    assert "of which 0 have masks in other." in reason
    n = len(session.project.folder.train) - len(late)
    assert memory_bank.text_on_bare_photos(session) == (
        f"{n} photos have no masks yet in other: use Make masks."
    )
    assert scene_of(session).bank is not None
    decision = scene_of(session).bank.log[0]  # type: ignore[union-attr]
    assert f"those of {made}" in memory_bank.where_masks_are(session, decision)
    (path / f"{Path(decision.view).stem}.png").unlink()
    assert memory_bank.where_masks_are(session, decision) == "Its masks are gone."


@pytest.mark.parametrize("name", ["9.png", "left/9.png", "left/9.tif"])
def test_masks_of_photos_in_subfolders_are_told_where_they_are(
    associated: Session, name: str
) -> None:
    """They lie in a subfolder, or next to the others as other programs write them; those were
    said to be gone."""
    assert associated.project is not None
    assert associated.project.folder is not None
    made, path = associated.provider, associated.project.folder.mask_folders[associated.provider]
    shutil.copytree(path, path.with_name("other"))
    decision = replace(scene_of(associated).bank.log[0], view="left/9.jpg")  # type: ignore[union-attr]
    (path / name).parent.mkdir(exist_ok=True)
    assert masks.choose(associated, "other")
    assert memory_bank.where_masks_are(associated, decision) == "Its masks are gone."
    write_labels(path / name, np.ones((2, 2), np.int32))
    assert f"those of {made}" in memory_bank.where_masks_are(associated, decision)


def test_new_groups_have_other_ids_than_copies_made_meanwhile(
    grown: tuple[Session, tuple[str, ...]],
) -> None:
    """A copy had the id of a new object, which was called as the copy then."""
    session, _ = grown
    scene = scene_of(session)
    assert scene.bank is not None
    labels, free = scene.labels, 3
    found = Association(
        scene.bank, labels, np.ones(len(labels), np.float32), {}, np.zeros(0, np.int32)
    )
    assert memory_bank.with_free_ids(free, free, found) is found
    assert memory_bank.with_free_ids(99, int(labels.max()) + 1, found) is found
    moved = memory_bank.with_free_ids(9, free, found)
    assert np.array_equal(moved.labels, np.where(labels >= free, labels + 6, labels))
    for was, now in zip(found.bank.log, moved.bank.log, strict=True):
        assert now.group == was.group + 6 * (was.group >= free)
    held = found.bank.group
    assert np.array_equal(moved.bank.group, np.where(held >= free, held + 6, held))


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
