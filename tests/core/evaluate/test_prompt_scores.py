"""LERF-Mask scores: an example by hand, and what is missing."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import BoolArray
from gaga_core.errors import GagaError
from gaga_core.evaluate.prompt_scores import boundary_iou, boundary_of, evaluate_lerf_mask, mask_iou


def box(shape: tuple[int, int], top: int, left: int, height: int, width: int) -> BoolArray:
    mask = np.zeros(shape, np.bool_)
    mask[top : top + height, left : left + width] = True
    return mask


def write(folder: Path, name: str, mask: BoolArray) -> None:
    path = folder / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(mask.astype(np.uint8) * 255).save(path)


def eroded_step_by_step(mask: BoolArray, steps: int) -> BoolArray:
    """The published script's way: a border of zeros, then a 3 x 3 erosion many times."""
    padded = np.pad(mask, 1)
    for _ in range(steps):
        around = [np.roll(padded, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        padded = np.logical_and.reduce(around)
        padded[[0, -1]] = False
        padded[:, [0, -1]] = False
    return padded[1:-1, 1:-1]


def test_a_small_example_by_hand(tmp_path: Path) -> None:
    shape = (30, 40)  # diagonal 50: the band is one pixel wide
    true = box(shape, 5, 5, 10, 10)
    shifted = box(shape, 5, 7, 10, 10)
    write(tmp_path / "gt", "0/red mug", true)
    write(tmp_path / "gt", "1/red mug", true)
    write(tmp_path / "gt", "1/plate", box(shape, 0, 0, 10, 10))
    write(tmp_path / "pred", "0/red mug", shifted)
    write(tmp_path / "pred", "1/red mug", true)
    write(tmp_path / "pred", "1/plate", box(shape, 0, 0, 10, 10))
    report = evaluate_lerf_mask(tmp_path / "pred", tmp_path / "gt")
    mug, plate = report.prompts[1], report.prompts[0]
    assert (mug.prompt, mug.n_views, plate.n_views) == ("red mug", 2, 1)
    # 10 x 8 of 100 + 100 - 80 pixels; the bands of 36 share two runs of 8 and no sides.
    assert mug.iou == pytest.approx((80 / 120 + 1) / 2)
    assert mug.boundary_iou == pytest.approx((16 / 56 + 1) / 2)
    assert plate.iou == plate.boundary_iou == 1
    assert report.miou == pytest.approx((mug.iou + 1) / 2)
    assert report.mean_boundary_iou == pytest.approx((mug.boundary_iou + 1) / 2)
    assert report.missing == report.unused == ()
    assert len(report.table()) == 4


def test_missing_counts_as_nothing_and_is_named_and_names_that_miss_are_told(
    tmp_path: Path,
) -> None:
    shape = (30, 40)
    for prompt in ("apple", "green apple"):
        write(tmp_path / "gt", f"7/{prompt}", box(shape, 2, 2, 8, 8))
    write(tmp_path / "pred", "7/apple", box(shape, 2, 2, 8, 8))
    write(tmp_path / "pred", "7/green_apple", box(shape, 2, 2, 8, 8))
    report = evaluate_lerf_mask(tmp_path / "pred", tmp_path / "gt")
    assert report.missing == ("7/green apple",)
    assert report.unused == ("7/green_apple",)
    assert report.miou == report.mean_boundary_iou == 0.5
    (tmp_path / "empty").mkdir()
    assert evaluate_lerf_mask(tmp_path / "empty", tmp_path / "gt").miou == 0
    with pytest.raises(GagaError, match="holds no masks"):
        evaluate_lerf_mask(tmp_path / "pred", tmp_path / "empty")


def test_two_empty_masks_agree() -> None:
    nothing, something = np.zeros((20, 20), np.bool_), box((20, 20), 3, 3, 5, 5)
    assert mask_iou(nothing, nothing) == boundary_iou(nothing, nothing) == 1
    assert mask_iou(nothing, something) == boundary_iou(something, nothing) == 0


@pytest.mark.parametrize("seed", range(3))
def test_the_band_is_that_of_the_published_script(seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocks = rng.random((9, 12)) < 0.6
    mask = np.kron(blocks, np.ones((20, 20), np.bool_))
    steps = round(0.02 * float(np.hypot(*mask.shape)))
    assert steps == 6
    assert (boundary_of(mask) == (mask & ~eroded_step_by_step(mask, steps))).all()


def test_predictions_of_another_size_are_resized(tmp_path: Path) -> None:
    mask = box((30, 40), 4, 8, 10, 20)
    write(tmp_path / "gt", "0/cup", mask)
    write(tmp_path / "pred", "0/cup", np.kron(mask, np.ones((2, 2), np.bool_)))
    assert evaluate_lerf_mask(tmp_path / "pred", tmp_path / "gt").miou == 1
