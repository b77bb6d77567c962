"""Masks in JSON: COCO data sets and results, SA-1B, and the lists of SAM's automatic generator.

A segmentation is a run-length mask ``{"size": [H, W], "counts": [...] or "..."}`` or a list of
polygons ``[[x, y, x, y, ...], ...]`` in pixels.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.arrays import BoolArray
from gaga_core.errors import GagaError
from gaga_core.io.json_file import convert_json, read_foreign_json
from gaga_core.io.mask_import_base import SCORE_KEYS, ImportedMasks, MaskList, MaskSource
from gaga_core.io.masks import view_key
from gaga_core.io.rle import decode_rle

_FORM = "JSON"
_MOST_BYTES = 1 << 30  # of one file: the masks of COCO's 118,000 pictures have half of it
_MOST_PIXELS = 1 << 28  # of one picture: more is damage, not a photo
_Number = int | float


class RunLengths(msgspec.Struct, frozen=True):
    """A mask by run lengths down the columns, zeros first, plain or in the COCO API's string."""

    size: Annotated[list[int], msgspec.Meta(min_length=2, max_length=2)]  # height, width, pixels
    counts: list[int] | str


class MaskEntry(msgspec.Struct, frozen=True):
    """One mask; other fields of an entry are not looked at. Scores: see ``SCORE_KEYS``."""

    segmentation: RunLengths | list[list[_Number]]  # polygons: x, y, x, y, ... pixels
    image_id: int | str | None = None
    score: _Number | None = None
    predicted_iou: _Number | None = None
    iou_preds: _Number | None = None
    iou: _Number | None = None
    confidence: _Number | None = None
    scores: _Number | None = None
    pred_scores: _Number | None = None


class ImageEntry(msgspec.Struct, frozen=True):
    """The picture that masks belong to: ``images`` of COCO, ``image`` of SA-1B."""

    id: int | str | None = None
    file_name: str = ""
    height: _Number | None = None  # pixels
    width: _Number | None = None


def recognise_json(path: Path) -> MaskSource:
    """What one JSON file holds: the masks of one picture or of many."""
    content = read_foreign_json(path, object, most_bytes=_MOST_BYTES)
    if isinstance(content, dict) and "images" in content and "annotations" in content:
        views = _coco_views(path, content)
        said = f"A COCO file with the masks of {len(views)} pictures: {path.name}."
        return MaskSource(_FORM, said, views)
    entries = _entries(path, content)
    if (
        entries
        and all(entry.image_id is not None for entry in entries)
        and _image(path, content) is None
    ):
        views = _result_views(path, entries)
        said = f"COCO results with masks of {len(views)} pictures: {path.name}."
        return MaskSource(_FORM, said, views)
    said = f"A list of {len(entries)} masks of one picture: {path.name}."
    return MaskSource(_FORM, said, {_stem(path, content): partial(_read_list, path)})


def recognise_json_folder(files: Sequence[Path], folder: Path) -> MaskSource:
    """What a folder of JSON files holds: one file a picture, or one COCO file for all."""
    first = recognise_json(files[0])
    if len(first.views) != 1 or len(files) == 1:
        if len(files) > 1:
            raise GagaError(
                f"{folder.name} holds {len(files)} JSON files, and {files[0].name} alone has "
                f"{len(first.views)} pictures. Choose one of the files."
            )
        return first
    views: dict[str, Callable[[], ImportedMasks]] = {
        path.stem: partial(_read_list, path) for path in files
    }
    said = f"{len(files)} JSON lists of masks, one a picture, in {folder.name}."
    return MaskSource(_FORM, said, views)


def _entries(path: Path, content: object) -> list[MaskEntry]:
    """The masks of a file for one picture: a list, or SA-1B's {"image", "annotations"}."""
    found = content.get("annotations") if isinstance(content, dict) else content
    if not isinstance(found, list) or not all(
        isinstance(entry, dict) and "segmentation" in entry for entry in found
    ):
        raise GagaError(
            f"{path.name} holds no masks: it is neither COCO nor a list of "
            '{"segmentation": ...} as SAM writes it.'
        )
    return convert_json(found, list[MaskEntry], path.name)


def _image(path: Path, content: object) -> ImageEntry | None:
    """SA-1B's description of the picture; None in other files."""
    image = content.get("image") if isinstance(content, dict) else None
    return convert_json(image, ImageEntry, path.name) if isinstance(image, dict) else None


