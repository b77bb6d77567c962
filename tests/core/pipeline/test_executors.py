"""A folder of scenes on engines of several workers, also when one of them dies."""

import contextlib
import json
import shutil
from pathlib import Path

import psutil
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.scene_folder import open_scene_folder
from gaga_core.pipeline.executors import (
    SUMMARY,
    EngineConfig,
    ScenesReport,
    list_scenes,
    run_scenes,
)
from gaga_core.pipeline.run import missing_stages
from gaga_core.progress import Stage, run_stage
from tests.app.folders import write_scene

LOCAL = EngineConfig("local", workers=2, threads=1)


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two tiny scenes with masks, without results."""
    root = tmp_path_factory.mktemp("template")
    for name in ("a", "b"):
        write_scene(root / name, n_objects=2)
    return root


@pytest.fixture
def scenes(template: Path, tmp_path: Path) -> Path:
    root = tmp_path / "scenes"
    shutil.copytree(template, root)
    return root


def complete(root: Path, report: ScenesReport) -> None:
    """Every scene is complete and says so, in its own report and in the summary."""
    assert [outcome.scene for outcome in report.outcomes] == ["a", "b"]
    assert report.failed == ()
    for name in ("a", "b"):
        assert missing_stages(open_scene_folder(root / name)) == ()
        entry = json.loads((root / name / "gaga" / "report.json").read_text())["run"]
        assert entry["failed"] == ""
        assert json.loads((root / SUMMARY).read_text())["failed"] == []


def workers(before: set[int]) -> list[psutil.Process]:
    """Worker processes that were started since; those that have ended are not among them."""
    found = []
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if process.pid not in before and "spawn_main" in " ".join(process.cmdline()):
                found.append(process)
    return found


def pids() -> set[int]:
    return {process.pid for process in psutil.Process().children(recursive=True)}


def run_and_kill(stage: Stage[ScenesReport], cpu_seconds: float) -> ScenesReport:
    """Drive ``stage``, killing the first worker that has computed for so long."""
    before, killed = pids(), False
    while True:
        try:
            next(stage)
        except StopIteration as end:
            assert killed
            report: ScenesReport = end.value
            return report
        for process in [] if killed else workers(before):
            with contextlib.suppress(psutil.Error):
                if process.cpu_times().user >= cpu_seconds:
                    process.kill()
                    killed = True
                    break


def test_two_workers_and_one_that_dies(scenes: Path) -> None:
    """The scene of the dead worker is run again; a second run finds nothing to do."""
    complete(scenes, run_and_kill(run_scenes(scenes, engine=LOCAL), 0.3))
    report = run_stage(run_scenes(scenes, engine=LOCAL))
    complete(scenes, report)
    assert {outcome.stages_run for outcome in report.outcomes} == {()}


def test_a_scene_that_fails_is_named_and_stops_no_other(scenes: Path) -> None:
    (scenes / "a" / "point_cloud.ply").write_bytes(b"no splats")
    report = run_stage(run_scenes(scenes, engine=LOCAL))
    assert [outcome.scene for outcome in report.failed] == ["a"]
    assert "point_cloud.ply" in report.failed[0].failed
    assert report.table()[1][0] == "a"
    assert "point_cloud.ply" in report.table()[1][3]
    entry = json.loads((scenes / "a" / "gaga" / "report.json").read_text())["run"]
    assert "point_cloud.ply" in entry["failed"]
    assert missing_stages(open_scene_folder(scenes / "b")) == ()


def test_closing_the_stage_ends_the_workers(scenes: Path) -> None:
    before = pids()
    stage = run_scenes(scenes, engine=LOCAL)
    while len(workers(before)) < 2:
        next(stage)
    stage.close()
    assert workers(before) == []


@pytest.mark.slow
def test_dask_workers_and_one_that_dies(scenes: Path) -> None:
    pytest.importorskip("distributed", reason="the extra executors is not installed")
    complete(scenes, run_and_kill(run_scenes(scenes, engine=EngineConfig("dask", 2, 1)), 1.0))


def test_scenes_are_found_with_photos_alone(scenes: Path) -> None:
    (scenes / "photos" / "input").mkdir(parents=True)
    (scenes / "notes").mkdir()
    shutil.copy(scenes / "a" / "images" / "000.png", scenes / "photos" / "input" / "000.png")
    assert [path.name for path in list_scenes(scenes)] == ["a", "b", "photos"]
    with pytest.raises(GagaError, match="no scene folders"):
        list_scenes(scenes / "notes")


def test_an_engine_that_is_not_there_is_told(scenes: Path) -> None:
    pytest.importorskip("distributed", reason="the extra executors is not installed")
    away = EngineConfig("dask", address="tcp://127.0.0.1:9")
    with pytest.raises(GagaError, match="no dask scheduler"):
        run_stage(run_scenes(scenes, engine=away))


@pytest.mark.slow
def test_ray_workers(scenes: Path) -> None:
    pytest.importorskip("ray", reason="ray is not installed")
    complete(scenes, run_stage(run_scenes(scenes, engine=EngineConfig("ray", 2, 1))))
