"""From the start of the process to the demo's first full picture, warm: kernels are compiled and
the demo scene is copied. As a ratio to importing numpy and the window's toolkit in a process."""

import os
import subprocess
import sys
import tempfile
import time

from tests.bench.figures import Figure
from tests.display import xvfb

_RUNS = 3
_LAUNCH = """
from tests.app.window.driver import Driver, drive
drive(lambda driver: None, demo=True, size=(1280, 720), fills_window=True)
"""
_BASE = "import numpy, imgui_bundle, moderngl"


def figures() -> list[Figure]:
    """Seconds are of this machine; the ratio travels."""
    with tempfile.TemporaryDirectory() as home, xvfb():
        environment = os.environ | {"GAGA_HOME": home}
        _run(_LAUNCH, environment)  # copies the demo, compiles the kernels
        launch = min(_run(_LAUNCH, environment) for _ in range(_RUNS))
        base = min(_run(_BASE, environment) for _ in range(_RUNS))
    return [
        Figure("launch: demo's first full picture, software OpenGL", launch, "s"),
        Figure("launch: ratio to importing numpy, imgui-bundle, moderngl", launch / base, "x"),
    ]


def _run(code: str, environment: dict[str, str]) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True)
    return time.perf_counter() - start
