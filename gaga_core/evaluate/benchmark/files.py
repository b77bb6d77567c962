"""Results of a scene on disk: one JSON, valid as long as what it was made from is the same."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import msgspec

from gaga_core.errors import GagaError
from gaga_core.evaluate.benchmark.tables import BenchmarkRun, InstanceScores, PromptScores
from gaga_core.evaluate.published import MADE_ELSEWHERE
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.masks.label_maps import RECORD, MaskRecord

VERSION = 3  # grows whenever the same settings give other figures


def digest_of(path: Path | None) -> str:
    """Stamp that tells a file or folder (with files, two levels deep) from a later state of it:
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
    """Name of a folder of label maps, who made them and from how many points, as far as it says so:
    "sam (SAM ViT-H, 64 points a side, predicted IoU 0.7)"."""
    try:
        record = read_foreign_json(masks / RECORD, MaskRecord)
    except GagaError:
        record = MaskRecord()
    return f"{masks.name} ({', '.join([record.model or MADE_ELSEWHERE, *_prompts(record)])})"


def _prompts(record: MaskRecord) -> list[str]:
    """How a model that is asked at points was asked; empty for others."""
    points, least = (record.settings.get(name) for name in ("points_per_side", "pred_iou_thresh"))
    known = isinstance(points, int) and isinstance(least, int | float)
    return [f"{points} points a side, predicted IoU {least:g}"] if known else []


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


class _RunEntry(msgspec.Struct, frozen=True):
    """A run as it is written: a `BenchmarkRun` whose scores are of one of two kinds."""

    share: float
    scores: dict[str, object] | None
    n_views: int
    n_groups: int
    seconds: float
    missing: tuple[str, ...]
    notes: tuple[str, ...]

    def run(self) -> BenchmarkRun:
        """The run; ``ValueError`` when its scores are of neither kind."""
        scores: InstanceScores | PromptScores | None = None
        if self.scores is not None and "with_void" in self.scores:
            scores = msgspec.convert(self.scores, InstanceScores)
        elif self.scores is not None:
            scores = msgspec.convert(self.scores, PromptScores)
        return BenchmarkRun(**msgspec.structs.asdict(self) | {"scores": scores})


class _RunsFile(msgspec.Struct, frozen=True):
    """Content of the file."""

    version: int
    settings: dict[str, object]
    runs: list[_RunEntry]


def read_runs(file: Path, settings: Mapping[str, object]) -> dict[float, BenchmarkRun]:
    """Runs by share that were made with these settings; none where the file is gone, damaged, or
    of other settings."""
    try:
        content = read_foreign_json(file, _RunsFile)
        if content.version != VERSION or content.settings != dict(settings):
            return {}
        runs = [entry.run() for entry in content.runs]
    except (GagaError, ValueError):  # the second of scores of neither kind
        return {}
    return {run.share: run for run in runs}
