"""Masks of other programs in many formats: recognised, and read one view at a time.

A view's entry is a label map, or a list of masks that may overlap and may have scores. Nothing is
ever unpickled. Of JSON, COCO data sets and results, SA-1B, and the lists of SAM's automatic
generator are read: a segmentation is a run-length mask ``{"size": [H, W], "counts": [...] or
"..."}`` or a list of polygons ``[[x, y, x, y, ...], ...]`` in pixels.
"""

import csv
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import read_array, read_arrays
from gaga_core.io.files import check_memory, explain_os_error
from gaga_core.io.images import IMAGE_SUFFIXES, open_image
from gaga_core.io.json_file import convert_json, read_foreign_json
from gaga_core.io.masks.coco import MOST_SIDE, decode_rle
from gaga_core.io.masks.label_maps import label_files, list_label_files, read_labels, view_key

_FORM = "JSON"
_MOST_BYTES = 1 << 30  # of one file: the masks of COCO's 118,000 pictures have half of it
_MOST_PIXELS = 1 << 28  # of one picture: more is damage, not a photo
_PER_PIXEL = 14  # bytes of a mask, its runs and its label map: measured on 121 megapixels, 13.3
_MOST_MASK_PIXELS = 1 << 34  # of all masks of a picture: 500 masks of 34 megapixels
_MOST_COVERS = 100  # times that the frames of a mask's polygons may cover its picture
_MOST_CROSSINGS = 1 << 22  # rows that a polygon's edges cross: the outline of a mask has fewer
MOST_COLORS = 4096  # a picture with more is a photo or an overlay, no label map
_ARRAY_SUFFIXES = (".npz", ".npy")
_LOSSY = (".jpg", ".jpeg")
_LABEL_KEYS = ("labels", "label", "ins_2d_label_id", "instance", "mask", "seg", "arr_0")
_MASK_KEYS = ("masks", "segmentation", "segmentations", "pred_masks", "mask", "arr_0")
_MOST_ID = 2**31 - 1
_NOT_MASKS = ("info.json", "import.json", "split.json", "transforms.json", "cameras.json")
_Number = int | float
SCORE_KEYS = ("score", "predicted_iou", "iou_preds", "iou", "confidence", "scores", "pred_scores")


@dataclass(frozen=True, eq=False)
class MaskList:
    """Masks of one picture; they are decoded one by one, when iterated over."""

    height: int
    width: int
    masks: Iterable[BoolArray]  # M of (H, W)
    scores: tuple[float, ...]  # M; 1 where the file has none


ImportedMasks = IntArray | MaskList  # a label map (H, W) int32, 0 = none, or masks that may overlap


@dataclass(frozen=True, eq=False)
class MaskSource:
    """The recognised format, and the reader of each view."""

    form: str  # "label maps", "SAM lists", ...
    said: str  # one sentence for people
    views: Mapping[str, Callable[[], ImportedMasks]]  # by `view_key` or number of the view
    name: str = "imported"  # a good name for the masks
    keeps_covered: bool = False  # of lists: published without the rule that drops covered masks


class RunLengths(msgspec.Struct, frozen=True):
    """A mask by run lengths down the columns, zeros first, plain or in the COCO API's string."""

    size: Annotated[list[int], msgspec.Meta(min_length=2, max_length=2)]  # height, width, pixels
    counts: list[int] | str

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.size[0], self.size[1]


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
    entries, image = _entries(path, content), _image(path, content)
    if entries and image is None and all(entry.image_id is not None for entry in entries):
        by_image: dict[str, list[MaskEntry]] = {}
        for entry in entries:
            by_image.setdefault(view_key(str(entry.image_id)), []).append(entry)
        views = {name: partial(_mask_list, path, of_it) for name, of_it in by_image.items()}
        said = f"COCO results with masks of {len(views)} pictures: {path.name}."
        return MaskSource(_FORM, said, views)
    said = f"A list of {len(entries)} masks of one picture: {path.name}."
    # SA-1B says which view it means, else the name of the file does.
    view = view_key(image.file_name) if image is not None and image.file_name else path.stem
    return MaskSource(_FORM, said, {view: partial(_read_list, path)})


