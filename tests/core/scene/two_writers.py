"""Programs that the tests start and kill: one saves again and again, one opens again and again."""

import sys
import time
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Barrier, Event
from pathlib import Path

from gaga_core.io.folder.lock import lock_folder
from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage, save_project


def save(place: Path, n: int, begin: Barrier) -> None:
    """Open the project and save it ``n`` times over whatever is there."""
    project = run_stage(open_path_stage(place))
    begin.wait(60)
    for _ in range(n):
        save_project(project, overwrites=True)


def read(place: Path, count: "Synchronized[int]", begin: Barrier, stop: Event) -> None:
    """Open the project until ``stop`` is set; count how often."""
    begin.wait(60)
    while not stop.is_set():
        run_stage(open_path_stage(place))
        count.value += 1


def hold(place: Path, begin: Barrier) -> None:
    """Hold the folder until killed."""
    lock_folder(place)
    begin.wait(60)
    time.sleep(600)


if __name__ == "__main__":  # hold PLACE
    lock_folder(Path(sys.argv[2]))
    sys.stdout.write("held\n")
    sys.stdout.flush()
    time.sleep(600)
