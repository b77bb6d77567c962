"""Videos through ffmpeg: what it may read; films that are written appear when they are whole."""

import subprocess
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, explain_os_error, open_file
from gaga_core.io.packed import unpacked_file
from gaga_core.progress import Progress, Stage

SUFFIXES = (".mp4", ".webm")
_SMALLEST, _LARGEST = 16, 8192  # pixels of a side
# Containers of films by ffmpeg's names: none of them names other files. A .gif is a film, too.
_CONTAINERS = (
    *("mov", "mp4", "matroska", "webm", "avi", "flv", "mpeg", "mpegts", "asf", "ogg", "mxf", "rm"),
    *(
        "dv",
        "gif",
        "ivf",
        "h264",
        "hevc",
        "m4v",
        "mpegvideo",
        "mjpeg",
        "yuv4mpegpipe",
        "wtv",
        "nut",
    ),
)
_MOST_PIXELS = 8192 * 4320  # of a frame: 8K
_GRACE = 60.0  # seconds that ffmpeg gets to write its last frames


def ffmpeg_program(purpose: str = "Reading a video") -> str:
    """Path of the ffmpeg that the package imageio-ffmpeg brings.

    The program folder holds it compressed, a third as large: the first film unpacks it into the
    user's cache. Raises ``GagaError`` when it is not there: ``purpose`` needs it.
    """
    import imageio_ffmpeg

    binaries = Path(imageio_ffmpeg.__file__).parent / "binaries"
    if (packed := next(binaries.glob("ffmpeg-*.zst"), None)) is not None:
        return str(unpacked_file(packed))
    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        raise GagaError(
            f"{purpose} needs ffmpeg. Install the package imageio-ffmpeg again with pip."
        ) from error


def video_input(video: Path) -> list[str]:
    """Arguments with which ffmpeg reads a film that nobody vouches for.

    No playlist, no pattern of names and nothing but this file is opened, whatever it holds. Raises
    ``GagaError`` when it is no regular file.
    """
    try:
        open_file(video).close()
    except OSError as error:
        raise GagaError(explain_os_error(error, video)) from error
    limits = ["-protocol_whitelist", "file", "-format_whitelist", ",".join(_CONTAINERS)]
    return [*limits, "-max_pixels", str(_MOST_PIXELS), "-i", f"file:{video.absolute()}"]


@dataclass(frozen=True)
class VideoConfig:
    """Size and quality of a video."""

    width: int = 1280  # pixels; codecs want even numbers: odd ones lose their last line
    height: int = 720
    fps: float = 30.0
    quality: int = 75  # 1 (small) .. 100 (no loss to be seen)

    def __post_init__(self) -> None:
        if not all(_SMALLEST <= side <= _LARGEST for side in (self.width, self.height)):
            raise GagaError(
                f"A video cannot be {self.width} x {self.height} pixels. "
                f"Choose sides of {_SMALLEST} to {_LARGEST}."
            )
        if not 0 < self.fps <= 240:
            raise GagaError(f"A video cannot have {self.fps:g} pictures a second. Choose 1 to 240.")
        if not 1 <= self.quality <= 100:
            raise GagaError(f"Quality {self.quality} is not in 1 to 100. Choose 75, say.")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height as they are written: even."""
        return self.width - self.width % 2, self.height - self.height % 2


def video_suffix(path: Path) -> str:
    """The suffix of a video's name; ``GagaError`` when it is none that can be written."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise GagaError(f"{path.name}: choose a name that ends in .mp4 (H.264) or .webm (VP9).")
    return suffix


def write_video_stage(
    path: Path,
    n_frames: int,
    frame: Callable[[int], UInt8Array],
    config: VideoConfig,
    *,
    stage: str = "Film",
) -> Stage[Path]:
    """Write ``frame(i)`` (H, W, 3), i = 0..n_frames-1, of ``config.size`` as a video.

    H.264 for .mp4, VP9 for .webm. ``frame`` is called in order, in the thread that runs the stage.
    Closing the stage ends ffmpeg and leaves nothing. Raises ``GagaError`` when it cannot be
    written, ``ValueError`` when a frame has another size.
    """
    suffix = video_suffix(path)
    with atomic_write(path) as temporary:
        whole = temporary.with_suffix(suffix)  # ffmpeg goes by it; removed with its folder entry
        try:
            with _Encoder(_command(whole, suffix, config)) as encoder:
                for i in range(n_frames):
                    yield Progress(stage, i, n_frames, f"picture {i + 1} of {n_frames}")
                    encoder.write(_checked(frame(i), config))
                yield Progress(stage, n_frames, n_frames, "Writing the file")
                encoder.finish(path)
            whole.replace(temporary)
        finally:
            whole.unlink(missing_ok=True)
    return path


def _command(target: Path, suffix: str, config: VideoConfig) -> list[str]:
    width, height = config.size
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    source = [*raw, "-r", f"{config.fps:g}", "-i", "pipe:0", "-an"]
    # RGB to the BT.709 limited range that players expect, and said so in the file.
    colors = ["-vf", "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p"]
    colors += ["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"]
    colors += ["-color_range", "tv"]
    loss = 1 - config.quality / 100
    if suffix == ".mp4":
        codec = ["-c:v", "libx264", "-preset", "medium", "-crf", f"{10 + 30 * loss:.0f}"]
        codec += ["-movflags", "+faststart"]
    else:
        codec = ["-c:v", "libvpx-vp9", "-b:v", "0", "-crf", f"{15 + 40 * loss:.0f}"]
        codec += ["-deadline", "good", "-cpu-used", "4", "-row-mt", "1"]
    start = [ffmpeg_program("Writing a video"), "-nostdin", "-hide_banner", "-v", "error", "-y"]
    return [*start, *source, *colors, *codec, str(target)]


def _checked(picture: UInt8Array, config: VideoConfig) -> UInt8Array:
    width, height = config.size
    if picture.shape != (height, width, 3) or picture.dtype != np.uint8:
        raise ValueError(
            f"frame: expected ({height}, {width}, 3) uint8, got {picture.shape} {picture.dtype}"
        )
    return np.ascontiguousarray(picture)


class _Encoder:
    """A running ffmpeg that takes frames; ended in any case when the block ends."""

    def __init__(self, command: list[str]) -> None:
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  closed at the end of the block
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._said
            )
        except OSError as error:
            self._said.close()
            raise GagaError(f"ffmpeg cannot be started ({error}). Install it again.") from error
        assert self._process.stdin is not None
        self._pipe = self._process.stdin

    def __enter__(self) -> "_Encoder":
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._said.close()
        with suppress(OSError):  # what was buffered has no reader any more
            self._pipe.close()

    def write(self, picture: UInt8Array) -> None:
        try:
            self._pipe.write(picture.data)
        except OSError as error:  # ffmpeg ended early: a full disk, say
            self._process.wait()
            raise GagaError(self._why()) from error

    def finish(self, path: Path) -> None:
        """Wait for the last frames; ``GagaError`` unless the file is whole."""
        try:
            self._pipe.close()
            status = self._process.wait(_GRACE)
        except subprocess.TimeoutExpired as error:
            raise GagaError(f"ffmpeg does not end, so {path.name} was not written.") from error
        except OSError as error:
            raise GagaError(self._why()) from error
        if status != 0:
            raise GagaError(self._why())

    def _why(self) -> str:
        self._said.seek(0)
        said = b" ".join(self._said).decode("utf-8", "replace").strip()
        return f"The video was not written: ffmpeg says {said[-200:] or 'nothing'!r}."
