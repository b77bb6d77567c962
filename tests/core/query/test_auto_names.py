"""Automatic names: sure ones are given, unsure ones are not, people's own are kept."""

from itertools import pairwise

import numpy as np
import pytest

from gaga_core.arrays import FloatArray
from gaga_core.query.auto_names import NOUNS, NameConfig, name_by_nouns, suggest_names
from gaga_core.query.index import GroupIndex, TextVectors

_DIM = 64


def _nouns(n: int, seed: int = 0) -> FloatArray:
    rows = np.random.default_rng(seed).normal(size=(n, _DIM))
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def _index(rows: FloatArray) -> GroupIndex:
    n = len(rows)
    length = np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)
    pictures = np.zeros((n, 64, 64, 3), np.uint8)
    groups = np.arange(1, n + 1, dtype=np.int32)
    return GroupIndex("m", groups, np.arange(n), (rows / length).astype(np.float32), pictures)


def test_clear_groups_are_named_and_torn_ones_are_not() -> None:
    nouns = ["mug", "plate", "lamp", "shoe", "rock", "tree"]
    v = _nouns(len(nouns))
    rows = np.stack([v[0], v[2], v[3] + v[4], np.zeros(_DIM, np.float32), v[5]])
    found = suggest_names(_index(rows.astype(np.float32)), nouns, v)
    assert found == {1: "mug", 2: "lamp", 5: "tree"}  # 3 lies between two, 4 is in no view


def test_equal_objects_are_numbered_and_given_names_are_kept() -> None:
    nouns = ["mug", "plate"]
    v = _nouns(2)
    index = _index(np.stack([v[0], v[0], v[1], v[0]]))
    assert suggest_names(index, nouns, v) == {1: "mug", 2: "mug 2", 3: "plate", 4: "mug 3"}
    taken = {1: "grandmother's cup", 9: "Mug"}
    assert suggest_names(index, nouns, v, taken=taken) == {2: "mug 2", 3: "plate", 4: "mug 3"}


def test_a_noun_that_is_near_to_everything_names_nothing_by_that() -> None:
    nouns = ["photo", *(f"noun {k}" for k in range(1, 11))]
    v = _nouns(11)
    # Every crop looks like a "photo" first, and a little less like what it is.
    rows = np.stack([v[0] * 1.02 + v[k] for k in range(1, 11)]).astype(np.float32)
    own = NameConfig(own=1.0, least=0.2, margin=1.2)
    assert suggest_names(_index(rows), nouns, v, config=own) == {
        k: f"noun {k}" for k in range(1, 11)
    }
    plain = NameConfig(own=0.0, least=0.2, margin=1.2)
    found = suggest_names(_index(rows), nouns, v, config=plain)
    assert sum(name.startswith("photo") for name in found.values()) > 5


def test_our_list_is_clean_and_its_vectors_are_made_once() -> None:
    assert len(NOUNS) > 280
    assert len({n.casefold() for n in NOUNS}) == len(NOUNS)
    assert all(n == n.strip() and "  " not in n and n for n in NOUNS)

    class Words:
        fingerprint = "w"
        n_texts = 0

        def pictures(self, pictures: object) -> FloatArray:
            raise AssertionError("names need no pictures")

        def texts(self, texts: object) -> FloatArray:
            assert isinstance(texts, list)
            self.n_texts += len(texts)
            return _nouns(len(texts))

    words = Words()
    texts = TextVectors("w", lambda: words)
    index = _index(_nouns(len(NOUNS))[[5, 9]])
    named = name_by_nouns(index, texts)
    assert list(named.values()) == [NOUNS[5], NOUNS[9]]
    assert name_by_nouns(index, texts) == named
    assert words.n_texts == len(NOUNS)


def test_stricter_margins_take_names_away_alone() -> None:
    rng = np.random.default_rng(3)
    nouns, v = [f"noun {k}" for k in range(40)], _nouns(40)
    rows = v[rng.integers(0, 40, 60)] + 0.4 * rng.normal(size=(60, _DIM))
    margins = ((0.05, 1.0), (0.2, 1.0), (0.2, 2.0), (0.6, 2.0), (0.9, 10.0))
    named = [
        set(suggest_names(_index(rows.astype("f4")), nouns, v, config=NameConfig(30, *both)))
        for both in margins
    ]
    assert all(after <= before for before, after in pairwise(named))
    assert len(named[0]) > len(named[-1])
    with pytest.raises(ValueError, match="names"):
        NameConfig(least=1.5)
