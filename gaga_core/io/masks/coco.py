"""COCO JSON of label maps: instances with run-length masks, and panoptic pictures.

Ids are shared by all pictures (a group is one object wherever it is seen), so every group is a
category of its own, and ``group_id`` names it in each annotation.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import BoolArray, IntArray, LongArray, UInt8Array, check_shape
from gaga_core.errors import GagaError
from gaga_core.io.files import write_text

# Run lengths of masks as COCO writes them: column by column, zeros first, plain or compressed. The
# compressed form is that of the COCO API's ``rleToString``: each count as a little-endian number of
# 5-bit digits in characters from "0" on, from the fourth on as the difference to the last but one.
_FIRST = 48  # character code of digit 0
_MORE, _SIGN, _BITS = 0x20, 0x10, 5
_LONGEST = 8  # digits of a count: 40 bits
MOST_SIDE = 65_536  # pixels; a larger picture is damage


def encode_rle(mask: BoolArray) -> list[int]:
    """Counts of ``mask`` (H, W) bool: 0s, 1s, 0s, ... down the columns; their sum is H W."""
    check_shape("mask", mask, ("H", "W"), np.bool_)
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    edges = np.concatenate([[0], changes, [flat.size]])
    counts: list[int] = np.diff(edges).tolist()
    return [0, *counts] if flat.size and flat[0] else counts


def encode_labels(labels: IntArray) -> dict[int, list[int]]:
    """Counts of every id > 0 of a label map (H, W) int32, as `encode_rle` of ``labels == id``.

    One pass over the picture, whatever the number of ids.
    """
    check_shape("labels", labels, ("H", "W"), np.int32)
    flat = labels.ravel(order="F")
    if flat.size == 0:
        return {}
    starts = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1])
    ends = np.append(starts[1:], flat.size)
    ids = flat[starts]
    order = np.argsort(ids, kind="stable")
    order = order[ids[order] > 0]
    if len(order) == 0:
        return {}
    present, first = np.unique(ids[order], return_index=True)
    counts = {}
    for label, runs in zip(present, np.split(order, first[1:]), strict=True):
        edges = np.empty(2 * len(runs), np.int64)
        edges[0::2], edges[1::2] = starts[runs], ends[runs]
        lengths: list[int] = np.diff(edges, prepend=0).tolist()
        rest = flat.size - int(edges[-1])
        counts[int(label)] = [*lengths, rest] if rest else lengths
    return counts


def decode_rle(counts: Sequence[int] | str | bytes, size: Sequence[int]) -> BoolArray:
    """Mask (H, W) bool of plain or compressed ``counts``; ``size`` is (H, W), COCO's order.

    Raises ``GagaError`` when the counts do not make such a picture.
    """
    if len(size) != 2 or not all(0 <= side <= MOST_SIDE for side in size):
        raise GagaError(
            f"A run-length mask says its size is {tuple(size)}. It must be two numbers of at most "
            f"{MOST_SIDE:,} pixels."
        )
    height, width = int(size[0]), int(size[1])
    if isinstance(counts, str | bytes):
        lengths = decompress_counts(counts)
    else:
        try:
            lengths = np.asarray(counts, np.int64).reshape(-1)
        except (ValueError, TypeError, OverflowError) as error:
            raise GagaError("A run-length mask holds something else than counts.") from error
    # Each run is checked before the sum is taken: int64 sums of damaged counts wrap around.
    if lengths.min(initial=0) < 0 or lengths.max(initial=0) > height * width:
        raise GagaError(
            f"A run of a run-length mask does not fit into its picture of {height} x {width} "
            "pixels. Make the file again."
        )
    if int(lengths.sum()) != height * width:
        raise GagaError(
            f"A run-length mask covers {int(lengths.sum())} pixels, "
            f"its picture has {height} x {width}. Make the file again."
        )
    values = np.arange(len(lengths)) % 2 == 1
    return np.ascontiguousarray(np.repeat(values, lengths).reshape(width, height).T)


def compress_counts(counts: Sequence[int]) -> str:
    """The COCO API's string of ``counts``."""
    values = np.asarray(counts, np.int64).reshape(-1)
    values = np.concatenate([values[:3], values[3:] - values[1:-2]])
    n_digits = np.ones(len(values), np.int64)
    for n in range(1, _LONGEST):
        limit = 1 << (_BITS * n - 1)
        n_digits += (values < -limit) | (values >= limit)
    ends = np.cumsum(n_digits)
    place = np.arange(n_digits.sum()) - np.repeat(ends - n_digits, n_digits)
    digits = (np.repeat(values, n_digits) >> (_BITS * place)) & 0x1F
    digits[place < np.repeat(n_digits, n_digits) - 1] |= _MORE
    return (digits + _FIRST).astype(np.uint8).tobytes().decode("ascii")


