"""A folder of scenes on engines of several workers, also when one of them dies."""

import contextlib
import json
import shutil
from pathlib import Path
from typing import cast

import psutil
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.pipeline.executors import (
    SUMMARY,
    TRIES,
    ScenesReport,
    SceneTask,
    list_tasks,
    run_one,
    run_scenes,
)
from gaga_core.pipeline.run import RunConfig, missing_stages
from gaga_core.pipeline.settings import EngineConfig
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


def run_and_kill(stage: Stage[ScenesReport], scenes: Path) -> ScenesReport:
    """Drive ``stage``, killing the first worker that has started a scene."""
    killed = False
    while True:
        try:
            next(stage)
        except StopIteration as end:
            assert killed
            return end.value
        for starts in [] if killed else scenes.glob(".gaga-*/*"):
            psutil.Process(int(starts.read_text().split()[1])).kill()
            killed = True
            break


def test_two_workers_and_one_that_dies(scenes: Path) -> None:
    """The scene of the dead worker is run again, and summary, table and page say so; a second run
    finds nothing to do."""
    report = run_and_kill(run_scenes(scenes, engine=LOCAL), scenes)
    complete(scenes, report)
    (again,) = report.requeued
    assert again.attempts == 2
    assert json.loads((scenes / SUMMARY).read_text())["requeued"] == [again.scene]
    row = next(row for row in report.table() if row[0] == again.scene)
    assert row[report.table()[0].index("attempts")] == "2"
    page = (scenes / "gaga-run.html").read_text()
    assert "1 were started more than once" in page
    assert page.count('src="data:image/webp;base64,') == 4  # photo and groups of two scenes
    assert list(scenes.glob(".gaga-*")) == []
    report = run_stage(run_scenes(scenes, engine=LOCAL))
    complete(scenes, report)
    assert {outcome.stages_run for outcome in report.outcomes} == {()}
    assert report.requeued == ()


def test_a_scene_that_fails_is_named_and_stops_no_other(scenes: Path) -> None:
    (scenes / "a" / "point_cloud.ply").write_bytes(b"no splats")
    report = run_stage(run_scenes(scenes, engine=LOCAL))
    assert [outcome.scene for outcome in report.failed] == ["a"]
    assert "point_cloud.ply" in report.failed[0].failed
    assert report.table()[1][0] == "a"
    assert "point_cloud.ply" in report.table()[1][-1]
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


def test_a_scene_that_ends_its_worker_each_time_is_tried_three_times(
    scenes: Path, tmp_path: Path
) -> None:
    """The fourth start in one run is refused: no engine can try it for ever."""
    task = SceneTask("a", scenes / "a", starts=tmp_path / "starts")
    (tmp_path / "starts").write_text("host 1\n" * TRIES)
    outcome = run_one(task, RunConfig(), 1)
    assert outcome.failed
    assert outcome.attempts == TRIES
    assert missing_stages(open_scene_folder(scenes / "a")) != ()


def test_an_error_of_the_program_is_told_as_such_and_at_once(
    scenes: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Not tried again and not taken for lack of memory; the log has the traceback."""
    task = SceneTask("a", scenes / "a", starts=tmp_path / "starts")
    outcome = run_one(task, RunConfig(masks=cast("Path", 3.5)), 1)
    assert "error of the program: TypeError" in outcome.failed
    assert ".py, line " in outcome.failed
    assert "memory" not in outcome.failed
    assert outcome.attempts == 1
    assert "Traceback" in caplog.text


def test_a_worker_stops_when_its_run_was_ended(scenes: Path, tmp_path: Path) -> None:
    """What a worker of a running cluster does when the command that asked for it is gone."""
    gone = SceneTask("a", scenes / "a", starts=tmp_path / "removed" / "starts")
    assert "ended" in run_one(gone, RunConfig(), 1).failed
    assert not (scenes / "a" / "gaga" / "labels.npz").exists()


def test_scenes_are_found_by_name_in_folders_and_as_photos(scenes: Path) -> None:
    (scenes / "photos" / "input").mkdir(parents=True)
    (scenes / "lone").mkdir()
    (scenes / "notes").mkdir()
    for place in (scenes / "photos" / "input", scenes / "lone"):
        shutil.copy(scenes / "a" / "images" / "000.png", place / "000.png")
    root, tasks = list_tasks([scenes])
    assert root == scenes
    assert [task.name for task in tasks] == ["a", "b", "lone-scene", "photos"]
    assert tasks[2].photos == scenes / "lone"
    root, tasks = list_tasks([scenes / "b", scenes / "a", scenes / "a"])
    assert root == scenes
    assert [task.name for task in tasks] == ["a", "b"]
    shutil.move(scenes / "b", scenes / "notes" / "a")
    root, tasks = list_tasks([scenes / "a", scenes / "notes" / "a"])
    assert [task.name for task in tasks] == ["a", "notes/a"]  # equal names stay apart
    with pytest.raises(GagaError, match="no scene folders"):
        list_tasks([scenes / "a", scenes / "lone" / "nothing"])


def test_an_engine_that_is_not_there_is_told(scenes: Path) -> None:
    pytest.importorskip("distributed", reason="the extra executors is not installed")
    away = EngineConfig("dask", address="tcp://127.0.0.1:9")
    with pytest.raises(GagaError, match="no dask scheduler"):
        run_stage(run_scenes(scenes, engine=away))
    with pytest.raises(GagaError, match="--executor dask"):
        run_stage(run_scenes(scenes, engine=EngineConfig("local", address="tcp://127.0.0.1:9")))


def test_dask_started_here_listens_on_this_machine_alone_and_says_nothing(
    scenes: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Two named scenes on two dask workers of which one is killed: complete, requeued, no port
    beyond localhost, not a line on the terminal."""
    pytest.importorskip("distributed", reason="the extra executors is not installed")
    listening: set[str] = set()
    report = run_and_kill(watched(scenes, EngineConfig("dask", 2, 1), listening), scenes)
    complete(scenes, report)
    assert [outcome.attempts for outcome in report.outcomes].count(2) == 1
    assert listening == {"127.0.0.1"}
    assert capfd.readouterr().err == ""


def watched(scenes: Path, engine: EngineConfig, listening: set[str]) -> Stage[ScenesReport]:
    """Run both scenes, by name; the addresses that are listened on meanwhile are added."""
    stage = run_scenes([scenes / "a", scenes / "b"], engine=engine)
    while True:
        try:
            step = next(stage)
        except StopIteration as end:
            return end.value
        listening.update(listeners())
        yield step


def listeners() -> set[str]:
    """Addresses on which this process and its children listen."""
    me = psutil.Process()
    found = set()
    for process in (me, *me.children(recursive=True)):
        with contextlib.suppress(psutil.Error):
            for connection in process.net_connections(kind="tcp"):
                if connection.status == psutil.CONN_LISTEN:
                    found.add(connection.laddr.ip)
    return found
