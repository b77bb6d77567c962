"""Frames of a video: the sharpest of each place, or of each moment (through ffmpeg)."""

import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.ffmpeg import ffmpeg_program
from gaga_core.io.images import read_rgb
from gaga_core.progress import Progress, Stage
from gaga_core.reconstruct.sharpness import sharpness
from gaga_core.reconstruct.subprocess_lines import follow
from gaga_core.reconstruct.video_motion import (
    FilmMotion,
    choose_frames,
    frames_between,
    look_through,
)

STAGE = "Read video"
_CANDIDATES = 3  # frames looked at for each one kept
_MOST = 300  # frames kept of a long video
_LOOK_SIDE = 640  # pixels: sharpness is compared at this size
_USUAL_FPS = 2.0  # frames that are kept of a second of an unhurried film
_USUAL_RATE, _USUAL_SIZE = 30.0, (1920, 1080)  # of a film whose header does not say


@dataclass(frozen=True)
class FilmFrames:
    """Frames of a film that lie in a folder, and how the film moves, to find more of them."""

    paths: tuple[Path, ...]  # in order
    chosen: tuple[int, ...]  # indices into the film's frames, ascending
    motion: FilmMotion | None  # None: they were taken by the clock


def extract_frames(
    video: Path,
    target: Path,
    *,
    fps: float,  # frames kept a second
    longest_side: int,  # pixels
) -> Stage[tuple[Path, ...]]:
    """Write frames of ``video`` by the clock to ``target`` as frame_00001.jpg ...; returns them.

    Three times as many are read, and the sharpest of each three neighbours stays. Raises
    ``GagaError`` when the file is no video that ffmpeg reads.
    """
    header = _header(video)
    expected = max(1, int(header.seconds * fps * _CANDIDATES))
    pictures = target / "all_%06d.jpg"
    yield from _write(video, pictures, f"fps={fps * _CANDIDATES:.6g}", longest_side, expected)
    return (yield from _keep_sharpest(sorted(target.glob("all_*.jpg")), target))


def extract_moving_frames(video: Path, target: Path, *, longest_side: int) -> Stage[FilmFrames]:
    """Write the frames that `video_motion.choose_frames` chooses, as frame_00001.jpg ...

    The number in a name is the frame's place among those that were looked at, so that more can be
    put in between. Raises ``GagaError`` when the file is no video that ffmpeg reads.
    """
    header = _header(video)
    motion = yield from look_through(video, header.seconds, header.rate, header.size)
    chosen = choose_frames(motion)
    if not chosen:
        raise _unreadable(video, "no frames")
    paths = yield from _extract(video, target, motion, chosen, longest_side)
    return FilmFrames(paths, chosen, motion)


def extract_more_frames(
    video: Path,
    target: Path,
    frames: FilmFrames,
    breaks: Sequence[tuple[int, int]],  # indices into frames.chosen: neighbours without matches
    *,
    longest_side: int,  # pixels
) -> Stage[FilmFrames]:
    """The same frames with more of them where the chain breaks; as they are if there are none."""
    if frames.motion is None:
        return frames
    gaps = [(frames.chosen[i], frames.chosen[j]) for i, j in breaks]
    more = frames_between(frames.motion, frames.chosen, gaps)
    if not more:
        return frames
    paths = yield from _extract(video, target, frames.motion, more, longest_side)
    chosen = tuple(sorted({*frames.chosen, *more}))
    return FilmFrames(tuple(sorted({*frames.paths, *paths})), chosen, frames.motion)


def _extract(
    video: Path, target: Path, motion: FilmMotion, chosen: Sequence[int], longest_side: int
) -> Stage[tuple[Path, ...]]:
    """The frames ``chosen`` of those that were looked at."""
    wanted = "+".join(f"eq(n\\,{i})" for i in chosen)
    choose = f"fps={motion.rate:.6g},select='{wanted}'"
    yield from _write(video, target / "all_%06d.jpg", choose, longest_side, len(chosen))
    found = []
    for path, i in zip(sorted(target.glob("all_*.jpg")), chosen, strict=False):
        found.append(path.rename(target / f"frame_{i + 1:05d}.jpg"))
    return tuple(found)