def decompress_counts(text: str | bytes) -> LongArray:
    """Counts (R,) int64 of the COCO API's string; ``GagaError`` when it is none."""
    raw = text.encode("ascii", "replace") if isinstance(text, str) else text
    digits = np.frombuffer(raw, np.uint8).astype(np.int64) - _FIRST
    if len(digits) == 0:
        return np.zeros(0, np.int64)
    is_last = (digits & _MORE) == 0
    if digits.min() < 0 or digits.max() > 0x3F or not is_last[-1]:
        raise GagaError("A compressed run-length mask is damaged. Make the file again.")
    ends = np.flatnonzero(is_last)
    starts = np.concatenate([[0], ends[:-1] + 1])
    n_digits = ends - starts + 1
    if n_digits.max() > _LONGEST:
        raise GagaError("A compressed run-length mask is damaged. Make the file again.")
    place = np.arange(len(digits)) - np.repeat(starts, n_digits)
    values = np.add.reduceat((digits & 0x1F) << (_BITS * place), starts)
    values -= np.where(digits[ends] & _SIGN, np.int64(1) << (_BITS * n_digits), 0)
    # Undo the differences: counts 3, 5, ... add up from 1 on, counts 4, 6, ... from 2 on.
    values[1::2] = np.cumsum(values[1::2])
    values[2::2] = np.cumsum(values[2::2])
    return values


# --- documents


CocoJson = dict[str, object]


@dataclass(frozen=True)
class LabelledPicture:
    """One picture and its label map's annotations."""

    file_name: str  # of the photo
    label_file: str  # of the panoptic picture; "" = none
    width: int
    height: int
    segments: tuple["Segment", ...]


@dataclass(frozen=True)
class Segment:
    """One group in one picture."""

    group: int  # > 0
    area: int  # pixels
    box: tuple[int, int, int, int]  # x, y, width, height
    counts: str  # compressed run lengths


def segments_of(labels: IntArray) -> tuple[Segment, ...]:
    """The groups of a label map (H, W) int32, by id."""
    from scipy.ndimage import find_objects

    check_shape("labels", labels, ("H", "W"), np.int32)
    counts = encode_labels(labels)
    ids = np.array(sorted(counts), np.int64)
    # Dense ids: one slice per id whatever its number.
    places = find_objects(np.where(labels > 0, np.searchsorted(ids, labels) + 1, 0), len(ids))
    found = []
    for group, place in zip(ids.tolist(), places, strict=True):
        rows, columns = place
        box = (columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
        area = sum(counts[group][1::2])
        found.append(Segment(group, area, box, compress_counts(counts[group])))
    return tuple(found)


def instances_document(pictures: Sequence[LabelledPicture], names: Mapping[int, str]) -> CocoJson:
    """COCO's instance format; ``names`` by group id make the categories."""
    found = [
        (image_id, picture, segment)
        for image_id, picture in enumerate(pictures, start=1)
        for segment in picture.segments
    ]
    annotations = [
        {
            "id": i,
            "image_id": image_id,
            "category_id": segment.group,
            "group_id": segment.group,
            "segmentation": {"size": [picture.height, picture.width], "counts": segment.counts},
            "area": segment.area,
            "bbox": list(segment.box),
            "iscrowd": 0,
        }
        for i, (image_id, picture, segment) in enumerate(found, start=1)
    ]
    return {
        "info": {"description": "Label maps rendered from 3D groups", "version": "1.0"},
        "images": _images(pictures),
        "categories": _categories(pictures, names),
        "annotations": annotations,
    }


def panoptic_document(pictures: Sequence[LabelledPicture], names: Mapping[int, str]) -> CocoJson:
    """COCO's panoptic format; the pictures next to it are written by `panoptic_picture`."""
    annotations = [
        {
            "image_id": image_id,
            "file_name": picture.label_file,
            "segments_info": [
                {
                    "id": segment.group,
                    "category_id": segment.group,
                    "area": segment.area,
                    "bbox": list(segment.box),
                    "iscrowd": 0,
                }
                for segment in picture.segments
            ],
        }
        for image_id, picture in enumerate(pictures, start=1)
    ]
    return {
        "images": _images(pictures),
        "categories": [c | {"isthing": 1} for c in _categories(pictures, names)],
        "annotations": annotations,
    }


def panoptic_picture(labels: IntArray) -> UInt8Array:
    """RGB picture (H, W, 3) of a label map: id = R + 256 G + 65536 B."""
    check_shape("labels", labels, ("H", "W"), np.int32)
    channels = [labels & 255, (labels >> 8) & 255, (labels >> 16) & 255]
    return np.stack(channels, axis=2).astype(np.uint8)


def write_json(path: Path, content: CocoJson) -> None:
    """Write ``content`` whole or not at all."""
    write_text(path, json.dumps(content, ensure_ascii=False) + "\n")


def _images(pictures: Sequence[LabelledPicture]) -> list[CocoJson]:
    return [
        {"id": i, "file_name": one.file_name, "width": one.width, "height": one.height}
        for i, one in enumerate(pictures, start=1)
    ]


def _categories(pictures: Sequence[LabelledPicture], names: Mapping[int, str]) -> list[CocoJson]:
    present = sorted({s.group for picture in pictures for s in picture.segments})
    return [
        {"id": group, "name": names.get(group, f"group {group}"), "supercategory": "object"}
        for group in present
    ]
