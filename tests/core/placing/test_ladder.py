"""Attempts to place photos follow each other; what falls into parts may be several scenes."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.placing import ladder
from gaga_core.placing.ladder import Ladder, LadderConfig, Rung, place_stage, scenes_of
from gaga_core.placing.metrics import SfmFacts
from gaga_core.placing.photos import PhotoSet
from gaga_core.placing.sfm import SfmConfig
from gaga_core.progress import Progress, run_stage
from tests.core.conftest import ROOM_SFM, PlacedRoom


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


def test_attempts_follow_each_other_and_are_not_made_twice(
    placed_room: PlacedRoom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A share that cannot be reached asks for all of them; the first one was made before."""

    def cheap(photos: PhotoSet, config: SfmConfig, *, has_learned: bool) -> tuple[Rung, ...]:
        assert not has_learned
        return Rung("first attempt", config), Rung("again", config, reuses=True)

    monkeypatch.setattr(ladder, "rungs", cheap)
    work, told = tmp_path / "work", list[Progress]()
    shutil.copytree(placed_room.workspace, work)
    every = LadderConfig(enough=1.01)

    def place() -> Ladder:
        told.clear()
        return run_stage(place_stage(placed_room.photos, work, ROOM_SFM, ladder=every), told.append)

    found = place()
    assert [attempt["placed"] for attempt in found.attempts] == [8, 8]
    assert [attempt["reason"] for attempt in found.attempts] == ["", "8 of 8 photos are placed."]
    assert [a["title"] for a in found.attempts if a["chosen"]][-1] == found.best.title
    assert found.best.is_right
    assert found.best.facts.names == placed_room.facts.names
    stages = [step.stage for step in told]
    assert stages[0] == "Place photos"  # with weaker demands: features and matches are there
    assert "Find features" not in stages  # the second attempt goes on from those of the first
    again = place()
    assert [step.stage for step in told] == ["Try again"]
    assert again.best.title == found.best.title


def test_attempts_get_more_thorough(placed_room: PlacedRoom) -> None:
    first, *rest = ladder.rungs(placed_room.photos, ROOM_SFM)
    assert first.config == ROOM_SFM
    assert all(rung.config.affine and rung.config.doubled for rung in rest)
    assert rest[-1].config.least_contrast < ROOM_SFM.least_contrast
    film = ladder.rungs(replace(placed_room.photos, ordered=True), ROOM_SFM)
    assert len(film) == len(rest) + 2  # all pairs, with the features that are there
    assert film[1].reuses
