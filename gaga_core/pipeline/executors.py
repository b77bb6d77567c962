"""Many scenes at once: every stage that is missing in each, by workers of an engine.

An engine only runs the function `run_one` somewhere and says what came back. All results lie in the
scene folders, each written as a whole or not at all: a scene whose worker died is simply run again,
and goes on where it was. Engines that are started here listen on this machine alone.
"""

import base64
import html
import io
import json
import logging
import os
import signal
import socket
import sys
import time
import traceback
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from PIL import Image

from gaga_core.arrays import UInt8Array
from gaga_core.errors import CancelledError, GagaError, cure_without
from gaga_core.io.files import atomic_write, explain_os_error, refuse_links
from gaga_core.io.folder.scene_folder import (
    AssociateEntry,
    is_scene_folder,
    open_scene_folder,
    read_report_entry,
    with_entry,
)
from gaga_core.io.folder.staging import staging_folder
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import read_labels, view_key
from gaga_core.pipeline.film import painted_labels
from gaga_core.pipeline.place import find_photos
from gaga_core.pipeline.reconstruct import source_of
from gaga_core.pipeline.run import RunConfig
from gaga_core.pipeline.settings import EngineConfig
from gaga_core.progress import Progress, Stage, run_stage

if TYPE_CHECKING:
    from distributed import Client, Future

# --- One scene of many as a task for any worker, and its result.
# A worker may die at any moment. So every start of a task is a line in a file of the run
# (`SceneTask.starts`), which is also how the run is stopped: a worker whose file is gone closes
# its stage. Both need nothing but the folder that all workers see.


_log = logging.getLogger(__name__)

TRIES = 3  # of a scene whose worker dies
_SIGN_OF_LIFE_S = 1.0  # between two looks at the file of starts


@dataclass(frozen=True)
class SceneTask:
    """A scene folder that is there, or to be made of photos."""

    name: str  # unique: its path below the folder of the summary
    folder: Path  # absolute
    photos: Path | None = None  # that lie elsewhere, absolute
    starts: Path | None = None  # a line for each start of this run; None: starts are not counted

    def n_starts(self) -> int:
        """Number of times that a worker started it in this run."""
        if self.starts is None or not self.starts.is_file():
            return 0
        return len(self.starts.read_text(encoding="utf-8").splitlines())


class SceneWork(Protocol):
    """What is done with each scene: a value that a worker of any engine can be sent."""

    def stage_of(self, folder: Path, photos: Path | None) -> Stage[tuple[str, ...]]:
        """The stage of one scene; it returns the names of what it has run."""
        ...


@dataclass(frozen=True)
class SceneOutcome:
    """Result of one scene."""

    scene: str  # `SceneTask.name`
    stages_run: tuple[str, ...] = ()
    failed: str = ""  # one sentence; "" = complete
    seconds: float = 0.0  # of the last attempt
    attempts: int = 1  # starts by workers; more than 1: workers ended without an answer


@dataclass(frozen=True)
class ScenesReport:
    """Results of all scenes."""

    outcomes: tuple[SceneOutcome, ...] = field(default=())  # by name
    page: Path | None = None  # gaga-run.html, once it is written

    @property
    def failed(self) -> tuple[SceneOutcome, ...]:
        """Those that are not complete."""
        return tuple(outcome for outcome in self.outcomes if outcome.failed)

    @property
    def requeued(self) -> tuple[SceneOutcome, ...]:
        """Those that more than one worker started."""
        return tuple(outcome for outcome in self.outcomes if outcome.attempts > 1)

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {
            "scenes": len(self.outcomes),
            "failed": [outcome.scene for outcome in self.failed],
            "requeued": [outcome.scene for outcome in self.requeued],
            "outcomes": [asdict(outcome) for outcome in self.outcomes],
        }

    def table(self) -> list[list[str]]:
        """Rows of text, headings first."""
        rows = [
            [
                o.scene,
                ", ".join(o.stages_run) or "nothing",
                f"{o.seconds:.0f}",
                str(o.attempts),
                o.failed or "yes",
            ]
            for o in self.outcomes
        ]
        return [["scene", "stages run", "seconds", "attempts", "complete"], *rows]