def _stem(path: Path, content: object) -> str:
    """The view that a file for one picture means: SA-1B says so, else its own name does."""
    image = _image(path, content)
    return view_key(image.file_name) if image is not None and image.file_name else path.stem


def _read_list(path: Path) -> MaskList:
    content = read_foreign_json(path, object, most_bytes=_MOST_BYTES)
    return _mask_list(path.name, _entries(path, content), _size_of(_image(path, content)))


def _coco_views(path: Path, content: object) -> dict[str, Callable[[], ImportedMasks]]:
    pictures = content["images"] if isinstance(content, dict) else None
    images = convert_json(pictures, list[ImageEntry], path.name)
    if not all(image.id is not None and image.file_name for image in images):
        raise GagaError(f"{path.name}: every image needs an id and a file_name. Write it again.")
    by_image: dict[str, list[MaskEntry]] = {str(image.id): [] for image in images}
    for entry in _entries(path, content):
        name = str(entry.image_id)
        if name not in by_image:
            raise GagaError(f"{path.name} has masks of an unknown image {name[:40]}.")
        by_image[name].append(entry)
    return {
        view_key(image.file_name): partial(
            _mask_list, path.name, by_image[str(image.id)], _size_of(image)
        )
        for image in images
    }


def _result_views(
    path: Path, entries: Sequence[MaskEntry]
) -> dict[str, Callable[[], ImportedMasks]]:
    by_image: dict[str, list[MaskEntry]] = {}
    for entry in entries:
        by_image.setdefault(view_key(str(entry.image_id)), []).append(entry)
    return {name: partial(_mask_list, path.name, of_it) for name, of_it in by_image.items()}


def _size_of(image: ImageEntry | None) -> tuple[int, int] | None:
    """Height and width that a description of a picture states."""
    height, width = (None, None) if image is None else (image.height, image.width)
    if isinstance(height, int) and isinstance(width, int) and height > 0 and width > 0:
        return height, width
    return None


def _mask_list(
    file: str, entries: Sequence[MaskEntry], size: tuple[int, int] | None = None
) -> MaskList:
    """The masks of one picture; polygons need to be told its ``size`` (H, W)."""
    for entry in entries:
        if isinstance(entry.segmentation, RunLengths):
            size = size or _rle_size(entry.segmentation)
    if size is None:
        if entries:
            raise GagaError(f"{file} has polygons but not the pictures' height and width.")
        raise GagaError(f"{file} has no masks, and no size, of a picture. Remove it.")
    height, width = size
    if not 0 < height * width <= _MOST_PIXELS or min(size) < 1:
        raise GagaError(f"{file} says that a picture has {height} x {width} pixels. Fix the file.")

    def masks() -> Iterator[BoolArray]:
        for entry in entries:
            yield _decode(file, entry.segmentation, (height, width))

    return MaskList(height, width, masks(), tuple(_score(file, e) for e in entries))


def _rle_size(rle: RunLengths) -> tuple[int, int]:
    return rle.size[0], rle.size[1]


def _decode(
    file: str, segmentation: RunLengths | list[list[_Number]], size: tuple[int, int]
) -> BoolArray:
    if isinstance(segmentation, list):
        return _fill(file, segmentation, size)
    if _rle_size(segmentation) != size:
        raise GagaError(f"{file} has masks of different sizes for one picture.")
    return decode_rle(segmentation.counts, size)


def _fill(file: str, polygons: list[list[_Number]], size: tuple[int, int]) -> BoolArray:
    """Pixels whose centres lie in any of the polygons; COCO's corners are at whole numbers."""
    from skimage.draw import polygon as inside

    mask = np.zeros(size, np.bool_)
    for polygon in polygons:
        if len(polygon) < 6 or len(polygon) % 2:
            raise GagaError(f"{file} has a polygon of fewer than three points.")
        try:
            corners = np.array(polygon, np.float64).reshape(-1, 2) - 0.5
        except OverflowError as error:
            raise GagaError(f"{file} has a polygon that is no list of numbers.") from error
        mask[inside(corners[:, 1], corners[:, 0], size)] = True  # type: ignore[no-untyped-call]
    return mask


def _score(file: str, entry: MaskEntry) -> float:
    for key in SCORE_KEYS:
        value: _Number | None = getattr(entry, key)
        if value is not None:
            try:
                return float(value)
            except OverflowError as error:
                raise GagaError(f"{file} has a {key} that is no number. Write it again.") from error
    return 1.0
