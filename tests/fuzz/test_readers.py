"""A short attack on every reader; ``make fuzz`` is the long one."""

import random
from pathlib import Path

import pytest

from tests.fuzz.attack import attack
from tests.fuzz.mutate import mutated

KINDS = (
    ("splats.ply", "splats.spz", "masks coco.json"),
    ("project", "script", "scene folder"),
)


@pytest.mark.parametrize("targets", KINDS, ids=lambda names: names[0])
def test_damaged_files_give_a_result_or_one_sentence(
    tmp_path: Path, targets: tuple[str, ...]
) -> None:
    result = attack(tmp_path, 0.0, [7], targets)
    assert result.findings == []
    assert result.n_cases == 50 * len(targets)


def test_a_seed_gives_the_same_damage_again() -> None:
    good = b'{"a": [1, 2, {"b": "text"}]}'
    made = [mutated(good, random.Random(seed)) for seed in range(300)]
    assert made == [mutated(good, random.Random(seed)) for seed in range(300)]
    assert len(set(made)) > 200
