"""Status of each known model on this machine."""

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.json_file import read_json
from gaga_core.segmentation.models.catalogue import CATALOGUE, KnownModel
from gaga_core.segmentation.models.download import ModelLock, lock_of, partial_bytes
from gaga_core.segmentation.models.weights import find_model, models_folder

# --- Time that a model takes for a photo on this machine: measured once used, estimated before.
# Kept in ``speed.json`` in the folder of models. An estimate compares the work of the model,
# measured once with its architecture, with how fast this machine multiplies matrices.


_FILE = "speed.json"
_SIDE, _TIMES = 64, 20  # matrices so small that one core multiplies them; times in a row
# Rounds, of which the fastest counts, each until the clock moved by so many ns: that of Windows
# moves in steps of 15.6 ms, so that a shorter one may read 0.
_ROUNDS, _ROUND_NS = 3, 50_000_000
# All end after so many ns, on a busy machine; a round after so many times in a row, when no clock
# moves: a core of 420 gigaflops takes as long for these as a round is.
_MOST_NS, _MOST = 1_000_000_000, 2000


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

    None when they are not known: never used, and nothing known of its work. The first estimate
    takes a moment, to time this machine.
    """
    found = measured(model.name)
    if found is not None:
        return found, True
    if not model.gigaflop:
        return None
    speed = _read()
    if speed.gigaflops <= 0:
        speed.gigaflops = _gigaflops()
        _write(speed)
    return model.gigaflop / speed.gigaflops, False


def _gigaflops() -> float:
    """Multiplications of float32 matrices on all cores, as networks do them.

    The fastest of some rounds on one core, times the cores, by the time that the processor spends
    on them: a busy machine does not look slow. By the time that passed where the former stands.
    """
    matrix = np.linspace(0, 1, _SIDE * _SIDE, dtype=np.float32).reshape(_SIDE, _SIDE)
    out = np.empty_like(matrix)
    found: list[float] = []  # ns a matrix
    began, start, n = time.perf_counter_ns(), time.thread_time_ns(), 0
    passed = spent = 0
    while len(found) < _ROUNDS and passed < _MOST_NS and n < _MOST * _TIMES:
        for _ in range(_TIMES):
            np.matmul(matrix, matrix, out=out)
        n += _TIMES
        now, passed = time.thread_time_ns(), time.perf_counter_ns() - began
        spent = now - start
        if spent >= _ROUND_NS:
            found.append(spent / n)
            start, n = now, 0
    best = min(found, default=(spent if spent > 0 else max(passed, 1)) / max(n, 1))
    return 2 * _SIDE**3 / best * (os.cpu_count() or 1)


def _read() -> _Speed:
    path = models_folder() / _FILE
    try:
        return read_json(path, _Speed, "") if path.is_file() else _Speed()
    except GagaError:  # damaged: it is measured again
        return _Speed()


def _write(speed: _Speed) -> None:
    try:
        with atomic_write(models_folder() / _FILE) as temporary:
            text = json.dumps(msgspec.to_builtins(speed), indent=1)
            temporary.write_text(text + "\n", encoding="utf-8")
    except GagaError:  # a folder of models that cannot be written: nothing is remembered
        return


_PURPOSES = {
    "masks": "masks of photos (gaga masks)",
    "words": "objects by words (gaga query --index-with)",
    "boxes": "phrases in one view (gaga query --detector)",
    "matches": "placing photos that SIFT does not match (gaga run)",
}


@dataclass(frozen=True)
class ModelStatus:
    """A known model on this machine."""

    model: KnownModel
    path: Path | None  # None: not here
    lock: ModelLock | None  # of weights that were downloaded by this program
    partial_bytes: int  # of a download that was stopped
    seconds: float | None  # a photo; None = not known
    is_measured: bool  # else estimated

    @property
    def good_for(self) -> str:
        """Its purpose in words."""
        purpose = _PURPOSES[self.model.purpose]
        return f"{purpose}; {self.model.note}" if self.model.note else purpose

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        model, lock = self.model, self.lock
        return {
            "name": model.name,
            "title": model.title,
            "purpose": model.purpose,
            "good_for": self.good_for,
            "repository": model.hub,
            "page": model.page,
            "licence": model.licence,
            "megabytes": model.megabytes,
            "is_gated": model.is_gated,
            "is_here": self.path is not None,
            "path": str(self.path or ""),
            "commit": lock.commit if lock is not None else "",
            "accepted_at": lock.accepted_at if lock is not None else "",
            "partial_bytes": self.partial_bytes,
            "seconds_a_photo": self.seconds,
            "is_measured": self.is_measured,
        }


def status_of(model: KnownModel) -> ModelStatus:
    """The state of one model; asks no network."""
    path = find_model(model)
    lock = lock_of(path) if path is not None and path.is_dir() else None
    known = seconds_a_photo(model) if model.purpose == "masks" else None
    seconds, is_measured = known or (None, False)
    return ModelStatus(model, path, lock, partial_bytes(model), seconds, is_measured)


def all_models() -> tuple[ModelStatus, ...]:
    """The state of every known model."""
    return tuple(status_of(model) for model in CATALOGUE)
