"""From photos to splats in a session: offered, shown while trained, cancelled, gone on with."""

import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.cameras.transforms_json import write_transforms_json
from gaga_core.io.folder.scene_folder import World, find_model, known_world, write_world
from gaga_core.io.images import write_rgb
from gaga_core.pipeline.place import WORKSPACE
from gaga_core.pipeline.reconstruct import (
    SURFACES,
    look_at_photos,
    photos_again,
    reconstruct_scene,
)
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.placing import ladder
from gaga_core.placing.checks import Verdict
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.scene.project import open_path_stage
from gaga_studio.features import objects, reconstruction
from gaga_studio.features.commands import command, run
from gaga_studio.features.find import association
from gaga_studio.features.reconstruction import ReconstructionPlan
from gaga_studio.session.notices import Level, Request
from gaga_studio.session.session import Session
from gaga_studio.session.view import TrainingPreview, TrainingUpdate, smoothed
from tests.core.placing.photo_scenes import write_photos
from tests.scenes import objects_scene

TINY = ReconstructConfig(iterations=30, max_side=96)
LONG = replace(TINY, iterations=20_000)
LATER = replace(TINY, iterations=400)  # stopped in between, and gone on with to the end


@pytest.fixture
def room(placed_photos: Path, tmp_path: Path) -> Path:
    """A copy that a test may write to."""
    shutil.copytree(placed_photos, tmp_path / "room")
    return tmp_path / "room"


def opened(session: Session, path: Path) -> None:
    session.open(path)
    assert session.jobs.wait(300)


def started(session: Session, config: ReconstructConfig) -> None:
    """Start, and wait until splats are shown."""
    found = session.photos
    assert found is not None
    reconstruction.make(session, ReconstructionPlan(config, found.scene))
    until(session, lambda: session.training is not None and session.training.update is not None)


def until(session: Session, is_done: Callable[[], bool]) -> None:
    end = time.monotonic() + 300
    while not is_done():
        session.tick(0.02)
        time.sleep(0.01)
        assert time.monotonic() < end, session.notices


def test_photos_alone_become_an_open_scene(
    new_session: Callable[[], Session], tmp_path: Path
) -> None:
    write_photos(tmp_path / "shots", 6)
    first = min((tmp_path / "shots").iterdir())
    shutil.copy(first, first.with_stem("twin"))  # which is left out
    session = new_session()
    opened(session, tmp_path / "shots")
    found = session.photos
    assert found is not None
    assert session.document is None
    assert (found.n_photos, found.is_placed, found.scene) == (7, False, tmp_path / "shots-scene")
    made = command("file.make_splats")
    assert not made.enabled(session)
    assert made.title_now(session) == "Make splats from 7 photos"
    assert found.seconds(TINY) < found.seconds(ReconstructConfig())
    reconstruction.make(session, ReconstructionPlan(TINY, found.scene))
    assert made.enabled(session) == "Make splats from 7 photos is still running."
    assert session.jobs.wait(300)
    assert session.scene is not None, session.notices
    assert session.project is not None
    assert session.project.folder is not None
    assert session.project.folder.root == found.scene
    assert session.photos is None
    assert session.training is None
    assert len(session.cameras) == 6
    assert any("held out" in notice.text for notice in session.notices)
    offer = association.stage_offer(session)
    assert offer is not None
    assert "no masks" in offer.reason
    opened(session, tmp_path / "shots")  # again: what was made of them
    assert session.scene is not None
    assert session.notices[-1].text == "This is the scene that was made of shots."
    shutil.copy(first, first.with_stem("new"))
    opened(session, tmp_path / "shots")
    told = session.notices[-1]
    assert told.text.endswith("1 photo of the folder came since.")
    assert run(told.command, session), "they can be used again, in a folder of their own"
    assert session.request is Request.MAKE_SPLATS
    again = reconstruction.meant(session)
    assert again is not None
    assert session.photos is None, "the scene stays open until Start"
    assert (again.n_photos, again.is_placed) == (8, False)
    assert again.scene == tmp_path / "shots-scene-2"
    (again.scene / WORKSPACE).mkdir(parents=True)
    begun = photos_again(found.scene)
    assert begun is not None
    assert begun.scene == again.scene, "what was begun goes on"
    one = ReconstructionPlan(replace(TINY, iterations=1), again.scene)
    reconstruction.make_meant(session, one)
    assert session.jobs.wait(300)
    assert session.project is not None
    assert session.project.folder is not None
    assert session.project.folder.root == again.scene
    assert find_model(found.scene) is not None, "the former scene stays"
    assert reconstruction.meant(session) is None
    opened(session, tmp_path / "shots")
    assert session.project.folder.root == again.scene, "the last one that was made of them"
    assert session.notices[-1].text == "This is the scene that was made of shots."
    opened(session, found.scene)
    assert session.project.folder.root == found.scene