def _write(
    video: Path, pictures: Path, choose: str, longest_side: int, expected: int
) -> Stage[None]:
    """Write the frames that the filter ``choose`` lets through, no side over ``longest_side``."""
    pictures.parent.mkdir(parents=True, exist_ok=True)
    size = f"min(1\\,{longest_side}/max(iw\\,ih))"
    scale = f"scale=trunc(iw*{size}/2)*2:trunc(ih*{size}/2)*2"
    command = [ffmpeg_program(), "-nostdin", "-v", "error", "-progress", "pipe:1", "-i", str(video)]
    command += ["-vf", f"{choose},{scale}", "-fps_mode", "passthrough", "-qscale:v", "2"]
    status, said = yield from _run([*command, str(pictures)], expected)
    if status != 0 or not any(pictures.parent.glob("all_*.jpg")):
        shutil.rmtree(pictures.parent, ignore_errors=True)
        raise _unreadable(video, said)


def _unreadable(video: Path, why: str) -> GagaError:
    return GagaError(
        f"{video} cannot be read as a video ({why[:150]}). Save it as MP4, or give a folder of "
        "photos."
    )


def expected_frames(video: Path) -> int:
    """Frames that `extract_frames` would keep of ``video``; 0 when it cannot be read."""
    seconds = _header(video).seconds
    return int(seconds * min(_USUAL_FPS, _MOST / max(seconds, 1e-3)))


def _run(command: list[str], expected: int) -> Stage[tuple[int, str]]:
    """Exit status of ffmpeg and what it said last."""
    lines, done, said = follow(command), 0, "no frames"
    try:
        while True:
            line = next(lines)
            if line.startswith("frame="):
                done = int(line.removeprefix("frame=").strip() or 0)
            elif line and not re.match(r"\w+=", line):
                said = line
            yield Progress(STAGE, min(done, expected), expected, f"{done} frames")
    except StopIteration as end:
        return int(end.value), said
    finally:
        lines.close()


def _keep_sharpest(frames: list[Path], target: Path) -> Stage[tuple[Path, ...]]:
    kept: list[Path] = []
    for i in range(0, len(frames), _CANDIDATES):
        some = frames[i : i + _CANDIDATES]
        yield Progress("Choose sharp frames", i, len(frames))
        best = max(some, key=lambda path: sharpness(read_rgb(path, _LOOK_SIDE)))
        kept.append(best.rename(target / f"frame_{len(kept) + 1:05d}.jpg"))
        for path in some:
            path.unlink(missing_ok=True)
    return tuple(kept)


@dataclass(frozen=True)
class _Header:
    """What the file says of itself."""

    seconds: float  # 0 when it does not say
    rate: float  # frames of each second
    size: tuple[int, int]  # width, height, pixels


def _header(video: Path) -> _Header:
    told = subprocess.run(
        [ffmpeg_program(), "-nostdin", "-hide_banner", "-i", str(video)],
        capture_output=True,
        check=False,
        encoding="utf-8",
        errors="replace",
        timeout=60,
    ).stderr
    found = re.search(r"Duration: (\d+):(\d+):(\d+\.?\d*)", told)
    hours, minutes, seconds = (float(p) for p in found.groups()) if found else (0.0, 0.0, 0.0)
    rate = re.search(r"Video:.*?(\d+\.?\d*) fps", told)
    size = re.search(r"Video:.*? (\d{2,5})x(\d{2,5})", told)
    return _Header(
        hours * 3600 + minutes * 60 + seconds,
        float(rate.group(1)) if rate else _USUAL_RATE,
        (int(size.group(1)), int(size.group(2))) if size else _USUAL_SIZE,
    )
