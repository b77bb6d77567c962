"""How long a model takes for a photo on this machine: measured at its use, estimated before.

Kept in ``speed.json`` in the folder of models. An estimate compares the work of the model, measured
once with its architecture, with how fast this machine multiplies matrices.
"""

import json
import os
import time
from pathlib import Path

import msgspec
import numpy as np

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.json_file import read_json
from gaga_core.models.catalogue import KnownModel
from gaga_core.models.weights import models_folder

_FILE = "speed.json"
_SIDE, _TIMES = 64, 20  # matrices so small that one core multiplies them; times in a row
_PATIENCE_S = 0.1


class _Speed(msgspec.Struct):
    seconds: dict[str, float] = {}  # a photo, by the name of the model
    gigaflops: float = 0.0  # of float32 matrices; 0 = not measured yet


def measured(name: str) -> float | None:
    """Seconds that the model ``name`` took for a photo here; None when it never ran."""
    return _read().seconds.get(name)


def record(name: str, seconds: float) -> None:
    """Remember what a photo took with the model ``name``; the newest counts."""
    if seconds <= 0:
        return
    speed = _read()
    speed.seconds[name] = round(seconds, 3)
    _write(speed)


def seconds_a_photo(model: KnownModel) -> tuple[float, bool] | None:
    """Seconds for a photo on this machine, and whether they were measured with the model.

    None when they cannot be told: never used, and nothing known of its work. The first estimate
    takes a moment, to time this machine.
    """
    found = measured(model.name)
    if found is not None:
        return found, True
    if not model.gigaflop:
        return None
    speed = _read()
    if speed.gigaflops <= 0:
        speed.gigaflops = round(_gigaflops(), 1)
        _write(speed)
    return model.gigaflop / speed.gigaflops, False


def _gigaflops() -> float:
    """Multiplications of float32 matrices on all cores, as networks do them.

    The best of many rounds of some microseconds on one core, times the cores: a busy machine does
    not look slow.
    """
    matrix = np.linspace(0, 1, _SIDE * _SIDE, dtype=np.float32).reshape(_SIDE, _SIDE)
    out = np.empty_like(matrix)
    best, end = float("inf"), time.perf_counter() + _PATIENCE_S
    while (start := time.perf_counter()) < end:
        for _ in range(_TIMES):
            np.matmul(matrix, matrix, out=out)
        best = min(best, (time.perf_counter() - start) / _TIMES)
    return 2 * _SIDE**3 / best / 1e9 * (os.cpu_count() or 1)


def _path() -> Path:
    return models_folder() / _FILE


def _read() -> _Speed:
    try:
        return read_json(_path(), _Speed, "") if _path().is_file() else _Speed()
    except GagaError:  # damaged: it is measured again
        return _Speed()


def _write(speed: _Speed) -> None:
    try:
        with atomic_write(_path()) as temporary:
            text = json.dumps(msgspec.to_builtins(speed), indent=1)
            temporary.write_text(text + "\n", encoding="utf-8")
    except GagaError:  # a folder of models that cannot be written: nothing is remembered
        return
