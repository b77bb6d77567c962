"""The time left of a reconstruction: by which factor it is wrong, from a tenth of the time on.

Four scenes one after the other with default options, with the rates that the ones before have
left; some ten minutes. ``GAGA_BENCH_SCENES=fox,demo`` takes some of them.
"""

import os
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.files import assets
from gaga_core.pipeline.reconstruct import Estimate, look_at_photos, reconstruct_scene
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import Progress, run_stage
from tests.bench.figures import Figure, data_folder

_SCENES = {"fox": "images", "demo": "images", "tankard": "photos", "sceaux": "images"}
_CONFIG = ReconstructConfig(accept_wrong=True)
_LAST_S = 3.0  # what is left at the very end is a matter of a second


def figures() -> list[Figure]:
    """Largest factor of each scene that is on this machine."""
    names = os.environ.get("GAGA_BENCH_SCENES", ",".join(_SCENES)).split(",")
    rates: dict[str, float] = {}
    found = []
    for name in names:
        photos = (assets() / "demo" if name == "demo" else data_folder(name)) / _SCENES[name]
        if photos.is_dir():
            with tempfile.TemporaryDirectory() as folder:
                shutil.copytree(photos, Path(folder) / "photos")
                factor, rates = _factor(Path(folder) / "photos", rates)
            found.append(Figure(f"time left: {name}, wrong by at most", factor, "times", "<= 1.5"))
    return found


def _factor(photos: Path, rates: dict[str, float]) -> tuple[float, dict[str, float]]:
    """The largest factor by which the time left was wrong, and the rates afterwards."""
    found = look_at_photos(photos)
    if found is None:
        raise GagaError(f"There are no photos in {photos}.")
    estimate = Estimate(found, _CONFIG, rates)
    said: list[tuple[float, float]] = []  # time, seconds left

    def heard(step: Progress) -> None:
        said.append((time.monotonic(), estimate.follow(step)[1]))

    run_stage(reconstruct_scene(found.photos, found.scene, replace(_CONFIG, only="all")), heard)
    begun, end = said[0][0], time.monotonic()
    judged = [
        (left, end - at)
        for at, left in said
        if at - begun > (end - begun) / 10 and end - at > _LAST_S
    ]
    factors = [max(left / true, true / max(left, 1e-9)) for left, true in judged]
    return max(factors), estimate.rates()
