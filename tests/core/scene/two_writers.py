"""Programs that the tests start and kill: one saves again and again, one opens again and again."""

import sys
import time
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.folder.lock import lock_folder
from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage, save_project


def save(place: Path, n: int) -> None:
    """Open the project and save it ``n`` times over whatever is there."""
    project = run_stage(open_path_stage(place))
    sys.stdout.write("saving\n")
    sys.stdout.flush()
    for _ in range(n):
        save_project(project, overwrites=True)


def read(place: Path, seconds: int) -> None:
    """Open the project for some seconds; print how often."""
    end, n = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        run_stage(open_path_stage(place))
        n += 1
    sys.stdout.write(f"{n}\n")


def hold(place: Path, _: int) -> None:
    """Hold the folder until killed."""
    lock_folder(place)
    sys.stdout.write("held\n")
    sys.stdout.flush()
    time.sleep(600)


if __name__ == "__main__":
    what = {"save": save, "read": read, "hold": hold}[sys.argv[1]]
    try:
        what(Path(sys.argv[2]), int(sys.argv[3]))
    except GagaError as error:
        sys.stdout.write(f"{error}\n")
        sys.exit(1)
