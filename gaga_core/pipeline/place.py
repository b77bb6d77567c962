"""From photos to a checked placement of them in a scene folder.

Photos are examined, placed by structure from motion in as many attempts as it takes, checked, and
undistorted. What is finished of a run that was stopped lies in SCENE/.gaga-reconstruct and is taken
up the next time.
"""

import hashlib
import json
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.scene_folder import read_report_entry, with_entry
from gaga_core.io.splits import carry_split
from gaga_core.pipeline.photo_set import photo_set_stage
from gaga_core.pipeline.placement_report import notes_of, sfm_entry
from gaga_core.pipeline.reconstruct_settings import ReconstructConfig
from gaga_core.progress import Stage
from gaga_core.reconstruct.controls import option
from gaga_core.reconstruct.foreground import MASKS, paint_background
from gaga_core.reconstruct.photos import PhotoSet, is_video, list_photos
from gaga_core.reconstruct.sfm_checks import Verdict
from gaga_core.reconstruct.sfm_ladder import Ladder, place_stage
from gaga_core.reconstruct.undistort import ORIGINALS, require_room, undistort_into

WORKSPACE = ".gaga-reconstruct"
_PICTURE_SIDE = 1600  # pixels of the pictures in a scene folder (Kerbl 2023)


class WrongModelError(GagaError):
    """The checks refuse the placement of the photos; ``finding`` says why and what to try."""

    def __init__(self, finding: str) -> None:
        super().__init__(f"{finding} (--accept-wrong keeps it all the same.)")
        self.finding = finding


def find_photos(scene: Path) -> Path | None:
    """The photos of a scene folder: input/, images/, or the one video in it; None without any."""
    for folder in (scene / ORIGINALS, scene / "images"):
        if folder.is_dir() and list_photos(folder):
            return folder
    videos = [path for path in sorted(scene.iterdir()) if is_video(path)] if scene.is_dir() else []
    return videos[0] if len(videos) == 1 else None


def place_photos(
    photos: Path | None, scene: Path, config: ReconstructConfig
) -> Stage[tuple[str, ...]]:
    """Photos -> checked COLMAP model and undistorted pictures in ``scene``; returns notes."""
    source = photos or find_photos(scene)
    if source is None:
        raise GagaError(f"There are no photos in {scene}. Put them into {scene / 'images'}.")
    start, existed = time.perf_counter(), scene.exists()
    workspace = scene / WORKSPACE
    try:
        _claim(workspace, _fingerprint(source, config))
        require_room(scene, source, workspace)
        found = yield from photo_set_stage(source, workspace, config)
        made = yield from place_stage(
            found,
            workspace,
            config.sfm(),
            priors=_priors(found),
            ladder=config.ladder(),
            scene=config.scene,
        )
        _require(made, config)
        _take(made.best.model, workspace / "model")
        if config.object_only:
            masks = workspace / MASKS
            yield from paint_background(found.photos, workspace / "photos", masks)
        side = max(_PICTURE_SIDE, config.max_side or 0)
        yield from undistort_into(
            scene, found, workspace, config.sfm(), longest_side=side, replaces=source
        )
        carry_split(source, scene)
    except OSError as error:
        raise GagaError(explain_os_error(error, scene)) from error
    finally:
        if not (workspace / "photos.json").is_file():
            shutil.rmtree(workspace, ignore_errors=True)
            if not existed and scene.is_dir() and not any(scene.iterdir()):
                scene.rmdir()
    entry = sfm_entry(source, found, made)
    write_entry(scene, {"sfm": entry | {"seconds": round(time.perf_counter() - start, 1)}})
    shutil.rmtree(workspace, ignore_errors=True)
    return notes_of(entry)


def read_entry(scene: Path) -> dict[str, object]:
    """The entry "reconstruct" of the scene's report.json; empty when there is none."""
    path = scene / "gaga" / "report.json"
    return read_report_entry(path, "reconstruct", dict[str, object]) or {}


def write_entry(scene: Path, values: dict[str, object]) -> None:
    """Add ``values`` to that entry."""
    path = scene / "gaga" / "report.json"
    text = with_entry(path, "reconstruct", read_entry(scene) | values)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _claim(workspace: Path, fingerprint: str) -> None:
    """Make the workspace this task's: what another left in it is removed."""
    mark = workspace / "task"
    if not (mark.is_file() and mark.read_text(encoding="ascii") == fingerprint):
        shutil.rmtree(workspace, ignore_errors=True)
        workspace.mkdir(parents=True)
        mark.write_text(fingerprint, encoding="ascii")


def _fingerprint(source: Path, config: ReconstructConfig) -> str:
    """Digest of the photos' names, sizes and times and of the settings that change their places."""
    files: Sequence[Path] = (source,) if source.is_file() else list_photos(source)
    stats = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    settings = asdict(replace(config.sfm(), threads=0))
    task = [stats, settings, config.focal, config.video_fps, config.foreground]
    return hashlib.sha256(json.dumps(task).encode()).hexdigest()


def _priors(photos: PhotoSet) -> dict[str, float]:
    return {photo.name: photo.focal for photo in photos.photos if photo.focal is not None}


def _take(model: Path, target: Path) -> None:
    """Put the chosen model where the next step looks for it."""
    if model != target:
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(model, target)


def _require(made: Ladder, config: ReconstructConfig) -> None:
    """``GagaError`` unless the best placement may be used."""
    best = made.best
    if config.scene > len(best.scenes):
        raise GagaError(
            f"--scene {config.scene}: the placed photos show {_scenes(len(best.scenes))} only. "
            "Leave --scene out, or give a smaller number."
        )
    late = f"The time for placing was used up; {option('--place-minutes')} gives more."
    why = (*made.reasons(), *((late,) if made.out_of_time else ()))
    refuse(best.verdicts, "The model of these photos is not to be trusted.", config, why)


def refuse(
    verdicts: Sequence[Verdict],
    title: str,
    config: ReconstructConfig,
    reasons: Sequence[str] = (),
) -> None:
    """`WrongModelError` when a verdict is an error and the settings do not accept it."""
    errors = [verdict.text for verdict in verdicts if verdict.level == "error"]
    if errors and not config.accept_wrong:
        raise WrongModelError(" ".join((title, *errors, *reasons)))


def _scenes(n: int) -> str:
    return "one scene" if n == 1 else f"{n} scenes"
