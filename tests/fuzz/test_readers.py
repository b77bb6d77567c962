"""A short attack on every reader; ``make fuzz`` is the long one."""

import random
from pathlib import Path

from tests.fuzz.attack import BATCH, attack
from tests.fuzz.mutate import mutated

_READERS = (
    "splats.ply",
    "splats.spz",
    "splats.sog",
    "masks coco.json",
    "project",
    "script",
    "settings",
    "scene folder",
)


def test_damaged_files_give_a_result_or_one_sentence(tmp_path: Path) -> None:
    result = attack(tmp_path, 0.0, [7], _READERS)
    assert result.findings == []
    assert result.n_cases == BATCH * (len(_READERS) - 1) + BATCH // 10


def test_a_seed_gives_the_same_damage_again() -> None:
    good = b'{"a": [1, 2, {"b": "text"}]}'
    made = [mutated(good, random.Random(seed)) for seed in range(300)]
    assert made == [mutated(good, random.Random(seed)) for seed in range(300)]
    assert len(set(made)) > 200