def _json_folder(files: Sequence[Path], folder: Path) -> MaskSource:
    """What a folder of JSON files holds: one file a picture, or one COCO file for all."""
    first = recognise_json(files[0])
    if len(files) == 1:
        return first
    if len(first.views) != 1:
        raise GagaError(
            f"{folder.name} holds {len(files)} JSON files, and {files[0].name} alone has "
            f"{len(first.views)} pictures. Choose one of the files."
        )
    said = f"{len(files)} JSON lists of masks, one a picture, in {folder.name}."
    return MaskSource(_FORM, said, {path.stem: partial(_read_list, path) for path in files})


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


def _read_list(path: Path) -> MaskList:
    content = read_foreign_json(path, object, most_bytes=_MOST_BYTES)
    return _mask_list(path, _entries(path, content), _size_of(_image(path, content)))


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
            _mask_list, path, by_image[str(image.id)], _size_of(image)
        )
        for image in images
    }


def _size_of(image: ImageEntry | None) -> tuple[int, int] | None:
    """Height and width that a description of a picture states."""
    height, width = (None, None) if image is None else (image.height, image.width)
    if isinstance(height, int) and isinstance(width, int) and height > 0 and width > 0:
        return height, width
    return None


def _mask_list(
    path: Path, entries: Sequence[MaskEntry], size: tuple[int, int] | None = None
) -> MaskList:
    """The masks of one picture; polygons need its ``size`` (H, W)."""
    file = path.name
    for entry in entries:
        if isinstance(entry.segmentation, RunLengths):
            size = size or entry.segmentation.shape
    if size is None:
        if entries:
            raise GagaError(f"{file} has polygons but not the pictures' height and width.")
        raise GagaError(f"{file} has no masks, and no size, of a picture. Remove it.")
    height, width = size
    if not 0 < height * width <= _MOST_PIXELS or min(size) < 1:
        raise GagaError(f"{file} says that a picture has {height} x {width} pixels. Fix the file.")

    check_memory(path, _PER_PIXEL * height * width, f"masks of {height:,} x {width:,} pixels")
    if len(entries) * height * width > _MOST_MASK_PIXELS:
        raise GagaError(
            f"{file} says that a picture of {height} x {width} pixels has {len(entries):,} masks, "
            "too many to be true. Fix the file."
        )

    def masks() -> Iterator[BoolArray]:
        for entry in entries:
            yield _decode(file, entry.segmentation, (height, width))

    return MaskList(height, width, masks(), tuple(_score(file, e) for e in entries))


def _decode(
    file: str, segmentation: RunLengths | list[list[_Number]], size: tuple[int, int]
) -> BoolArray:
    if isinstance(segmentation, list):
        return _fill(file, segmentation, size)
    if segmentation.shape != size:
        raise GagaError(f"{file} has masks of different sizes for one picture.")
    return decode_rle(segmentation.counts, size)


def _fill(file: str, polygons: list[list[_Number]], size: tuple[int, int]) -> BoolArray:
    """Pixels whose centres lie in any of the polygons; COCO's corners are at whole numbers."""
    mask, n_looked_at = np.zeros(size, np.bool_), 0
    for polygon in polygons:
        if len(polygon) < 6 or len(polygon) % 2:
            raise GagaError(f"{file} has a polygon of fewer than three points.")
        try:
            corners = np.array(polygon, np.float64).reshape(-1, 2) - 0.5
        except OverflowError as error:
            raise GagaError(f"{file} has a polygon that is no list of numbers.") from error
        if not np.abs(corners).max() <= MOST_SIDE:  # NaN, too
            raise GagaError(
                f"{file} has a polygon with a corner beyond {MOST_SIDE:,} pixels. Fix the file."
            )
        n_looked_at += _fill_polygon(file, mask, corners)
        if n_looked_at > _MOST_COVERS * mask.size:
            raise GagaError(
                f"{file} has a mask of polygons that cover its picture {_MOST_COVERS} times. "
                "Fix the file."
            )
    return mask


