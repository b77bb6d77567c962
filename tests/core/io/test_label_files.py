"""Pictures and label maps: what is written is read, what cannot be read is a sentence."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin
from PIL.PngImagePlugin import PngInfo

from gaga_core.errors import GagaError
from gaga_core.io.images import open_image, read_rgb, write_rgb
from gaga_core.io.masks.label_maps import (
    list_label_files,
    mask_folder,
    read_further_labels,
    read_labels,
    write_labels,
)


def ids(seed: int = 0, top: int = 900) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.integers(0, top, (20, 30)).astype(np.int32)


def test_ids_above_255_survive(tmp_path: Path) -> None:
    labels = ids(top=65536)
    labels[0, :4] = [255, 256, 257, 65535]
    write_labels(tmp_path / "a.png", labels)
    assert np.array_equal(read_labels(tmp_path / "a.png"), labels)


def test_maps_at_other_levels_of_detail_lie_in_the_same_file(tmp_path: Path) -> None:
    path, labels, further = tmp_path / "a.png", ids(), [ids(1)[::2], ids(2, 65536)]
    write_labels(path, labels, further)
    assert np.array_equal(read_labels(path), labels)
    found = read_further_labels(path)
    assert all(np.array_equal(one, other) for one, other in zip(found, further, strict=True))
    Image.open(path).save(tmp_path / "b.png")  # as another program does
    assert np.array_equal(read_labels(tmp_path / "b.png"), labels)
    assert read_further_labels(tmp_path / "b.png") == ()
    write_labels(path, labels)
    assert read_further_labels(path) == ()
    with pytest.raises(GagaError, match="65535"):
        write_labels(path, labels, [np.full((2, 2), 65536, np.int32)])
    content = PngInfo()
    content.add(b"gaLV", b"no picture")
    Image.new("L", (2, 2)).save(path, pnginfo=content)
    with pytest.raises(GagaError, match="damaged"):
        read_further_labels(path)


def test_ids_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(GagaError, match="65535"):
        write_labels(tmp_path / "a.png", np.full((2, 2), 65536, np.int32))
    assert list(tmp_path.iterdir()) == []


def test_every_kind_of_label_picture_gives_the_same_regions(tmp_path: Path) -> None:
    labels = ids(top=200) * (np.arange(20)[:, None] > 3)
    small = labels.astype(np.uint8)
    Image.fromarray(small).save(tmp_path / "gray.png")
    palette = Image.fromarray(small).convert("P")
    palette.putdata(small.ravel().tolist())
    palette.save(tmp_path / "palette.png")
    lookup = np.random.default_rng(3).integers(1, 255, (200, 3)).astype(np.uint8)
    lookup[0] = 0
    Image.fromarray(lookup[small]).save(tmp_path / "color.png")
    assert np.array_equal(read_labels(tmp_path / "gray.png"), labels)
    assert np.array_equal(read_labels(tmp_path / "palette.png"), labels)
    colored = read_labels(tmp_path / "color.png")
    assert np.array_equal(colored == 0, labels == 0)
    assert len(np.unique(colored)) == len(np.unique(labels))
    joint = np.unique(np.stack([colored.ravel(), labels.ravel()]), axis=1)
    assert joint.shape[1] == len(np.unique(labels))  # one color, one id


def test_mask_folder_matches_by_stem(tmp_path: Path) -> None:
    write_labels(tmp_path / "a.b.png", ids(1))
    write_labels(tmp_path / "c.png", ids(2))
    masks = mask_folder(tmp_path, ["a.b.jpg", "d.jpg"])
    assert masks.names == ("a.b.jpg",)
    assert np.array_equal(masks.load("a.b.jpg", 30, 20), ids(1))
    assert masks.load("a.b.jpg", 60, 40).shape == (40, 60)
    assert len(list_label_files(tmp_path)) == 2


def test_a_resized_mask_keeps_its_ids_in_place(tmp_path: Path) -> None:
    write_labels(tmp_path / "a.png", ids(1))
    masks = mask_folder(tmp_path, ["a.png"])
    large = masks.load("a.png", 90, 60)
    assert np.array_equal(large[1::3, 1::3], ids(1))


@pytest.mark.parametrize("content", [b"", b"no picture", b"\x89PNG\r\n\x1a\n\0\0"])
def test_pictures_that_are_none_are_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.png").write_bytes(content)
    for read in (read_rgb, read_labels):
        with pytest.raises(GagaError, match=r"x\.png"):
            read(tmp_path / "x.png")


def test_photos_turn_as_their_tag_says(tmp_path: Path) -> None:
    picture = np.zeros((4, 6, 3), np.uint8)
    picture[0, 0] = 255
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees clockwise to show
    Image.fromarray(picture).save(tmp_path / "a.png", exif=exif)
    assert read_rgb(tmp_path / "a.png").shape == (6, 4, 3)
    assert read_rgb(tmp_path / "a.png")[0, -1, 0] == 255


def test_written_pictures_are_clipped_and_rounded(tmp_path: Path) -> None:
    picture = np.array([[[-1, 0.5, 2]]], np.float32)
    write_rgb(tmp_path / "a.png", picture)
    assert read_rgb(tmp_path / "a.png").tolist() == [[[0, 128, 255]]]


def test_a_picture_that_claims_more_than_the_memory_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "a.png")

    def full(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(PngImagePlugin.PngImageFile, "load_end", full)
    with pytest.raises(GagaError, match="too large"):
        open_image(tmp_path / "a.png")
