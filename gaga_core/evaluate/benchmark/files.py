"""Results of a scene on disk: one JSON, valid as long as what it was made from is the same."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gaga_core.errors import GagaError
from gaga_core.evaluate.benchmark_tables import BenchmarkRun, InstanceScores, PromptScores
from gaga_core.evaluate.metrics import Score
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.json_file import read_loose_json
from gaga_core.io.masks import RECORD

VERSION = 2  # grows whenever the same settings give other figures


def digest_of(path: Path | None) -> str:
    """What tells a file or folder (with its files, two levels deep) from a later state of it:
    names, sizes and times, not contents."""
    if path is None or not path.exists():
        return ""
    files = [path] if path.is_file() else sorted((*path.glob("*"), *path.glob("*/*")))
    try:
        stats = [(file, file.stat()) for file in files if file.is_file()]
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    names = [file.relative_to(path.parent).as_posix() for file, _ in stats]
    rows = [f"{stat.st_size} {stat.st_mtime_ns}" for _, stat in stats]
    text = "\n".join(f"{name} {row}" for name, row in zip(names, rows, strict=True))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def made_by(masks: Path) -> str:
    """Name of a folder of label maps, and who made them as far as it says so."""
    try:
        record = read_loose_json(masks / RECORD)
    except GagaError:
        record = {}
    model = record.get("model")
    return f"{masks.name} ({model if isinstance(model, str) and model else 'made elsewhere'})"


def write_runs(
    file: Path, settings: Mapping[str, object], runs: Mapping[float, BenchmarkRun]
) -> None:
    """Write the runs of a scene with the settings they were made with."""
    content = {
        "version": VERSION,
        "settings": dict(settings),
        "runs": [asdict(run) for _, run in sorted(runs.items(), reverse=True)],
    }
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_runs(file: Path, settings: Mapping[str, object]) -> dict[float, BenchmarkRun]:
    """Runs by share that were made with these settings; none where the file is gone, damaged, or
    of other settings."""
    try:
        content: Any = read_loose_json(file)
        if content["version"] != VERSION or content["settings"] != dict(settings):
            return {}
        runs = [_run_of(values) for values in content["runs"]]
    except (GagaError, ValueError, KeyError, TypeError, AttributeError, OverflowError):
        return {}
    return {run.share: run for run in runs}


def _run_of(values: dict[str, object]) -> BenchmarkRun:
    return BenchmarkRun(
        share=float(str(values["share"])),
        scores=_scores_of(values["scores"]),
        n_views=int(str(values["n_views"])),
        n_groups=int(str(values["n_groups"])),
        seconds=float(str(values["seconds"])),
        missing=_words(values["missing"]),
        notes=_words(values["notes"]),
    )


def _scores_of(values: object) -> InstanceScores | PromptScores | None:
    if values is None:
        return None
    if not isinstance(values, dict):
        raise TypeError("scores")
    if "with_void" in values:
        return InstanceScores(Score(**values["with_void"]), Score(**values["without_void"]))
    by_prompt = {str(name): (float(a), float(b)) for name, (a, b) in values["by_prompt"].items()}
    return PromptScores(float(values["miou"]), float(values["mean_boundary_iou"]), by_prompt)


def _words(values: object) -> tuple[str, ...]:
    if not isinstance(values, list):
        raise TypeError("a list of words")
    return tuple(str(value) for value in values)
