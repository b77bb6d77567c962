"""The session: opening, saving, associating; nothing is lost on the way."""

import shutil
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from threading import Event

import numpy as np
import pytest

from gaga_core.export.export import export_objects_stage
from gaga_core.io.files import assets
from gaga_core.io.splats.ply import write_ply
from gaga_core.io.splats.splat_files import SplatFormat, write_splats
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.project import open_path_stage, reopen_stage
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import files, objects, selection, transform
from gaga_studio.features.commands import command, run
from gaga_studio.features.find import association
from gaga_studio.session.notices import HINT_SECONDS, Level, Notice, UserQuestion
from gaga_studio.session.session import Session
from gaga_studio.session.settings import load_settings
from tests.app.looks import finish, objects_of, scene_of, snapshot, true_labels
from tests.core.io.colmap_parts import bend
from tests.core.io.splat_parts import write_unchecked
from tests.scenes import objects_scene, random_gaussians

_W, _H = 320, 240


def test_open_a_folder(session: Session) -> None:
    assert session.title == "table"
    assert len(session.cameras) == 8
    assert session.provider == "made"
    assert len(session.masks) == 8
    offer = association.stage_offer(session)
    assert offer is not None
    assert offer.reason == "8 photos have masks but no objects yet."
    assert offer.command == "object.associate"
    assert offer.duration.startswith("about ")
    assert not session.unsaved
    np.testing.assert_allclose(session.rig.eye, session.cameras[0].position, atol=1e-9)


def test_what_cannot_be_opened_loses_nothing(associated: Session, tmp_path: Path) -> None:
    selection.select_groups(associated, (objects_of(associated)[0],))
    document, before = associated.document, snapshot(scene_of(associated))
    broken = tmp_path / "broken.ply"
    broken.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    for path in (broken, tmp_path / "none.ply", tmp_path):
        associated.open(path)
        assert associated.jobs.wait()
        assert associated.notices[-1].level is Level.ERROR
        assert associated.document is document
        assert snapshot(scene_of(associated)) == before


@pytest.mark.parametrize("names", [("a.ply",), ("a.ply", "a.ply"), ("a.ply", "b.ply", "c.ply")])
def test_only_the_last_try_to_open_has_an_error(
    associated: Session, tmp_path: Path, names: tuple[str, ...]
) -> None:
    """Cards about former tries stayed over the picture; an error of another task stays."""
    associated.notify(Level.ERROR, "The disk is full.")
    for name in names:
        associated.open(tmp_path / name)
        assert associated.jobs.wait()
    other, last = (n.text for n in associated.notices if n.level is Level.ERROR)
    assert other == "The disk is full."
    assert names[-1] in last


def test_a_save_that_succeeds_takes_the_error_of_the_former_one(
    associated: Session, tmp_path: Path
) -> None:
    blocked = tmp_path / "blocked"
    blocked.write_bytes(b"")
    for path in (blocked / "a.gaga", tmp_path / "a.gaga"):
        associated.save(path)
        assert associated.jobs.wait()
        is_saved = path.exists()
        assert any(n.level is Level.ERROR for n in associated.notices) is not is_saved
    assert is_saved


@pytest.mark.parametrize("wanted", ["camera.bookmark_1", "edit.undo"])
def test_a_hint_goes_by_itself(
    session: Session, monkeypatch: pytest.MonkeyPatch, wanted: str
) -> None:
    """What one gesture met was said until the next one, however long that took."""
    assert not run(wanted, session)
    assert session.hint
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + HINT_SECONDS)
    assert not session.hint


def test_what_is_said_again_is_one_notice_and_the_newest(associated: Session) -> None:
    """The same sentence filled the picture as often as it was said."""
    for text in ("one", "two", "one"):
        associated.notify(Level.ERROR, text)
    assert [n.text for n in associated.notices if n.level is Level.ERROR] == ["two", "one"]


