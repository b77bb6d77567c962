"""Frames of a video: the sharpest of each place, or of each moment (through ffmpeg)."""

import re
import shutil
import time
from collections import deque
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.folder.processes import follow, follow_blocks
from gaga_core.io.images import read_rgb
from gaga_core.io.video import ffmpeg_program, video_input
from gaga_core.placing.photos import LOOK_SIDE, sharpness
from gaga_core.progress import Progress, Stage, run_stage

# --- The motion of a film, and which of its frames to place.
# Frames are chosen by what changes between them, not by the clock: a film that rests gives one
# frame, one that hurries gives all of them. Among frames of about the same place the sharpest is
# taken.


_LOOK_WIDTH = 320  # pixels: frames are looked at in this size
_LOOK_HEIGHT = 2048  # pixels at most, of a film that is narrow and high
_BLOCK = 64  # pixels of a block, at half that size
_PATIENCE = 20.0  # seconds without a frame, or without a header, after which ffmpeg is ended
_MOST_PATIENCE = 240.0  # seconds, where it leaves out hundreds of frames after each that it gives
_CLEAR_PEAK = 0.08  # height of the peak of a phase correlation that is no chance


@dataclass(frozen=True)
class MotionConfig:
    """Spacing of the chosen frames."""

    step: float = 0.05  # x width that the picture moves from one chosen frame to the next
    lost: float = 0.25  # x width: motion between two frames that show hardly the same
    rate: float = 12.0  # frames looked at of each second at most
    most_looked: int = 2400
    most: int = 300  # frames chosen
    fewest: int = 24


_CONFIG = MotionConfig()


@dataclass(frozen=True, eq=False)
class FilmMotion:
    """The frames of a film at a steady rate. C frames."""

    rate: float  # frames of each second
    sharpness: DoubleArray  # (C,)
    motion: DoubleArray  # (C,) x width, since the frame before


def look_through(
    video: Path,
    seconds: float,
    native_rate: float,
    size: tuple[int, int],  # pixels
) -> Stage[FilmMotion]:
    """Read the film once, small, and measure each frame. An unreadable film has no frames."""
    rate = min(native_rate, _CONFIG.rate, _CONFIG.most_looked / max(seconds, 1e-3))
    width = _LOOK_WIDTH
    height = round(width * size[1] / max(size[0], 1) / 2) * 2
    height = min(max(_BLOCK * 2, height), _LOOK_HEIGHT)
    command = [ffmpeg_program(), "-nostdin", "-v", "error", *video_input(video)]
    command += ["-vf", f"fps={rate:.6g},scale={width}:{height}:flags=area", "-pix_fmt", "rgb24"]
    command += ["-frames:v", str(_CONFIG.most_looked), "-f", "rawvideo", "pipe:1"]
    sharp, motion = list[float](), list[float]()
    before: FloatArray | None = None
    expected = max(1, int(seconds * rate))
    # Between two frames that are looked at ffmpeg decodes others: a second for each.
    patience = max(_PATIENCE, min(native_rate / max(rate, 1e-3), _MOST_PATIENCE))
    moved_at = time.monotonic()
    with closing(follow_blocks(command, width * height * 3)) as blocks:
        for data in blocks:
            if data:
                frame: UInt8Array = np.frombuffer(data, np.uint8).reshape(height, width, 3)
                small = _halved(frame)
                sharp.append(sharpness(frame))
                motion.append(0.0 if before is None else displacement(before, small, _CONFIG.lost))
                before, moved_at = small, time.monotonic()
            elif time.monotonic() - moved_at > patience:
                raise _stalled(video, patience)
            yield Progress("Look through video", min(len(sharp), expected), expected)
    return FilmMotion(rate, np.array(sharp), np.array(motion))


