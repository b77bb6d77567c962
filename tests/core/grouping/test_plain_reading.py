"""Preset paper gives what a plain reading of section 3.2 gives."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.io.cameras.colmap import read_colmap
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.splats.ply import read_ply
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.core.grouping import plain_reading
from tests.core.grouping.true_masks import permuted, true_map
from tests.scenes import objects_scene


def _assert_equal(
    gaussians: Gaussians,
    views: Sequence[Camera],  # by name
    maps: Mapping[str, IntArray],
) -> plain_reading.Reading:
    rasterizer = CpuRasterizer()
    masks = MaskSet({name: partial(maps.__getitem__, name) for name in maps}, "test masks")
    config = AssociateConfig.of("paper")
    shuffled = [views[i] for i in np.random.default_rng(0).permutation(len(views))]
    found = run_stage(associate_stage(gaussians, shuffled, masks, rasterizer, config))
    read = plain_reading.read(gaussians, views, maps, rasterizer)
    log = {(d.view, d.mask): d for d in found.bank.log}
    assert {key: d.group for key, d in log.items()} == read.of_mask
    assert {key: d.overlap for key, d in log.items()} == pytest.approx(read.overlap)
    assert np.array_equal(np.maximum(found.bank.group, 0), read.owner)
    voted = plain_reading.votes(gaussians, views, maps, read, rasterizer)
    # Weights are summed in another order: a tie may go the other way.
    assert (found.labels != voted).mean() < 1e-4
    return read


def _faulty(labels: IntArray, seed: int) -> IntArray:
    """Masks as of a segmenter: one divided, two joined, one left out, a lone pixel, mixed ids."""
    rng = np.random.default_rng(seed)
    result = labels.copy()
    divided, joined, other, gone = rng.permutation(np.unique(labels[labels > 0]))[:4]
    rows, columns = np.nonzero(labels == divided)
    half = columns > np.median(columns)
    result[rows[half], columns[half]] = labels.max() + 1
    result[labels == other] = joined
    result[labels == gone] = 0
    result[0, 0] = labels.max() + 2  # nothing lies behind it
    return permuted(result, seed, top=40)


@pytest.mark.parametrize("seed", [0, 1, 4, 6])
def test_preset_paper_is_its_plain_reading(seed: int) -> None:
    scene = objects_scene(6, 150, seed=seed, n_cameras=11)
    views = [replace(camera, name=f"rgb_{i}.png") for i, camera in enumerate(scene.cameras)]
    maps = {c.name: _faulty(true_map(scene, c), 100 * seed + i) for i, c in enumerate(views)}
    read = _assert_equal(scene.gaussians, views, maps)
    n_first = len({mask for view, mask in read.of_mask if view == views[0].name})
    assert len(read.groups) >= n_first - 1 > 3  # behind the lone pixel lies nothing


def test_preset_paper_is_its_plain_reading_on_a_real_table(ycb_table: Path) -> None:
    views = read_colmap(ycb_table / "sparse" / "0").cameras[::20]
    files = {camera.name: ycb_table / "masks" / "sim" / camera.name for camera in views}
    maps = {name: read_labels(path.with_suffix(".png")) for name, path in files.items()}
    read = _assert_equal(read_ply(ycb_table / "point_cloud.ply"), views, maps)
    assert len(read.groups) > 10
