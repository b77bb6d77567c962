"""Masks of the object: read from a folder, or found where something moves."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.errors import GagaError
from gaga_core.io.images import read_rgb
from gaga_core.placing.foreground import masks_from_folder, masks_of_what_moves, paint_background
from gaga_core.placing.photos import Photo, PhotoSet
from gaga_core.progress import run_stage


@pytest.fixture
def turned(tmp_path: Path) -> PhotoSet:
    """Eight photos of noise that stands still, with a square in the middle that changes."""
    rng = np.random.default_rng(0)
    room = rng.integers(0, 255, (120, 160, 3), dtype=np.uint8)
    (tmp_path / "photos").mkdir()
    photos = []
    for i in range(8):
        picture = room.copy()
        picture[40:80, 60:100] = rng.integers(0, 255, (40, 40, 3), dtype=np.uint8)
        Image.fromarray(picture).save(tmp_path / "photos" / f"{i}.png")
        photos.append(Photo(f"{i}.png", f"/in/view{i}.jpg", 160, 120))
    return PhotoSet(tuple(photos))


def test_the_part_that_moves_is_found_and_the_rest_painted(
    turned: PhotoSet, tmp_path: Path
) -> None:
    masks = tmp_path / "masks"
    run_stage(masks_of_what_moves(turned, tmp_path / "photos", masks))
    mask = np.asarray(Image.open(masks / "3.png.png")) > 0
    assert mask[40:80, 60:100].all()
    assert mask.mean() < 0.25
    run_stage(paint_background(turned.photos, tmp_path / "photos", masks))
    painted = read_rgb(tmp_path / "photos" / "3.png")
    assert not painted[~mask].any()
    assert painted[mask].any()


def test_photos_in_which_nothing_or_everything_moves_are_refused(
    turned: PhotoSet, tmp_path: Path
) -> None:
    still = PhotoSet(tuple(turned.photos[0] for _ in range(4)))
    with pytest.raises(GagaError, match="--turntable"):
        run_stage(masks_of_what_moves(still, tmp_path / "photos", tmp_path / "masks"))


def test_masks_are_found_by_the_names_of_the_photos(turned: PhotoSet, tmp_path: Path) -> None:
    given = tmp_path / "given"
    given.mkdir()
    square = np.zeros((60, 80), np.uint8)  # half the size of the photos
    square[20:40, 30:50] = 1
    for i in range(7):
        Image.fromarray(square).save(given / f"view{i}.png")
    with pytest.raises(GagaError, match=r"1 of 8 photos have no mask.*view7\.jpg"):
        run_stage(masks_from_folder(turned, given, tmp_path / "masks"))
    Image.fromarray(square).save(given / "view7.jpg.png")
    run_stage(masks_from_folder(turned, given, tmp_path / "masks"))
    mask = np.asarray(Image.open(tmp_path / "masks" / "7.png.png"))
    assert mask.shape == (120, 160)
    assert mask[42:78, 62:98].all()
    assert (mask > 0).mean() < 0.12