def list_tasks(paths: Sequence[Path]) -> tuple[Path, tuple[SceneTask, ...]]:
    """The folder that a summary of ``paths`` belongs into, and the tasks, by name.

    A path is a scene folder, a folder of photos or a video, else a folder of such: one task each.
    Raises ``GagaError`` when one of them has no scene.
    """
    found: dict[Path, Path | None] = {}
    for path in dict.fromkeys(path.absolute() for path in paths):
        for photos, scene in _scenes_at(path):
            found.setdefault(scene, photos)
    single = paths[0].absolute()
    is_folder_of_scenes = len(paths) == 1 and single not in found and single.is_dir()
    try:
        common = Path(os.path.commonpath([scene.parent for scene in found]))
    except ValueError as error:
        raise GagaError(
            "The scenes are on several drives. Run those of each drive separately."
        ) from error
    root = single if is_folder_of_scenes else common
    names = {scene: scene.relative_to(root).as_posix() for scene in found}
    ordered = sorted(found, key=lambda scene: names[scene])
    return root, tuple(SceneTask(names[scene], scene, found[scene]) for scene in ordered)


def _scenes_at(path: Path) -> list[tuple[Path | None, Path]]:
    """Photos and scene folder of each scene that ``path`` is or holds."""
    one = _scene_at(path)
    if one is not None:
        return [one]
    children = sorted(path.iterdir()) if path.is_dir() else []
    scenes = [_scene_at(child) for child in children if child.name[0] != "."]
    if not any(scenes):
        raise GagaError(f"There are no scene folders in {path}. Choose the folder that holds them.")
    return [scene for scene in scenes if scene is not None]


def _scene_at(path: Path) -> tuple[Path | None, Path] | None:
    """Photos and scene folder that ``path`` stands for by itself; None when it does not."""
    photos, scene = source_of(path)
    if photos is not None:
        return photos, scene
    is_one = scene.is_dir() and (is_scene_folder(scene) or find_photos(scene) is not None)
    return (None, scene.absolute()) if is_one else None


def run_one(task: SceneTask, work: SceneWork, threads: int) -> SceneOutcome:
    """Run what is missing in one scene; a worker of any engine calls this."""
    os.environ.setdefault("GAGA_THREADS", str(threads))
    start, stages, failed = time.perf_counter(), tuple[str, ...](), ""
    attempt = _note_start(task)
    if attempt > TRIES:
        return died(task, "killed, or out of memory")
    try:
        stage = work.stage_of(task.folder, task.photos)
        try:
            stages = run_stage(stage, _SignOfLife(task))
        finally:
            stage.close()
    except GagaError as error:
        failed = str(error)
    except MemoryError:
        failed = "It needs more memory than there is. Use fewer workers, or a smaller --max-side."
    except OSError as error:
        failed = explain_os_error(error, Path(os.fsdecode(error.filename or task.folder)))
    except Exception as error:  # noqa: BLE001  or the engine takes it for a death of the worker
        _log.exception("%s stopped at an error of the program", task.name)
        failed = f"It stopped at an error of the program: {_what_and_where(error)}. Please report."
    seconds = round(time.perf_counter() - start, 1)
    return SceneOutcome(task.name, stages, failed, seconds, attempt)


def _what_and_where(error: Exception) -> str:
    """The kind and first line of an exception, and the line of code that raised it."""
    lines = str(error).strip().splitlines() or [""]
    at = traceback.extract_tb(error.__traceback__)[-1]
    text = f": {lines[0][:160]}" if lines[0] else ""
    return f"{type(error).__name__}{text} ({Path(at.filename).name}, line {at.lineno})"


def died(task: SceneTask, why: str) -> SceneOutcome:
    """The outcome of a scene whose workers ended without an answer."""
    n = task.n_starts()
    times = "Its worker" if n <= 1 else f"{min(n, TRIES)} workers in turn"
    return SceneOutcome(
        task.name,
        failed=f"{times} ended without an answer ({why}). If memory ran out, use fewer --workers; "
        "then run the command again.",
        attempts=min(n, TRIES),
    )


def _note_start(task: SceneTask) -> int:
    """Note a start of the task; which one it is, from 1."""
    if task.starts is None:
        return 1
    with suppress(FileNotFoundError), task.starts.open("a", encoding="utf-8") as file:
        file.write(f"{socket.gethostname()} {os.getpid()}\n")
    return max(1, task.n_starts())


class _SignOfLife:
    """Shows from time to time that the worker lives, and stops it when its run was ended."""

    def __init__(self, task: SceneTask) -> None:
        self._starts = task.starts
        self._next = time.monotonic()

    def __call__(self, _step: Progress) -> None:
        """Touch the file of starts; ``CancelledError`` when it is gone."""
        if self._starts is None or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + _SIGN_OF_LIFE_S
        try:
            os.utime(self._starts)
        except FileNotFoundError:
            raise CancelledError("The run was ended before it was complete.") from None


