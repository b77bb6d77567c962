"""COCO documents of label maps: what a reader of the format gets back is the map."""

import json
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import BoolArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.io.masks.coco import (
    LabelledPicture,
    compress_counts,
    decode_rle,
    decompress_counts,
    encode_labels,
    encode_rle,
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


# --- Run lengths of masks: round trips, the COCO API's own strings, damaged input.


def _masks() -> list[BoolArray]:
    rng = np.random.default_rng(0)
    shapes = [(1, 1), (1, 7), (7, 1), (5, 9), (64, 48), (300, 400)]
    masks = [rng.random(shape) < share for shape in shapes for share in (0.0, 0.02, 0.5, 1.0)]
    blob = np.zeros((480, 640), bool)
    blob[100:300, 50:500] = True
    return [*masks, blob]


def _counts_one_by_one(mask: BoolArray) -> list[int]:
    """The definition, pixel by pixel."""
    counts, value = [0], False
    for pixel in mask.T.ravel().tolist():
        if pixel != value:
            counts.append(0)
            value = pixel
        counts[-1] += 1
    return counts


def _string_one_by_one(counts: list[int]) -> str:
    """rleToString of the COCO API, line by line."""
    text = ""
    for i, count in enumerate(counts):
        x = count - counts[i - 2] if i > 2 else count
        more = True
        while more:
            c = x & 0x1F
            x >>= 5
            more = x != -1 if c & 0x10 else x != 0
            text += chr((c | 0x20 if more else c) + 48)
    return text


@pytest.mark.parametrize("mask", _masks(), ids=lambda mask: f"{mask.shape}-{mask.mean():.2f}")
def test_round_trips(mask: BoolArray) -> None:
    counts = encode_rle(mask)
    assert counts == _counts_one_by_one(mask)
    text = compress_counts(counts)
    assert text == _string_one_by_one(counts)
    assert decompress_counts(text).tolist() == counts
    for form in (counts, text, text.encode()):
        decoded = decode_rle(form, mask.shape)
        assert decoded.dtype == np.bool_
        np.testing.assert_array_equal(decoded, mask)


def test_large_and_odd_counts() -> None:
    rng = np.random.default_rng(1)
    counts = [int(c) for c in rng.integers(0, 1 << rng.integers(1, 34, 500))]
    assert decompress_counts(compress_counts(counts)).tolist() == counts
    assert compress_counts(counts) == _string_one_by_one(counts)
    assert compress_counts([]) == ""
    assert decompress_counts("").tolist() == []


def test_a_known_string_of_the_coco_api() -> None:
    """A 3 x 3 picture whose middle column is set: 3 zeros, 3 ones, 3 zeros."""
    mask = np.zeros((3, 3), bool)
    mask[:, 1] = True
    assert compress_counts(encode_rle(mask)) == "333"
    np.testing.assert_array_equal(decode_rle("333", (3, 3)), mask)


def test_all_ids_of_a_label_map_at_once() -> None:
    rng = np.random.default_rng(2)
    labels = np.repeat(rng.integers(-1, 6, (20, 30)), 3, axis=0).astype(np.int32)
    runs = encode_labels(labels)
    assert sorted(runs) == [1, 2, 3, 4, 5]
    for label, counts in runs.items():
        assert counts == encode_rle(labels == label)
    assert encode_labels(np.zeros((4, 4), np.int32)) == {}
    assert encode_labels(np.full((4, 4), 9, np.int32)) == {9: [0, 16]}
    assert encode_labels(np.zeros((0, 4), np.int32)) == {}


@pytest.mark.parametrize(
    ("counts", "size"),
    [
        ([1, 2], (2, 2)),
        ([-1, 5], (2, 2)),
        ([4], (2, 2, 1)),
        ([4], (-2, -2)),
        (["a"], (1, 1)),
        ([1 << 70], (1, 1)),
        ("3`", (3, 3)),
        ("3\x01", (3, 3)),
        ("33", (3, 3)),
        ("oooooooooo0", (3, 3)),
        ("ä", (1, 1)),
    ],
)
def test_damaged_counts_are_named(counts: list[int] | str, size: tuple[int, ...]) -> None:
    with pytest.raises(GagaError, match="run-length"):
        decode_rle(counts, size)
