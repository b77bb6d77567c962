"""Two models of one mapping: parts of one scene, or scenes of their own."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.placing.ladder import scenes_of
from gaga_core.placing.metrics import SfmFacts
from tests.core.conftest import PlacedRoom


@pytest.fixture
def two(placed_room: PlacedRoom) -> tuple[SfmFacts, SfmFacts]:
    """The room, and the same under other names as if it were another model; and two lost photos.

    lost0 has matches with the second model, lost1 with none.
    """
    first = placed_room.facts
    n = len(first.names)
    others = tuple(f"other{name}" for name in first.names)
    names = (*first.names, *others, "lost0.jpg", "lost1.jpg")
    pairs = np.concatenate([first.pairs, first.pairs + n, [[n, 2 * n]]])
    counts = np.concatenate([first.pair_matches, first.pair_matches, [20]])
    known = replace(first, all_names=names, pairs=pairs, pair_matches=counts)
    return known, replace(known, names=others)


def test_models_without_common_matches_are_scenes(two: tuple[SfmFacts, SfmFacts]) -> None:
    first, second = scenes_of(two)
    assert first.names == two[0].names
    assert first.all_names == (*two[0].names, "lost1.jpg")
    assert second.all_names == (*two[1].names, "lost0.jpg")
    for facts in (first, second):
        assert facts.pairs.max() < len(facts.all_names)
        assert len(facts.pairs) == len(facts.pair_matches)
    assert len(second.pairs) == len(first.pairs) + 1


def test_models_that_share_matches_are_parts_of_one_scene(
    two: tuple[SfmFacts, SfmFacts],
) -> None:
    n = len(two[0].names)
    bridge = np.array([[i, n + i] for i in range(n)])
    linked = [
        replace(
            model,
            pairs=np.concatenate([model.pairs, bridge]),
            pair_matches=np.concatenate([model.pair_matches, np.full(n, 60)]),
        )
        for model in two
    ]
    assert [facts.names for facts in scenes_of(linked)] == [two[0].names]
    assert scenes_of(two[:1]) == (two[0],)
