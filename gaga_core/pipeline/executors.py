"""Many scenes at once: every stage that is missing in each, by workers of an engine.

An engine only runs the function `run_one` somewhere and says what came back. All results lie in the
scene folders, each written as a whole or not at all: a scene whose worker died is simply run again,
and goes on where it was. Engines that are started here listen on this machine alone.
"""

import json
import logging
import os
import signal
import sys
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Literal, cast, get_args

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.scene_folder import with_entry
from gaga_core.io.staging import staging_folder
from gaga_core.pipeline.run import RunConfig
from gaga_core.pipeline.scene_tasks import (
    TRIES,
    SceneOutcome,
    ScenesReport,
    SceneTask,
    died,
    list_tasks,
    run_one,
)
from gaga_core.pipeline.scenes_page import PAGE, write_page
from gaga_core.progress import Progress, Stage

if TYPE_CHECKING:
    from distributed import Client, Future

Engine = Literal["local", "dask", "ray"]
ENGINES = get_args(Engine)
SUMMARY = "gaga-run.json"  # in the folder of scenes, next to `PAGE`
_HERE = "127.0.0.1"
_SECONDS = 0.2  # between two polls of the engine
_PATIENCE_S = 60.0  # with a scheduler that has no workers
_STAGE = "Run scenes"
_ENDED = ("finished", "error", "lost", "cancelled")  # of a dask future


