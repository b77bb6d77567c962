"""Causes of a failed placement, planted one by one in matches that are otherwise fine."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.reconstruct.photos import Photo, PhotoSet
from gaga_core.reconstruct.sfm_diagnosis import Diagnosis, MatchFacts, chain_breaks, diagnose

_N = 12


@pytest.fixture
def photos() -> PhotoSet:
    names = [f"{i:02d}.jpg" for i in range(_N)]
    return PhotoSet(tuple(Photo(name, name, 400, 300, sharpness=0.2) for name in names))


@pytest.fixture
def fine(photos: PhotoSet) -> MatchFacts:
    pairs = np.array([(i, j) for i in range(_N) for j in range(i + 1, _N)], np.int64)
    return MatchFacts(
        names=tuple(photo.name for photo in photos.photos),
        n_features=np.full(_N, 1500),
        coverage=np.full(_N, 0.8),
        pairs=pairs,
        pair_matches=np.full(len(pairs), 80),
        still=np.zeros(len(pairs)),
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
    assert "--turntable (Object on a turntable" in found.reasons()[0]
    neighbours = (np.diff(fine.pairs, axis=1)[:, 0] == 1).astype(float)  # a film that rests
    assert not diagnose(photos, replace(fine, still=neighbours)).still
