"""The photos of a reconstruction: listed, examined one by one, and prepared for matching.

Cameras, phones and editors leave all kinds of files in a folder. What cannot be used is left out
and named; what can be is turned upright, made 8-bit RGB, and shrunk if it is very large.
"""

import hashlib
import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from PIL import ExifTags, Image

from gaga_core.arrays import DoubleArray, FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.depth_maps import is_map
from gaga_core.io.images import (
    HEIF_SUFFIXES,
    IMAGE_SUFFIXES,
    RAW_SUFFIXES,
    image_header,
    read_rgb,
)
from gaga_core.io.json_file import read_json
from gaga_core.progress import Progress, Stage

# --- Copies of a photo: smaller, compressed again, or with another exposure, as from a chat.


_FINE_SIDE = 128  # pixels: pictures are compared at this size
_COARSE_SIDE = 16  # ... and first at this one
_ALIKE = 0.998  # correlation from which two pictures may be of one photo, coarse
_SAME_DIFFERENCE = 0.08  # standard deviations: mean difference of two copies at most
_SIDES_APART = 0.01  # sides may differ by this share


class LooksIndex:
    """The photos that were looked at so far, to find copies among them."""

    def __init__(self) -> None:
        self._coarse: list[FloatArray] = []
        self._fine: list[FloatArray] = []
        self._ratio: list[float] = []

    def has_like(self, picture: UInt8Array) -> bool:
        """Whether ``picture`` (H, W, 3) is a copy of one of them; remembers it if not.

        Two photos from places a step apart differ by far more than copies do.
        """
        height, width = picture.shape[:2]
        coarse, fine = _looks(picture, _COARSE_SIDE), _looks(picture, _FINE_SIDE)
        ratio = width / height
        for other, detail, shape in zip(self._coarse, self._fine, self._ratio, strict=True):
            if abs(shape / ratio - 1) > _SIDES_APART or float((coarse * other).mean()) < _ALIKE:
                continue
            # Where there is something: a small object may turn in front of much white.
            content = (np.abs(fine) > 1) | (np.abs(detail) > 1)
            if float(np.abs(fine - detail)[content].mean()) < _SAME_DIFFERENCE:
                return True
        self._coarse.append(coarse)
        self._fine.append(fine)
        self._ratio.append(ratio)
        return False


def _looks(picture: UInt8Array, side: int) -> FloatArray:
    """Brightness (side, side) with mean 0 and standard deviation 1."""
    image = Image.fromarray(picture).convert("L").resize((side, side), Image.Resampling.LANCZOS)
    gray = np.asarray(image, np.float32)
    return (gray - gray.mean()) / max(float(gray.std()), 1.0)


# --- Sharpness of a picture: the strength of its finest detail.


LOOK_SIDE = 640  # pixels: pictures are compared at this size


def sharpness(picture: UInt8Array) -> float:
    """Variance of the Laplacian of the brightness of a picture (H, W, 3): larger is sharper.

    Divided by the variance of the brightness itself, so that a dark photo is not a blurred one.
    """
    gray: FloatArray = picture.mean(axis=2, dtype=np.float32)
    if min(gray.shape) < 3:  # one row more on each side of the Laplacian
        return 0.0
    inner = gray[1:-1, 1:-1] * 4
    laplacian = inner - gray[:-2, 1:-1] - gray[2:, 1:-1] - gray[1:-1, :-2] - gray[1:-1, 2:]
    return float(laplacian.var() / max(float(gray.var()), 1.0))


def shrunk(picture: UInt8Array, longest_side: int) -> UInt8Array:
    """``picture`` (H, W, 3) with no side longer than ``longest_side`` pixels."""
    height, width = picture.shape[:2]
    times = longest_side / max(width, height)
    if times >= 1:
        return picture
    size = (max(round(width * times), 1), max(round(height * times), 1))
    image = Image.fromarray(picture).resize(size, Image.Resampling.BOX, reducing_gap=2.0)
    return np.asarray(image)