@pytest.mark.parametrize("act", [Session.open, files.add_splats])
def test_what_a_reader_left_out_is_a_notice(
    associated: Session, tmp_path: Path, act: Callable[[Session, Path], object]
) -> None:
    path, g = tmp_path / "odd.ply", random_gaussians(9)
    g.means[2:5, 1], g.quats[7] = np.nan, 0
    write_unchecked(path, g)
    act(associated, path)
    finish(associated)
    told = [notice.text for notice in associated.notices if notice.level is Level.WARNING]
    assert told == [
        "odd.ply: 3 splats with numbers that are not finite or out of range were left out, and "
        "1 rotation of no length was set to none."
    ]


def test_distorted_cameras_are_a_notice(associated: Session, scene_folder: Path) -> None:
    bend(scene_folder / "sparse" / "0")
    associated.open(scene_folder)
    finish(associated)
    told = [notice.text for notice in associated.notices if notice.level is Level.WARNING]
    assert any(
        "has distorted cameras (OPENCV); their pinhole part is used" in text for text in told
    )


def test_another_scene_starts_afresh(associated: Session, scene_folder: Path) -> None:
    group = objects_of(associated)[0]
    selection.select_groups(associated, (group,))
    associated.filter = "mug"
    associated.open(scene_folder / "point_cloud.ply")
    finish(associated)
    assert associated.filter == ""
    assert associated.focus == 0
    assert associated.selected_groups() == ()
    assert associated.active_view is None
    assert len(associated.masks) == 0


def test_a_lone_file_says_that_a_project_was_saved_of_it(session: Session, tmp_path: Path) -> None:
    """It opens without edits; the project is the newest recent file until then."""
    file = tmp_path / "bowl.ply"
    write_ply(file, objects_scene(2, 30, n_cameras=1).gaussians)
    session.open(file)
    assert session.jobs.wait()
    assert not any("bowl.gaga" in notice.text for notice in session.notices)
    session.need().select(np.arange(5, dtype=np.int32), "set", "Select")
    objects.separate(session)
    session.save()
    assert session.jobs.wait()
    session.tick(0.1)
    assert session.settings.recent[0] == str(tmp_path / "bowl.gaga")
    session.open(file)
    assert session.jobs.wait()
    session.tick(0.1)
    told = next(n for n in session.notices if "bowl.gaga was saved of this file" in n.text)
    assert run(told.command, session)
    assert session.jobs.wait()
    session.tick(0.1)
    assert (session.need().scene.labels > 0).sum() == 5


def test_exported_objects_are_one_scene_of_their_folder(session: Session, tmp_path: Path) -> None:
    """Title, project and Recent name the folder; its project and those of its files are told apart,
    also where an object has the folder's name, or a file of another format an object's."""
    made = objects_scene(3, 30, n_cameras=1)
    scene = Scene.of(made.gaussians, made.labels)
    scene.names = {1: "room", 2: "cup", 3: "jug"}
    folder = tmp_path / "room"
    run_stage(export_objects_stage(scene, folder))
    write_splats(folder / "cup.spz", random_gaussians(50, seed=2), SplatFormat.SPZ)

    def offered_by(path: Path) -> list[str]:
        session.notices = ()
        session.open(path)
        finish(session)
        session.tick(0.1)
        said: tuple[Notice, ...] = session.notices
        return [notice.text.split()[0] for notice in said if "was saved of" in notice.text]

    sources = (folder, folder / "room.ply", folder / "cup.ply", folder / "cup.spz")
    saved: dict[Path, str] = {}
    for source in sources:
        assert offered_by(source) == [], source
        assert session.title == source.name
        session.save()
        finish(session)
        session.tick(0.1)
        project = session.need().project.path
        assert project is not None
        assert project.parent == folder
        saved[source] = project.name
        assert session.settings.recent[0] == str(project)
        assert str(source) not in session.settings.recent
    assert saved[folder] == "room.gaga"
    assert len(set(saved.values())) == len(sources)
    for source in sources:
        assert offered_by(source) == [saved[source]], source
        assert session.settings.recent[0] == str(source)
    session.open(folder / "room.gaga")
    finish(session)
    assert session.need().project.manifest == folder / "groups.json"
    reloaded = run_stage(reopen_stage(session.need().project)).scene
    assert reloaded.labels.tolist() == session.need().scene.labels.tolist()


