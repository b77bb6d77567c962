"""The replay of a saved bank ends where the bank ended, and never takes anything back."""

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.grouping.bank_file import bank_arrays, bank_of
from gaga_core.grouping.figures import BankGrowth, growth_stage
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.grouping.views import GatedViews
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.core.grouping.true_masks import masks_of
from tests.scenes import Synthetic, objects_scene


def _associated(preset: str) -> tuple[Synthetic, MaskSet, AssociateConfig, MemoryBank, np.ndarray]:
    scene = objects_scene(4, 120, n_cameras=5)
    masks, config = masks_of(scene, scene.cameras), AssociateConfig.of(preset)
    found = run_stage(
        associate_stage(scene.gaussians, scene.cameras, masks, CpuRasterizer(), config)
    )
    return scene, masks, config, bank_of(bank_arrays(found.bank)), found.labels


def _replayed(
    scene: Synthetic, masks: MaskSet, config: AssociateConfig, bank: MemoryBank, labels: np.ndarray
) -> BankGrowth:
    gated = GatedViews(scene.gaussians, scene.cameras, masks, config.gate, config.depth)
    return run_stage(growth_stage(gated, bank, labels, CpuRasterizer()))


@pytest.mark.parametrize("preset", ["paper", "robust"])
def test_at_the_last_step_the_labels_are_the_saved_ones(preset: str) -> None:
    scene, masks, config, bank, labels = _associated(preset)
    growth = _replayed(scene, masks, config, bank, labels)
    assert growth.views == tuple(dict.fromkeys(d.view for d in bank.log))
    assert np.array_equal(growth.labels_at(growth.last_step), labels)
    assert (growth.labels_at(0) == 0).all()
    former = growth.labels_at(0)
    for step in range(1, growth.last_step):
        now = growth.labels_at(step)
        assert np.array_equal(now[former > 0], former[former > 0])  # ownership is exclusive
        known = {d.group for d in bank.log[: growth.n_decisions[step]] if d.group}
        assert set(np.unique(now[now > 0])) <= known
        assert growth.n_groups[step] == len(known) >= growth.n_groups[step - 1]
        former = now
    assert growth.n_decisions[-1] == len(bank.log)
    if preset == "paper":  # what the paper's bank owned after all views, Gaussian by Gaussian
        assert np.array_equal(former, np.maximum(bank.group, 0))
    for step in (-1, growth.last_step + 1):
        with pytest.raises(ValueError, match="step"):
            growth.labels_at(step)


def test_a_view_without_masks_is_named() -> None:
    scene, masks, config, bank, labels = _associated("paper")
    views = scene.cameras[1:]
    gated = GatedViews(scene.gaussians, views, masks, config.gate, config.depth)
    with pytest.raises(GagaError, match=scene.cameras[0].name):
        run_stage(growth_stage(gated, bank, labels, CpuRasterizer()))