def test_splats_are_shown_while_they_train_and_a_cancelled_training_goes_on(
    new_session: Callable[[], Session], room: Path
) -> None:
    session = new_session()
    opened(session, room)
    started(session, LONG)
    training = session.training
    assert training is not None
    assert session.shown is training.scene
    assert session.cameras == training.cameras
    np.testing.assert_allclose(session.rig.eye, session.cameras[0].position, atol=1e-6)
    assert session.document is None
    for name in ("edit.delete", "file.save", "object.associate", "file.export_scene"):
        assert not run(name, session)
    session.jobs.cancel()
    assert session.jobs.wait(300)
    assert training.is_stopped
    assert SURFACES in session.rates.rates, "what was done tells of the next run"
    assert session.shown is training.scene, "it can still be looked at"
    reconstruction.leave_stopped(session)
    assert session.shown is None
    found = session.photos
    assert found is not None
    assert found.going_on == replace(LONG, only="all")
    assert 0 < found.iteration < LONG.train().iterations
    assert command("file.make_splats").title_now(session) == "Continue training"
    assert "stopped at" in reconstruction.found_text(found)
    assert not (room / "point_cloud.ply").exists()
    second = new_session()  # the next start of the program goes on there
    opened(second, room)
    assert second.photos == found
    assert run("file.make_splats", second)
    end = time.monotonic() + 300
    while second.training is None or second.training.update is None:
        second.tick(0.02)
        assert time.monotonic() < end
    assert second.training.update.iteration >= found.iteration
    second.jobs.cancel()
    assert second.jobs.wait(300)


def test_stop_here_keeps_a_scene_and_the_training_goes_on_to_the_same_splats(
    new_session: Callable[[], Session], room: Path, tmp_path: Path
) -> None:
    shutil.copytree(room, tmp_path / "whole")
    write_world(room, World(is_metric=True, up=(0, 0, 1), program="transforms.json"))
    session = new_session()
    opened(session, room)
    started(session, LATER)
    until(session, lambda: session.training is not None and session.training.update is not None)
    reconstruction.stop_here(session)
    until(session, lambda: session.scene is not None)
    assert not (room / "gaga-before").exists(), "there were no splats before"
    assert not any("former splats" in notice.text for notice in session.notices)
    assert known_world(room) == (True, (0, 0, 1)), "of the poses, which are the same"
    kept = len(session.need().scene)
    assert (room / "point_cloud.ply").is_file()
    going_on = command("file.go_on_training")
    assert not going_on.enabled(session)
    assert going_on.title_now(session).startswith("Go on training from ")
    (room / "gaga").mkdir(exist_ok=True)
    (room / "gaga" / "labels.npz").write_bytes(b"of the splats that were kept")
    session.need().select(np.arange(5, dtype=np.int32), "set", "Select")
    objects.separate(session)
    assert run("file.go_on_training", session)
    assert session.pending_question is not None, "objects are not lost without a word"
    assert "gaga-before" in session.pending_question.text
    session.answer("Cancel")
    assert session.scene is not None
    assert run("file.go_on_training", session)
    session.answer("Go on")
    assert session.pending_question is not None, "edits are not lost without a question"
    session.answer("Save")
    until(session, lambda: session.training is not None)
    session.jobs.cancel()
    assert session.jobs.wait(300)
    assert session.document is None
    reconstruction.leave_stopped(session)
    until(session, lambda: session.scene is not None)
    assert len(session.scene) == kept, "a cancelled training leaves the scene as it was"
    assert run("file.go_on_training", session)
    session.answer("Go on")
    until(session, lambda: session.training is not None)
    assert session.jobs.wait(300)
    session.tick(0.1)
    assert session.scene is not None, session.notices
    assert (room / "gaga-before" / "labels.npz").is_file()
    assert len(session.scene) != kept
    assert any("gaga-before" in notice.text for notice in session.notices)
    assert known_world(room) == (True, (0, 0, 1))
    assert session.scene.frame.is_metric
    before = run_stage(open_path_stage(room / "gaga-before"))
    assert len(before.scene) == kept
    assert (before.scene.labels > 0).sum() == 5
    assert not (room / ".gaga-reconstruct").exists()
    assert going_on.enabled(session)
    run_stage(reconstruct_scene(None, tmp_path / "whole", LATER))
    paths = [folder / "point_cloud.ply" for folder in (room, tmp_path / "whole")]
    assert paths[0].read_bytes() == paths[1].read_bytes(), "as without the stop"


