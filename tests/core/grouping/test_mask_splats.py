"""What the depth gate lets through of a mask, and the shares of groups."""

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.grouping.figures import mask_splats, shares_of_groups, shares_of_pixels
from gaga_core.grouping.gate import ViewMasks
from gaga_core.grouping.views import GatedViews, load_labels
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.core.grouping.true_masks import masks_of
from tests.scenes import objects_scene


@pytest.mark.parametrize("preset", ["paper", "robust"])
def test_the_gate_takes_a_part_of_what_lies_behind_a_mask(preset: str) -> None:
    scene = objects_scene(4, 150, n_cameras=4)
    masks = masks_of(scene, scene.cameras)
    config = AssociateConfig.of(preset)
    gated = GatedViews(scene.gaussians, scene.cameras, masks, config.gate, config.depth)
    taken = np.zeros(len(scene.gaussians), int)
    n_behind = n_gated = 0
    for camera in scene.cameras:
        gated.render(camera, CpuRasterizer())
        labels, _ = load_labels(masks, camera)
        pixels, depth = camera.project(scene.gaussians.means.astype(np.float64))
        column, row = np.floor(pixels).astype(int).T
        inside = (depth > 0.01) & (column >= 0) & (column < camera.width)
        inside &= (row >= 0) & (row < camera.height)
        for mask in np.unique(labels[labels > 0]):
            found = mask_splats(gated, camera, int(mask))
            assert not (found.gated & ~found.behind).any()
            assert found.of(True) is found.gated
            assert found.of(False) is found.behind
            rows = np.flatnonzero(inside)
            expected = rows[labels[row[rows], column[rows]] == mask]
            assert np.array_equal(np.flatnonzero(found.behind), expected)
            n_behind += int(found.behind.sum())
            n_gated += int(found.gated.sum())
            taken[found.gated] += camera is scene.cameras[0]
        with pytest.raises(GagaError, match="has mask 999"):
            mask_splats(gated, camera, 999)
        with pytest.raises(GagaError, match="has mask 0"):
            mask_splats(gated, camera, 0)
    assert taken.max() == 1  # masks of one view share no Gaussian
    assert 0 < n_gated < n_behind


def test_shares_are_those_of_the_chosen_and_add_up_to_one() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        labels = rng.integers(0, 6, 200).astype(np.int32)
        chosen = rng.random(200) < rng.random()
        shares = shares_of_groups(labels, chosen)
        assert list(shares.values()) == sorted(shares.values(), reverse=True)
        for group in range(6):
            held = (labels[chosen] == group).sum()
            assert shares.get(group, 0.0) == pytest.approx(held / max(chosen.sum(), 1))
        if chosen.any():
            assert sum(shares.values()) == pytest.approx(1)
    assert shares_of_groups(labels, np.zeros(200, bool)) == {}


def test_shares_of_pixels_are_counted_for_every_mask_of_a_view() -> None:
    rng = np.random.default_rng(3)
    ids = np.array([0, 2, 7, 900], np.int32)
    labels = ids[rng.integers(0, 4, (20, 30))]
    seen = rng.choice(np.array([0, 4, 5, 60], np.int32), (20, 30), p=[0.1, 0.2, 0.3, 0.4])
    found = shares_of_pixels(ViewMasks.of(labels), seen)
    assert list(found) == [2, 7, 900]
    for mask, shares in found.items():
        inside = seen[labels == mask]
        assert shares == {g: (inside == g).mean() for g in np.unique(inside).tolist()}
        assert list(shares.values()) == sorted(shares.values(), reverse=True)