def _fill_polygon(file: str, mask: BoolArray, corners: DoubleArray) -> int:
    """Set the pixels of ``mask`` (H, W) whose centres lie in a polygon (P, 2) xy, or on its edge.

    By where its edges cross the rows of pixel centres: an odd one enters it. Returns the number of
    pixels that were looked at.
    """
    top = max(int(np.ceil(corners[:, 1].min())), 0)
    left = max(int(np.ceil(corners[:, 0].min())), 0)
    part = mask[top : int(np.floor(corners[:, 1].max())) + 1]
    part = part[:, left : int(np.floor(corners[:, 0].max())) + 1]
    if part.size == 0:
        return 0
    height, width = part.shape
    corners = corners - (left, top)
    ends = np.roll(corners, -1, axis=0)
    is_down = (corners[:, 1] <= ends[:, 1])[:, None]
    low, high = np.where(is_down, corners, ends), np.where(is_down, ends, corners)  # (P, 2) by y
    first = np.maximum(np.ceil(low[:, 1]), 0).astype(np.int64)
    last = np.minimum(np.floor(high[:, 1]), height - 1).astype(np.int64)
    n_rows = np.maximum(last - first + 1, 0)
    if n_rows.sum() > _MOST_CROSSINGS:
        raise GagaError(f"{file} has a polygon with too many long edges. Fix the file.")
    edge = np.repeat(np.arange(len(corners)), n_rows)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(n_rows) - n_rows - first, n_rows)
    low, high = low[edge], high[edge]
    rise = high[:, 1] - low[:, 1]
    x = low[:, 0] + (row - low[:, 1]) * (high[:, 0] - low[:, 0]) / np.where(rise > 0, rise, 1)
    column = np.clip(np.ceil(x), 0, width).astype(np.int64)
    # An edge counts in the row of its lower end, not of its upper: a corner is crossed once.
    counts = row < high[:, 1]
    enters = np.zeros((height, width + 1), np.uint8)
    np.bitwise_xor.at(enters, (row[counts], column[counts]), 1)
    part |= np.bitwise_xor.accumulate(enters, axis=1, out=enters)[:, :width].astype(np.bool_)
    on_edge = (column == x) & (column < width)
    part[row[on_edge], column[on_edge]] = True
    if (level := np.flatnonzero(rise == 0)).size:  # edges along a row
        ends_x = np.clip(np.sort([low[level, 0], high[level, 0]], axis=0), -1, width)
        inside = np.zeros((height, width + 2), np.int32)
        np.add.at(inside, (row[level], np.ceil(ends_x[0]).clip(0).astype(np.int64)), 1)
        np.add.at(inside, (row[level], np.floor(ends_x[1]).astype(np.int64) + 1), -1)
        part |= np.cumsum(inside, axis=1)[:, :width] > 0
    return part.size


def _score(file: str, entry: MaskEntry) -> float:
    for key in SCORE_KEYS:
        value: _Number | None = getattr(entry, key)
        if value is not None:
            try:
                score = float(value)
            except OverflowError:
                score = math.inf
            if not math.isfinite(score):
                raise GagaError(f"{file} has a {key} that is no number. Write it again.")
            return score
    return 1.0


def recognise(source: Path, views: Iterable[str] = ()) -> MaskSource:
    """What the file or folder ``source`` holds; of the contents only a sample is read.

    Folders of label maps in ``source`` are one import where they are called like the folders of
    the photos ``views``; otherwise one of them must be chosen.
    Known: label maps (8- and 16-bit, palette, RGB-coded; Gaga's raw_<method>_mask and
    <method>_mask, Gaussian Grouping's object_mask, EntitySeg), lists of SAM's generator (JSON, npz,
    npy), COCO and SA-1B JSON, one folder of binary masks a picture (with SAM's metadata.csv).
    Lists called like EntitySeg or CropFormer keep masks that others cover, as published.
    Raises ``GagaError`` with one sentence when it is none of these.
    """
    found = _recognised(Path(source), views)
    if _is_entityseg(Path(source).name) and found.form != "label maps":
        return replace(found, name="entityseg", keeps_covered=True)
    return found


def _is_entityseg(name: str) -> bool:
    return re.search("(?<!id)entity|cropformer", name, re.I) is not None


def _recognised(source: Path, views: Iterable[str]) -> MaskSource:
    if source.is_file():
        suffix = source.suffix.lower()
        if suffix == ".json":
            return recognise_json(source)
        if suffix in _ARRAY_SUFFIXES:
            return _arrays([source], source)
        if suffix in IMAGE_SUFFIXES:
            return _label_maps([source], source)
        raise GagaError(f"{source.name} holds no masks: choose a .png, .npz, .npy or .json file.")
    if not source.is_dir():
        raise GagaError(f"{source} does not exist. Check the path.")
    files = [p for p in sorted(source.iterdir()) if p.is_file() and p.name[0] != "."]
    pictures = list_label_files(source)
    jsons = [p for p in files if p.suffix.lower() == ".json" and p.name not in _NOT_MASKS]
    arrays = [p for p in files if p.suffix.lower() in _ARRAY_SUFFIXES]
    if pictures and len(pictures) >= max(len(jsons), len(arrays)):
        return _label_maps(pictures, source)
    if jsons and len(jsons) >= len(arrays):
        return _json_folder(jsons, source)
    if arrays:
        return _arrays(arrays, source)
    return _inside(source, views)


