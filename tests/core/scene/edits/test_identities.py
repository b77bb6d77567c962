"""Labels by votes or by identities: what a choice keeps, and what it gives back."""

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import LabelSource, Scene
from tests.core.scene.edits.edit_walk import walk_scene


def lifted(*, used: bool) -> tuple[Scene, History]:
    """A scene of 400 splats whose identities put every second one into group 6."""
    scene = walk_scene()
    history = History(scene)
    labels = np.where(np.arange(400) % 2, 6, scene.labels).astype(np.int32)
    sure = np.linspace(0, 1, 400).astype(np.float32)
    colors = np.tile(np.arange(400, dtype=np.uint8)[:, None], (1, 3))
    history.do(edits.set_identities(scene, labels, sure, colors, used=used))
    return scene, history


@pytest.mark.parametrize("used", [True, False])
def test_each_source_keeps_its_corrections(used: bool) -> None:
    scene, history = lifted(used=used)
    sources: tuple[LabelSource, LabelSource] = ("votes", "identities")
    first, second = reversed(sources) if used else sources
    assert scene.identities.source == first
    history.do(edits.set_labels(scene, np.arange(3), 5))
    corrected, sure = scene.labels, scene.confidence
    history.do(edits.use_labels(scene, second))
    assert scene.identities.source == second
    assert not np.array_equal(scene.labels, corrected)
    assert (scene.labels[1::2] == 6).all() == (second == "identities")
    history.do(edits.use_labels(scene, first))
    assert np.array_equal(scene.labels, corrected)
    assert (scene.confidence is None) == (sure is None)
    assert edits.use_labels(scene, first) is None


def test_duplicates_stay_in_their_groups() -> None:
    scene, history = lifted(used=False)
    history.do(edits.duplicate(scene, np.flatnonzero(scene.labels == 2)))
    copies = scene.labels[400:]
    history.do(edits.use_labels(scene, "identities"))
    assert np.array_equal(scene.labels[400:], copies)
    colors = scene.identity_colors_of()
    assert colors is not None
    assert np.array_equal(colors[400:], colors[scene.source[400:]])


def test_another_association_has_no_identities_yet() -> None:
    scene, history = lifted(used=True)
    history.do(edits.set_grouping(scene, np.ones(400, np.int32), None))
    assert (scene.identities.source, scene.identities.other) == ("votes", None)
    with pytest.raises(GagaError, match="Lift the groups first"):
        edits.use_labels(scene, "identities")
    history.undo()
    assert scene.identities.other is not None


def test_a_second_lift_does_not_touch_the_votes() -> None:
    scene, history = lifted(used=True)
    votes = walk_scene().labels
    labels = np.full(400, 3, np.int32)
    sure, colors = np.ones(400, np.float32), np.zeros((400, 3), np.uint8)
    history.do(edits.set_identities(scene, labels, sure, colors, used=False))
    assert np.array_equal(scene.labels, votes)
    history.do(edits.use_labels(scene, "identities"))
    assert (scene.labels == 3).all()


def test_new_groups_do_not_take_ids_that_come_back_with_the_other_labels() -> None:
    scene = walk_scene()
    history = History(scene)
    labels = np.full(400, edits.free_group(scene), np.int32)  # a group without a vote
    sure, colors = np.ones(400, np.float32), np.zeros((400, 3), np.uint8)
    history.do(edits.set_identities(scene, labels, sure, colors, used=False))
    history.do(edits.duplicate(scene, np.flatnonzero(scene.labels == 2)))
    history.do(edits.use_labels(scene, "identities"))
    assert not np.isin(scene.labels[400:], scene.labels[:400]).any()