def test_the_picture_turns_while_splats_are_trained_until_it_is_moved_by_hand(
    new_session: Callable[[], Session],
) -> None:
    made = objects_scene(2, 20, n_cameras=4)
    session = new_session()
    session.training = training = TrainingPreview("room", 100)
    training.take(TrainingUpdate(made.cameras, gaussians=made.gaussians))

    def turned(seconds: float, *, dt: float = 0.1, is_drawn: bool = True, took: float = 0) -> float:
        before = session.rig.pose.yaw
        for _ in range(round(seconds / dt)):
            reconstruction.tick(session, dt, is_drawn, took)
        return float((session.rig.pose.yaw - before) % (2 * np.pi))

    distance, scene = session.rig.pose.distance, training.scene
    assert scene is not None
    training.take(TrainingUpdate(made.cameras, gaussians=replace(made.gaussians)))
    before = scene.revision.splats
    assert turned(1, is_drawn=False) == 0
    assert scene.revision.splats == before, "new splats wait for the picture of the former ones"
    assert turned(2.5) == 0
    assert scene.revision.splats == before + 1
    assert np.degrees(turned(11)) > 60
    assert session.rig.pose.distance == pytest.approx(distance, rel=0.05)
    assert turned(5, is_drawn=False) == 0
    assert 0 < turned(1) < np.radians(20), "what was missed is not made up for in one jump"
    switch = command("view.turn_in_training")
    assert switch.is_on is not None
    moves: tuple[Callable[[], object], ...] = (
        lambda: session.rig.orbit(30, 0),
        lambda: session.rig.go_to(made.cameras[1], animated=False),
        lambda: session.rig.go_to(made.cameras[2]),
    )
    for move in moves:
        assert switch.is_on(session)
        move()
        session.rig.update(10)
        assert turned(20) == 0, "it went on from there, off the photos"
        assert not switch.is_on(session)
        assert session.settings.turns_in_training, "the next training turns"
        run("view.turn_in_training", session)
        assert turned(1) > 0
    steps = [turned(0.1, took=0.4) for _ in range(40)]
    assert 1 <= np.count_nonzero(steps) <= 2, "drawing takes a fifth of the time"
    run("view.turn_in_training", session)
    assert turned(9) == 0
    before = scene.revision.splats
    for _ in range(40):
        training.take(TrainingUpdate(made.cameras, gaussians=replace(made.gaussians)))
        turned(0.1, took=0.4)
    assert 1 <= scene.revision.splats - before <= 3, "and so for the newest splats"
    run("view.turn_in_training", session)
    training.is_stopped = True
    assert turned(9) == 0


def test_the_picture_swings_where_photos_are_on_one_side(
    new_session: Callable[[], Session],
) -> None:
    """Once around it would show the wall behind the thing from inside."""
    made = objects_scene(2, 20, n_cameras=12)
    session = new_session()
    front = tuple(camera for camera in made.cameras if camera.position[1] > 0)
    session.training = training = TrainingPreview("room", 100)
    training.take(TrainingUpdate(front, gaussians=made.gaussians))
    session.rig.go_to(front[0], animated=False)
    eyes = []
    for _ in range(600):
        reconstruction.tick(session, 0.1, True, 0.0)
        eyes.append(session.rig.eye)
    places = np.array([camera.position for camera in front])
    assert len(front) > 3
    assert np.ptp(eyes, axis=0).max() > 0.3 * np.ptp(places, axis=0).max()
    assert np.min(eyes, axis=0)[1] > places[:, 1].min() - 0.1 * np.ptp(places)