def _inside(source: Path, views: Iterable[str]) -> MaskSource:
    """A folder of folders: one of binary masks a picture, or a scene that holds known ones."""
    folders = [p for p in sorted(source.iterdir()) if p.is_dir() and p.name[0] != "."]
    known = [p for p in folders if _method_of(p.name) or p.name == "object_mask"]
    raw = [p for p in known if p.name.startswith("raw_")]
    for choice in (raw, known):
        if len(choice) == 1:
            return recognise(choice[0])
    if known:
        names = ", ".join(p.name for p in known)
        raise GagaError(f"{source} holds several folders of masks: {names}. Choose one of them.")
    nested = label_files(source)
    photos = {view_key(name) for name in views}
    if any("/" in key and key in photos for key in nested):
        return _nested_maps(nested, source)
    filled = [p for p in folders if _mask_files(p)]
    if filled and len(np.unique(read_labels(_mask_files(filled[0])[0]))) > 2:
        names = ", ".join(p.name for p in filled[:5])
        raise GagaError(f"{source} holds folders of pictures: {names}. Choose one of them.")
    if filled:
        return _mask_folders(filled, source)
    raise GagaError(
        f"{source} holds no masks: choose a folder of label maps (.png), of lists (.json, .npz, "
        ".npy), or of one folder of masks a picture."
    )


def _method_of(name: str) -> str:
    """The segmenter in the name of a mask folder of Gaga (raw_sam_mask, sam_mask); else ""."""
    method = name.removeprefix("raw_").removesuffix("_mask")
    return method if name.endswith("_mask") and name != "object_mask" else ""


def _label_maps(files: Sequence[Path], source: Path) -> MaskSource:
    files = _exact(files)
    _check_labels(files[0])
    kind, n = _bits(files[0]), f"{len(files)} label maps" if len(files) > 1 else "a label map"
    folder = source if source.is_dir() else source.parent
    method = _method_of(folder.name)
    name, origin = "imported", ""
    if folder.name == "object_mask":
        name, origin = "object_mask", " of Gaussian Grouping, ids already tracked from view to view"
    elif method and folder.name.startswith("raw_"):
        name, origin = method, f" of Gaga's {method} masks, not associated yet"
    elif method and (folder / "info.json").is_file():
        name, origin = folder.name, f" of Gaga, {method} masks that it has associated already"
    elif method or _is_entityseg(folder.name):
        name = method or "entityseg"
        origin = f" of {method or 'EntitySeg'}"
    views = {path.stem: partial(_read_checked, path) for path in files}
    return MaskSource("label maps", f"{n}{origin} ({kind}) in {folder.name}.", views, name)


def _nested_maps(files: Mapping[str, Path], source: Path) -> MaskSource:
    """Label maps in folders that are called like those of the photos."""
    exact = _exact(list(files.values()))
    _check_labels(exact[0])
    n, kept = len({path.parent for path in exact}), set(exact)
    said = f"{len(exact)} label maps ({_bits(exact[0])}) in {n} folders of {source.name}."
    views = {key: partial(_read_checked, path) for key, path in files.items() if path in kept}
    return MaskSource("label maps", said, views)


def _exact(files: Sequence[Path]) -> list[Path]:
    """Files that keep every id; a JPEG next to them is a preview. ``GagaError`` if all are such."""
    exact = [path for path in files if path.suffix.lower() not in _LOSSY]
    if not exact:
        raise GagaError(
            f"{files[0].name} is a JPEG, which blurs ids at every edge. Save label maps as PNG."
        )
    return exact


def _bits(path: Path) -> str:
    mode = open_image(path).mode
    known = {"L": "8-bit gray", "P": "palette", "1": "one bit", "I;16": "16-bit gray"}
    return known.get(mode, "16-bit gray" if mode.startswith("I") else "RGB-coded")


def _check_labels(path: Path) -> None:
    """``GagaError`` when a picture is not a label map but a photo or an overlay."""
    image = open_image(path)
    if image.mode in ("RGB", "RGBA") and image.getcolors(MOST_COLORS) is None:
        raise GagaError(
            f"{path.name} has more than {MOST_COLORS} colors: it is a photo or an overlay, not a "
            "label map. Choose the folder of the label maps."
        )


