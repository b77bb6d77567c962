"""Many scenes at once: every stage that is missing in each, by workers of an engine.

An engine only runs the function `run_one` somewhere and says what came back. All results lie in the
scene folders, each written as a whole or not at all: a scene whose worker died is simply run again,
and goes on where it was.
"""

import json
import logging
import os
import signal
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import FrameType
from typing import Literal, cast, get_args

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.scene_folder import is_scene_folder, with_entry
from gaga_core.pipeline.reconstruct import find_photos
from gaga_core.pipeline.run import RunConfig, run_folder
from gaga_core.progress import Progress, Stage, run_stage

Engine = Literal["local", "dask", "ray"]
ENGINES = get_args(Engine)
SUMMARY = "gaga-run.json"  # in the folder of scenes
_SECONDS = 0.2  # between two polls of the engine
_TRIES = 3  # of a scene whose worker dies
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

    @property
    def threads_each(self) -> int:
        """Threads of one worker."""
        return self.threads or max(1, (os.cpu_count() or 1) // self.workers)


@dataclass(frozen=True)
class SceneOutcome:
    """What became of one scene."""

    scene: str  # name of its folder
    stages_run: tuple[str, ...] = ()
    failed: str = ""  # one sentence; "" = complete
    seconds: float = 0.0


@dataclass(frozen=True)
class ScenesReport:
    """What became of all."""

    outcomes: tuple[SceneOutcome, ...] = field(default=())  # by name

    @property
    def failed(self) -> tuple[SceneOutcome, ...]:
        """Those that are not complete."""
        return tuple(outcome for outcome in self.outcomes if outcome.failed)

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {
            "scenes": len(self.outcomes),
            "failed": [outcome.scene for outcome in self.failed],
            "outcomes": [asdict(outcome) for outcome in self.outcomes],
        }

    def table(self) -> list[list[str]]:
        """Rows of text, headings first."""
        rows = [
            [o.scene, ", ".join(o.stages_run) or "nothing", f"{o.seconds:.0f}", o.failed or "yes"]
            for o in self.outcomes
        ]
        return [["scene", "stages run", "seconds", "complete"], *rows]


def list_scenes(root: Path) -> tuple[Path, ...]:
    """Scene folders in ``root``, also those with nothing but photos, by name.

    Raises ``GagaError`` when there is none.
    """
    folders = [p for p in sorted(root.iterdir()) if p.is_dir()] if root.is_dir() else []
    scenes = [
        p
        for p in folders
        if p.name[0] != "." and (is_scene_folder(p) or find_photos(p) is not None)
    ]
    if not scenes:
        raise GagaError(f"There are no scene folders in {root}. Choose the folder that holds them.")
    return tuple(scenes)


def run_scenes(
    root: Path, config: RunConfig | None = None, engine: EngineConfig | None = None
) -> Stage[ScenesReport]:
    """Run every missing stage of every scene in ``root``.

    A scene that fails does not stop the others. Each scene's report.json gets the entry "run", and
    ``root``/gaga-run.json says how far all are. Closing the stage ends the workers started here.
    """
    scenes, engine = list_scenes(root), engine or EngineConfig()
    engines = {"local": _run_local, "dask": _run_dask, "ray": _run_ray}
    done: dict[str, SceneOutcome] = {}
    answers = engines[engine.engine](scenes, config or RunConfig(), engine)
    with closing(answers):
        yield Progress(_STAGE, 0, len(scenes), "start the workers")
        for outcome in answers:
            if outcome is not None:
                done[outcome.scene] = outcome
                _note(root, outcome, ScenesReport(_by_name(done)))
            message = "" if outcome is None else f"{outcome.scene}: {outcome.failed or 'complete'}"
            yield Progress(_STAGE, len(done), len(scenes), message)
    return ScenesReport(_by_name(done))


def run_one(scene: str, config: RunConfig, threads: int) -> SceneOutcome:
    """Run what is missing in one scene; a worker of any engine calls this."""
    os.environ.setdefault("GAGA_THREADS", str(threads))
    path, start = Path(scene), time.perf_counter()
    stages: tuple[str, ...] = ()
    failed = ""
    try:
        stages = run_stage(run_folder(path, config))
    except GagaError as error:
        failed = str(error)
    return SceneOutcome(path.name, stages, failed, round(time.perf_counter() - start, 1))


def _by_name(done: dict[str, SceneOutcome]) -> tuple[SceneOutcome, ...]:
    return tuple(done[name] for name in sorted(done))


def _note(root: Path, outcome: SceneOutcome, report: ScenesReport) -> None:
    path = root / outcome.scene / "gaga" / "report.json"
    texts = {
        path: with_entry(path, "run", asdict(outcome)),
        root / SUMMARY: json.dumps(report.to_json(), indent=2) + "\n",
    }
    for target, text in texts.items():
        with atomic_write(target) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _died(scene: Path, why: str) -> SceneOutcome:
    return SceneOutcome(
        scene.name, failed=f"Its worker ended without an answer ({why}). Run the command again."
    )


Answers = Generator[SceneOutcome | None, None, None]  # None: nothing new for a moment


def _run_local(scenes: Sequence[Path], config: RunConfig, engine: EngineConfig) -> Answers:
    """A process for each scene, so many at a time."""
    context = SpawnContext()
    waiting = [(scene, 1) for scene in reversed(scenes)]
    running: dict[Connection, tuple[SpawnProcess, Path, int]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < engine.workers:
                scene, attempt = waiting.pop()
                ours, theirs = context.Pipe(duplex=False)
                arguments = (theirs, str(scene), config, engine.threads_each)
                process = context.Process(target=_work, args=arguments)
                process.start()
                theirs.close()
                running[ours] = (process, scene, attempt)
            yield None
            for ready in cast("list[Connection]", wait(list(running), _SECONDS)):
                process, scene, attempt = running.pop(ready)
                outcome = _received(ready)
                process.join()
                if outcome is None and attempt < _TRIES:
                    waiting.append((scene, attempt + 1))
                    continue
                yield outcome or _died(scene, f"exit status {process.exitcode}")
    finally:
        for process, _, _ in running.values():
            process.terminate()
        for connection, (process, _, _) in running.items():
            process.join()
            connection.close()


def _received(connection: Connection) -> SceneOutcome | None:
    """What a worker sent; None when it died."""
    with connection:
        try:
            outcome = connection.recv()
        except (EOFError, OSError):
            return None
    return outcome if isinstance(outcome, SceneOutcome) else None


def _work(answer: Connection, scene: str, config: RunConfig, threads: int) -> None:
    """A local worker: a request to end closes the stage, which removes what is half-made."""

    def end(_number: int, _frame: FrameType | None) -> None:
        sys.exit(1)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which asks
    answer.send(run_one(scene, config, threads))
    answer.close()


def _run_dask(scenes: Sequence[Path], config: RunConfig, engine: EngineConfig) -> Answers:
    """The workers of a dask scheduler, or of one that is started here."""
    try:
        from distributed import Client, Future, LocalCluster
    except ImportError as error:
        raise GagaError(
            "Dask is not installed. Install it with: pip install gaga-studio[executors]"
        ) from error
    cluster: LocalCluster | None = None
    if not engine.address:
        cluster = LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=engine.workers,
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=logging.ERROR,
        )
    try:
        client = Client(engine.address or cluster, timeout="5s")  # type: ignore[no-untyped-call]
    except OSError as problem:
        raise GagaError(
            f"There is no dask scheduler at {engine.address}. Start it, or leave --address out."
        ) from problem
    try:
        arguments = (config, engine.threads_each)
        running: dict[Future[SceneOutcome], Path] = {
            client.submit(run_one, str(s), *arguments, pure=False, retries=_TRIES - 1): s
            for s in scenes
        }
        while running:
            time.sleep(_SECONDS)
            yield None
            for future in [future for future in running if future.status in _ENDED]:
                scene = running.pop(future)
                if future.status == "finished":
                    yield client.gather(future)  # type: ignore[no-untyped-call]
                else:
                    yield _died(scene, f"dask says {future.status}")
    finally:
        client.close()  # type: ignore[no-untyped-call]
        if cluster is not None:
            cluster.close()


def _run_ray(scenes: Sequence[Path], config: RunConfig, engine: EngineConfig) -> Answers:
    """The workers of a ray cluster, or of one that is started here."""
    try:
        import ray
    except ImportError as error:
        raise GagaError("Ray is not installed. Install it with: pip install ray") from error
    if engine.address:
        ray.init(address=engine.address, log_to_driver=False)
    else:
        ray.init(num_cpus=engine.workers, log_to_driver=False, include_dashboard=False)
    try:
        task = ray.remote(max_retries=_TRIES - 1, num_cpus=1)(run_one)
        running = {task.remote(str(scene), config, engine.threads_each): scene for scene in scenes}
        while running:
            ready, _ = ray.wait(list(running), num_returns=1, timeout=_SECONDS)
            yield None
            for reference in ready:
                scene = running.pop(reference)
                try:
                    outcome: SceneOutcome = ray.get(reference)
                except ray.exceptions.RayError as error:
                    outcome = _died(scene, str(error).splitlines()[0][:120])
                yield outcome
    finally:
        ray.shutdown()