STAGE = "Look at photos"
FEWEST = 3  # photos: two to train on and one held out
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg")
_WITH_EXTRAS = (*HEIF_SUFFIXES, *RAW_SUFFIXES)
UNREAD_SUFFIXES = (".jxl", *(s for s in _WITH_EXTRAS if s not in IMAGE_SUFFIXES))
_SAVE_AS = "install gaga-studio[photos], or save as JPEG to use"
MASKS = "photo_masks"  # folder next to the photos: NAME.jpg.png, black = background
DEPTH_MAPS = "photo_depth"  # ... NAME.jpg.png, as in `depth_maps.DEPTH`
_PREPARED = re.compile(r"[\w.\-]+\.(jpg|png)")  # names of photos that were made ready
_PLAIN = ("JPEG", "PNG")  # formats of those
_EXIF, _ORIENTATION = 0x8769, 0x0112  # tags
_SIDE_35MM = np.hypot(36, 24)  # millimetres: the diagonal of a 35 mm negative
_NAMED = 3  # names in a sentence
_LEAST_SIDE = 32  # pixels
# Yaw (right) and pitch (up) of the views of a panorama, degrees: rows that overlap by half, as
# COLMAP cuts them.
_ROWS = (0, -35, 35)
VIEWS = tuple((yaw + 45 * (p != 0), p) for p in _ROWS for yaw in range(0, 360, 90))
_INCH, _UNITS = 25.4, {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # millimetres


@dataclass(frozen=True)
class Photo:
    """A photo that is ready for matching."""

    name: str  # file name in the folder of prepared photos; its stem is unique
    source: str  # where it came from
    width: int  # pixels, prepared
    height: int
    focal: float | None = None  # pixels, prepared; from EXIF or the user; None = unknown
    sharpness: float = 0.0  # `sharpness.sharpness` of the picture; 0 = not measured
    view: int | None = None  # which of `VIEWS` of a panorama; None = a photo


@dataclass(frozen=True)
class PhotoSet:
    """The photos to reconstruct from."""

    photos: tuple[Photo, ...]  # by name
    ordered: bool = False  # frames of a video: neighbours see the same
    notes: tuple[str, ...] = ()  # sentences about what was left out

    def to_json(self) -> dict[str, object]:
        """Plain values; `read_photo_set` reads them back."""
        return asdict(self)

    def cameras(self) -> tuple[tuple[Photo, ...], ...]:
        """Photos that one camera took: same size and (but for 1 %) same focal length.

        The views of panoramas are of as many cameras that are mounted together.
        """
        groups: dict[tuple[int, int, int, int | None], list[Photo]] = {}
        for photo in self.photos:
            focal = 0 if photo.focal is None else round(np.log(photo.focal) * 100)
            groups.setdefault((photo.width, photo.height, focal, photo.view), []).append(photo)
        return tuple(tuple(group) for group in groups.values())


def read_photo_set(path: Path) -> PhotoSet:
    """Read what `PhotoSet.to_json` gave. Raises ``GagaError`` when the file is damaged."""
    cure = "Remove it and run again."
    photos = read_json(path, PhotoSet, cure)
    if any(photo.focal is not None and photo.focal <= 0 for photo in photos.photos):
        raise GagaError(f"{path} is damaged: a focal length is not positive. {cure}")
    return photos


def check_prepared(photos: PhotoSet, workspace: Path) -> None:
    """``GagaError`` unless ``photos`` and their masks are files that `prepare_photos` could write.

    COLMAP reads them by readers of its own, for any format.
    """
    for photo in photos.photos:
        found = [workspace / "photos" / photo.name, workspace / MASKS / f"{photo.name}.png"]
        for path in found[: 2 if (workspace / MASKS).is_dir() else 1]:
            if not _PREPARED.fullmatch(photo.name) or path.is_symlink():
                raise GagaError(f"{path} was not made here. Remove {workspace} and run again.")
            with image_header(path) as image:
                if image.format not in _PLAIN:
                    raise GagaError(f"{path} was not made here. Remove {workspace} and run again.")


def is_video(path: Path) -> bool:
    """Whether ``path`` is a file that `video.extract_frames` takes."""
    return path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES


def list_photos(folder: Path) -> tuple[Path, ...]:
    """Picture files in ``folder`` and its subfolders, by name; hidden ones are left out.

    Raises ``GagaError`` when there is no such folder.
    """
    if not folder.is_dir():
        raise GagaError(f"{folder} is no folder of photos and no video. Check the path.")
    return tuple(path for path in _files(folder) if path.suffix.lower() in IMAGE_SUFFIXES)


def _files(folder: Path) -> list[Path]:
    inside = ((p, p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    return sorted(
        p for p, q in inside if not (is_map(q) or any(part.startswith(".") for part in q.parts))
    )


def prepare_photos(
    sources: Sequence[Path],
    target: Path,
    *,
    root: Path,
    longest_side: int,  # pixels
    focal: float | None = None,  # pixels of the photos as they are
    ordered: bool = False,
    panoramas: bool = False,  # all are of 360 degrees, whether or not they say so
    others: Sequence[str] = (),  # notes about files that are not among ``sources``
) -> Stage[PhotoSet]:
    """Copy the usable ones of ``sources`` to ``target``, named by their paths in ``root``.

    Upright (EXIF), 8-bit RGB, no side longer than ``longest_side``. Files that cannot be read, are
    tiny, or show exactly what another shows are left out and named in the notes. Raises
    ``GagaError`` when fewer than `FEWEST` are left.
    """
    target.mkdir(parents=True, exist_ok=True)
    photos: list[Photo] = []
    names, seen = set[str](), dict[str, Path]()
    unread: list[str] = []
    twins: list[str] = []
    copies: list[str] = []
    cut: list[str] = []
    looks_of = LooksIndex()
    for i, path in enumerate(_largest_first(sources)):
        yield Progress(STAGE, i, len(sources), path.name)
        try:
            picture = read_rgb(path)
        except GagaError:
            unread.append(path.name)
            continue
        height, width = picture.shape[:2]
        if min(height, width) < _LEAST_SIDE:
            unread.append(path.name)
            continue
        looks = hashlib.sha256(repr(picture.shape).encode() + picture.tobytes()).hexdigest()
        if looks in seen:
            twins.append(path.name)
            continue
        seen[looks] = path
        if not ordered and looks_of.has_like(picture):
            copies.append(path.name)
            continue
        name = _name_of(path, root, names)
        if panoramas or is_panorama(path, width, height):
            cut.append(path.name)
            photos += _cut(path, picture, target / name, longest_side)
            names.update(photo.name.rpartition(".")[0].lower() for photo in photos)
            continue
        photo = _prepared(path, picture, target / name, longest_side)
        known = focal if focal is not None else exif_focal(path, width, height)
        scale = photo.width / width
        sharp = sharpness(shrunk(picture, LOOK_SIDE))
        known = None if known is None else known * scale
        photos.append(replace(photo, focal=known, sharpness=sharp))
    notes = (
        *_note("could not be read and {is} left out", unread),
        *_note("{is} the same as another and left out", twins),
        *_note("{is} a smaller or recompressed copy of another and left out", copies),
        *_note(f"{{is}} of 360 degrees, each cut into {len(VIEWS)} views", cut),
        *others,
    )
    if len(photos) < FEWEST:
        raise GagaError(_too_few(len(photos), len(sources), len(unread), notes))
    yield Progress(STAGE, len(sources), len(sources))
    return PhotoSet(tuple(sorted(photos, key=lambda p: p.name)), ordered, notes)


def is_panorama(path: Path, width: int, height: int) -> bool:
    """Whether a photo shows all directions: its metadata (GPano) say equirectangular."""
    if abs(width - 2 * height) > 1:
        return False
    with image_header(path) as image:
        found = image.info.get("xmp", b"")
    text = found if isinstance(found, bytes) else str(found).encode(errors="replace")
    return b"equirectangular" in text


def panorama_views(picture: UInt8Array, side: int) -> Iterator[UInt8Array]:
    """Square views (side, side, 3) of 90 degrees of an equirectangular picture (H, 2 H, 3).

    Focal length side / 2. The middle of the picture is straight ahead, its upper edge above.
    """
    height, width = picture.shape[:2]
    v, u = np.mgrid[0:side, 0:side] + 0.5
    rays = np.stack([u - side / 2, v - side / 2, np.full_like(u, side / 2)], axis=2)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    for k in range(len(VIEWS)):
        x, y, z = np.moveaxis(rays @ turn_of_view(k).T, 2, 0)
        column = (np.arctan2(x, z) / (2 * np.pi) + 0.5) * width - 0.5
        row = (np.arcsin(np.clip(y, -1, 1)) / np.pi + 0.5) * height - 0.5
        yield _sampled(picture, row, column)


def turn_of_view(view: int) -> DoubleArray:
    """Rotation (3, 3) from the camera of a view to that of view 0: x right, y down, z ahead."""
    (cy, sy), (cp, sp) = ((np.cos(a), np.sin(a)) for a in np.radians(VIEWS[view]))
    up = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    right = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return right @ up


def prefix_of_view(view: int, side: int) -> str:
    """How names of views of panoramas begin; what follows is the same for all of one panorama."""
    return f"view{view:02d}-{side}-"


def _sampled(picture: UInt8Array, row: DoubleArray, column: DoubleArray) -> UInt8Array:
    """Pixels between others, bilinear; columns go round."""
    height, width = picture.shape[:2]
    row = np.clip(row, 0, height - 1)
    top, left = np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)
    down, across = (row - top)[..., None], (column - left)[..., None]
    bottom, right = np.minimum(top + 1, height - 1), (left + 1) % width
    left %= width
    upper = picture[top, left] * (1 - across) + picture[top, right] * across
    lower = picture[bottom, left] * (1 - across) + picture[bottom, right] * across
    return (upper * (1 - down) + lower * down + 0.5).astype(np.uint8)


def _cut(path: Path, picture: UInt8Array, target: Path, longest_side: int) -> list[Photo]:
    """Write the views of a panorama, as sharp as it is in the middle."""
    side = min(picture.shape[1] // 4, longest_side)
    found = []
    for k, view in enumerate(panorama_views(picture, side)):
        file = target.with_name(prefix_of_view(k, side) + target.name)
        Image.fromarray(view).save(file, quality=97, subsampling=0)
        sharp = sharpness(shrunk(view, LOOK_SIDE))
        found.append(Photo(file.name, str(path), side, side, side / 2, sharp, k))
    return found


def _largest_first(sources: Sequence[Path]) -> list[Path]:
    """By the number of pixels, else as they come, so that of two copies the better one is kept."""

    def pixels(path: Path) -> int:
        try:
            with image_header(path) as image:
                return image.width * image.height
        except GagaError:
            return 0

    return sorted(sources, key=pixels, reverse=True)


def unread_kinds(folder: Path) -> tuple[str, ...]:
    """A note about files that look like photos but are of kinds that are not read."""
    names = [p.name for p in _files(folder) if p.suffix.lower() in UNREAD_SUFFIXES]
    return _note(f"{{is}} of a kind that is not read; {_SAVE_AS}", names)


def ignored_files(folder: Path) -> tuple[str, ...]:
    """A note about files among the photos that are no pictures."""
    known = (*IMAGE_SUFFIXES, *UNREAD_SUFFIXES)
    names = [p.name for p in _files(folder) if p.suffix.lower() not in known]
    return _note("{is} no picture and ignored", names, "file")


def _note(what: str, names: Sequence[str], kind: str = "photo") -> tuple[str, ...]:
    if not names:
        return ()
    listed = ", ".join(names[:_NAMED])
    more = len(names) - _NAMED
    listed += f" and {more} more" if more > 0 else ""
    many = len(names) > 1
    verb = what.replace("{is}", "are" if many else "is")
    return (f"{len(names)} {kind}{'s' if many else ''} {verb}: {listed}.",)


def _too_few(n: int, n_files: int, n_unread: int, notes: Sequence[str]) -> str:
    left = f"There {'is' if n == 1 else 'are'} {n} usable {'photo' if n == 1 else 'photos'}"
    of = f" among {n_files} files" if n_files > n else ""
    why = " ".join(("", *notes)) if notes else ""
    cure = " Take more photos, in a walk around."
    if n + n_unread >= FEWEST:
        cure = " Copy those that could not be read from the camera again, or take more photos."
    if any(_SAVE_AS in note for note in notes):
        cure = ""
    return (
        f"{left}{of}; it takes at least {FEWEST} that overlap, and 30 or more for a whole scene."
        f"{why}{cure}"
    )


def plain_stem(path: Path, root: Path) -> str:
    """The stem that `prepare_photos` gives a photo of a folder, unless another one has it."""
    inside = path.relative_to(root).with_suffix("").as_posix()
    return re.sub(r"[^\w.\-]+", "_", inside).strip("._") or "photo"


def _name_of(path: Path, root: Path, taken: set[str]) -> str:
    """A file name whose stem no other photo has, ignoring the case of its letters."""
    plain = plain_stem(path, root)
    stem, i = plain, 1
    while stem.lower() in taken:
        i += 1
        stem = f"{plain}-{i}"
    taken.add(stem.lower())
    return stem + (".jpg" if path.suffix.lower() in (".jpg", ".jpeg") else ".png")


def _prepared(path: Path, picture: UInt8Array, target: Path, longest_side: int) -> Photo:
    """Write the picture; the file itself is copied when nothing is to be done to it."""
    height, width = picture.shape[:2]
    times = min(1.0, longest_side / max(width, height))
    if times == 1 and _is_plain(path):
        shutil.copyfile(path, target)
        return Photo(target.name, str(path), width, height)
    width, height = max(round(width * times), 1), max(round(height * times), 1)
    image = Image.fromarray(picture)
    if times < 1:
        image = image.resize((width, height), Image.Resampling.LANCZOS)
    image.save(target, quality=97, subsampling=0)
    return Photo(target.name, str(path), width, height)


def _is_plain(path: Path) -> bool:
    """Whether the file is an upright 8-bit RGB JPEG or PNG already."""
    with image_header(path) as image:
        upright = image.getexif().get(_ORIENTATION, 1) == 1
        return image.format in _PLAIN and image.mode == "RGB" and upright


def exif_focal(path: Path, width: int, height: int) -> float | None:
    """Focal length in pixels of a picture of this size, from its EXIF; None if it says none.

    From the 35 mm equivalent (by the diagonal), else from the focal length and the resolution of
    the sensor.
    """
    try:
        with image_header(path) as image:
            stored = (image.width, image.height)
            tags = image.getexif().get_ifd(_EXIF)
    except GagaError:
        return None
    equivalent = _number(tags.get(ExifTags.Base.FocalLengthIn35mmFilm))
    if equivalent > 0:
        return float(equivalent / _SIDE_35MM * np.hypot(width, height))
    millimetres = _number(tags.get(ExifTags.Base.FocalLength))
    resolution = _number(tags.get(ExifTags.Base.FocalPlaneXResolution))
    unit = _UNITS.get(int(_number(tags.get(ExifTags.Base.FocalPlaneResolutionUnit))), _INCH)
    taken = _number(tags.get(ExifTags.Base.ExifImageWidth)) or stored[0]
    if millimetres > 0 and resolution > 0 and taken > 0:
        return float(millimetres * resolution / unit * stored[0] / taken)
    return None


def _number(value: object) -> float:
    """A tag as a number; 0 when it is missing or nonsense."""
    try:
        number = float(cast("float", value))
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if np.isfinite(number) else 0.0
