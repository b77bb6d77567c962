"""The film of a training: from the photos placed to the picture that turns, and to trained splats.

In a window, photos opened and made to splats as a draft. Both clocks are of the whole process,
which draws every frame in software meanwhile; seconds need a machine with nothing else.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from gaga_core.io.files import assets
from gaga_core.io.folder.scene_folder import find_sparse
from gaga_core.pipeline.settings import ReconstructConfig
from tests.bench.figures import Figure, data_folder
from tests.display import xvfb

_SIZE = (1280, 800)
_STEPS = {"the scene turns": "<= 15", "splats of the training": ""}


def figures() -> list[Figure]:
    """Seconds and CPU seconds of each step, of real photos and drawn ones."""
    found = []
    for name, photos in (("fox", data_folder("fox")), ("demo", assets() / "demo")):
        if not photos.is_dir():
            continue
        with tempfile.TemporaryDirectory() as folder:
            shutil.copytree(photos / "images", Path(folder) / "photos")
            run = subprocess.run(
                [sys.executable, "-m", "tests.bench.bench_training_film", folder],
                env=os.environ | {"GAGA_HOME": f"{folder}/home"},
                check=True,
                stdout=subprocess.PIPE,
                text=True,
            )
        took = json.loads(next(line for line in run.stdout.splitlines() if line.startswith("{")))
        for step, bar in _STEPS.items():
            cpu, seconds = took[step]
            title = f"training film: {name}, photos placed to {step}"
            found.append(Figure(f"{title}, of the processor", cpu, "CPU-s"))
            found.append(Figure(title, seconds, "s", bar))
    return found


def _work(folder: Path) -> None:
    from gaga_studio.features import reconstruction
    from tests.app.window.driver import Driver, drive

    took: dict[str, tuple[float, float]] = {}

    def test(driver: Driver) -> None:
        session, scene = driver.session, folder / f"{folder.name}-scene"
        driver.on_main(lambda: session.open(folder / "photos"))
        driver.until(lambda: session.photos is not None, "the photos are found")
        plan = reconstruction.ReconstructionPlan(ReconstructConfig(), scene)
        driver.on_main(lambda: reconstruction.make(session, plan))
        driver.until(lambda: find_sparse(scene) is not None, "the photos are placed")
        start = time.process_time(), time.monotonic()

        def note(step: str) -> None:
            took[step] = time.process_time() - start[0], time.monotonic() - start[1]

        driver.until(lambda: session.training is not None, "points are shown")
        eye = session.rig.eye.copy()
        driver.until(lambda: bool((session.rig.eye != eye).any()), "the picture turns")
        note("the scene turns")

        def trained() -> bool:
            update = session.training.update if session.training is not None else None
            return update is not None and update.gaussians is not None

        driver.until(trained, "trained splats are shown")
        note("splats of the training")
        driver.on_main(session.jobs.cancel)

    with xvfb(_SIZE):
        drive(test, size=_SIZE, fills_window=True, patience_s=1800)
    sys.stdout.write(f"\n{json.dumps(took)}\n")


if __name__ == "__main__":
    _work(Path(sys.argv[1]))
