"""Twenty scenes on a dask cluster of four worker processes that fail: ``make cluster``.

The cluster is started as a person would, with a limit of memory for each worker, and
`gaga run --executor dask --address` is given its address. One worker is killed in the middle, and
one of the scenes needs more memory than a worker may have. All others must be complete, the large
one must be named, and a second run must go on from there. Prints what it found; exit status 0 when
all of it holds.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil

from gaga_core.gaussians import Gaussians
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline.executors import SUMMARY, TRIES
from gaga_core.pipeline.run import missing_stages
from tests.app.folders import write_scene

_KINDS, _OF_EACH = 5, 4
_LARGE = "scene-07"
_LARGE_SPLATS = 5_000_000
_MEMORY = "700MiB"  # of a worker: a scene takes some 400 MiB, the large one 1.5 GiB
WORKERS = 4


def main() -> int:
    """Run the proof in a folder of its own, removed at the end."""
    with tempfile.TemporaryDirectory() as name:
        root = Path(name) / "scenes"
        _write_scenes(root)
        with cluster(Path(name), _MEMORY) as address:
            first = _run(root, address, kills=True)
            second = _run(root, address, kills=False)
    return 0 if _holds(first, second) else 1


def _write_scenes(root: Path) -> None:
    for kind in range(_KINDS):
        write_scene(root / f"scene-{kind:02d}", n_objects=2 + kind)
        for copy in range(1, _OF_EACH):
            shutil.copytree(root / f"scene-{kind:02d}", root / f"scene-{kind + copy * _KINDS:02d}")
    rng = np.random.default_rng(0)
    n = _LARGE_SPLATS
    large = Gaussians(
        means=rng.uniform(-1, 1, (n, 3)).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.full((n, 3), -6, np.float32),
        logit_opacities=np.zeros(n, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )
    write_ply(root / _LARGE / "point_cloud.ply", large)


@contextmanager
def cluster(folder: Path, memory: str = "0") -> Iterator[str]:
    """A scheduler and its workers, on this machine alone; yields the address.

    ``memory``: that a worker may take, "700MiB"; "0" = all.
    """
    where = folder / "scheduler.json"
    common = ["--scheduler-file", str(where), "--host", "127.0.0.1", "--no-dashboard"]
    scheduler = ["dask", "scheduler", "--port", "0", *common]
    limits = ["--nworkers", str(WORKERS), "--nthreads", "1", "--memory-limit", memory]
    workers = ["dask", "worker", *limits, "--local-directory", str(folder), *common]
    started = []
    try:
        for command in (scheduler, workers):
            program = [sys.executable, "-m", "dask", *command[1:]]
            log = (folder / f"{command[1]}.log").open("w")
            own = os.environ | {"TMPDIR": str(folder)}
            started.append(subprocess.Popen(program, stdout=log, stderr=log, env=own))
        while not where.is_file():
            time.sleep(0.5)
        yield json.loads(where.read_text())["address"]
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()


def _run(root: Path, address: str, *, kills: bool) -> dict[str, object]:
    """One `gaga run`; what it says, and which scenes are whole."""
    command = ["run", str(root), "--executor", "dask", "--address", address, "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "gaga_core.cli.main", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    if kills:
        _kill_in_the_middle(root, process)
    shown, said = process.communicate()
    whole = [
        folder.name
        for folder in sorted(root.glob("scene-*"))
        if not missing_stages(open_scene_folder(folder))
    ]
    page = (root / "gaga-run.html").read_text()
    pictures = page.count("data:image/webp")
    return {**json.loads(shown), "said": said, "whole": whole, "pictures": pictures}


def _kill_in_the_middle(root: Path, run: "subprocess.Popen[str]") -> None:
    """Kill the worker of another scene than the large one once eight scenes are done."""
    while run.poll() is None:
        done = json.loads((root / SUMMARY).read_text()) if (root / SUMMARY).is_file() else {}
        finished = {outcome["scene"] for outcome in done.get("outcomes", [])}
        names = sorted(folder.name for folder in root.glob("scene-*"))
        for starts in root.glob(".gaga-*/*"):
            scene = names[int(starts.name)]
            if len(finished) >= 8 and scene not in finished and scene != _LARGE:
                psutil.Process(int(starts.read_text().split()[-1])).kill()
                sys.stdout.write(f"killed the worker of {scene}\n")
                return
        time.sleep(0.1)


def _holds(first: dict[str, object], second: dict[str, object]) -> bool:
    """Print what was found; whether it is what should be."""
    n = _KINDS * _OF_EACH
    facts = {
        f"{n - 1} of {n} scenes are whole": len(_list(first["whole"])) == n - 1,
        "the large one is named": first["failed"] == [_LARGE],
        "two scenes had several workers": len(_list(first["requeued"])) == 2,
        f"the large one was tried {TRIES} times": _attempts(first, _LARGE) == TRIES,
        "pictures of all but the large one": first["pictures"] == 2 * (n - 1),
        "a second run does what is missing alone": _stages(second) == 0,
        "no traceback on the terminal": "Traceback" not in f"{first['said']}{second['said']}",
    }
    for fact, is_so in facts.items():
        sys.stdout.write(f"{'yes' if is_so else 'NO '}  {fact}\n")
    sys.stdout.write(f"said on the terminal:\n{first['said']}{second['said']}\n")
    for outcome in _list(first["outcomes"]):
        sys.stdout.write(f"{outcome}\n")
    return all(facts.values())


def _list(value: object) -> list[dict[str, object]]:
    assert isinstance(value, list)
    return value


def _attempts(report: dict[str, object], scene: str) -> object:
    found = [o["attempts"] for o in _list(report["outcomes"]) if o["scene"] == scene]
    return found[0]


def _stages(report: dict[str, object]) -> int:
    return sum(len(_list(o["stages_run"])) for o in _list(report["outcomes"]))


if __name__ == "__main__":
    sys.exit(main())
