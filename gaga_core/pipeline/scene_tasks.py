"""One scene of many as a task for any worker, and what became of it.

A worker may die at any moment. So every start of a task is a line in a file of the run
(`SceneTask.starts`), which is also how the run is stopped: a worker whose file is gone closes its
stage. Both need nothing but the folder that all workers see.
"""

import logging
import os
import socket
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from gaga_core.errors import CancelledError, GagaError
from gaga_core.io.files import explain_os_error
from gaga_core.io.scene_folder import is_scene_folder
from gaga_core.pipeline.photo_source import source_of
from gaga_core.pipeline.reconstruct import find_photos
from gaga_core.pipeline.run import RunConfig, run_folder
from gaga_core.progress import Progress, run_stage

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
        """How often a worker has started it in this run."""
        if self.starts is None or not self.starts.is_file():
            return 0
        return len(self.starts.read_text(encoding="utf-8").splitlines())


@dataclass(frozen=True)
class SceneOutcome:
    """What became of one scene."""

    scene: str  # `SceneTask.name`
    stages_run: tuple[str, ...] = ()
    failed: str = ""  # one sentence; "" = complete
    seconds: float = 0.0  # of the last attempt
    attempts: int = 1  # starts by workers; more than 1: workers ended without an answer


@dataclass(frozen=True)
class ScenesReport:
    """What became of all."""

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
            "The scenes lie on several drives. Run those of each drive alone."
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


def run_one(task: SceneTask, config: RunConfig, threads: int) -> SceneOutcome:
    """Run what is missing in one scene; a worker of any engine calls this."""
    os.environ.setdefault("GAGA_THREADS", str(threads))
    start, stages, failed = time.perf_counter(), tuple[str, ...](), ""
    attempt = _note_start(task)
    if attempt > TRIES:
        return died(task, "killed, or out of memory")
    try:
        stage = run_folder(task.folder, config, photos=task.photos)
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
