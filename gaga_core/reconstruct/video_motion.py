"""How a film moves, and which of its frames are worth to be placed.

Frames are chosen by what changes between them, not by the clock: a film that rests gives one frame,
one that hurries gives all of them. Among frames of about the same place the sharpest is taken.
"""

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, UInt8Array
from gaga_core.io.ffmpeg import ffmpeg_program
from gaga_core.progress import Progress, Stage
from gaga_core.reconstruct.sharpness import sharpness

_WIDTH = 320  # pixels: frames are looked at in this size
_BLOCK = 64  # pixels of a block, at half that size
_CLEAR = 0.08  # height of the peak of a phase correlation that is no chance


@dataclass(frozen=True)
class MotionConfig:
    """How far apart the chosen frames are."""

    step: float = 0.05  # x width that the picture moves from one chosen frame to the next
    lost: float = 0.25  # x width: motion between two frames that show hardly the same
    rate: float = 12.0  # frames looked at of each second at most
    most_looked: int = 2400
    most: int = 300  # frames chosen
    fewest: int = 24


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
    config: MotionConfig | None = None,
) -> Stage[FilmMotion]:
    """Read the film once, small, and measure each frame. An unreadable film has no frames."""
    config = config or MotionConfig()
    rate = min(native_rate, config.rate, config.most_looked / max(seconds, 1e-3))
    width = _WIDTH
    height = max(_BLOCK * 2, round(width * size[1] / max(size[0], 1) / 2) * 2)
    command = [ffmpeg_program(), "-nostdin", "-v", "error", "-i", str(video)]
    command += ["-vf", f"fps={rate:.6g},scale={width}:{height}:flags=area", "-pix_fmt", "rgb24"]
    command += ["-f", "rawvideo", "pipe:1"]
    sharp, motion = list[float](), list[float]()
    before: FloatArray | None = None
    expected = max(1, int(seconds * rate))
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        try:
            while process.stdout is not None:
                data = process.stdout.read(width * height * 3)
                if len(data) < width * height * 3:
                    break
                frame: UInt8Array = np.frombuffer(data, np.uint8).reshape(height, width, 3)
                small = _halved(frame)
                sharp.append(sharpness(frame))
                motion.append(0.0 if before is None else displacement(before, small, config.lost))
                before = small
                yield Progress("Look through video", min(len(sharp), expected), expected)
        finally:
            process.kill()
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
            if peak[row, column] >= _CLEAR:
                down, across = ((i + _BLOCK // 2) % _BLOCK - _BLOCK // 2 for i in (row, column))
                found.append(float(np.hypot(down, across)) / width)
    enough = len(rows) * len(columns) // 3
    return min(float(np.median(found)), lost) if len(found) > enough else lost


def choose_frames(film: FilmMotion, config: MotionConfig | None = None) -> tuple[int, ...]:
    """Indices of the frames to place, ascending: one about every `MotionConfig.step`."""
    config = config or MotionConfig()
    if len(film.motion) == 0:
        return ()
    way = np.cumsum(film.motion)
    step = max(config.step, way[-1] / max(config.most - 1, 1))
    step = min(step, max(way[-1] / max(config.fewest - 1, 1), 1e-6))
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
    result: FloatArray = cells.mean(axis=(1, 3))
    return result
