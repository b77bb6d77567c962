"""Flattening by its laws: most confident on top, small visible shares dropped, ids dense."""

import numpy as np
import pytest

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.segmentation import base as module
from gaga_core.segmentation.base import (
    FlattenConfig,
    ScoredMasks,
    flatten,
    flatten_levels,
    scored_masks,
)


def _random(seed: int, n: int = 24) -> tuple[BoolArray, FloatArray]:
    """Rectangles and ellipses of all sizes, with ties among the scores."""
    rng = np.random.default_rng(seed)
    h, w = int(rng.integers(20, 60)), int(rng.integers(20, 60))
    y, x = np.mgrid[:h, :w]
    masks = np.zeros((n, h, w), bool)
    for i in range(n):
        cy, cx = rng.uniform(0, h), rng.uniform(0, w)
        ry, rx = rng.uniform(1, h / 2, 2) if i % 2 else rng.uniform(1, 6, 2)
        masks[i] = np.maximum(abs(y - cy) / ry, abs(x - cx) / rx) <= 1
    return masks, np.round(rng.random(n), 1).astype(np.float32)


def _slow(masks: BoolArray, scores: FloatArray, config: FlattenConfig) -> IntArray:
    """The definition, pixel by pixel: who covers it, then who stays."""
    order = [i for i in range(len(masks)) if scores[i] >= config.min_score and masks[i].any()]
    order.sort(key=lambda i: (-scores[i], masks[i].sum(), i))
    top = np.full(masks.shape[1:], -1)
    for y, x in np.ndindex(*masks.shape[1:]):
        top[y, x] = next((rank for rank, i in enumerate(order) if masks[i, y, x]), -1)
    labels = np.zeros(masks.shape[1:], np.int32)
    n = 0
    for rank, i in enumerate(order):
        if (top == rank).sum() > config.min_visible * masks[i].sum():
            n += 1
            labels[top == rank] = n
    return labels


@pytest.mark.parametrize("seed", range(12))
def test_as_defined(seed: int) -> None:
    masks, scores = _random(seed)
    config = FlattenConfig(min_score=0.3 * (seed % 3), min_visible=0.1 * (seed % 4))
    labels = flatten(scored_masks(masks, scores, *masks.shape[1:]), config)
    assert labels.dtype == np.int32
    np.testing.assert_array_equal(labels, _slow(masks, scores, config))
    ids = np.unique(labels[labels > 0])
    np.testing.assert_array_equal(ids, np.arange(1, len(ids) + 1))


def test_without_masks_that_are_sure_the_map_is_zero() -> None:
    unsure = scored_masks([np.ones((4, 5), bool)], [0.49], 4, 5)
    for scored in (scored_masks([], [], 4, 5), unsure):
        assert flatten(scored).tolist() == np.zeros((4, 5), int).tolist()


def test_levels_show_the_outermost_and_the_innermost_mask() -> None:
    """Whole, part and subpart of one thing, and another thing next to it."""
    masks = np.zeros((4, 12, 12), bool)
    masks[0, :8] = True
    masks[1, 2:8] = True
    masks[2, 4:6, :6] = True
    masks[3, 9:] = True
    scored = scored_masks(masks, [0.6, 0.9, 0.7, 0.8], 12, 12)
    found = flatten_levels(scored, FlattenConfig(min_visible=0))
    assert found is not None
    wholes, parts = found
    assert len(np.unique(wholes[:8])) == 1
    assert len(np.unique(parts[:8])) == 3
    for region in (masks[2], masks[1] & ~masks[2], masks[0] & ~masks[1], masks[3]):
        assert len(np.unique(parts[region])) == 1
    assert not (wholes[8] | parts[8]).any()
    assert wholes[9:].min() > 0


def test_masks_side_by_side_have_no_levels() -> None:
    masks = np.eye(16, dtype=bool).reshape(16, 4, 4)
    assert (
        flatten_levels(scored_masks(masks, np.linspace(0.5, 1, 16, dtype=np.float32), 4, 4)) is None
    )


def test_more_masks_than_a_map_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_LABELS", 3)
    masks = np.eye(16, dtype=bool).reshape(16, 4, 4)
    with pytest.raises(GagaError, match="16 masks"):
        flatten(scored_masks(masks, np.ones(16, np.float32), 4, 4))


def test_masks_are_kept_by_their_boxes() -> None:
    masks, scores = _random(7)
    masks[4] = False
    scored = scored_masks(masks, scores, *masks.shape[1:])
    kept = [i for i in range(len(masks)) if masks[i].any()]
    assert len(scored) == len(kept) < len(masks)
    np.testing.assert_array_equal(scored.areas, masks[kept].sum(axis=(1, 2)))
    for k, i in enumerate(kept):
        np.testing.assert_array_equal(scored.mask(k), masks[i])
        crop = scored.crops[k]
        assert all(edge.any() for edge in (crop[0], crop[-1], crop[:, 0], crop[:, -1]))


def test_wrong_shapes_are_wrong_calls() -> None:
    with pytest.raises(ValueError, match="mask"):
        scored_masks([np.ones((3, 3), bool)], [1.0], 4, 4)
    with pytest.raises(ValueError, match="scores"):
        ScoredMasks(4, 4, np.zeros((0, 4), np.int32), (), np.zeros(1, np.float32))
    with pytest.raises(ValueError, match="min_visible"):
        FlattenConfig(min_visible=1.0)
