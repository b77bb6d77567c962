"""Pictures of photos, as their functions make them without a window."""

from pathlib import Path

import numpy as np
from PIL import Image

from gaga_studio.ui.kit.textures import without_background


def test_a_background_that_is_left_out_is_dark_and_the_object_as_it_is(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(60, 255, (80, 120, 3), np.uint8)
    mask = np.zeros((40, 60), np.uint8)  # half the size
    mask[10:30, 20:40] = 255
    Image.fromarray(picture).save(tmp_path / "photo.png")
    Image.fromarray(mask).save(tmp_path / "mask.png")
    found = without_background(tmp_path / "photo.png", tmp_path / "mask.png", 120).astype(float)
    assert found.shape == picture.shape
    np.testing.assert_allclose(found[26:54, 46:74], picture[26:54, 46:74], atol=1)
    assert (found[:14] < 0.3 * picture[:14]).all()
    assert (found[:, 90:] > 0.2 * picture[:, 90:] - 1).all()
