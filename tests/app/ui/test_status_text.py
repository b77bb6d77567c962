"""What the status bar says: who computes and why, and that kernels are compiled in the quiet."""

from dataclasses import replace
from pathlib import Path

import pytest

from gaga_core import kernels
from gaga_core.progress import Progress, run_stage
from gaga_core.raster import backend_report
from gaga_studio.session import stages
from gaga_studio.session.jobs import Job
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.ui.chrome import status
from tests.app.folders import write_scene


@pytest.fixture(autouse=True)
def _look_again() -> None:
    status._look.cache_clear()


def test_it_names_the_backend_and_the_reason() -> None:
    name, reason = backend_report(wait=False)
    found = status.backend()
    assert (found.name, found.reason) == (name.upper(), reason)
    assert found.sentence.endswith(f"{reason}.")
    assert name.upper() in found.sentence


def test_a_choice_by_the_user_is_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAGA_BACKEND", "cpu")
    assert status.backend() == status.Backend("CPU", "GAGA_BACKEND says so")


def test_it_is_not_asked_every_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def report(*, wait: bool) -> tuple[str, str]:
        asked.append(wait)
        return "cuda", "a card"

    monkeypatch.setattr(status, "backend_report", report)
    monkeypatch.setattr(status, "_LOOK_EVERY", 1e9)
    assert {status.backend() for _ in range(100)} == {status.Backend("CUDA", "a card")}
    assert asked == [False]  # and no self-test is started


def test_kernels_are_compiled_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """With progress that names its steps; what is compiled in this process costs nothing again."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))  # where the note of the end is kept
    seen: list[Progress] = []
    run_stage(stages.kernels_stage(), seen.append)
    assert {step.stage for step in seen} == {"Prepare kernels"}
    assert len({step.message for step in seen}) > 5
    assert kernels.is_compiled()
    assert list(stages.kernels_stage()) == []


def test_opening_a_scene_prepares_the_kernels_beside(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    started: list[str] = []
    write_scene(tmp_path / "scene", n_objects=2)
    session = Session(Settings())
    monkeypatch.setattr(session.jobs, "start_quiet", lambda title, stage: started.append(title))
    session.open(tmp_path / "scene")
    assert session.jobs.wait()
    session.tick(0.1)
    assert session.scene is not None
    assert started == ["Prepare kernels"]
    assert session.jobs.running is None


def test_a_running_job_says_what_how_far_and_how_long() -> None:
    job = Job("Associate masks", "Associate masks", "", -1.0, None, 0.0, False)
    assert status.job_text(job) == "Associate masks", "not known how far"
    job = replace(job, fraction=0.456)
    assert status.job_text(job) == "Associate masks  46 %"
    assert status.job_text(replace(job, eta_s=12.2)) == "Associate masks  46 %, 12 s left"
    late = status.job_text(replace(job, eta_s=200.0))
    assert late == "Associate masks  46 %, 3 min 20 s left"
    assert status.job_text(replace(job, is_cancelling=True)) == "Associate masks: stopping"
