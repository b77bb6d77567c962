"""Which groups are background, and that their words say so."""

import numpy as np

from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.pipeline.describe import describe
from gaga_core.query.group_facts import group_facts
from tests.core.query.made_scenes import BACK, FRONT, TABLE, boxes_scene

VIEWS = (FRONT, BACK)
_BLOCK = 2  # of TABLE: the large blue box, which by itself is a thing


def test_what_the_association_found_to_surround_the_scene_is_called_background() -> None:
    scene = boxes_scene(TABLE)
    alone = describe(scene, group_facts(scene, VIEWS), VIEWS)
    assert _BLOCK not in alone.background
    assert "box" in alone.words[_BLOCK] or "thing" in alone.words[_BLOCK]
    levels = Levels(scene.labels[None], 0, background=_BLOCK)
    scene.bank = MemoryBank(scene.labels, int(scene.labels.max()), preset="robust", levels=levels)
    found = describe(scene, group_facts(scene, VIEWS), VIEWS)
    assert _BLOCK in found.background
    assert found.words[_BLOCK] == "blue background"
    things = set(np.unique(scene.labels).tolist()) - found.background
    assert all("background" not in found.words[group] for group in things)