@dataclass(frozen=True)
class EngineConfig:
    """Who runs the scenes."""

    engine: Engine = "local"
    workers: int = 2  # scenes at once, where the engine is started here
    threads: int = 0  # of each worker; 0 = an equal share
    address: str = ""  # of a dask scheduler or a ray cluster that is running; "" = start one here

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise ValueError(f"engine: {self.engine!r} is none of {ENGINES}")
        if self.workers < 1:
            raise GagaError("--workers must be at least 1.")
        if self.address and self.engine == "local":
            raise GagaError("--address is of a dask or ray cluster. Choose --executor dask or ray.")

    @property
    def threads_each(self) -> int:
        """Threads of one worker."""
        return self.threads or max(1, (os.cpu_count() or 1) // self.workers)


def run_scenes(
    scenes: Path | Sequence[Path],
    config: RunConfig | None = None,
    engine: EngineConfig | None = None,
) -> Stage[ScenesReport]:
    """Run every missing stage of every scene in a folder, or of those given (`list_tasks`).

    A scene that fails does not stop the others. Each scene's report.json gets the entry "run";
    gaga-run.json in the folder of scenes (their common parent) says how far all are, and
    gaga-run.html shows them at the end. Closing the stage ends the workers started here, and
    those of a running cluster at their next step.
    """
    root, tasks = list_tasks([scenes] if isinstance(scenes, Path) else scenes)
    engine, config = engine or EngineConfig(), config or RunConfig()
    engines = {"local": _run_local, "dask": _run_dask, "ray": _run_ray}
    done: dict[str, SceneOutcome] = {}
    with staging_folder(root) as starts:
        counted = [replace(task, starts=starts / f"{i}") for i, task in enumerate(tasks)]
        folders = {task.name: task.folder for task in tasks}
        answers = engines[engine.engine](counted, _shared(config, engine), engine)
        with closing(answers):
            yield Progress(_STAGE, 0, len(tasks), "start the workers")
            for outcome in answers:
                message = ""
                if outcome is not None:
                    done[outcome.scene] = outcome
                    _note(root, folders[outcome.scene], outcome, ScenesReport(_by_name(done)))
                    message = f"{outcome.scene}: {outcome.failed or 'complete'}"
                yield Progress(_STAGE, len(done), len(tasks), message)
    report = ScenesReport(_by_name(done), root / PAGE)
    write_page(root / PAGE, report, folders)
    return report


def _shared(config: RunConfig, engine: EngineConfig) -> RunConfig:
    """The settings with a worker's share of this machine's memory for votes."""
    n = 1 if engine.address else engine.workers
    associate = config.associate
    share = replace(associate, histogram_bytes=max(1, associate.histogram_bytes // n))
    return replace(config, associate=share)


def _by_name(done: dict[str, SceneOutcome]) -> tuple[SceneOutcome, ...]:
    return tuple(done[name] for name in sorted(done))


def _note(root: Path, folder: Path, outcome: SceneOutcome, report: ScenesReport) -> None:
    path = folder / "gaga" / "report.json"
    texts = {root / SUMMARY: json.dumps(report.to_json(), indent=2) + "\n"}
    if folder.is_dir():  # photos that could not be placed leave none
        texts[path] = with_entry(path, "run", asdict(outcome))
    for target, text in texts.items():
        with atomic_write(target) as temporary:
            temporary.write_text(text, encoding="utf-8")


Answers = Generator[SceneOutcome | None, None, None]  # None: nothing new for a moment


def _run_local(tasks: Sequence[SceneTask], config: RunConfig, engine: EngineConfig) -> Answers:
    """A process for each scene, so many at a time."""
    context = SpawnContext()
    waiting = list(reversed(tasks))
    running: dict[Connection, tuple[SpawnProcess, SceneTask]] = {}
    failures = dict.fromkeys((task.name for task in tasks), 0)
    try:
        while waiting or running:
            while waiting and len(running) < engine.workers:
                task = waiting.pop()
                ours, theirs = context.Pipe(duplex=False)
                arguments = (theirs, task, config, engine.threads_each)
                process = context.Process(target=_work, args=arguments)
                process.start()
                theirs.close()
                running[ours] = (process, task)
            yield None
            for ready in cast("list[Connection]", wait(list(running), _SECONDS)):
                process, task = running.pop(ready)
                outcome = _received(ready)
                process.join()
                if outcome is None:
                    failures[task.name] += 1
                    if failures[task.name] < TRIES:
                        waiting.append(task)
                        continue
                yield outcome or died(task, _exit_reason(process.exitcode))
    finally:
        for process, _ in running.values():
            process.terminate()
        for connection, (process, _) in running.items():
            process.join()
            connection.close()


def _exit_reason(status: int | None) -> str:
    """What an exit status says of a process."""
    if status is not None and status < 0:
        return f"ended by signal {signal.Signals(-status).name}"
    return f"exit status {status}"


def _received(connection: Connection) -> SceneOutcome | None:
    """What a worker sent; None when it died."""
    with connection:
        try:
            outcome = connection.recv()
        except (EOFError, OSError):
            return None
    return outcome if isinstance(outcome, SceneOutcome) else None


def _work(answer: Connection, task: SceneTask, config: RunConfig, threads: int) -> None:
    """A local worker: a request to end closes the stage, which removes what is half-made."""

    def end(_number: int, _frame: FrameType | None) -> None:
        sys.exit(1)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which asks
    answer.send(run_one(task, config, threads))
    answer.close()


@contextmanager
def _dask_client(engine: EngineConfig) -> "Iterator[Client]":
    """A client of the scheduler that is named, or of one that is started here."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise GagaError(
            "Dask is not installed. Install it with: pip install gaga-studio[executors]"
        ) from error
    if engine.address:
        try:
            client = Client(engine.address, timeout="5s")  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as problem:
            raise GagaError(
                f"There is no dask scheduler at {engine.address}. Start it, or leave --address out."
            ) from problem
        with closing(client):
            yield client
        return
    with (
        # A worker that dies or is restarted is what `_run_dask` expects: its log is no news.
        dask.config.set({"distributed.logging.distributed": "critical"}),
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=engine.workers,
            threads_per_worker=1,
            host=_HERE,
            dashboard_address=f"{_HERE}:0",
            worker_dashboard_address=None,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,  # type: ignore[no-untyped-call]
    ):
        yield client


def _run_dask(tasks: Sequence[SceneTask], config: RunConfig, engine: EngineConfig) -> Answers:
    """The workers of a dask scheduler, or of one that is started here.

    No more scenes are handed over than there are workers: dask blames the death of a worker on all
    that wait there.
    """
    waiting = list(reversed(tasks))
    running: dict[Future[SceneOutcome], SceneTask] = {}
    handed = dict.fromkeys((task.name for task in tasks), 0)
    with _dask_client(engine) as client:
        last_worker = time.monotonic()
        while waiting or running:
            n_workers = _n_dask_workers(client, engine)
            while waiting and len(running) < n_workers:
                task = waiting.pop()
                future = client.submit(run_one, task, config, engine.threads_each, pure=False)
                running[future] = task
                handed[task.name] += 1
            last_worker = time.monotonic() if n_workers else last_worker
            if time.monotonic() - last_worker > _PATIENCE_S:
                raise GagaError(
                    "The dask scheduler has no workers. Start some: dask worker ADDRESS"
                )
            time.sleep(_SECONDS)
            yield None
            for future in [future for future in running if future.status in _ENDED]:
                task = running.pop(future)
                outcome = _dask_outcome(future, task)
                if outcome is None and max(task.n_starts(), handed[task.name]) < TRIES:
                    waiting.append(task)
                else:
                    yield outcome or died(task, "dask gave it up")


def _n_dask_workers(client: "Client", engine: EngineConfig) -> int:
    """Workers that there are now."""
    try:
        return len(client.ncores())  # type: ignore[no-untyped-call]
    except OSError as error:
        where = engine.address or "this machine"
        raise GagaError(
            f"The dask scheduler at {where} has gone. Run the command again."
        ) from error


def _dask_outcome(future: "Future[SceneOutcome]", task: SceneTask) -> SceneOutcome | None:
    """What came back of a scene; None when its worker ended without an answer."""
    from distributed import KilledWorker

    if future.status == "finished":
        outcome: SceneOutcome = future.result()
        return outcome
    problem: BaseException | None = None
    if future.status == "error":
        problem = future.exception()  # type: ignore[no-untyped-call]
    if problem is None or isinstance(problem, KilledWorker):
        return None
    return died(task, _sentence(problem))


def _sentence(problem: BaseException) -> str:
    """The first line of an exception."""
    text = str(problem).strip().splitlines()
    return f"{type(problem).__name__}: {text[0][:160]}" if text else type(problem).__name__


def _run_ray(tasks: Sequence[SceneTask], config: RunConfig, engine: EngineConfig) -> Answers:
    """The workers of a ray cluster, or of one that is started here."""
    if not engine.address:
        # Ray's own switch, read when it is imported: without a cluster it stays on this machine.
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
    try:
        import ray
    except ImportError as error:
        raise GagaError("Ray is not installed. Install it with: pip install ray") from error
    try:
        if engine.address:
            ray.init(address=engine.address, log_to_driver=False, logging_level=logging.ERROR)
        else:
            ray.init(
                num_cpus=engine.workers,
                log_to_driver=False,
                logging_level=logging.ERROR,
                include_dashboard=False,
            )
    except (ConnectionError, ValueError) as problem:
        raise GagaError(
            f"There is no ray cluster at {engine.address}. Start it, or leave --address out."
        ) from problem
    try:
        remote = ray.remote(max_retries=TRIES - 1, num_cpus=1)(run_one)
        running = {remote.remote(task, config, engine.threads_each): task for task in tasks}
        while running:
            ready, _ = ray.wait(list(running), num_returns=1, timeout=_SECONDS)
            yield None
            for reference in ready:
                task = running.pop(reference)
                try:
                    outcome: SceneOutcome = ray.get(reference)
                except ray.exceptions.RayError as error:
                    outcome = died(task, _sentence(error))
                yield outcome
    finally:
        ray.shutdown()
