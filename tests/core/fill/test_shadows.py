"""Shadows are taken off also where nothing is filled: large splats cover the object's place."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.color import dc_from_rgb, rgb_from_dc
from gaga_core.fill.fill import Filling, fill_stage, filled_edit
from gaga_core.fill.surfaces import FillConfig
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene.bake import bake
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.values import joined
from gaga_core.scene.scene import Scene
from tests.core.fill.tables import BOX, HALF, STEP, TABLE, Table, table_with_box

CPU = choose("cpu")
_WIDTH = 0.09  # half of the pillar
_SHADOW = 0.5  # its length on the table
_DEPTH = 0.5


def pillar(*, depth: float) -> tuple[Scene, Table, BoolArray]:
    """A pillar on a table of large splats, and the splats (N,) in its shadow along x."""
    table = table_with_box()
    box = table.gaussians.take(np.flatnonzero(table.labels == BOX))
    box = replace(box, means=box.means * np.array([_WIDTH / HALF] * 2 + [1], np.float32))
    bare = table.empty.take(np.flatnonzero(np.abs(table.empty.means[:, :2]).max(axis=1) > _WIDTH))
    wide = np.array([np.log(1.9)] * 2 + [0], np.float32)
    x, y = bare.means[:, 0], bare.means[:, 1]
    dark = (x > 0) & (x < _SHADOW) & (np.abs(y) < _WIDTH + STEP / 2)
    rgb = rgb_from_dc(bare.sh[:, 0]) * np.where(dark, 1 - depth, 1.0)[:, None]
    sh = bare.sh.copy()
    sh[:, 0] = dc_from_rgb(rgb.astype(np.float32))
    whole = joined(replace(bare, log_scales=bare.log_scales + wide, sh=sh), box)
    labels = np.repeat(np.array([TABLE, BOX], np.int32), [len(bare), len(box)])
    return Scene.of(whole, labels), table, np.append(dark, np.zeros(len(box), np.bool_))


def filling(scene: Scene, table: Table, *, lighten: bool = True) -> Filling:
    config = FillConfig(lighten=lighten)
    return run_stage(fill_stage(scene, scene.labels == BOX, table.cameras, CPU, config))


def test_the_shadow_of_what_left_no_hole_is_taken_off() -> None:
    scene, table, dark = pillar(depth=_DEPTH)
    found = filling(scene, table)
    assert len(found.splats) == 0
    assert found
    gains = np.ones(len(scene))
    gains[found.stained] = found.gains.mean(axis=1)
    # Large splats in the light lie over its edge: they stay as they are.
    assert 1.4 < np.median(gains[dark]) < 1.1 / (1 - _DEPTH)
    far = (scene.labels == TABLE) & ~dark
    far &= np.abs(scene.gaussians.means[:, 1]) > _WIDTH + 4 * STEP
    assert gains[far].max() < 1.05
    assert len(filling(scene, table, lighten=False).stained) == 0
    before = bake(scene)
    assert History(scene).do(filled_edit(scene, found, "Delete and fill"))
    after = bake(scene)
    at = np.flatnonzero(dark)
    assert rgb_from_dc(after.sh[at, 0]).mean() > 1.4 * rgb_from_dc(before.sh[at, 0]).mean()


def test_without_a_shadow_nothing_is_lightened_and_it_says_what_was_refused() -> None:
    scene, table, _ = pillar(depth=0.0)
    found = filling(scene, table)
    assert len(found.splats) == 0
    assert len(found.stained) == 0
    assert found.is_refused


@pytest.mark.parametrize(("darker", "is_filled"), [(0.1, False), (0.3, True)])
def test_a_hole_that_shows_nearly_the_right_color_is_left_as_it_is(
    darker: float, is_filled: bool
) -> None:
    """What lies under the table shows in the hole."""
    table = table_with_box()
    under = table.empty
    rgb = rgb_from_dc(under.sh[:, 0]) - darker
    under = replace(
        under,
        means=under.means - np.array([0, 0, 0.08], np.float32),
        sh=dc_from_rgb(rgb.astype(np.float32))[:, None],
    )
    labels = np.append(table.labels, np.full(len(under), 3, np.int32))
    found = filling(Scene.of(joined(table.gaussians, under), labels), table)
    assert (len(found.splats) > 50) == is_filled
    assert found.is_refused != is_filled
