"""The best cut of a tree against all cuts there are; levels that refine one another."""

import itertools
from collections.abc import Iterator

import numpy as np
import pytest

from gaga_core.arrays import LongArray
from gaga_core.grouping.surfaces.borders import FEATURES, Borders, SignedGraph, linked
from gaga_core.grouping.surfaces.objects import CHOSEN, OBJECT, PRICES, Tree, best_cut, cuts

_NONE = np.zeros(0, np.int64)
_NO_BORDERS = Borders(np.zeros(0), _NONE, _NONE, np.zeros(0), np.zeros((0, len(FEATURES))))


def _tree_of(leaf: LongArray, parent: LongArray) -> Tree:
    """Without evidence: a cut depends on what nodes are worth alone."""
    pieces = SignedGraph(np.zeros(0), _NONE, _NONE, np.zeros(0), np.zeros(0))
    n = np.zeros(len(parent))
    return Tree(pieces, leaf, np.arange(len(leaf)), parent, n, n, _NO_BORDERS, np.zeros(0))


def _tree(rng: np.random.Generator, n_leaves: int) -> Tree:
    """Leaves that join in any order, some never."""
    parent, free = [-1] * n_leaves, list(range(n_leaves))
    while len(free) > 1 and rng.random() < 0.95:
        a, b = (free.pop(int(rng.integers(len(free)))) for _ in range(2))
        parent[a] = parent[b] = len(parent)
        free.append(len(parent))
        parent.append(-1)
    leaf = np.repeat(np.arange(n_leaves), 3)
    return _tree_of(leaf, np.array(parent))


def _all_cuts(tree: Tree, node: int) -> Iterator[list[int]]:
    yield [node]
    if node >= tree.n_leaves:
        one, other = tree.children()[node].tolist()
        for left in _all_cuts(tree, one):
            for right in _all_cuts(tree, other):
                yield left + right


@pytest.mark.parametrize("seed", range(20))
def test_no_cut_is_better_than_the_best_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = _tree(rng, 7)
    worth = rng.normal(size=len(tree.parent))
    cut = best_cut(tree, worth)
    assert (tree.leaves()[cut].sum(axis=0) == 1).all()  # each leaf once
    roots = np.flatnonzero(tree.parent < 0).tolist()
    best = sum(max(float(worth[c].sum()) for c in _all_cuts(tree, root)) for root in roots)
    assert worth[cut].sum() == pytest.approx(best)


@pytest.mark.parametrize("seed", range(20))
def test_levels_refine_one_another_and_the_background_is_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = _tree(rng, 40)
    objectness = rng.random(len(tree.parent))
    rest = rng.random(len(objectness)) < 0.1
    levels, behind, sure = cuts(tree, objectness, rest)
    assert len(levels) == len(PRICES) + 1
    for coarse, fine in itertools.pairwise(levels):
        for cluster in np.unique(fine):
            assert len(np.unique(coarse[fine == cluster])) == 1
    for level in levels[: CHOSEN + 1]:
        assert len(np.unique(level[behind])) <= 1
        assert not np.isin(level[~behind], level[behind]).any()
    chosen = levels[CHOSEN]
    assert (sure[~behind] >= OBJECT).all()
    assert (sure[~behind] == objectness[chosen[~behind]]).all()
    assert not rest[chosen[~behind]].any()
    whole, none, _ = cuts(tree, objectness, np.zeros_like(rest), -np.inf)
    assert not none.any()
    assert [len(np.unique(level)) for level in whole] == sorted(len(np.unique(x)) for x in whole)


def test_a_whole_that_is_better_than_its_parts_together_is_taken() -> None:
    """A plate of one piece and a plane of two, in one tree: no threshold parts them like this."""
    parent = np.array([4, 4, 5, 5, 6, 6, -1])
    tree = _tree_of(np.arange(4), parent)

    def cut(*worth: float) -> list[int]:
        return [int(node) for node in best_cut(tree, np.array(worth))]

    assert cut(0.1, 0.2, 0.8, 0.7, 0.9, 0.6, 0.3) == [2, 3, 4]
    assert cut(0.1, 0.2, 0.1, 0.2, 0.4, 0.4, 0.9) == [6]


def test_joins_are_told_in_their_order_with_their_borders() -> None:
    graph = SignedGraph(
        np.ones(3), np.array([0, 1]), np.array([1, 2]), np.array([2.0, 5.0]), np.array([3.0, 1.0])
    )
    joins = linked(graph, -np.inf)
    assert [(value, length) for _, _, value, length in joins] == [(3.0, 2.0), (1.0, 5.0)]
    assert {joins[0][0], joins[0][1]} == {0, 1}