def test_recent_files_are_remembered(session: Session, scene_folder: Path) -> None:
    assert session.settings.recent == (str(scene_folder),)
    assert load_settings()[0].recent == (str(scene_folder),)


def test_a_scene_is_listed_once_however_it_is_opened(
    associated: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its folder, its project or the file in that, from anywhere; and once it is saved."""
    associated.save()
    assert associated.jobs.wait()
    associated.tick(0.1)
    root = associated.need().project.folder
    assert root is not None
    monkeypatch.chdir(root.root.parent)
    (tmp_path / "link").symlink_to(root.root, target_is_directory=True)
    inside = (Path("gaga"), Path("gaga/project.json"))
    ways = [Path(root.root.name), tmp_path / "link", *(root.root / one for one in inside)]
    for way in ways:
        associated.open(way)
        assert associated.jobs.wait()
        associated.tick(0.1)
        assert associated.settings.recent == (str(root.root.resolve()),), way
        assert not any("was made of" in notice.text for notice in associated.notices), way
    file = tmp_path / "bowl.ply"
    write_ply(file, objects_scene(2, 30, n_cameras=1).gaussians)
    sog = tmp_path / "sog"
    write_splats(tmp_path / "one.sog", random_gaussians(50, seed=2), SplatFormat.SOG)
    shutil.unpack_archive(tmp_path / "one.sog", sog, "zip")
    associated.open(file)
    assert associated.jobs.wait()
    associated.save()
    assert associated.jobs.wait()
    associated.tick(0.1)
    project = tmp_path / "bowl.gaga"
    for way in (project / "project.json", project):
        associated.open(way)
        assert associated.jobs.wait()
        associated.tick(0.1)
        assert associated.settings.recent == (str(project), str(root.root.resolve())), way
    for way in (sog / "meta.json", sog):
        associated.open(way)
        assert associated.jobs.wait()
        associated.tick(0.1)
        assert associated.settings.recent[:2] == (str(sog), str(project)), way


def test_a_lone_splat_file(new_session: Callable[[], Session], scene_folder: Path) -> None:
    session = new_session()
    session.open(scene_folder / "point_cloud.ply")
    finish(session)
    assert session.title == "point_cloud.ply"
    assert session.cameras == ()
    offer = association.stage_offer(session)
    assert offer is not None
    assert not offer.action
    assert session.pick(_W / 2, _H / 2, _W, _H) is not None  # the first view shows it


@pytest.mark.parametrize("is_home", [False, True])
def test_a_room_without_photos_is_looked_into(
    new_session: Callable[[], Session], is_home: bool
) -> None:
    """From the front of most models the demo's room shows the back of a wall; Home shows it as it
    was first, wherever the whole scene was moved to."""
    session = new_session()
    session.open(assets() / "demo" / "point_cloud.sog")
    finish(session)
    if is_home:
        matrix = np.column_stack([50 * np.eye(3), [900.0, -300.0, 70.0]])
        session.edit(lambda scene: edits.move_scene(scene, matrix, "Set scale"))
        session.show_start()
    view = session.rig.camera(320, 240)
    picture = choose("cpu").render(bake(scene_of(session)), view)
    teapot = np.array([[-0.15, 0.03, 0.80, 1.0]]) @ scene_of(session).frame.world[:3].T
    pixels, depths = view.project(teapot)
    u, v = pixels[0].astype(int)
    assert picture.median_depth[v, u] > 0.9 * depths[0]


def test_a_folder_without_masks_offers_to_make_them(
    new_session: Callable[[], Session], scene_folder: Path
) -> None:
    shutil.rmtree(scene_folder / "masks")
    session = new_session()
    session.open(scene_folder)
    finish(session)
    offer = association.stage_offer(session)
    assert offer is not None
    assert "no masks" in offer.reason
    assert offer.command == "object.masks_quick"
    association.associate(session)
    assert "no masks" in session.notices[-1].text
    assert session.jobs.running is None


# --- unsaved edits


def test_a_selection_is_nothing_to_save(associated: Session) -> None:
    first, second = objects_of(associated)[:2]
    selection.select_groups(associated, (first,))
    assert not associated.unsaved
    objects.rename(associated, first, "mug")
    assert associated.unsaved
    assert associated.title.endswith("*")
    selection.select_groups(associated, (second,))
    assert associated.unsaved
    associated.undo()
    associated.undo()
    assert not associated.unsaved
    associated.redo()
    assert associated.unsaved
    associated.undo()
    selection.select_groups(associated, (second,))
    assert not associated.unsaved


def test_what_was_undone_can_be_redone_after_a_deselection(associated: Session) -> None:
    selection.select_groups(associated, (1,))
    assert objects.delete(associated)
    deleted, state = associated.need().scene.state.tobytes(), associated.need().history.state_id
    associated.undo()
    assert run("edit.cancel", associated)
    assert not associated.selected_groups()
    assert associated.need().redo_title.startswith("Delete")
    associated.redo()
    document = associated.need()
    assert (document.scene.state.tobytes(), document.history.state_id) == (deleted, state)
    associated.undo()
    assert not associated.selected_groups()


def test_saved_edits_are_saved_until_one_is_undone(associated: Session) -> None:
    objects.rename(associated, objects_of(associated)[0], "mug")
    associated.save()
    finish(associated)
    assert not associated.unsaved
    associated.undo()
    assert associated.unsaved
    associated.redo()
    assert not associated.unsaved


@pytest.mark.parametrize("choice", ["Save", "Discard", "Cancel"])
def test_closing_asks_about_unsaved_edits(
    associated: Session, new_session: Callable[[], Session], choice: str
) -> None:
    group = objects_of(associated)[0]
    folder = associated.need().project.folder
    assert folder is not None
    objects.rename(associated, group, "mug")
    associated.close()
    question = associated.pending_question
    assert question is not None
    assert question.choices == ("Save", "Discard", "Cancel")
    assert associated.scene is not None
    associated.answer(choice)
    finish(associated)
    assert associated.pending_question is None
    assert (associated.scene is None) == (choice != "Cancel")
    again = new_session()
    again.open(folder.root)
    finish(again)
    assert (again.need().name_of(group) == "mug") == (choice == "Save")


def test_a_question_names_what_a_save_writes(session: Session, tmp_path: Path) -> None:
    """It asked about changes to x.spz, which no save touches."""
    file = tmp_path / "x.spz"
    write_splats(file, objects_scene(2, 30, n_cameras=1).gaussians, SplatFormat.SPZ)
    for opened, named in (
        (file, "x.spz as x.gaga"),
        (file, "x.spz as x.2.gaga"),
        (tmp_path / "x.2.gaga", "x.2.gaga"),
    ):
        session.open(opened)
        finish(session)
        for group, words in ((1, named), (2, named.rpartition(" ")[2])):  # the first save, the next
            session.need().select(np.arange(5 * group, dtype=np.int32), "set", "Select")
            assert objects.separate(session)
            session.close()
            assert session.pending_question is not None
            assert f"changes to {words} before" in session.pending_question.text
            session.answer("Cancel")
            _endless(session)
            session.quit()
            assert session.pending_question is not None
            assert words.rpartition(" ")[2] in session.pending_question.text
            session.answer("Cancel")
            session.jobs.cancel()
            finish(session)
            session.save()
            finish(session)
            assert session.title == words.rpartition(" ")[2]
            assert (tmp_path / session.title / "project.json").is_file()


def test_quitting_and_opening_ask_too(associated: Session, scene_folder: Path) -> None:
    objects.rename(associated, objects_of(associated)[0], "mug")
    associated.quit()
    associated.answer("Cancel")
    assert not associated.should_quit
    associated.open(scene_folder)
    finish(associated)
    assert associated.unsaved
    associated.answer("Discard")
    assert not associated.unsaved
    associated.quit()
    assert associated.should_quit


def test_nothing_is_asked_before_what_cannot_be_opened(associated: Session, tmp_path: Path) -> None:
    objects.rename(associated, objects_of(associated)[0], "mug")
    document = associated.document
    (tmp_path / "notes.txt").write_text("no splats")
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\n")
    (tmp_path / "empty").mkdir()
    for name in ("notes.txt", "broken.ply", "empty", "none.ply"):
        associated.open(tmp_path / name)
        assert associated.pending_question is None
        assert associated.jobs.wait()
        assert associated.pending_question is None
        assert associated.notices[-1].level is Level.ERROR
        assert associated.document is document


def test_an_edit_while_a_scene_is_opened_is_not_lost_without_a_question(
    associated: Session, tmp_path: Path
) -> None:
    write_ply(tmp_path / "other.ply", random_gaussians(20))
    document = associated.document
    associated.open(tmp_path / "other.ply")
    objects.rename(associated, objects_of(associated)[0], "mug")
    finish(associated)
    assert associated.document is document
    associated.answer("Cancel")
    assert associated.document is document
    assert associated.unsaved


def test_what_is_saved_before_its_own_project_is_opened_again_is_in_it(associated: Session) -> None:
    group, folder = objects_of(associated)[0], associated.need().project.folder
    assert folder is not None
    objects.rename(associated, group, "mug")
    associated.open(folder.root)
    finish(associated)
    document = associated.document
    associated.answer("Save")
    finish(associated)
    assert associated.document is not document
    assert associated.need().name_of(group) == "mug"


def test_a_save_that_fails_keeps_the_document_open(associated: Session, tmp_path: Path) -> None:
    objects.rename(associated, objects_of(associated)[0], "mug")
    (tmp_path / "file").write_text("")
    associated.save(tmp_path / "file" / "project", then=associated.close)
    assert associated.jobs.wait()
    assert associated.notices[-1].level is Level.ERROR
    assert associated.scene is not None
    assert associated.unsaved


# --- while a job runs


def _endless(session: Session, *, resumes: bool = False) -> None:
    def stage() -> Stage[None]:
        while True:
            time.sleep(0.001)
            yield Progress("Film", 1, 3)

    session.jobs.start("Film out.mp4", stage(), resumes=resumes)


def test_a_mask_is_lit_while_a_job_runs(associated: Session) -> None:
    _endless(associated)
    assert command("object.quality").enabled(associated) == "Film out.mp4 is still running."
    for name in ("view.lights_masks", "view.mask_gate"):
        assert not command(name).enabled(associated)
    associated.close()
    assert all(command(f"view.{x}").enabled(associated) for x in ("lights_masks", "mask_gate"))


def test_saving_works_while_a_job_runs(
    associated: Session, new_session: Callable[[], Session]
) -> None:
    group = objects_of(associated)[0]
    objects.rename(associated, group, "mug")
    _endless(associated)
    assert not command("file.save").enabled(associated)
    assert run("file.save", associated)
    objects.rename(associated, group, "jug")
    associated.save()  # waits for the first
    end = time.monotonic() + 60
    while associated.unsaved and time.monotonic() < end:
        associated.tick(0.01)
    assert not associated.unsaved
    assert associated.jobs.at_risk is not None
    associated.jobs.cancel()
    finish(associated)
    folder = associated.need().project.folder
    assert folder is not None
    again = new_session()
    again.open(folder.root)
    finish(again)
    assert again.need().name_of(group) == "jug"


def test_quitting_asks_while_a_job_runs(associated: Session) -> None:
    _endless(associated)
    associated.quit()
    assert associated.pending_question is not None
    assert "Film out.mp4" in associated.pending_question.text
    associated.answer("Cancel")
    assert not associated.should_quit
    objects.rename(associated, objects_of(associated)[0], "mug")
    associated.quit()
    question = associated.pending_question
    assert question is not None
    for lost in ("Film out.mp4 is still running", "has unsaved changes"):
        assert lost in question.text
    associated.answer("Save and quit")
    assert associated.pending_question is None, "one question"
    end = time.monotonic() + 60
    while not associated.should_quit and time.monotonic() < end:
        associated.tick(0.01)
    assert associated.should_quit
    assert not associated.unsaved


@pytest.mark.parametrize("resumes", [False, True])
def test_the_question_at_the_end_says_what_can_go_on(associated: Session, *, resumes: bool) -> None:
    """Of a training, which goes on from its checkpoint, it was said that its work is lost."""
    _endless(associated, resumes=resumes)
    associated.quit()
    question = associated.pending_question
    assert question is not None
    assert ("can go on later" in question.text) is resumes
    assert ("is lost" in question.text) is not resumes
    associated.answer("Cancel")
    associated.jobs.cancel()


@pytest.mark.parametrize("waits", ["", "Clean edges"])
def test_saving_says_that_a_preview_is_not_in_it(associated: Session, waits: str) -> None:
    document = associated.need()
    if waits:
        edit = edits.delete(document.scene, np.arange(9))
        assert edit is not None
        document.show(edit, waits_as=waits)
    associated.save()
    end = time.monotonic() + 60
    while not any("Saved to" in notice.text for notice in associated.notices):
        assert time.monotonic() < end
        associated.tick(0.01)
    (said,) = (notice.text for notice in associated.notices if "Saved to" in notice.text)
    assert ("The preview of Clean edges is not applied" in said) is bool(waits)


@pytest.mark.parametrize(("runs", "waits", "unsaved"), list(product([False, True], repeat=3))[1:])
def test_enter_loses_nothing_at_the_end(
    associated: Session, *, runs: bool, waits: bool, unsaved: bool
) -> None:
    """Enter at the end of the program ended a training, or dropped a preview."""
    document = associated.need()
    if unsaved:
        objects.rename(associated, objects_of(associated)[0], "mug")
    if waits:
        edit = edits.delete(document.scene, np.arange(9))
        assert edit is not None
        document.show(edit, waits_as="Clean edges")
    if runs:
        _endless(associated)
    associated.quit()
    question = associated.pending_question
    assert question is not None
    assert (question.by_enter == "Cancel") is (runs or waits)
    associated.answer(question.by_enter)
    assert (associated.jobs.at_risk is not None) is runs
    assert bool(document.waiting) is waits
    is_at_risk, end = runs or waits, time.monotonic() + 60
    while not (is_at_risk or associated.should_quit) and time.monotonic() < end:
        associated.tick(0.01)
    assert associated.should_quit is not is_at_risk, "saved, or not at all"
    assert document.unsaved is (unsaved and is_at_risk)
    if runs:
        associated.jobs.cancel()


def test_escape_says_what_ends_a_task_that_it_does_not_end(associated: Session) -> None:
    assert command("edit.cancel").enabled(associated) == "There is nothing to cancel."
    _endless(associated)
    assert not run("edit.cancel", associated)
    assert "Film out.mp4 goes on" in associated.hint
    run("job.cancel", associated)
    assert "Film out.mp4 goes on" not in associated.hint, "it does not"
    assert not run("edit.cancel", associated)
    finish(associated)
    assert associated.hint == "", "true until the task ends"
    assert command("edit.cancel").enabled(associated) == "There is nothing to cancel."


@pytest.mark.parametrize("is_seen", [False, True])
def test_a_question_about_a_job_that_ends_behind_it_is_asked_anew(
    associated: Session, *, is_seen: bool
) -> None:
    """*Quit* dropped what *Find objects* had found meanwhile, and the recovered edits: the question
    still said that it was running."""
    go_on = Event()

    def stage() -> Stage[None]:
        while not go_on.is_set():
            time.sleep(0.001)
            yield Progress("Recover", 1, 3)

    def done(_: None) -> None:
        objects.rename(associated, objects_of(associated)[0], "mug")

    associated.jobs.start("Recover", stage(), on_done=done)
    associated.quit()
    go_on.set()
    assert associated.jobs.wait()
    if is_seen:
        associated.tick(0.01)
    else:
        associated.answer("Quit")
    assert not associated.should_quit
    question = associated.pending_question
    assert question is not None
    assert "Save the changes" in question.text
    associated.answer("Cancel")
    _endless(associated)
    associated.save()
    while associated.unsaved:
        associated.tick(0.01)
    associated.quit()
    associated.jobs.cancel()
    assert associated.jobs.wait()
    associated.tick(0.01)
    assert associated.pending_question is not None
    assert associated.pending_question.text == "What was running is done."
    assert not associated.should_quit, "nobody said so"
    associated.answer("Quit")
    assert associated.should_quit


def test_the_end_of_the_program_waits_for_saves(associated: Session) -> None:
    group = objects_of(associated)[0]
    folder = associated.need().project.folder
    assert folder is not None
    for name in ("a", "b", "c"):
        objects.rename(associated, group, name)
        associated.save()
    associated.shut_down()
    assert run_stage(open_path_stage(folder.root)).scene.names[group] == "c"


# --- association


def test_association_shows_the_bank_and_is_one_edit(session: Session) -> None:
    before = snapshot(scene_of(session))
    association.associate(session)
    assert association.stage_offer(session) is None
    seen: list[int] = []
    end = time.monotonic() + 60
    while session.jobs.running is not None and time.monotonic() < end:
        session.tick(1 / 60)
        if session.live is not None:
            assert session.live_labels is not None
            seen.append(int((session.objects().ids > 0).sum()))
    assert session.live is None
    assert session.live_labels is None
    assert seen == sorted(seen)
    scene, truth = scene_of(session), true_labels()
    found = set()
    for ball in range(1, 6):  # splats of the floor that no photo shows may belong to any
        owners = np.bincount(scene.labels[truth == ball])
        assert owners.max() > 0.9 * owners.sum()
        found.add(int(owners.argmax()))
    assert found <= set(objects_of(session))
    assert len(found) == 5
    assert session.history is not None
    assert [e.title for e in session.history.entries()] == ["Find objects"]
    n_objects = len(objects_of(session))
    assert session.notices[-1].text == f"Found {n_objects} objects."
    group = objects_of(session)[0]
    assert {d.group for d in session.decisions(group)} == {group}
    assert session.objects().n_views[session.objects().row(group)] > 0
    session.undo()
    assert snapshot(scene) == before
    assert session.decisions(group) == ()
    session.redo()
    assert len(objects_of(session)) == n_objects


def test_what_a_person_changed_stays_when_objects_are_found_again(session: Session) -> None:
    association.associate(session, preset="robust")
    finish(session)
    scene = scene_of(session)
    by_size = sorted(objects_of(session), key=lambda k: -int((scene.labels == k).sum()))
    one, other, third, named = by_size[:4]
    selection.select_groups(session, (named,))
    objects.rename(session, named, "a ball")
    of_name = scene.labels == named
    selection.select_groups(session, (one, other))
    assert objects.merge(session)
    joined = scene.labels == one
    part = np.flatnonzero(scene.labels == third)[::2]
    session.edit(lambda scene: edits.select(scene, part, "set"))
    assert run("object.separate", session)
    divided = np.isin(np.arange(len(scene)), part)
    association.associate(session, preset="robust")
    finish(session)
    for whole in (joined, divided):
        (group,) = np.unique(scene.labels[whole])
        np.testing.assert_array_equal(scene.labels == group, whole)
    (group,) = (k for k, name in scene.names.items() if name == "a ball")
    np.testing.assert_array_equal(scene.labels == group, of_name)
    assert "stay as you changed them" in session.notices[-1].text
    session.undo()
    np.testing.assert_array_equal(scene.labels == one, joined)


def test_cancelled_association_leaves_everything(session: Session) -> None:
    before = snapshot(scene_of(session))
    association.associate(session)
    session.jobs.cancel()
    finish(session)
    session.tick(0)
    assert session.live is None
    assert snapshot(scene_of(session)) == before
    assert session.history is not None
    assert not session.history.can_undo
    assert association.stage_offer(session) is not None


def test_what_is_done_while_objects_are_found_stays(associated: Session) -> None:
    """A copy made meanwhile and its original became one object."""
    scene, document = scene_of(associated), associated.need()
    n, (a, b, c, d) = len(scene), objects_of(associated)[:4]
    association.associate(associated)
    selection.select_groups(associated, (a,))
    assert transform.duplicate(associated)
    copy = int(scene.labels[-1])
    assert objects.rename(associated, copy, "copy")
    assert document.edit(lambda scene: edits.merge_groups(scene, (b, c)))
    both = scene.labels == b
    gone = np.flatnonzero(scene.labels == d)
    assert document.edit(lambda scene: edits.delete(scene, gone))
    where = world_means(scene)
    finish(associated)
    (now,) = set(scene.labels[n:].tolist())
    assert scene.names == {now: "copy"}
    assert now not in scene.labels[:n]
    assert np.array_equal(scene.labels == scene.labels[both][0], both)
    assert scene.has(State.DELETED)[gone].all()
    assert np.array_equal(world_means(scene), where)


def test_unknown_masks_are_a_sentence(session: Session) -> None:
    association.associate(session, "none")
    assert session.notices[-1].level is Level.ERROR
    assert "made" in session.notices[-1].text


def test_the_demo_opens_ready_for_its_objects(new_session: Callable[[], Session]) -> None:
    session = new_session()
    session.open_demo()
    finish(session)
    assert len(scene_of(session)) > 100_000
    assert len(session.masks) == len(session.cameras) == 40
    assert association.stage_offer(session) is not None


def test_the_offer_counts_one_photo_as_one(
    new_session: Callable[[], Session], scene_folder: Path
) -> None:
    """ "1 photos have no masks yet." was offered."""
    shutil.rmtree(scene_folder / "masks")
    session = new_session()
    session.open(scene_folder)
    finish(session)
    offer, folder = association.stage_offer(session), session.need().project.folder
    assert offer is not None
    assert folder is not None
    assert folder.test
    said = [int(word) for word in offer.reason.split() if word.isdigit()]
    assert said == [len(folder.train), len(folder.test)], "those for testing get no masks"
    first, *others = sorted((scene_folder / "images").iterdir())
    for path in others:
        path.unlink()
    for start in ("1 photo has no masks", "The 8 photos are not in"):
        session = new_session()
        session.open(scene_folder)
        finish(session)
        offer = association.stage_offer(session)
        assert offer is not None
        assert offer.reason.startswith(start)
        first.unlink(missing_ok=True)


def test_a_question_waits_until_the_one_that_is_shown_is_answered(session: Session) -> None:
    """The answer of a save took the place of "Quit?" under the mouse; the quit was forgotten."""
    chosen: list[str] = []
    for text in ("Quit?", "Save elsewhere?", "Quit?"):
        session.pending_question = UserQuestion(text, ("Yes", "No"), chosen.append)
    assert session.pending_question is not None
    assert session.pending_question.text == "Quit?"
    session.answer("Yes")
    assert session.pending_question.text == "Save elsewhere?"
    session.answer("No")
    assert session.pending_question is None
    session.answer("Yes")
    assert chosen == ["Yes", "No"]
