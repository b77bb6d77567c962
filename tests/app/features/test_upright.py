"""Files that do not say how they stand: asked about once, turned from then on."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.edit_script import run_script
from gaga_core.export.export import export_scene_stage
from gaga_core.export.options import ExportOptions
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats
from gaga_core.io.splats.splat_files import SplatFormat, write_splats
from gaga_core.progress import run_stage
from gaga_core.scene import edits, orientation
from gaga_core.scene.orientation import upright_basis
from gaga_core.scene.project import save_project
from gaga_core.scene.scene import Scene
from gaga_studio.features import upright
from gaga_studio.features.commands import command, run
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session
from gaga_studio.session.settings import load_settings
from tests.core.io.splat_parts import write_without_up
from tests.scenes import random_gaussians


@pytest.fixture
def silent(tmp_path: Path) -> Path:
    """An .spz that does not say how it stands."""
    path = tmp_path / "toy.spz"
    write_without_up(path, random_gaussians(60, seed=4))
    return path


def _opened(session: Session, path: Path) -> np.ndarray:
    """Where the splats stand."""
    session.open(path)
    assert session.jobs.wait()
    scene = session.scene
    assert scene is not None, session.notices
    matrices = scene.placements.matrix[scene.placement]
    means = np.einsum("nij,nj->ni", matrices[:, :, :3], scene.gaussians.means)
    result: np.ndarray = means + matrices[:, :, 3]
    return result


def test_a_turned_file_is_turned_when_it_is_opened_again(
    new_session: Callable[[], Session], silent: Path
) -> None:
    session = new_session()
    before = _opened(session, silent)
    assert session.notices[-1].command == upright.COMMAND
    assert session.notices[-1].otherwise == upright.LEAVE
    assert run(upright.COMMAND, session)
    assert session.unsaved
    assert load_settings()[0].upright == (str(silent),)
    other = new_session()
    other.settings = load_settings()[0]
    again = _opened(other, silent)
    np.testing.assert_allclose(again, before * [1, -1, -1], atol=1e-6)
    assert not other.unsaved
    assert not any(notice.command for notice in other.notices)
    assert run(upright.COMMAND, other)  # back, and forgotten
    assert load_settings()[0].upright == ()
    other.undo()
    other.undo()
    third = new_session()
    np.testing.assert_allclose(_opened(third, silent), before, atol=1e-6)


def test_a_file_that_stands_upright_is_not_asked_about_again(
    new_session: Callable[[], Session], silent: Path
) -> None:
    session = new_session()
    _opened(session, silent)
    assert run(upright.LEAVE, session)
    assert not session.unsaved
    other = new_session()
    other.settings = load_settings()[0]
    _opened(other, silent)
    assert not any(notice.command for notice in other.notices)
    assert "You said" in command(upright.COMMAND).enabled(other)
    assert not run(upright.COMMAND, other)
    is_ticked = command(upright.LEAVE).is_on
    assert is_ticked is not None
    assert is_ticked(other)
    assert run(upright.LEAVE, other)  # a second thought counts
    assert load_settings()[0].as_filed == ()
    assert not is_ticked(other)
    assert run(upright.COMMAND, other)
    assert load_settings()[0].upright == (str(silent),)


@pytest.mark.parametrize("answer", [upright.COMMAND, upright.LEAVE])
def test_the_question_goes_once_it_is_answered_anywhere(
    new_session: Callable[[], Session], silent: Path, answer: str
) -> None:
    """A turn by the menu left the card, whose button turned the scene onto its head again."""
    session = new_session()
    _opened(session, silent)
    assert any(notice.otherwise for notice in session.notices)
    assert run("view.home", session)
    assert any(notice.otherwise for notice in session.notices), "that is no answer"
    assert run(answer, session)
    assert not any(notice.otherwise for notice in session.notices)


def test_what_is_reset_stays_upright_in_a_scene_that_was_turned(
    new_session: Callable[[], Session], silent: Path
) -> None:
    session = new_session()
    before = _opened(session, silent)
    assert run(upright.COMMAND, session)
    scene = session.need().scene
    session.need().do(edits.transform(scene, np.arange(9), np.eye(3, 4) * 2, "Move"))
    scene = session.need().scene
    session.need().do(edits.reset_placement(scene, np.arange(9)))
    rows = session.need().scene.placements.matrix[session.need().scene.placement]
    means = np.einsum("nij,nj->ni", rows[:, :, :3], session.need().scene.gaussians.means)
    np.testing.assert_allclose(means, before * [1, -1, -1], atol=1e-6)


def test_a_file_that_says_how_it_stands_is_not_asked_about(
    new_session: Callable[[], Session], tmp_path: Path
) -> None:
    for form in (SplatFormat.SPZ, SplatFormat.PLY):
        path = tmp_path / f"a{form.suffix}"
        write_splats(path, random_gaussians(60, seed=4), form)
        session = new_session()
        _opened(session, path)
        assert not any(notice.command for notice in session.notices)
        says = command(upright.COMMAND).enabled(session)
        assert bool(says) == (form is SplatFormat.SPZ), "a .ply can be turned all the same"
        assert run(upright.COMMAND, session) == (form is SplatFormat.PLY)
        assert "does not say" in command(upright.LEAVE).enabled(session), "a .ply says nothing"
        assert session.settings.upright == ()


def test_a_project_saved_before_files_were_read_this_way_opens_as_it_was(
    new_session: Callable[[], Session], silent: Path
) -> None:
    session = new_session()
    as_now = _opened(session, silent)
    where = save_project(session.need().project)
    note = where / "project.json"
    entries = json.loads(note.read_text())
    assert entries["model"].pop("axes") == "RDF"
    note.write_text(json.dumps(entries))
    for _ in range(2):  # the second time after it was saved by this version
        older = new_session()
        np.testing.assert_allclose(_opened(older, where), as_now * [1, -1, -1], atol=1e-6)
        save_project(older.need().project)
    assert json.loads(note.read_text())["model"]["axes"] == "RUB"


def test_a_project_of_a_turned_file_says_which_way_is_up(
    new_session: Callable[[], Session], silent: Path
) -> None:
    """`gaga export` wrote it upside down: what had been guessed was turned along."""
    session = new_session()
    _opened(session, silent)
    assert run(upright.COMMAND, session)
    up = session.rig.up.copy()
    np.testing.assert_allclose(session.need().project.up, up)
    save_project(session.need().project)
    again = new_session()
    _opened(again, silent.with_suffix(".gaga"))
    np.testing.assert_allclose(again.rig.up, up)
    np.testing.assert_allclose(again.need().project.up, up)


def test_what_a_script_laid_along_z_stands_when_it_is_opened(
    new_session: Callable[[], Session], tmp_path: Path
) -> None:
    write_splats(tmp_path / "plan.ply", _standing((0.0, 1.0, 0.0)))
    session = new_session()
    _opened(session, tmp_path / "plan.ply")
    np.testing.assert_allclose(session.rig.up, (0, 1, 0))
    points = [[-1, 0, -1], [-1, 0, 1], [1, 0, 0]]
    script = [{"op": "align_to_ground", "points": points, "seen_from": [0, 3, 0]}]
    document = session.need()
    run_script(document.scene, script, document.history)
    save_project(document.project)
    again = new_session()
    _opened(again, tmp_path / "plan.gaga")
    np.testing.assert_allclose(again.rig.up, (0, 0, 1))


def test_what_a_notice_offers_goes_with_its_scene(
    new_session: Callable[[], Session], silent: Path, tmp_path: Path
) -> None:
    session = new_session()
    _opened(session, silent)
    assert any(notice.command for notice in session.notices)
    session.notify(Level.INFO, "Exported chair.ply.", shows=tmp_path)
    session.notify(Level.INFO, "Saved.")
    path = tmp_path / "next.ply"
    write_splats(path, random_gaussians(60, seed=5), SplatFormat.PLY)
    _opened(session, path)
    assert not any(notice.command for notice in session.notices), "it would turn the other scene"
    assert not any(notice.shows for notice in session.notices)
    assert any(notice.text == "Saved." for notice in session.notices)


@pytest.mark.parametrize("form", [SplatFormat.GLB, SplatFormat.USD])
def test_what_was_exported_standing_stands_when_it_is_opened_again(
    new_session: Callable[[], Session], tmp_path: Path, form: SplatFormat
) -> None:
    """What is much longer than high, without a ground, was taken to stand along its length."""
    if form is SplatFormat.USD:
        pytest.importorskip("pxr")
    row, path = random_gaussians(300, seed=2), tmp_path / f"row{form.suffix}"
    row = replace(row, means=row.means * np.array([1, 4, 1], np.float32))
    options = ExportOptions(up=(0.0, 0.0, 1.0))
    run_stage(export_scene_stage(Scene.of(row), path, form=form, options=options))
    session = new_session()
    means = _opened(session, path)
    np.testing.assert_allclose(means @ session.rig.up, row.means[:, 2], atol=1e-4)


def _standing(up: tuple[float, float, float]) -> Gaussians:
    """A ground of flat splats with a few things above it, in a world with this up."""
    rng = np.random.default_rng(2)
    ground = rng.uniform([-2, -2, -0.01], [2, 2, 0.01], (400, 3))
    things = rng.uniform([-0.5, -0.5, 0], [0.5, 0.5, 1.5], (100, 3))
    turn = upright_basis(np.array(up)).T
    made = random_gaussians(500, seed=1)
    return replace(
        made,
        means=(np.concatenate([ground, things]) @ turn.T).astype(np.float32),
        log_scales=np.tile(np.log([0.1, 0.1, 0.001]).astype(np.float32), (500, 1)),
        quats=np.tile(matrices_to_quats(turn[None])[0].astype(np.float32), (500, 1)),
        logit_opacities=np.full(500, 4.0, np.float32),
    )


@pytest.mark.parametrize("says", ["ground", "file"])
@pytest.mark.parametrize("up", [(0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_what_is_known_to_stand_upright_is_not_turned_over(
    new_session: Callable[[], Session],
    tmp_path: Path,
    says: str,
    up: tuple[float, float, float],
) -> None:
    made = _standing(up) if says == "ground" else random_gaussians(60, seed=4).with_up(up)
    path = tmp_path / "thing.ply"
    write_splats(path, made, SplatFormat.PLY)
    session = new_session()
    _opened(session, path)
    np.testing.assert_allclose(session.rig.up, up, atol=1e-6)
    why = command(upright.COMMAND).enabled(session)
    assert ("ground shows" if says == "ground" else "file says") in why
    assert not run(upright.COMMAND, session)
    # Turned over by hand, or in a project that was saved so, it can be turned back, once.
    over = np.concatenate([np.diag([1.0, -1.0, -1.0]), np.zeros((3, 1))], axis=1)
    session.need().do(edits.move_scene(session.need().scene, over, "Rotate"))
    assert run(upright.COMMAND, session)
    np.testing.assert_allclose(session.need().world, np.eye(4), atol=1e-6)
    np.testing.assert_allclose(session.rig.up, up, atol=1e-6)
    assert command(upright.COMMAND).enabled(session) == why


@pytest.mark.parametrize("shows", [True, False])
def test_who_says_that_it_is_upright_is_found_once(
    new_session: Callable[[], Session],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    shows: bool,
) -> None:
    """An open menu asks in every frame."""
    made = _standing((0.0, -1.0, 0.0)) if shows else random_gaussians(60, seed=4)
    path = tmp_path / "thing.spz"
    write_splats(path, made, SplatFormat.SPZ)
    session = new_session()
    _opened(session, path)
    looked = list[Gaussians]()
    look = orientation._from_ground

    def counted(gaussians: Gaussians) -> np.ndarray | None:
        looked.append(gaussians)
        return look(gaussians)

    monkeypatch.setattr(orientation, "_from_ground", counted)
    why = command(upright.COMMAND).enabled(session)
    assert ("ground shows" if shows else "file says") in why
    assert looked
    looked.clear()
    assert command(upright.COMMAND).enabled(session) == why
    assert not looked


def test_the_camera_of_before_comes_back_with_undo_and_that_of_the_turn_with_redo(
    new_session: Callable[[], Session], silent: Path
) -> None:
    session = new_session()
    _opened(session, silent)

    def seen() -> np.ndarray:
        for _ in range(30):
            session.tick(0.1)
        return session.rig.camera(640, 480).cam_from_world.copy()

    seen()
    session.rig.orbit(120, 40)
    session.rig.zoom(2)
    before = seen()
    assert run(upright.COMMAND, session)
    turned = seen()
    assert np.abs(turned - before).max() > 0.1
    for move in (session.undo, session.redo, session.undo):
        move()
        np.testing.assert_allclose(seen(), turned if move == session.redo else before, atol=1e-9)
    session.rig.orbit(-70, 10)  # what another motion does with the camera is its own
    other = seen()
    shift = np.c_[np.eye(3), [3.0, 0.0, 0.0]]
    session.need().do(edits.move_scene(session.need().scene, shift, "Move"))
    session.tick(0.1)
    session.undo()
    np.testing.assert_allclose(seen(), other, atol=1e-6)


def test_a_scene_with_photos_is_not_turned_onto_its_head(associated: Session) -> None:
    before = associated.need().scene.frame.world
    assert "photos say" in command(upright.COMMAND).enabled(associated)
    assert not run(upright.COMMAND, associated)
    np.testing.assert_array_equal(associated.need().scene.frame.world, before)
