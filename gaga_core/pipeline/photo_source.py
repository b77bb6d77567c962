"""Photos without splats: what a path means, what was begun there, and how long it takes."""

from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from gaga_core.errors import GagaError
from gaga_core.io.images import IMAGE_SUFFIXES
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.scene_folder import find_model, find_sparse, is_scene_folder
from gaga_core.kernels import n_threads
from gaga_core.pipeline.reconstruct import (
    CHECKPOINT,
    SETTINGS,
    WORKSPACE,
    ReconstructConfig,
    find_photos,
)
from gaga_core.reconstruct.checkpoint import iteration_of
from gaga_core.reconstruct.photos import UNREAD_SUFFIXES, is_video, list_photos, unread_kinds
from gaga_core.reconstruct.undistort import ORIGINALS
from gaga_core.reconstruct.video import expected_frames

# Structure from motion of photos of a room, measured on two cores: seconds of one core.
_SECONDS_PER_PHOTO = 0.35
_SECONDS_PER_PAIR = 0.012
_TIMES = {"draft": 1.0, "standard": 4.0, "full": 12.0}  # more and finer features
_VIDEO_SIZE = (1920, 1080)  # pixels: a guess, the header is not read for it


@dataclass(frozen=True)
class PhotoFind:
    """Photos, or a video, that no splats were made of yet."""

    photos: Path | None  # where they lie; None: in the scene folder
    scene: Path  # the scene folder that is to be made, or completed
    n_photos: int  # of a video: frames that will be taken
    size: tuple[int, int]  # width, height of the first, pixels
    is_video: bool = False
    is_placed: bool = False  # there is a COLMAP model: only the training is missing
    going_on: ReconstructConfig | None = None  # settings of a training that was stopped
    iteration: int = 0  # ... and how far it came

    @property
    def name(self) -> str:
        """What to call it."""
        return (self.photos or self.scene).name

    def seconds(self, config: ReconstructConfig) -> float:
        """Rough time that making splats takes here, on the processor."""
        return (self._placing(config) + self._training(config)) / n_threads()

    def placing_share(self, config: ReconstructConfig) -> float:
        """Share of that time that goes into placing the photos, 0..1."""
        placing = self._placing(config)
        return placing / (placing + self._training(config))

    def _placing(self, config: ReconstructConfig) -> float:
        if self.is_placed:
            return 0.0
        sfm, n = config.sfm(), self.n_photos
        neighbours = sfm.overlap * 2 if self.is_video else sfm.neighbours
        pairs = n * (n - 1) / 2
        if self.is_video or n > sfm.exhaustive_up_to:
            pairs = min(pairs, n * neighbours)
        return _TIMES[config.quality] * (_SECONDS_PER_PHOTO * n + _SECONDS_PER_PAIR * pairs)

    def _training(self, config: ReconstructConfig) -> float:
        settings, (width, height) = config.train(), self.size
        times = min(1.0, settings.longest_side / max(width, height))
        left = 1 - min(self.iteration / settings.iterations, 1.0)
        return max(left * settings.cpu_seconds(round(width * height * times**2)), 1.0)


def look_at_photos(path: Path) -> PhotoFind | None:
    """What ``path`` (a scene folder, photos, a video) has to make splats of; None when nothing.

    A scene folder that has splats has nothing to make. Of photos outside a scene folder that were
    begun before, what was begun is found. Raises ``GagaError`` when the folder cannot be read, or
    holds photos of kinds only that are not read.
    """
    outside, scene = source_of(path)
    if find_model(scene) is not None:
        return None if outside is None else PhotoFind(outside, scene, 0, (1, 1))
    is_placed = find_sparse(scene) is not None
    source = scene / "images" if is_placed else outside or find_photos(scene)
    if source is None:
        return None
    going_on, iteration = _left_training(scene) if is_placed else (None, 0)
    outside = None if is_placed else outside
    if is_video(source):
        return PhotoFind(outside, scene, expected_frames(source), _VIDEO_SIZE, is_video=True)
    files = list_photos(source) if source.is_dir() else ()
    if not files:
        unread = unread_kinds(source) if source.is_dir() else ()
        if unread:
            raise GagaError(unread[0])
        return None
    return PhotoFind(
        outside, scene, len(files), _size_of(files), False, is_placed, going_on, iteration
    )


def _size_of(files: tuple[Path, ...]) -> tuple[int, int]:
    """Size of the first photo that can be read."""
    for file in files[:5]:
        try:
            with Image.open(file) as image:
                return image.size
        except (OSError, ValueError):
            continue
    return _VIDEO_SIZE


def scene_of(photos: Path) -> Path:
    """Scene folder for photos or a video that lie outside one, where the user names none.

    Next to them, with "-scene" behind the name; for SCENE/images and SCENE/input it is SCENE.
    """
    photos = photos.absolute()
    if photos.is_dir() and photos.name in ("images", ORIGINALS):
        return photos.parent
    return photos.with_name(f"{photos.stem if photos.is_file() else photos.name}-scene")


def source_of(path: Path) -> tuple[Path | None, Path]:
    """The photos and the scene folder that a user means by ``path``.

    Photos are None for a scene folder, or one to be that holds its photos or its video.
    """
    if is_video(path):
        return path, scene_of(path)
    if not path.is_dir() or is_scene_folder(path):
        return None, path
    kinds = (*IMAGE_SUFFIXES, *UNREAD_SUFFIXES)
    direct = any(p.suffix.lower() in kinds for p in path.iterdir() if p.is_file())
    if not direct:
        return None, path
    scene = scene_of(path)
    return (None if scene == path.absolute().parent else path), scene


def _left_training(scene: Path) -> tuple[ReconstructConfig | None, int]:
    """Settings of the training of ``scene`` that was stopped, and how far it came."""
    iteration = iteration_of(scene / WORKSPACE / CHECKPOINT)
    if iteration is None:
        return None, 0
    try:
        config = read_foreign_json(scene / WORKSPACE / SETTINGS, ReconstructConfig)
    except GagaError:
        return None, 0
    return config, iteration
