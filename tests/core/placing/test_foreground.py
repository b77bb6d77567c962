"""Masks of the object: read from a folder, or found in front of what stands still."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_dilation, gaussian_filter

from gaga_core.arrays import BoolArray
from gaga_core.errors import GagaError
from gaga_core.geometry import look_at
from gaga_core.placing.foreground import (
    backdrop_color,
    backdrop_stage,
    exposure_gains,
    masks_from_folder,
    object_mask,
    write_masks,
)
from gaga_core.placing.metrics import SfmFacts
from gaga_core.placing.photos import Photo, PhotoSet
from gaga_core.progress import Progress, run_stage
from tests.shares import falls, shares

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


@pytest.mark.parametrize("is_static", [True, False])
def test_the_share_goes_on_while_colors_are_compared(tmp_path: Path, is_static: bool) -> None:
    """Of 48 s the middle 29 had no word, and the photos that were read before, in 3 s, were told as
    half: the time left went from three times too little to twice too much. Where there is no
    backdrop to look for, the step is told as done."""
    rng = np.random.default_rng(0)
    room = gaussian_filter(rng.uniform(0, 500, (*_SHAPE, 3)), (2, 2, 0)).clip(20, 200)
    names = tuple(f"{k:02}.png" for k in range(_N))
    for k, name in enumerate(names):
        if not is_static:
            room = rng.uniform(0, 255, room.shape)
        photo = np.where(_square(k)[..., None], (30.0, 60.0, 220.0), room).astype(np.uint8)
        Image.fromarray(photo).save(tmp_path / name)
    height, width = _SHAPE
    photos = PhotoSet(tuple(Photo(name, f"/in/{name}", width, height) for name in names))
    heard: list[Progress] = []
    stage = backdrop_stage(
        photos, tmp_path, _facts(names, rng), tmp_path / "masks", is_static=is_static
    )
    found = run_stage(stage, heard.append)
    assert (found is not None) is is_static
    assert falls(heard) == []
    known = shares(heard)
    assert known[0] == 0
    if is_static:
        assert len(heard) >= 2 * _N + 2 * _N, "each photo twice, and the colors of each"
        assert known[_N] < 0.1, "photos are read in no time"
    else:
        assert known[-1] == 1


def _facts(names: tuple[str, ...], rng: np.random.Generator) -> SfmFacts:
    """Cameras all around a ball of points."""
    turns = np.linspace(0, 2 * np.pi, len(names), endpoint=False)
    centers = 4 * np.column_stack([np.sin(turns), 0 * turns, -np.cos(turns)])
    down = np.array([0.0, 1.0, 0.0])
    poses = np.array([look_at(c, np.zeros(3), -down)[:3] for c in centers])
    points = rng.normal(size=(200, 3)) / 4
    seen = np.indices((len(names), len(points))).reshape(2, -1)
    none = np.zeros((0, 2), np.int64)
    return SfmFacts(
        names=names,
        poses=poses,
        focal=np.full((len(names), 2), 128.0),
        sizes=np.tile(np.array(_SHAPE[::-1]), (len(names), 1)),
        points=points,
        track_lengths=np.full(len(points), 5),
        seen_points=seen[1],
        seen_views=seen[0],
        seen_errors=np.zeros(seen.shape[1]),
        match_views=none,
        match_points=none,
        match_rays=np.zeros((0, 2, 3)),
        all_names=names,
        pairs=none,
        pair_matches=np.zeros(0, np.int64),
        model_sizes=np.array([len(names)]),
    )


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
