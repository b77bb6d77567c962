"""Files that version 0.1.0 saved open as they were (tests/fixtures/version_0_1_0/README.md)."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.cli.main import main
from gaga_core.grouping.bank_file import load_bank
from gaga_core.progress import run_stage
from gaga_core.scene.project import Project, open_path_stage
from gaga_core.scene.scene import State
from gaga_studio.features import autosave
from gaga_studio.session.session import Session
from gaga_studio.session.settings import load_settings

SAVED = Path(__file__).resolve().parents[1] / "fixtures" / "version_0_1_0"


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """A copy of the files, at home in its new place."""
    folder = tmp_path / "saved"
    shutil.copytree(SAVED, folder)
    for file in [*(folder / "recovery").glob("*.json"), folder / "settings.json"]:
        text = file.read_text(encoding="utf-8")
        file.write_text(text.replace("@FIXTURE@", folder.as_posix()), encoding="utf-8")
    return folder


def test_a_saved_project_opens_with_every_edit_and_its_bank(saved: Path) -> None:
    project = run_stage(open_path_stage(saved / "table"))
    scene = project.scene
    with np.load(saved / "expected.npz") as expected:
        for name in ("labels", "state", "placement"):
            np.testing.assert_array_equal(getattr(scene, name), expected[name])
        for name in ("matrix", "color"):
            np.testing.assert_array_equal(getattr(scene.placements, name), expected[name])
    assert scene.names == {1: "red ball", 6: "group 2 copy"}
    assert [(name, kept.mask().sum()) for name, kept in scene.named_selections.items()] == [
        ("the red one", 60)
    ]
    assert [(mark.name, mark.key) for mark in project.bookmarks] == [("Front", 1)]
    assert len(project.film.keyframes) == 16
    assert scene.bank is not None
    assert scene.bank.n_groups == 5
    assert len(scene.bank.log) == 25


@pytest.mark.parametrize("preset", ["robust", "paper"])
def test_a_bank_is_read_with_its_log_and_groups(saved: Path, preset: str) -> None:
    bank = load_bank(saved / "banks" / preset / "bank.npz")
    with np.load(saved / "banks" / preset / "labels.npz") as arrays:
        labels = arrays["labels"]
    assert bank.n_groups == labels.max() == 5
    assert len(bank.log) == 25
    assert bank.preset == preset
    assert len({(decision.view, decision.mask) for decision in bank.log}) == 25
    assert {decision.group for decision in bank.log} == {1, 2, 3, 4, 5}
    assert bank.group.shape == labels.shape


@pytest.mark.parametrize("preset", ["robust", "paper"])
def test_an_associated_folder_without_a_project_opens_with_its_groups(
    saved: Path, preset: str
) -> None:
    work = saved / "table" / "gaga"
    shutil.rmtree(work)
    shutil.copytree(saved / "banks" / preset, work)
    scene = run_stage(open_path_stage(saved / "table")).scene
    assert sorted(set(scene.labels.tolist())) == [1, 2, 3, 4, 5]
    assert scene.bank is not None


def test_preferences_keep_what_was_chosen(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAGA_HOME", str(saved))
    settings, problem = load_settings()
    assert problem == ""
    chosen = (settings.keys, settings.theme, settings.fly_speed, settings.clean_first)
    assert chosen == ("blender", "light", 2.0, True)
    assert settings.recent == (f"{saved.as_posix()}/table", "/somewhere/table")


def test_what_a_crash_left_is_offered_and_recovered(
    saved: Path, new_session: Callable[[], Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = new_session()
    home = saved / "home"
    monkeypatch.setenv("GAGA_HOME", str(home))
    shutil.copytree(saved / "recovery", home / "recovery" / "999999999-0b82c9c7")
    before = run_stage(open_path_stage(saved / "table"))
    assert autosave.offer(session)
    session.answer("Recover")
    assert session.jobs.wait()
    assert session.scene is not None, session.notices
    assert session.unsaved
    assert session.project is not None
    assert session.project.path == saved / "table" / "gaga"
    assert _n_deleted(session.project) == _n_deleted(before) + 179


def test_a_recorded_script_gives_the_saved_scene(saved: Path, tmp_path: Path) -> None:
    shutil.rmtree(saved / "table" / "gaga")
    shutil.copytree(saved / "banks" / "robust", saved / "table" / "gaga")
    written, script = tmp_path / "edited.ply", saved / "edits.json"
    assert main(["edit", str(saved / "table"), str(written), "--script", str(script)]) == 0
    edited = run_stage(open_path_stage(written)).scene
    with np.load(saved / "expected.npz") as expected:
        is_left = (expected["state"] & State.DELETED) == 0
    assert len(edited.gaussians) == np.count_nonzero(is_left)


def _n_deleted(project: Project) -> int:
    return int(np.count_nonzero(project.scene.state & State.DELETED))
