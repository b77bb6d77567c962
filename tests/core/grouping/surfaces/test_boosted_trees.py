"""Ensembles of trees against a plain reading; what is stored is what is read."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.grouping.surfaces import boosted_trees
from gaga_core.grouping.surfaces.boosted_trees import FILE, BoostedTrees, Learned, learned
from gaga_core.io.files import assets


def _random(seed: int, n_features: int = 5) -> BoostedTrees:
    rng = np.random.default_rng(seed)
    roots, rows = list[int](), list[list[float]]()

    def grow(depth: int) -> None:
        place = len(rows)
        rows.append([0, 0, 0, float(np.float32(rng.normal()))])
        if depth and rng.random() < 0.8:
            rows[place][:2] = int(rng.integers(n_features)), float(np.float32(rng.normal()))
            grow(depth - 1)
            rows[place][2] = len(rows)
            grow(depth - 1)

    for _ in range(4):
        roots.append(len(rows))
        grow(4)
    feature, threshold, right, value = np.array(rows).T
    whole = (np.array(a).astype(np.int32) for a in (roots, feature, right))
    of_roots, of_feature, of_right = whole
    return BoostedTrees(of_roots, of_feature, threshold, of_right, value, np.array([0.25]))


def _plain(trees: BoostedTrees, row: DoubleArray) -> float:
    total = float(trees.base[0])
    for root in trees.roots.tolist():
        node = root
        while trees.right[node]:
            goes_on = row[trees.feature[node]] <= trees.threshold[node]
            node = node + 1 if goes_on else int(trees.right[node])
        total += float(trees.value[node])
    return total


@pytest.mark.parametrize("seed", range(5))
def test_sums_are_those_of_a_plain_walk_and_survive_being_stored(seed: int) -> None:
    trees, rows = _random(seed), np.random.default_rng(seed + 100).normal(size=(50, 5))
    wanted = [_plain(trees, row) for row in rows]
    np.testing.assert_allclose(trees(rows), wanted, rtol=1e-12)
    stored = {key: value.astype(np.float64) if value.dtype.kind == "f" else value
              for key, value in trees.arrays("x").items()}  # fmt: skip
    np.testing.assert_array_equal(BoostedTrees.of(stored, "x")(rows), trees(rows))


def test_too_few_features_are_a_wrong_call() -> None:
    with pytest.raises(ValueError, match="features"):
        _random(0)(np.zeros((3, 1)))


def test_the_file_of_the_program_is_small_and_each_damage_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = assets() / FILE
    assert path.stat().st_size < 500_000
    with np.load(path, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    monkeypatch.setattr(boosted_trees, "assets", lambda: tmp_path)
    loops = np.arange(len(arrays["pieces_right"]), dtype=np.int32)  # each node to itself
    for name, broken in (
        ("pieces_right", np.maximum(loops, 1)),
        ("objects_value", np.full_like(arrays["objects_value"], np.nan)),
        ("borders_roots", arrays["borders_roots"] + 1_000_000),
    ):
        np.savez(tmp_path / FILE, **{**arrays, name: broken})
        learned.cache_clear()
        with pytest.raises(GagaError, match="damaged"):
            learned()
    learned.cache_clear()
    np.savez(tmp_path / FILE, **arrays)
    assert isinstance(learned(), Learned)
    learned.cache_clear()
