"""Causes of a failed placement, planted one by one in matches that are otherwise fine."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.placing.diagnosis import Diagnosis, MatchFacts, chain_breaks, diagnose, photo_cycles
from gaga_core.placing.photos import Photo, PhotoSet

_N = 12


def about_z(degrees: float) -> DoubleArray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


@pytest.fixture
def photos() -> PhotoSet:
    names = [f"{i:02d}.jpg" for i in range(_N)]
    return PhotoSet(tuple(Photo(name, name, 400, 300, sharpness=0.2) for name in names))


@pytest.fixture
def fine(photos: PhotoSet) -> MatchFacts:
    pairs = np.array([(i, j) for i in range(_N) for j in range(i + 1, _N)], np.int64)
    turns = [about_z(30.0 * i) for i in range(_N)]
    return MatchFacts(
        names=tuple(photo.name for photo in photos.photos),
        n_features=np.full(_N, 1500),
        coverage=np.full(_N, 0.8),
        pairs=pairs,
        pair_matches=np.full(len(pairs), 80),
        still=np.zeros(len(pairs)),
        turns=np.array([turns[j] @ turns[i].T for i, j in pairs]),
    )


def test_photos_that_are_fine_have_no_fault(photos: PhotoSet, fine: MatchFacts) -> None:
    found = diagnose(photos, fine)
    assert found == Diagnosis((), (fine.names,), few_features=False, featureless=False, still=False)
    assert found.reasons() == ()


def test_blurred_photos_are_named(photos: PhotoSet, fine: MatchFacts) -> None:
    changed = [replace(p, sharpness=0.01) if i % 2 else p for i, p in enumerate(photos.photos)]
    found = diagnose(replace(photos, photos=tuple(changed)), fine)
    assert found.blurred == fine.names[1::2]
    assert "6 of 12 photos are blurred: 01.jpg" in found.reasons()[0]
    assert found.why_out("03.jpg") == "blurred"
    smooth = tuple(replace(p, sharpness=0.04) for p in photos.photos)  # all alike: no fault
    assert diagnose(replace(photos, photos=smooth), fine).blurred == ()


def test_photos_without_overlap_are_told_apart(photos: PhotoSet, fine: MatchFacts) -> None:
    crossing = (fine.pairs[:, 0] < 8) & (fine.pairs[:, 1] >= 8)
    cut = replace(fine, pair_matches=np.where(crossing, 5, 80))
    found = diagnose(photos, cut)
    assert found.groups == (fine.names[:8], fine.names[8:])
    assert "4 of 12 photos show too little of what the others show" in found.reasons()[0]
    assert found.why_out("09.jpg") == "shows too little of what the others show"
    assert found.reasons(placed=fine.names) == ()
    assert chain_breaks(cut) == (("07.jpg", "08.jpg"),)


def test_a_plain_background_is_told(photos: PhotoSet, fine: MatchFacts) -> None:
    found = diagnose(photos, replace(fine, coverage=np.full(_N, 0.2)))
    assert "plain" in found.reasons()[0]
    found = diagnose(photos, replace(fine, n_features=np.full(_N, 90)))
    assert "few details" in found.reasons()[0]


def test_a_background_that_stands_still_is_told(photos: PhotoSet, fine: MatchFacts) -> None:
    found = diagnose(photos, replace(fine, still=np.full(len(fine.pairs), 0.9)))
    assert found.still
    assert "--foreground (Masks of the object" in found.reasons()[0]
    known = np.where(np.arange(len(fine.pairs)) % 2, np.nan, 0.9)  # too few matches to say
    assert diagnose(photos, replace(fine, still=known)).still
    neighbours = (np.diff(fine.pairs, axis=1)[:, 0] == 1).astype(float)  # a film that rests
    assert not diagnose(photos, replace(fine, still=neighbours)).still


def test_things_that_repeat_are_told(photos: PhotoSet, fine: MatchFacts) -> None:
    """A room of four equal walls: photos a quarter turn apart match as if they were neighbours."""
    apart = 30.0 * np.diff(fine.pairs, axis=1)[:, 0]
    seen = (apart + 45) % 90 - 45
    found = diagnose(photos, replace(fine, turns=np.array([about_z(a) for a in seen])))
    assert found.repeats > 0.2
    assert len(found.alike) == 3
    assert "Similar-looking" in found.repeated()
    assert all(name in found.repeated() for name in found.alike)
    assert diagnose(photos, fine).repeated() == ""


def test_pairs_of_few_matches_may_be_wrong(photos: PhotoSet, fine: MatchFacts) -> None:
    """A quarter of the pairs, far apart and weak, are turned by chance: nothing repeats."""
    rng = np.random.default_rng(0)
    weak = rng.random(len(fine.pairs)) < 0.25
    wrong = np.array([about_z(a) for a in rng.uniform(60, 300, len(fine.pairs))])
    turns = np.where(weak[:, None, None], wrong, fine.turns)
    counts = np.where(weak, 60, 500)
    assert diagnose(photos, replace(fine, turns=turns)).repeats > 0.3
    assert diagnose(photos, replace(fine, turns=turns, pair_matches=counts)).repeats == 0


def test_turns_close_whatever_is_unknown_and_whichever_way_pairs_go(fine: MatchFacts) -> None:
    rng = np.random.default_rng(0)
    swapped = rng.random(len(fine.pairs)) < 0.5
    pairs = np.where(swapped[:, None], fine.pairs[:, ::-1], fine.pairs)
    turns = np.where(swapped[:, None, None], fine.turns.transpose(0, 2, 1), fine.turns)
    turns[::5] = np.nan
    cycles = photo_cycles(_N, pairs, turns, fine.pair_matches)
    assert len(cycles.errors) > 50
    assert cycles.errors.max() < 1e-5
    known = {tuple(sorted(p)) for p in pairs[~np.isnan(turns).any(axis=(1, 2))].tolist()}
    assert all({(a, b), (a, c), (b, c)} <= known for a, b, c in cycles.photos.tolist())
    nothing = photo_cycles(_N, pairs, np.full_like(turns, np.nan), fine.pair_matches)
    assert len(nothing.errors) == 0
