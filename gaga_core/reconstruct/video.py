"""Frames of a video: evenly spread, the sharpest of each moment (through ffmpeg)."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.ffmpeg import ffmpeg_program
from gaga_core.io.images import read_rgb
from gaga_core.progress import Progress, Stage
from gaga_core.reconstruct.subprocess_lines import follow

STAGE = "Read video"
_CANDIDATES = 3  # frames looked at for each one kept
_MOST = 300  # frames kept: a longer video is read at a lower rate
_LOOK_SIDE = 640  # pixels: sharpness is compared at this size
_DEFAULT_FPS = 2.0


def extract_frames(
    video: Path,
    target: Path,
    *,
    fps: float | None = None,  # frames kept a second; None = 2, fewer if the video is long
    longest_side: int,  # pixels
) -> Stage[tuple[Path, ...]]:
    """Write frames of ``video`` to ``target`` as frame_00001.jpg ...; returns them in order.

    Three times as many are read, and the sharpest of each three neighbours stays. Raises
    ``GagaError`` when the file is no video that ffmpeg reads.
    """
    seconds = _duration(video)
    rate = fps or _rate(seconds)
    target.mkdir(parents=True, exist_ok=True)
    expected = max(1, int(seconds * rate * _CANDIDATES))
    size = f"min(1,{longest_side}/max(iw,ih))"
    picture = f"fps={rate * _CANDIDATES:.6g},scale=trunc(iw*{size}/2)*2:trunc(ih*{size}/2)*2"
    command = [ffmpeg_program(), "-nostdin", "-v", "error", "-progress", "pipe:1", "-i", str(video)]
    command += ["-vf", picture.replace("min(1,", "min(1\\,").replace("max(iw,", "max(iw\\,")]
    command += ["-qscale:v", "2", str(target / "all_%06d.jpg")]
    status, said = yield from _run(command, expected)
    frames = sorted(target.glob("all_*.jpg"))
    if status != 0 or not frames:
        shutil.rmtree(target, ignore_errors=True)
        raise GagaError(
            f"{video} cannot be read as a video ({said[:150]}). Save it as MP4, or give a folder "
            "of photos."
        )
    return (yield from _keep_sharpest(frames, target))


def expected_frames(video: Path) -> int:
    """Frames that `extract_frames` would keep of ``video``; 0 when it cannot be read."""
    seconds = _duration(video)
    return int(seconds * _rate(seconds))


def _rate(seconds: float) -> float:
    """Frames kept a second of a video, where the user does not say."""
    return min(_DEFAULT_FPS, _MOST / max(seconds, 1e-3))


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


def sharpness(picture: UInt8Array) -> float:
    """Variance of the Laplacian of the brightness of a picture (H, W, 3): larger is sharper."""
    gray: FloatArray = picture.mean(axis=2, dtype=np.float32)
    inner = gray[1:-1, 1:-1] * 4
    laplacian = inner - gray[:-2, 1:-1] - gray[2:, 1:-1] - gray[1:-1, :-2] - gray[1:-1, 2:]
    return float(laplacian.var())


def _duration(video: Path) -> float:
    """Seconds of the video, as its header says; 0 when it does not."""
    told = subprocess.run(
        [ffmpeg_program(), "-nostdin", "-hide_banner", "-i", str(video)],
        capture_output=True,
        check=False,
        encoding="utf-8",
        errors="replace",
        timeout=60,
    ).stderr
    found = re.search(r"Duration: (\d+):(\d+):(\d+\.?\d*)", told)
    if found is None:
        return 0.0
    hours, minutes, seconds = (float(part) for part in found.groups())
    return hours * 3600 + minutes * 60 + seconds
