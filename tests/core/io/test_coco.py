"""COCO documents of label maps: what a reader of the format gets back is the map."""

import json
from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.io.masks.coco import (
    LabelledPicture,
    decode_rle,
    instances_document,
    panoptic_document,
    panoptic_picture,
    segments_of,
    write_json,
)
from gaga_core.io.masks.other_programs import recognise_json


def _map(seed: int, height: int = 30, width: int = 45) -> IntArray:
    rng = np.random.default_rng(seed)
    ids = np.array([0, 0, 3, 70, 900, 65535], np.int32)
    coarse = ids[rng.integers(0, len(ids), (height // 5, width // 5))]
    return np.repeat(np.repeat(coarse, 5, axis=0), 5, axis=1)


def _pictures() -> tuple[list[IntArray], list[LabelledPicture]]:
    maps = [_map(seed) for seed in range(3)] + [np.zeros((30, 45), np.int32)]
    pictures = [
        LabelledPicture(f"view_{i}.jpg", f"view_{i}.png", 45, 30, segments_of(labels))
        for i, labels in enumerate(maps)
    ]
    return maps, pictures


def test_segments_say_what_the_map_does() -> None:
    labels = _map(1)
    segments = segments_of(labels)
    assert [s.group for s in segments] == sorted(set(labels[labels > 0].tolist()))
    for segment in segments:
        mask = labels == segment.group
        np.testing.assert_array_equal(decode_rle(segment.counts, labels.shape), mask)
        assert segment.area == mask.sum()
        x, y, w, h = segment.box
        assert mask[y : y + h, x : x + w].sum() == mask.sum()
        assert mask[y].any()
        assert mask[y + h - 1].any()
        assert mask[:, x].any()
        assert mask[:, x + w - 1].any()
    assert segments_of(np.zeros((4, 4), np.int32)) == ()


def test_instances_round_trip(tmp_path: Path) -> None:
    maps, pictures = _pictures()
    document = instances_document(pictures, {3: "mug", 70: "Schüssel"})
    write_json(tmp_path / "instances.json", document)
    read = json.loads((tmp_path / "instances.json").read_text(encoding="utf-8"))
    names = {category["id"]: category["name"] for category in read["categories"]}
    assert names == {3: "mug", 70: "Schüssel", 900: "group 900", 65535: "group 65535"}
    by_image = {image["id"]: maps[i] for i, image in enumerate(read["images"])}
    back = {key: np.zeros_like(value) for key, value in by_image.items()}
    for annotation in read["annotations"]:
        rle = annotation["segmentation"]
        mask = decode_rle(rle["counts"], rle["size"])
        back[annotation["image_id"]][mask] = annotation["category_id"]
    for key, labels in by_image.items():
        np.testing.assert_array_equal(back[key], labels)
    ids = [annotation["id"] for annotation in read["annotations"]]
    assert ids == list(range(1, len(ids) + 1))


def test_our_own_import_reads_it(tmp_path: Path) -> None:
    _, pictures = _pictures()
    write_json(tmp_path / "instances.json", instances_document(pictures, {}))
    source = recognise_json(tmp_path / "instances.json")
    assert {f"view_{i}" for i in range(3)} <= set(source.views)


def test_panoptic_pictures_and_their_list_agree() -> None:
    maps, pictures = _pictures()
    document = panoptic_document(pictures, {})
    annotations = document["annotations"]
    assert isinstance(annotations, list)
    for labels, annotation in zip(maps, annotations, strict=True):
        rgb = panoptic_picture(labels).astype(np.int64)
        ids = rgb[..., 0] + 256 * rgb[..., 1] + 65536 * rgb[..., 2]
        np.testing.assert_array_equal(ids, labels)
        listed = {segment["id"]: segment["area"] for segment in annotation["segments_info"]}
        present, areas = np.unique(labels[labels > 0], return_counts=True)
        assert listed == dict(zip(present.tolist(), areas.tolist(), strict=True))
