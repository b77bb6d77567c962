"""Masks of the object: read from a folder, or found in front of what stands still."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_dilation, gaussian_filter

from gaga_core.arrays import BoolArray
from gaga_core.errors import GagaError
from gaga_core.placing.foreground import (
    backdrop_color,
    exposure_gains,
    masks_from_folder,
    object_mask,
    write_masks,
)
from gaga_core.placing.photos import Photo, PhotoSet
from gaga_core.progress import run_stage

_N, _SHAPE = 12, (96, 128)


def _square(k: int) -> BoolArray:
    mask = np.zeros(_SHAPE, bool)
    left = 20 + 60 * k // _N
    mask[35:65, left : left + 30] = True
    return mask


@pytest.mark.parametrize("drift", [0.0, 0.3])
def test_an_object_is_found_before_a_room_that_stands_still(drift: float) -> None:
    """Whatever the exposure of each photo, and although the object has one color."""
    rng = np.random.default_rng(0)
    room = gaussian_filter(rng.uniform(0, 500, (*_SHAPE, 3)), (2, 2, 0)).clip(20, 200)
    gains = 1 + drift * rng.uniform(-1, 0, (_N, 1, 1, 3))
    squares = np.array([_square(k) for k in range(_N)])
    photos = np.where(squares[..., None], (30.0, 60.0, 220.0), room) * gains
    looks = (photos + rng.normal(0, 1, photos.shape)).clip(0, 255).astype(np.uint8)
    found = exposure_gains(looks)
    hulls = np.array([binary_dilation(square, iterations=4) for square in squares])
    color, known = backdrop_color(looks, found, hulls)
    for k in range(_N):
        mask = object_mask(looks[k] / found[k], color, known, hulls[k])
        both, either = (mask & squares[k]).sum(), (mask | squares[k]).sum()
        assert both > 0.8 * either


def test_masks_are_found_by_the_names_of_the_photos(tmp_path: Path) -> None:
    photos = PhotoSet(tuple(Photo(f"{i}.png", f"/in/view{i}.jpg", 160, 120) for i in range(8)))
    given = tmp_path / "given"
    given.mkdir()
    square = np.zeros((60, 80), np.uint8)  # half the size of the photos
    square[20:40, 30:50] = 1
    for i in range(7):
        Image.fromarray(square).save(given / f"view{i}.png")
    with pytest.raises(GagaError, match=r"1 of 8 photos have no mask.*view7\.jpg"):
        run_stage(masks_from_folder(photos, given, tmp_path / "masks"))
    Image.fromarray(square).save(given / "view7.jpg.png")
    run_stage(masks_from_folder(photos, given, tmp_path / "masks"))
    mask = np.asarray(Image.open(tmp_path / "masks" / "7.png.png"))
    assert mask.shape == (120, 160)
    assert mask[42:78, 62:98].all()
    assert (mask > 0).mean() < 0.12


def test_given_masks_turn_with_their_photos(tmp_path: Path) -> None:
    photos = PhotoSet(tuple(Photo(f"{i}.png", f"/in/{i}.jpg", 60, 80) for i in range(2)))
    mask = np.zeros((60, 80), np.uint8)
    mask[:20] = 1  # the upper edge, which is the right one when turned clockwise
    Image.fromarray(mask).save(tmp_path / "m.png")
    run_stage(write_masks(photos, {"0.png": (tmp_path / "m.png", 1)}, tmp_path / "masks"))
    turned, whole = (np.asarray(Image.open(tmp_path / "masks" / f"{i}.png.png")) for i in (0, 1))
    assert turned[:, 42:].all()
    assert not turned[:, :38].any()
    assert whole.all()
    Image.fromarray(mask * 0).save(tmp_path / "m.png")
    with pytest.raises(GagaError, match="black mask"):
        run_stage(write_masks(photos, {"1.png": (tmp_path / "m.png", 0)}, tmp_path / "masks"))
