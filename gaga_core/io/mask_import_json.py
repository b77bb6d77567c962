"""Masks in JSON: COCO data sets and results, SA-1B, and the lists of SAM's automatic generator.

A segmentation is a run-length mask ``{"size": [H, W], "counts": [...] or "..."}`` or a list of
polygons ``[[x, y, x, y, ...], ...]`` in pixels.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from gaga_core.arrays import BoolArray
from gaga_core.errors import GagaError
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.mask_import_base import SCORE_KEYS, ImportedMasks, MaskList, MaskSource
from gaga_core.io.masks import view_key
from gaga_core.io.rle import decode_rle

MaskEntry = Mapping[str, object]  # one mask of a file
_FORM = "JSON"
_MOST_BYTES = 1 << 30  # of one file: the masks of COCO's 118,000 pictures have half of it
_MOST_PIXELS = 1 << 28  # of one picture: more is damage, not a photo


def recognise_json(path: Path) -> MaskSource:
    """What one JSON file holds: the masks of one picture or of many."""
    content = read_foreign_json(path, object, most_bytes=_MOST_BYTES)
    if isinstance(content, dict) and "images" in content and "annotations" in content:
        views = _coco_views(path, content)
        said = f"A COCO file with the masks of {len(views)} pictures: {path.name}."
        return MaskSource(_FORM, said, views)
    entries = _entries(path, content)
    if entries and all("image_id" in entry for entry in entries) and not _single(content):
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
    return found


def _single(content: object) -> bool:
    return isinstance(content, dict) and isinstance(content.get("image"), dict)


def _stem(path: Path, content: object) -> str:
    """The view that a file for one picture means: SA-1B says so, else its own name does."""
    if isinstance(content, dict) and isinstance(content.get("image"), dict):
        name = content["image"].get("file_name")
        if isinstance(name, str) and name:
            return view_key(name)
    return path.stem


def _read_list(path: Path) -> MaskList:
    content = read_foreign_json(path, object, most_bytes=_MOST_BYTES)
    size = _size_of(content["image"]) if isinstance(content, dict) and _single(content) else None
    return _mask_list(path.name, _entries(path, content), size)


def _coco_views(
    path: Path, content: Mapping[str, object]
) -> dict[str, Callable[[], ImportedMasks]]:
    images, entries = content["images"], _entries(path, content)
    if not isinstance(images, list) or not all(
        isinstance(i, dict) and "id" in i and "file_name" in i for i in images
    ):
        raise GagaError(f"{path.name}: every image needs an id and a file_name. Write it again.")
    by_image: dict[str, list[MaskEntry]] = {str(image["id"]): [] for image in images}
    for entry in entries:
        name = str(entry.get("image_id"))
        if name not in by_image:
            raise GagaError(f"{path.name} has masks of an unknown image {name[:40]}.")
        by_image[name].append(entry)
    return {
        view_key(str(image["file_name"])): partial(
            _mask_list, path.name, by_image[str(image["id"])], _size_of(image)
        )
        for image in images
    }


def _result_views(
    path: Path, entries: Sequence[MaskEntry]
) -> dict[str, Callable[[], ImportedMasks]]:
    by_image: dict[str, list[MaskEntry]] = {}
    for entry in entries:
        name = str(entry["image_id"])
        by_image.setdefault(view_key(name), []).append(entry)
    return {name: partial(_mask_list, path.name, of_it) for name, of_it in by_image.items()}


def _size_of(image: object) -> tuple[int, int] | None:
    """Height and width that a description of a picture states."""
    if not isinstance(image, dict):
        return None
    height, width = image.get("height"), image.get("width")
    if isinstance(height, int) and isinstance(width, int) and height > 0 and width > 0:
        return height, width
    return None


def _mask_list(
    file: str, entries: Sequence[MaskEntry], size: tuple[int, int] | None = None
) -> MaskList:
    """The masks of one picture; polygons need to be told its ``size`` (H, W)."""
    for entry in entries:
        rle = entry["segmentation"]
        if isinstance(rle, dict):
            size = size or _rle_size(file, rle)
    if size is None:
        if entries:
            raise GagaError(f"{file} has polygons but not the pictures' height and width.")
        raise GagaError(f"{file} has no masks, and no size, of a picture. Remove it.")
    height, width = size
    if not 0 < height * width <= _MOST_PIXELS or min(size) < 1:
        raise GagaError(f"{file} says that a picture has {height} x {width} pixels. Fix the file.")

    def masks() -> Iterator[BoolArray]:
        for entry in entries:
            yield _decode(file, entry["segmentation"], (height, width))

    return MaskList(height, width, masks(), tuple(_score(file, e) for e in entries))


def _rle_size(file: str, rle: Mapping[str, object]) -> tuple[int, int]:
    size = rle.get("size")
    if isinstance(size, list) and len(size) == 2 and all(isinstance(v, int) for v in size):
        return int(size[0]), int(size[1])
    raise GagaError(f"{file}: a run-length mask has no size [height, width]. Write it again.")


def _decode(file: str, segmentation: object, size: tuple[int, int]) -> BoolArray:
    if isinstance(segmentation, dict):
        if _rle_size(file, segmentation) != size:
            raise GagaError(f"{file} has masks of different sizes for one picture.")
        counts = segmentation.get("counts")
        if isinstance(counts, str | list):
            return decode_rle(counts, size)
    elif isinstance(segmentation, list):
        return _fill(file, segmentation, size)
    raise GagaError(f"{file} has a mask that is neither run lengths nor polygons.")


def _fill(file: str, polygons: Sequence[object], size: tuple[int, int]) -> BoolArray:
    """Pixels whose centres lie in any of the polygons; COCO's corners are at whole numbers."""
    from skimage.draw import polygon as inside

    mask = np.zeros(size, np.bool_)
    for polygon in polygons:
        if not isinstance(polygon, list) or len(polygon) < 6 or len(polygon) % 2:
            raise GagaError(f"{file} has a polygon of fewer than three points.")
        try:
            corners = np.array(polygon, np.float64).reshape(-1, 2) - 0.5
        except (ValueError, TypeError) as error:
            raise GagaError(f"{file} has a polygon that is no list of numbers.") from error
        mask[inside(corners[:, 1], corners[:, 0], size)] = True  # type: ignore[no-untyped-call]
    return mask


def _score(file: str, entry: MaskEntry) -> float:
    for key in SCORE_KEYS:
        value = entry.get(key)
        if isinstance(value, int | float):
            try:
                return float(value)
            except OverflowError as error:
                raise GagaError(f"{file} has a {key} that is no number. Write it again.") from error
    return 1.0