def test_a_wrong_model_is_a_question_and_can_be_used_anyway(
    new_session: Callable[[], Session], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_photos(tmp_path / "room" / "images", 6)
    wrong = (Verdict("focal", "error", "The focal length ran away. Give it with --focal."),)
    monkeypatch.setattr(ladder, "check_model", lambda *_: wrong)
    session = new_session()
    opened(session, tmp_path / "room")
    found = session.photos
    assert found is not None
    one_attempt = replace(TINY, place_minutes=0.001)
    reconstruction.make(session, ReconstructionPlan(one_attempt, found.scene))
    assert session.jobs.wait(300)
    question = session.pending_question
    assert question is not None
    assert "focal length ran away" in question.text
    assert "window" not in question.text, "it names the window's own controls"
    assert "Minutes for placing in Settings gives more" in question.text
    assert session.photos is not None
    session.answer("Use it anyway")
    assert session.jobs.wait(300)
    assert session.scene is not None, session.notices
    assert any("ran away" in n.text and n.level is Level.WARNING for n in session.notices)


def test_errors_are_one_sentence_and_the_photos_stay_open(
    new_session: Callable[[], Session], room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> Stage[None]:
        yield Progress("Place photos", 0, 1)
        raise GagaError("No photo overlaps another.")

    monkeypatch.setattr("gaga_core.pipeline.reconstruct.reconstruct_scene", fails)
    session = new_session()
    opened(session, room)
    assert run("file.make_splats", session)
    assert session.jobs.wait(300)
    assert session.notices[-1].level is Level.ERROR
    assert session.photos is not None
    assert session.training is None
    assert not (room / "point_cloud.ply").exists()


def test_a_newer_copy_replaces_the_splats_in_the_same_scene() -> None:
    small, large = (objects_scene(2, n, n_cameras=2).gaussians for n in (20, 30))
    camera = objects_scene(2, 20, n_cameras=2).cameras[0]
    training = TrainingPreview("room", 100)
    assert training.take(TrainingUpdate((camera,), gaussians=small))
    scene = training.scene
    assert scene is not None
    before = scene.revision.splats
    assert not training.take(TrainingUpdate((camera,), gaussians=small))
    assert scene.revision.splats == before
    assert not training.take(TrainingUpdate((camera,), gaussians=large))
    assert scene.revision.splats == before
    training.show()
    assert training.scene is scene
    assert scene.revision.splats == before + 1
    assert scene.revision.rows_kept_since(before) == 0
    assert len(scene.labels) == len(scene.state) == len(scene.source) == len(large)


def test_a_curve_of_losses_keeps_their_mean() -> None:
    losses = np.random.default_rng(0).uniform(0, 1, 1000)
    curve = smoothed(losses, 100)
    assert len(curve) == 100
    assert np.mean([y for _, y in curve]) == pytest.approx(losses.mean())
    assert curve[-1][0] == 1000
    assert smoothed([]) == []
    assert smoothed([3.0]) == [(1.0, 3.0)]


def test_what_a_path_means(tmp_path: Path) -> None:
    write_photos(tmp_path / "plain", 3)
    room, images = tmp_path / "room", tmp_path / "room" / "images"
    write_photos(images, 3)
    write_photos(tmp_path / "begun" / "images", 3)
    (tmp_path / "begun" / ".gaga-reconstruct").mkdir()
    for path, photos, scene in (
        (tmp_path / "plain", tmp_path / "plain", tmp_path / "plain-scene"),
        (room, None, room),
        (images, images, room / "room-images-scene"),
        (tmp_path / "begun" / "images", None, tmp_path / "begun"),
    ):
        found = look_at_photos(path)
        assert found is not None
        assert (found.photos, found.scene) == (photos, scene)
        assert (found.n_photos, found.size) == (3, (320, 240))
    assert look_at_photos(tmp_path) is None


@pytest.mark.parametrize("name", ["photos", "Photos", "rgb", "DCIM", "frames"])
@pytest.mark.parametrize("between", [(), ("input",)])
def test_a_folder_whose_name_says_nothing_has_that_of_what_it_is_in(
    name: str, between: tuple[str, ...], tmp_path: Path
) -> None:
    """Every scene was "photos-scene", in the title, among the recent ones and in exports."""
    folder = tmp_path.joinpath("tankard", *between, name)
    write_photos(folder, 3)
    found = look_at_photos(folder)
    assert found is not None
    assert found.name == "tankard"
    assert found.scene == folder.parent / f"tankard-{name}-scene", "two of them are two scenes"
    begun = folder.parent / f"{name}-scene"
    begun.mkdir()
    again = look_at_photos(folder)
    assert again is not None
    assert again.scene == begun, "it was begun under its own name"


@pytest.mark.parametrize("n", [1, 2, 3])
def test_too_few_photos_say_what_is_missing(
    new_session: Callable[[], Session], tmp_path: Path, n: int
) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for i in range(n):
        write_rgb(folder / f"{i}.png", np.full((32, 48, 3), 0.2 * i, np.float32))
    session = new_session()
    session.open(folder)
    assert session.jobs.wait()
    assert session.photos is not None
    plural = "" if n == 1 else "s"
    assert reconstruction.title(session) == f"Make splats from {n} photo{plural}"
    assert ("it takes at least 3" in reconstruction.why_not(session)) == (n < 3)


def test_what_given_poses_tell_is_no_warning_but_what_they_lack_is(
    new_session: Callable[[], Session], tmp_path: Path
) -> None:
    room = tmp_path / "room"
    cameras = write_photos(room / "images", 9)
    images = {camera.name: room / "images" / camera.name for camera in cameras}
    write_transforms_json(room / "transforms.json", list(cameras), images)
    images[cameras[0].name].unlink()
    session = new_session()
    opened(session, room)
    found = session.photos
    assert found is not None
    config = replace(TINY, poses="keep")
    reconstruction.make(session, ReconstructionPlan(config, found.scene))
    assert session.jobs.wait(300)
    assert session.scene is not None, session.notices
    levels = {notice.text: notice.level for notice in session.notices}
    of_poses = {level for text, level in levels.items() if "poses of" in text}
    of_missing = {level for text, level in levels.items() if "are not here" in text}
    assert (of_poses, of_missing) == ({Level.INFO}, {Level.WARNING}), levels
