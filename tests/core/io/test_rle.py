"""Run lengths of masks: round trips, the COCO API's own strings, damaged input."""

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.errors import GagaError
from gaga_core.io.masks.coco import (
    compress_counts,
    decode_rle,
    decompress_counts,
    encode_labels,
    encode_rle,
)


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
