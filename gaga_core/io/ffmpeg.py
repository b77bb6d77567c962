"""The ffmpeg that reads and writes videos: the binary that the package imageio-ffmpeg brings."""

from gaga_core.errors import GagaError


def ffmpeg_program(purpose: str = "Reading a video") -> str:
    """Path of ffmpeg. Raises ``GagaError`` when it is not there: ``purpose`` needs it."""
    import imageio_ffmpeg

    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        raise GagaError(
            f"{purpose} needs ffmpeg. Install the package imageio-ffmpeg again with pip."
        ) from error
