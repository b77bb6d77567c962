"""The photos of a reconstruction, in its workspace: from a folder, or frames of a film."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from gaga_core.io.files import atomic_write
from gaga_core.pipeline.reconstruct_settings import ReconstructConfig
from gaga_core.progress import Stage
from gaga_core.reconstruct.foreground import MASKS, masks_from_folder, masks_of_what_moves
from gaga_core.reconstruct.photos import (
    PhotoSet,
    ignored_files,
    is_video,
    list_photos,
    prepare_photos,
    read_photo_set,
    unread_kinds,
)
from gaga_core.reconstruct.sfm import run_matching
from gaga_core.reconstruct.sfm_diagnosis import MatchFacts, chain_breaks
from gaga_core.reconstruct.video import (
    FilmFrames,
    extract_frames,
    extract_more_frames,
    extract_moving_frames,
)

_PREPARED_SIDE = 3200  # pixels: larger photos bring nothing to the matching
_ROUNDS = 2  # times that more frames are taken where the chain breaks


def photo_set_stage(source: Path, workspace: Path, config: ReconstructConfig) -> Stage[PhotoSet]:
    """The photos of ``source``, a folder or a film, ready in workspace/photos.

    What was made ready before is read. Raises ``GagaError`` when there are too few.
    """
    file = workspace / "photos.json"
    if file.is_file():
        return read_photo_set(file)
    if is_video(source):
        found = yield from _film(source, workspace, config)
    else:
        others = (*unread_kinds(source), *ignored_files(source))
        found = yield from _prepared(list_photos(source), workspace, source, config, others=others)
    shutil.rmtree(workspace / "frames", ignore_errors=True)
    if config.foreground is not None:
        yield from masks_from_folder(found, Path(config.foreground), workspace / MASKS)
    elif config.turntable:
        yield from masks_of_what_moves(found, workspace / "photos", workspace / MASKS)
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(found.to_json()), encoding="utf-8")
    return found


def _prepared(
    sources: Sequence[Path],
    workspace: Path,
    root: Path,
    config: ReconstructConfig,
    *,
    ordered: bool = False,
    others: Sequence[str] = (),
) -> Stage[PhotoSet]:
    shutil.rmtree(workspace / "photos", ignore_errors=True)
    return (
        yield from prepare_photos(
            sources,
            workspace / "photos",
            root=root,
            longest_side=_PREPARED_SIDE,
            focal=config.focal,
            ordered=ordered,
            others=others,
        )
    )


def _film(video: Path, workspace: Path, config: ReconstructConfig) -> Stage[PhotoSet]:
    """Frames by the clock where a person says so, else as the film moves.

    Where two neighbours share no matches, frames between them are added and matched again.
    """
    root = workspace / "frames"
    shutil.rmtree(root, ignore_errors=True)
    side = _PREPARED_SIDE
    if config.video_fps is not None:
        paths = yield from extract_frames(video, root, fps=config.video_fps, longest_side=side)
        return (yield from _prepared(paths, workspace, root, config, ordered=True))
    frames = yield from extract_moving_frames(video, root, longest_side=side)
    found = yield from _prepared(frames.paths, workspace, root, config, ordered=True)
    for _ in range(0 if config.object_only else _ROUNDS):
        yield from run_matching(found, workspace, config.sfm())
        gaps = _gaps(frames, MatchFacts.load(workspace / "matches.npz"))
        more = yield from extract_more_frames(video, root, frames, gaps, longest_side=side)
        if more is frames:
            break
        frames = more
        for mark in workspace.glob("*.finished"):
            mark.unlink()
        found = yield from _prepared(frames.paths, workspace, root, config, ordered=True)
    return found


def _gaps(frames: FilmFrames, matches: MatchFacts) -> list[tuple[int, int]]:
    """The breaks of the chain, as indices into ``frames.chosen``."""
    place = {path.stem: i for i, path in enumerate(frames.paths)}
    return [(place[Path(a).stem], place[Path(b).stem]) for a, b in chain_breaks(matches)]