# --- A page about many scenes that were run: the result of each, with a photo and its groups.


PAGE = "gaga-run.html"  # in the folder of scenes
_WIDTH = 240  # pixels of a picture
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem; color: #222; background: #fff }
table { border-collapse: collapse }
td, th { padding: .4rem .8rem; text-align: left; vertical-align: top }
td, th { border-bottom: 1px solid #ddd }
td.number { text-align: right }
tr.failed td { background: #fdecea }
img { width: 240px; display: inline-block; margin-right: 4px }
@media (prefers-color-scheme: dark) {
  body { color: #ddd; background: #1b1b1b }
  td, th { border-color: #444 }
  tr.failed td { background: #4a2320 }
}
"""


def write_page(path: Path, report: ScenesReport, folders: Mapping[str, Path]) -> None:
    """Write the page of ``report``; ``folders`` has the folder of every scene by its name.

    One file without scripts: the pictures are in it. A scene without groups has none.
    """
    rows = "\n".join(_row(outcome, folders[outcome.scene]) for outcome in report.outcomes)
    n, n_failed, n_again = len(report.outcomes), len(report.failed), len(report.requeued)
    page = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>gaga run: {n} scenes</title>
<style>{_STYLE}</style></head><body>
<h1>{n} scenes</h1>
<p>{n - n_failed} complete, {n_failed} not; {n_again} were started more than once, because a worker
ended without an answer.</p>
<table>
<tr><th>scene</th><th>complete</th><th>groups</th><th>stages run</th><th>seconds</th>
<th>attempts</th><th>photo and groups</th></tr>
{rows}
</table></body></html>
"""
    with atomic_write(path) as temporary:
        # Names of folders may have bytes that are no text: they become "?".
        temporary.write_text(page, encoding="utf-8", errors="replace")


def _row(outcome: SceneOutcome, folder: Path) -> str:
    entry = read_report_entry(folder / "gaga" / "report.json", "associate", AssociateEntry)
    try:
        shown = "".join(f'<img alt="" src="{_inline(p)}">' for p in _pictures(folder))
    except (GagaError, OSError) as error:  # a scene that failed may hold anything
        shown = html.escape(str(error))
    stages = ", ".join(outcome.stages_run) or "nothing"
    texts = [html.escape(text) for text in (outcome.scene, outcome.failed or "yes", stages)]
    cells = [
        f"<td>{texts[0]}</td><td>{texts[1]}</td>",
        f'<td class="number">{"" if entry is None else entry.groups_with_gaussians}</td>',
        f"<td>{texts[2]}</td>",
        f'<td class="number">{outcome.seconds:.0f}</td>',
        f'<td class="number">{outcome.attempts}</td><td>{shown}</td>',
    ]
    kind = ' class="failed"' if outcome.failed else ""
    return f"<tr{kind}>{''.join(cells)}</tr>"


def _pictures(root: Path) -> list[UInt8Array]:
    """The photo, where there is one, and the groups of the first view whose groups are drawn."""
    if not root.is_dir():
        return []
    folder = open_scene_folder(root)
    for camera in folder.cameras:
        drawn = folder.work / "renders" / "groups" / f"{view_key(camera.name)}.png"
        if not drawn.is_file():
            continue
        groups = read_labels(drawn)
        step = max(1, groups.shape[1] // _WIDTH)
        painted = painted_labels(groups[::step, ::step])
        photo = folder.image_paths.get(camera.name)
        if photo is None:
            return [painted]
        image = Image.fromarray(read_rgb(photo))
        size = (_WIDTH, max(1, round(image.height * _WIDTH / image.width)))
        return [np.asarray(image.resize(size)), painted]
    return []


def _inline(picture: UInt8Array) -> str:
    data = io.BytesIO()
    Image.fromarray(picture).convert("RGB").save(data, "WEBP", quality=80)
    return "data:image/webp;base64," + base64.b64encode(data.getvalue()).decode()


SUMMARY = "gaga-run.json"  # in the folder of scenes, next to `PAGE`
_HERE = "127.0.0.1"
_SECONDS = 0.2  # between two polls of the engine
_PATIENCE_S = 60.0  # with a scheduler that has no workers
_STAGE = "Run scenes"
_ENDED = ("finished", "error", "lost", "cancelled")  # of a dask future


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
    done: dict[str, SceneOutcome] = {}
    # A worker's share of this machine's memory for votes.
    n = 1 if engine.address else engine.workers
    memory = max(1, config.associate.histogram_bytes // n)
    shared = replace(config, associate=replace(config.associate, histogram_bytes=memory))

    def report() -> ScenesReport:
        return ScenesReport(tuple(done[name] for name in sorted(done)))

    folders = {task.name: task.folder for task in tasks}
    with (
        staging_folder(root) as starts,
        closing(answers_of(tasks, shared, engine, starts)) as answers,
    ):
        yield Progress(_STAGE, 0, len(tasks), "start the workers")
        for outcome in answers:
            message = ""
            if outcome is not None:
                done[outcome.scene] = outcome
                _note(root, folders[outcome.scene], outcome, report())
                message = f"{outcome.scene}: {outcome.failed or 'complete'}"
            yield Progress(_STAGE, len(done), len(tasks), message)
    whole = replace(report(), page=root / PAGE)
    write_page(root / PAGE, whole, folders)
    return whole


def _note(root: Path, folder: Path, outcome: SceneOutcome, report: ScenesReport) -> None:
    path = folder / "gaga" / "report.json"
    texts = {root / SUMMARY: json.dumps(report.to_json(), indent=2) + "\n"}
    if folder.is_dir():  # photos that could not be placed leave none
        refuse_links(path.parent, folder)
        texts[path] = with_entry(path, "run", asdict(outcome))
    for target, text in texts.items():
        with atomic_write(target) as temporary:
            temporary.write_text(text, encoding="utf-8")


Answers = Generator[SceneOutcome | None, None, None]  # None: nothing new for a moment


def answers_of(
    tasks: Sequence[SceneTask], work: SceneWork, engine: EngineConfig, starts: Path
) -> Answers:
    """Do ``work`` with every scene by the workers of ``engine``; ``starts`` is a folder for the
    time of the run that all workers see. Closing it ends the workers started here."""
    if engine.address and engine.engine != "dask":
        raise GagaError("--address is of a dask scheduler. Choose --executor dask.")
    counted = [replace(task, starts=starts / f"{i}") for i, task in enumerate(tasks)]
    return (_run_dask if engine.engine == "dask" else _run_local)(counted, work, engine)


def _run_local(tasks: Sequence[SceneTask], work: SceneWork, engine: EngineConfig) -> Answers:
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
                arguments = (theirs, task, work, engine.threads_each)
                process = context.Process(target=_work, args=arguments)
                process.start()
                theirs.close()
                running[ours] = (process, task)  # a pipe of Windows, too
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
    """Meaning of an exit status of a process."""
    if status is not None and status < 0:
        return f"ended by signal {signal.Signals(-status).name}"
    return f"exit status {status}"


def _received(connection: Connection) -> SceneOutcome | None:
    """The message of a worker; None when it died."""
    with connection:
        try:
            outcome = connection.recv()
        except (EOFError, OSError):
            return None
    return outcome if isinstance(outcome, SceneOutcome) else None


def _work(answer: Connection, task: SceneTask, work: SceneWork, threads: int) -> None:
    """A local worker: a request to end closes the stage, which removes what is half-made."""

    def end(_number: int, _frame: FrameType | None) -> None:
        sys.exit(1)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which asks
    answer.send(run_one(task, work, threads))
    answer.close()


@contextmanager
def _dask_client(engine: EngineConfig) -> "Iterator[Client]":
    """A client of the scheduler that is named, or of one that is started here."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise GagaError(
            f"Dask is not installed. Install it: {cure_without('executors')}."
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
        # What the scheduler and workers put on the disk.
        TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        # A worker that dies or is restarted is what `_run_dask` expects: its log is no news.
        dask.config.set(
            {"distributed.logging.distributed": "critical", "temporary-directory": folder}
        ),
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=engine.workers,
            threads_per_worker=1,
            host=_HERE,
            dashboard_address=f"{_HERE}:0",
            worker_dashboard_address=None,
            local_directory=folder,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,  # type: ignore[no-untyped-call]
    ):
        yield client


def _run_dask(tasks: Sequence[SceneTask], work: SceneWork, engine: EngineConfig) -> Answers:
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
                future = client.submit(run_one, task, work, engine.threads_each, pure=False)
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
    """The result of a scene; None when its worker ended without an answer."""
    from distributed import KilledWorker

    if future.status == "finished":
        return future.result()
    problem: BaseException | None = None
    if future.status == "error":
        problem = future.exception()  # type: ignore[no-untyped-call]
    if problem is None or isinstance(problem, KilledWorker):
        return None
    text = str(problem).strip().splitlines()
    first = f": {text[0][:160]}" if text else ""
    return died(task, f"{type(problem).__name__}{first}")