def displacement(before: FloatArray, after: FloatArray, lost: float) -> float:
    """How far (x width) the picture moved between two brightness images (H, W): median of blocks.

    ``lost`` where too few blocks are found again.
    """
    height, width = before.shape
    window = np.hanning(_BLOCK)[:, None] * np.hanning(_BLOCK)
    found = []
    rows = np.linspace(0, height - _BLOCK, max(2, round(height / _BLOCK))).astype(int)
    columns = np.linspace(0, width - _BLOCK, max(2, round(width / _BLOCK))).astype(int)
    for y in rows:
        for x in columns:
            part = (slice(y, y + _BLOCK), slice(x, x + _BLOCK))
            a, b = (window * (image[part] - image[part].mean()) for image in (before, after))
            cross = np.fft.rfft2(a) * np.conj(np.fft.rfft2(b))
            peak = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-9), s=(_BLOCK, _BLOCK))
            row, column = divmod(int(peak.argmax()), _BLOCK)
            if peak[row, column] >= _CLEAR_PEAK:
                down, across = ((i + _BLOCK // 2) % _BLOCK - _BLOCK // 2 for i in (row, column))
                found.append(float(np.hypot(down, across)) / width)
    enough = len(rows) * len(columns) // 3
    return min(float(np.median(found)), lost) if len(found) > enough else lost


def choose_frames(film: FilmMotion) -> tuple[int, ...]:
    """Indices of the frames to place, ascending: one about every `MotionConfig.step`."""
    if len(film.motion) == 0:
        return ()
    way = np.cumsum(film.motion)
    step = max(_CONFIG.step, way[-1] / max(_CONFIG.most - 1, 1))
    step = min(step, max(way[-1] / max(_CONFIG.fewest - 1, 1), 1e-6))
    return _sharpest(film, way, 0.0, way[-1] + step / 2, step)


def frames_between(
    film: FilmMotion, chosen: Sequence[int], breaks: Sequence[tuple[int, int]]
) -> tuple[int, ...]:
    """More frames for each gap (first, last) of two chosen ones that no matches link.

    Four times as many there, as far as the film has them; the chosen ones are not among them.
    """
    way, found = np.cumsum(film.motion), set[int]()
    for first, last in breaks:
        inside = np.arange(first + 1, last)
        if len(inside) == 0:
            continue
        step = max((way[last] - way[first]) / 4, 1e-6)
        picked = _sharpest(film, way, way[first] + step / 2, way[last] - step / 4, step)
        found |= set(picked) & set(inside.tolist())
        if not set(picked) & set(inside.tolist()):
            found.add(int(inside[film.sharpness[inside].argmax()]))
    return tuple(sorted(found - set(chosen)))


def _sharpest(
    film: FilmMotion, way: DoubleArray, start: float, end: float, step: float
) -> tuple[int, ...]:
    """The sharpest frame near each multiple of ``step`` on the way from ``start`` to ``end``.

    A frame further from the mark counts as less sharp.
    """
    chosen: list[int] = []
    for mark in np.arange(start, end, step):
        off = np.abs(way - mark)
        near: BoolArray = off <= 0.5 * step
        if not near.any():
            continue
        worth = np.where(near, film.sharpness * (1 - 0.5 * off / step), -1.0)
        best = int(worth.argmax())
        if not chosen or best > chosen[-1]:
            chosen.append(best)
    return tuple(chosen)


def _halved(frame: UInt8Array) -> FloatArray:
    """Brightness (H/2, W/2)."""
    gray = frame.mean(axis=2, dtype=np.float32)
    height, width = gray.shape[0] // 2 * 2, gray.shape[1] // 2 * 2
    cells = gray[:height, :width].reshape(height // 2, 2, width // 2, 2)
    return cells.mean(axis=(1, 3))


STAGE = "Read video"
_CANDIDATES = 3  # frames looked at for each one kept
# A filter that prints lines which begin so for each decoded frame, chosen or not.
_MARKED = "metadata=add:key=gaga:value=1,metadata=print:key=gaga:file=-:direct=1"
_MARKS = ("frame:", "gaga=")
_MOST_SAID, _LONGEST = 1000, 300  # lines of ffmpeg that are kept, and characters of each
_MOST_READ = 50_000  # pictures written of one film: of five hours at three a second
_WHOLE = 8192  # pixels: no frame has longer sides
_MOST_FRAMES = 300  # frames kept of a long video
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
    header = yield from _header(video)
    expected = max(1, int(header.seconds * fps * _CANDIDATES))
    pictures = target / "all_%06d.jpg"
    yield from _write(video, pictures, f"fps={fps * _CANDIDATES:.6g}", longest_side, expected)
    return (yield from _keep_sharpest(sorted(target.glob("all_*.jpg")), target))


def extract_moving_frames(video: Path, target: Path, *, longest_side: int) -> Stage[FilmFrames]:
    """Write the frames that `video_motion.choose_frames` chooses, as frame_00001.jpg ...

    The number in a name is the frame's place among those that were looked at, so that more can be
    put in between. Raises ``GagaError`` when the file is no video that ffmpeg reads.
    """
    header = yield from _header(video)
    motion = yield from look_through(video, header.seconds, header.rate, header.size)
    chosen = choose_frames(motion)
    if not chosen:
        raise _unreadable(video, "no frames")
    paths = yield from _extract(video, target, motion, chosen, longest_side)
    return FilmFrames(paths, chosen, motion)


def extract_numbered_frames(video: Path, target: Path, numbers: Sequence[int]) -> Stage[None]:
    """Write those frames of ``video``, counted from 0, as 000000.jpg ... by their numbers.

    Raises ``GagaError`` when the file is no video that ffmpeg reads, or has fewer frames.
    """
    wanted = "+".join(f"eq(n\\,{i})" for i in numbers)
    choose = f"select='{wanted}'"
    yield from _write(video, target / "all_%06d.jpg", choose, _WHOLE, len(numbers))
    found = sorted(target.glob("all_*.jpg"))
    if len(found) != len(numbers):
        raise _unreadable(video, f"it ends before frame {numbers[len(found)]}")
    for path, i in zip(found, numbers, strict=True):
        path.rename(target / f"{i:06d}.jpg")


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
    command = [ffmpeg_program(), "-nostdin", "-v", "error", "-progress", "pipe:1"]
    command += [
        *video_input(video),
        "-frames:v",
        str(_MOST_READ),
        "-vf",
        f"{_MARKED},{choose},{scale}",
        "-fps_mode",
        "passthrough",
        "-qscale:v",
        "2",
    ]
    status, said = yield from _run(video, [*command, str(pictures)], expected)
    if status != 0 or not any(pictures.parent.glob("all_*.jpg")):
        shutil.rmtree(pictures.parent, ignore_errors=True)
        raise _unreadable(video, said[-1] if said else "no frames")


def _unreadable(video: Path, why: str) -> GagaError:
    return GagaError(
        f"{video} cannot be read as a video ({why[:150]}). Save it as MP4, or give a folder of "
        "photos."
    )


def _stalled(video: Path, seconds: float) -> GagaError:
    return _unreadable(video, f"ffmpeg makes no progress for {seconds:.0f} seconds")


def shows_all_directions(video: Path) -> Stage[bool]:
    """Whether each frame of ``video`` is an equirectangular picture of all directions."""
    return (yield from _header(video)).is_panorama


def frame_size(video: Path) -> tuple[int, int]:
    """Width and height. Raises ``GagaError`` when the file is no video that ffmpeg reads."""
    return run_stage(_header(video)).size


def expected_frames(video: Path) -> tuple[int, bool]:
    """Frames that `extract_frames` would keep of ``video``, 0 when it cannot be read; and what
    `shows_all_directions` says."""
    header = run_stage(_header(video))
    seconds = header.seconds
    n = int(seconds * min(_USUAL_FPS, _MOST_FRAMES / max(seconds, 1e-3)))
    return n, header.is_panorama


def _run(video: Path, command: list[str], expected: int) -> Stage[tuple[int, list[str]]]:
    """Exit status of ffmpeg and what it said; ``GagaError`` when it makes no progress."""
    done, said, moved_at = 0, deque[str](maxlen=_MOST_SAID), time.monotonic()
    lines = follow(command)
    try:
        while True:
            line = next(lines)
            if line.startswith(_MARKS):
                moved_at = time.monotonic()
                continue
            if line.startswith("frame="):
                done = int(line.removeprefix("frame=").strip() or 0)
            elif line and not re.match(r"\w+=", line):
                said.append(line[:_LONGEST])
            elif not line and time.monotonic() - moved_at > _PATIENCE:
                raise _stalled(video, _PATIENCE)
            yield Progress(STAGE, min(done, expected), expected, f"{done} frames")
    except StopIteration as end:
        return int(end.value), list(said)
    finally:
        lines.close()


def _keep_sharpest(frames: list[Path], target: Path) -> Stage[tuple[Path, ...]]:
    kept: list[Path] = []
    for i in range(0, len(frames), _CANDIDATES):
        some = frames[i : i + _CANDIDATES]
        yield Progress("Choose sharp frames", i, len(frames))
        best = max(some, key=lambda path: sharpness(read_rgb(path, LOOK_SIDE)))
        kept.append(best.rename(target / f"frame_{len(kept) + 1:05d}.jpg"))
        for path in some:
            path.unlink(missing_ok=True)
    return tuple(kept)


@dataclass(frozen=True)
class _Header:
    """Metadata of the file."""

    seconds: float  # 0 when it does not say
    rate: float  # frames of each second
    size: tuple[int, int]  # width, height, pixels
    is_panorama: bool  # it says that it is equirectangular: Spherical Video 1 or 2


def _header(video: Path) -> Stage[_Header]:
    command = [ffmpeg_program(), "-nostdin", "-hide_banner", *video_input(video)]
    told = "\n".join((yield from _run(video, command, 0))[1])
    found = re.search(r"Duration: (\d+):(\d+):(\d+\.?\d*)", told)
    hours, minutes, seconds = (float(p) for p in found.groups()) if found else (0.0, 0.0, 0.0)
    rate = re.search(r"Video:.*?(\d+\.?\d*) fps", told)
    size = re.search(r"Video:.*? (\d{2,5})x(\d{2,5})", told)
    return _Header(
        hours * 3600 + minutes * 60 + seconds,
        float(rate.group(1)) if rate else _USUAL_RATE,
        (int(size.group(1)), int(size.group(2))) if size else _USUAL_SIZE,
        re.search(r"(?i)spherical.*: equirectangular", told) is not None,
    )
