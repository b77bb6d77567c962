"""The whole window on 200,000 splats: what its start and its frames cost the processor.

``python -m tests.bench.window_worker FOLDER`` prints it as JSON, the drawing threads of software
OpenGL included; the first run writes the scene into FOLDER, and prints nothing of the window.
"""

import json
import sys
import time
from functools import partial
from pathlib import Path

from tests.app.window.driver import Driver, drive
from tests.bench import bench_many_groups

_SPLATS, _GROUPS = 200_000, 50
_FRAMES = 30


def measure(scene: Path) -> dict[str, float]:
    """Processor time: seconds until the first full picture, milliseconds a frame."""
    costs: dict[str, float] = {}

    def walk(d: Driver) -> None:
        costs["start_s"] = time.process_time()
        d.settle()
        cameras = d.session.cameras

        def each(name: str, *, moves: bool) -> None:
            start = time.process_time()
            for i in range(_FRAMES):
                if moves:
                    camera = cameras[i % len(cameras)]
                    d.on_main(partial(d.session.rig.go_to, camera, animated=False))
                d.frames(1)
            costs[name] = 1e3 * (time.process_time() - start) / _FRAMES

        each("rest_ms", moves=False)
        each("motion_ms", moves=True)

    drive(walk, path=scene, size=(1280, 720), patience_s=600, fills_window=True)
    return costs


if __name__ == "__main__":
    folder = Path(sys.argv[1]) / "scene"
    costs: dict[str, float] = {}
    if folder.exists():
        costs = measure(folder)
    else:
        bench_many_groups.write_scene(folder, _GROUPS, _SPLATS)
    sys.stdout.write(json.dumps(costs) + "\n")
