"""Cached rows of the blending matrix: which pixels, how many, in which batches."""

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.rows import RowConfig, ViewRows, mixed_batches, sample_rows, view_batches
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.identity.noisy import ROWS, G
from tests.scenes import Synthetic


def _rows(scene: Synthetic, label_map: LabelMap, config: RowConfig) -> list[ViewRows]:
    return run_stage(sample_rows(scene.gaussians, scene.cameras, label_map, choose(), config))


def test_rows_are_labelled_pixels_spread_over_the_view(
    scene: Synthetic, label_map: LabelMap, maps: dict[str, IntArray]
) -> None:
    for view in _rows(scene, label_map, RowConfig(per_view=1000)):
        truth = maps[view.view]
        assert len(view.labels) == 1000
        assert (view.labels > 0).all()
        share = np.bincount(truth[truth > 0], minlength=G + 1) / (truth > 0).sum()
        got = np.bincount(view.labels, minlength=G + 1) / 1000
        assert np.abs(share - got).max() < 0.03


@pytest.mark.parametrize("void", [False, True])
def test_all_pixels_when_no_number_is_given(
    scene: Synthetic, label_map: LabelMap, maps: dict[str, IntArray], void: bool
) -> None:
    views = _rows(scene, label_map, RowConfig(per_view=0, w_min=0, train_void=void))
    wanted = [maps[v.view].size if void else int((maps[v.view] > 0).sum()) for v in views]
    assert [len(view.labels) for view in views] == wanted


def test_rows_keep_to_the_memory(scene: Synthetic, label_map: LabelMap) -> None:
    limit = 3_000_000
    views = _rows(scene, label_map, RowConfig(per_view=0, memory_bytes=limit))
    used = sum(16 * len(view.weights.indices) for view in views)
    assert 0.4 * limit < used < 1.1 * limit


def test_batches_hold_every_row_once(scene: Synthetic, label_map: LabelMap) -> None:
    views = _rows(scene, label_map, RowConfig(per_view=333))
    whole = np.sort(np.concatenate([view.weights.weights for view in views]))
    mixed = mixed_batches(views, len(scene.gaussians))
    by_view = view_batches(views, len(scene.gaussians))
    for batches in (mixed, by_view):
        assert len(batches) == len(scene.cameras)
        got = np.concatenate([batch.rows.by_pixel.weights for batch in batches])
        assert np.array_equal(np.sort(got), whole)
    sizes = [len(batch.labels) for batch in mixed]
    assert max(sizes) - min(sizes) <= len(scene.cameras)


def test_nothing_labelled_is_told(scene: Synthetic) -> None:
    with pytest.raises(GagaError, match="No pixel"):
        _rows(scene, lambda c: np.zeros((c.height, c.width), np.int32), ROWS)
