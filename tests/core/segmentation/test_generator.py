"""The generator's logic with a model whose answers are known: boxes around points."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from gaga_core.arrays import AnyArray, FloatArray, UInt8Array
from gaga_core.progress import Progress, run_stage
from gaga_core.segmentation.base import ScoredMasks
from gaga_core.segmentation.choose import ProviderSettings
from gaga_core.segmentation.generator import (
    Encoded,
    boxes_of,
    crop_windows,
    generate,
    non_maximum_suppression,
    point_grid,
)
from gaga_core.segmentation.settings import GeneratorConfig

_TILE = 40  # pixels of the picture's tiles
_CONFIG = GeneratorConfig(points_per_side=8, points_per_batch=5)


class Tiles:
    """Answers each point with its tile of the picture, well, badly, and not at all.

    Its logits are a quarter of the picture's size, as a model's are.
    """

    def __init__(self) -> None:
        self.looks = 0
        self.batches: list[int] = []

    def __call__(self, image: UInt8Array) -> Encoded:
        self.looks += 1
        height, width = image.shape[:2]
        ids = image[..., 0].astype(np.int64)
        small = torch.from_numpy(ids[2::4, 2::4].copy())

        def decode(points: FloatArray) -> tuple[Tensor, Tensor]:
            self.batches.append(len(points))
            at = torch.from_numpy(points).long()
            tile = torch.from_numpy(ids)[at[:, 1], at[:, 0]]
            good = torch.where(small[None] == tile[:, None, None], 8.0, -8.0)
            vague = torch.where(small[None] == tile[:, None, None], 0.5, -0.5)  # unstable
            nothing = torch.full_like(good, -8.0)
            sure = 0.9 if self.looks == 1 else 0.85  # less in crops
            scores = torch.tensor([sure, 0.95, 0.99]).expand(len(points), 3)
            return torch.stack([good, vague, nothing], dim=1), scores

        def upscale(logits: Tensor) -> Tensor:
            return interpolate(logits[:, None], (height, width), mode="nearest")[:, 0]

        def prompt(points: FloatArray, is_on: AnyArray) -> tuple[Tensor, Tensor]:
            raise AssertionError("the generator asks with single points")

        def boxes(corners: FloatArray) -> Tensor:
            raise AssertionError("the generator asks with single points")

        return Encoded(decode, upscale, (1.0, 1.0), prompt, boxes)


def _picture(rows: int = 3, columns: int = 4) -> UInt8Array:
    ids = 1 + np.arange(rows * columns).reshape(rows, columns)
    tiles = np.repeat(np.repeat(ids, _TILE, axis=0), _TILE, axis=1).astype(np.uint8)
    return np.stack([tiles] * 3, axis=2)


def _tiles_found(masks: ScoredMasks, image: UInt8Array) -> list[int]:
    found = []
    for i in range(len(masks)):
        values = np.unique(image[..., 0][masks.mask(i)])
        assert len(values) == 1
        assert masks.areas[i] == (image[..., 0] == values[0]).sum()
        found.append(int(values[0]))
    return found


def test_every_tile_is_found_once() -> None:
    image, model = _picture(), Tiles()
    steps: list[Progress] = []

    def follow(step: Progress) -> None:
        assert not torch.is_inference_mode_enabled(), "no mode leaks out of the stage"
        steps.append(step)

    masks = run_stage(generate(model, image, _CONFIG), follow)
    assert sorted(_tiles_found(masks, image)) == list(range(1, 13))
    assert masks.scores.tolist() == pytest.approx([0.9] * 12)
    assert model.looks == 1
    assert model.batches == [5] * 12 + [4]
    done = [step.done for step in steps]
    assert done == sorted(done)
    assert done[-1] == steps[-1].total == 64


@pytest.mark.parametrize("size", [1, 64])
def test_batches_change_nothing(size: int) -> None:
    some, other = (
        run_stage(generate(Tiles(), _picture(), replace(_CONFIG, points_per_batch=n)))
        for n in (_CONFIG.points_per_batch, size)
    )
    np.testing.assert_array_equal(some.boxes, other.boxes)
    np.testing.assert_array_equal(some.scores, other.scores)


def test_points_lie_in_the_middle_of_their_cells_and_boxes_are_tight() -> None:
    assert point_grid(2).tolist() == [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]]
    masks = torch.zeros(2, 6, 9, dtype=torch.bool)
    masks[0, 2:4, 3:8] = True
    masks[1, 5, 0] = True
    assert boxes_of(masks).tolist() == [[3, 2, 8, 4], [0, 5, 1, 6]]
    assert boxes_of(masks[:0]).shape == (0, 4)


def test_thresholds_choose() -> None:
    image = _picture()
    for change in (
        {"pred_iou_thresh": 0.91},  # leaves the unstable and the empty ones
        {"min_area": 0.2},
    ):
        assert len(run_stage(generate(Tiles(), image, replace(_CONFIG, **change)))) == 0  # type: ignore[arg-type]
    loose = replace(_CONFIG, stability_score_thresh=0.0)
    masks = run_stage(generate(Tiles(), image, loose))
    assert masks.scores.tolist() == pytest.approx([0.95] * 12)  # the vague one is the better now
    all_of_them = run_stage(generate(Tiles(), image, replace(_CONFIG, box_nms_thresh=1.0)))
    assert len(all_of_them) == 64


def test_crops_find_no_cut_masks_and_no_duplicates() -> None:
    image, model = _picture(), Tiles()
    config = replace(_CONFIG, crop_layers=1, pred_iou_thresh=0.5)
    masks = run_stage(generate(model, image, config))
    assert model.looks == 5
    assert sorted(_tiles_found(masks, image)) == list(range(1, 13))
    # Tiles that lie whole in a crop are taken from there, though less sure: they are sharper.
    assert sorted(set(masks.scores.tolist())) == pytest.approx([0.85, 0.9])


def test_small_things_come_from_crops() -> None:
    image = _picture()
    image[46:54, 60:68] = 200  # between the points of a coarse grid, on one of a crop's
    config = replace(_CONFIG, points_per_side=4, crop_point_divisor=1, min_area=0.0)
    assert 200 not in _tiles_found_any(run_stage(generate(Tiles(), image, config)), image)
    deep = replace(config, crop_layers=1)
    assert 200 in _tiles_found_any(run_stage(generate(Tiles(), image, deep)), image)


def _tiles_found_any(masks: ScoredMasks, image: UInt8Array) -> set[int]:
    return {int(np.median(image[..., 0][masks.mask(i)])) for i in range(len(masks))}


def test_a_cancel_stops_between_batches() -> None:
    model = Tiles()
    stage = generate(model, _picture(), _CONFIG)
    for _ in range(4):
        next(stage)
    stage.close()
    assert len(model.batches) == 2


@pytest.mark.parametrize("size", [(480, 640), (640, 480), (100, 1000), (37, 41)])
def test_crops_cover_the_picture(size: tuple[int, int]) -> None:
    height, width = size
    for window in crop_windows(height, width, replace(_CONFIG, crop_layers=2)):
        assert 0 <= window.x0 < window.x1 <= width
        assert 0 <= window.y0 < window.y1 <= height
    for layer in (1, 2):
        seen = np.zeros(size, int)
        for window in crop_windows(height, width, replace(_CONFIG, crop_layers=2)):
            if window.layer == layer:
                seen[window.y0 : window.y1, window.x0 : window.x1] += 1
        assert seen.min() >= 1


def test_suppression_as_defined() -> None:
    rng = np.random.default_rng(0)
    corners = rng.uniform(0, 80, (60, 2))
    boxes = np.concatenate([corners, corners + rng.uniform(5, 40, (60, 2))], axis=1)
    scores = np.round(rng.random(60), 1)  # with ties

    def iou(a: int, b: int) -> float:
        lo, hi = np.maximum(boxes[a, :2], boxes[b, :2]), np.minimum(boxes[a, 2:], boxes[b, 2:])
        inter = float(np.prod(np.clip(hi - lo, 0, None)))
        areas = [float(np.prod(boxes[i, 2:] - boxes[i, :2])) for i in (a, b)]
        return inter / (sum(areas) - inter)

    kept: list[int] = []
    for i in sorted(range(60), key=lambda i: (-scores[i], i)):
        if all(iou(i, k) <= 0.5 for k in kept):
            kept.append(i)
    found = non_maximum_suppression(torch.from_numpy(boxes), torch.from_numpy(scores), 0.5)
    assert found.tolist() == kept
    nothing = non_maximum_suppression(torch.zeros(0, 4), torch.zeros(0), 0.5)
    assert nothing.tolist() == []


def test_settings_are_checked() -> None:
    for change in ({"points_per_side": 0}, {"crop_overlap": 1.0}, {"stability_score_offset": 0.0}):
        with pytest.raises(ValueError, match=next(iter(change))):
            GeneratorConfig(**change)
    on_cpu, on_gpu = (GeneratorConfig.of("sam2", on_gpu=on) for on in (False, True))
    assert (on_cpu.points_per_side, on_gpu.points_per_side) == (16, 32)
    paper = [
        ProviderSettings(profile="paper").generator_of(kind, on_gpu=on_gpu)
        for kind in ("sam", "sam2")
        for on_gpu in (True, False)
    ]
    assert {(c.points_per_side, c.pred_iou_thresh, c.stability_score_thresh) for c in paper} == {
        (64, 0.7, 0.95)
    }
    fewer = ProviderSettings(profile="paper", points_per_side=8)  # what is asked for by name wins
    assert fewer.generator_of("sam", on_gpu=True).points_per_side == 8
    assert GeneratorConfig.of("sam", on_gpu=True).pred_iou_thresh == 0.88