def _read_checked(path: Path) -> IntArray:
    _check_labels(path)
    return read_labels(path)


def _arrays(files: Iterable[Path], source: Path) -> MaskSource:
    """Lists of masks, or label maps, as numpy saves them."""
    files = list(files)
    sample = _read_array_file(files[0])
    what = "label maps" if isinstance(sample, np.ndarray) else "lists of masks"
    views = {path.stem: partial(_read_array_file, path) for path in files}
    said = f"{len(files)} numpy files with {what} in {source.name}."
    return MaskSource("numpy", said, views)


def _read_array_file(path: Path) -> ImportedMasks:
    """Label map or masks of a .npy or .npz; ``GagaError`` when it holds Python objects."""
    cure = "Save masks as plain arrays: np.savez(file, masks=masks, scores=scores)."
    if path.suffix.lower() == ".npy":
        arrays = {"arr_0": read_array(path, cure)}
    else:
        arrays = read_arrays(path, cure)
    for key in _MASK_KEYS:
        if key in arrays and arrays[key].ndim in (3, 4):
            return _mask_stack(path, arrays[key], arrays)
    for key in _LABEL_KEYS:
        if key in arrays and arrays[key].ndim == 2 and arrays[key].dtype.kind in "iub":
            labels = arrays[key]
            if labels.size and int(labels.max()) > _MOST_ID:
                raise GagaError(f"{path.name} has ids above {_MOST_ID:,}. Number them again.")
            return np.maximum(labels, labels.dtype.type(0)).astype(np.int32)
    found = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "nothing"
    raise GagaError(f"{path.name} holds no masks (M, H, W) and no label map (H, W), but {found}.")


def _mask_stack(path: Path, stack: AnyArray, arrays: Mapping[str, AnyArray]) -> MaskList:
    if stack.ndim == 4 and stack.shape[1] == 1:
        stack = stack[:, 0]
    if stack.ndim != 3 or stack.dtype.kind not in "biuf":
        raise GagaError(
            f"{path.name}: masks must be numbers (M, H, W), these are {stack.dtype} {stack.shape}."
        )
    scores = np.ones(len(stack))
    for key in SCORE_KEYS:
        if key in arrays:
            if arrays[key].dtype.kind not in "biuf" or not np.isfinite(arrays[key]).all():
                raise GagaError(f"{path.name}: {key} must be finite numbers. Write it again.")
            scores = arrays[key].astype(np.float64).reshape(-1)
    if len(scores) != len(stack):
        raise GagaError(f"{path.name} has {len(stack)} masks but {len(scores)} scores.")
    return MaskList(
        height=stack.shape[1],
        width=stack.shape[2],
        masks=(np.ascontiguousarray(mask > 0) for mask in stack),
        scores=tuple(scores.tolist()),
    )


def _mask_files(folder: Path) -> tuple[Path, ...]:
    return tuple(p for p in list_label_files(folder) if p.suffix.lower() not in _LOSSY)


def _mask_folders(folders: Iterable[Path], source: Path) -> MaskSource:
    folders = list(folders)
    scored = sum((folder / "metadata.csv").is_file() for folder in folders)
    with_scores = " with SAM's metadata.csv" if scored else ""
    said = f"{len(folders)} folders of one binary mask a file{with_scores} in {source.name}."
    views = {folder.name: partial(_read_mask_folder, folder) for folder in folders}
    return MaskSource("mask folders", said, views)


def _read_mask_folder(folder: Path) -> MaskList:
    files = _mask_files(folder)
    scores = _metadata(folder / "metadata.csv")
    width, height = open_image(files[0]).size

    def masks() -> Iterable[BoolArray]:
        for path in files:
            labels = read_labels(path)
            if labels.shape != (height, width):
                raise GagaError(f"{path} has another size than {files[0].name}. Make both again.")
            yield labels > 0

    found = tuple(scores.get(path.stem, 1.0) for path in files)
    return MaskList(height, width, masks(), found)


def _metadata(path: Path) -> dict[str, float]:
    """Scores by mask of the table that SAM's command writes next to its masks."""
    if not path.is_file():
        return {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            scores = {row["id"]: float(row["predicted_iou"]) for row in csv.DictReader(file)}
        if not all(math.isfinite(score) for score in scores.values()):
            raise ValueError("a score is no number")
        return scores
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except (KeyError, ValueError, TypeError, csv.Error) as error:
        raise GagaError(f"{path} is damaged. Copy it again, or remove it.") from error
