"""COCO JSON of label maps: instances with run-length masks, and panoptic pictures.

Ids are shared by all pictures (a group is one object wherever it is seen), so every group is a
category of its own, and ``group_id`` names it in each annotation.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray, UInt8Array, check_shape
from gaga_core.io.files import atomic_write
from gaga_core.io.rle import compress_counts, encode_labels

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
    annotations: list[CocoJson] = []
    for image_id, picture in enumerate(pictures, start=1):
        for segment in picture.segments:
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": image_id,
                    "category_id": segment.group,
                    "group_id": segment.group,
                    "segmentation": {
                        "size": [picture.height, picture.width],
                        "counts": segment.counts,
                    },
                    "area": segment.area,
                    "bbox": list(segment.box),
                    "iscrowd": 0,
                }
            )
    return {
        "info": {"description": "Label maps rendered from 3D groups", "version": "1.0"},
        "images": [_image(i, picture) for i, picture in enumerate(pictures, start=1)],
        "categories": _categories(pictures, names),
        "annotations": annotations,
    }


def panoptic_document(pictures: Sequence[LabelledPicture], names: Mapping[int, str]) -> CocoJson:
    """COCO's panoptic format; the pictures next to it are written by `panoptic_picture`."""
    annotations: list[CocoJson] = []
    for image_id, picture in enumerate(pictures, start=1):
        segments = [
            {
                "id": segment.group,
                "category_id": segment.group,
                "area": segment.area,
                "bbox": list(segment.box),
                "iscrowd": 0,
            }
            for segment in picture.segments
        ]
        annotations.append(
            {"image_id": image_id, "file_name": picture.label_file, "segments_info": segments}
        )
    return {
        "images": [_image(i, picture) for i, picture in enumerate(pictures, start=1)],
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
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(content, ensure_ascii=False) + "\n", encoding="utf-8")


def _image(image_id: int, picture: LabelledPicture) -> CocoJson:
    return {
        "id": image_id,
        "file_name": picture.file_name,
        "width": picture.width,
        "height": picture.height,
    }


def _categories(pictures: Sequence[LabelledPicture], names: Mapping[int, str]) -> list[CocoJson]:
    present = sorted({s.group for picture in pictures for s in picture.segments})
    return [
        {"id": group, "name": names.get(group, f"group {group}"), "supercategory": "object"}
        for group in present
    ]
