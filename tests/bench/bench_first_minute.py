"""The first minute of a new installation: the demo with objects in a window, nothing compiled yet.

From the first picture of the splats to the answers of a click in it. Both clocks are of the whole
process, which draws ten frames a second in software meanwhile, as while a job runs; seconds need a
machine with nothing else.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from gaga_core.io.demo_scene import copy_demo_stage
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.pipeline.associate import associate_scene
from gaga_core.progress import run_stage
from tests.bench.figures import Figure
from tests.display import xvfb

_SIZE = (1280, 800)
_FRAME_S = 0.1  # from one frame to the next while something is waited for
_STEPS = ("demo opened", "outline", "thumbnails", "names", "all kernels of the window")


def figures() -> list[Figure]:
    """CPU seconds and seconds of each step, after the first picture; of the first, from the order
    to open."""
    with tempfile.TemporaryDirectory() as name:
        scene = run_stage(copy_demo_stage(Path(name) / "demo"))
        run_stage(associate_scene(open_scene_folder(scene)))
        run = subprocess.run(
            [sys.executable, "-m", "tests.bench.bench_first_minute", str(scene)],
            env=os.environ | {"NUMBA_CACHE_DIR": f"{name}/cache", "GAGA_HOME": f"{name}/home"},
            check=True,
            stdout=subprocess.PIPE,
            text=True,
        )
    took = json.loads(next(line for line in run.stdout.splitlines() if line.startswith("{")))
    bars = {"demo opened": "<= 3", "outline": "<= 5", "names": "<= 5", "thumbnails": "<= 5"}
    return [
        Figure(f"first minute: {step}{of}", took[step][k], unit, bars.get(step, "") if k else "")
        for step in _STEPS
        for k, unit, of in ((0, "CPU-s", ", of the processor"), (1, "s", ""))
    ]


def _work(scene: Path) -> None:
    from gaga_studio.features.find.search import SearchState
    from tests.app.window.driver import Driver, drive

    took: dict[str, tuple[float, float]] = {}

    def test(driver: Driver) -> None:
        session, studio = driver.session, driver.studio

        def clocks() -> tuple[float, float]:
            return time.process_time(), time.monotonic()

        def note(step: str, start: tuple[float, float]) -> None:
            now = clocks()
            took[step] = now[0] - start[0], now[1] - start[1]

        def wait(is_done: Callable[[], bool], what: str) -> None:
            def rested() -> bool:
                time.sleep(_FRAME_S)
                return is_done()

            driver.until(rested, what)

        start = clocks()
        driver.on_main(lambda: session.open(scene))
        driver.until(lambda: session.document is not None, "the scene opens")
        note(_STEPS[0], start)
        driver.until(lambda: studio.viewport is not None and studio.viewport.settled, "a picture")
        start = clocks()
        driver.click_picture(driver.size[0] * 0.5, driver.size[1] * 0.55)
        wait(lambda: session.focus > 0, "a click selects")
        note(_STEPS[1], start)
        search = session.need().feature(SearchState)
        wait(lambda: search.has_looks, "looks")
        driver.frames(4)
        wait(lambda: studio.images is not None and not studio.images.loading, "thumbnails")
        note(_STEPS[2], start)
        wait(lambda: search.described is not None, "names")
        note(_STEPS[3], start)
        wait(lambda: session.jobs.preparing is None, "kernels")
        note(_STEPS[4], start)

    with xvfb(_SIZE):
        drive(test, size=_SIZE, fills_window=True, patience_s=900)
    sys.stdout.write(f"\n{json.dumps(took)}\n")


if __name__ == "__main__":
    _work(Path(sys.argv[1]))
