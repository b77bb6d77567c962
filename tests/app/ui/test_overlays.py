"""Labels of lengths in the picture: on their lines where there is room, and off each other."""

from itertools import combinations, pairwise

import numpy as np
import pytest

from gaga_studio.ui.kit.picture_area import Rect, overlap
from gaga_studio.ui.viewport.overlays import label_places

_RADIUS, _SIZES = 10.0, ((120.0, 24.0), (130.0, 24.0))


def _places(marks: np.ndarray) -> list[Rect | None]:
    middles = [((a + b) / 2).tolist() for a, b in pairwise(marks)]
    return label_places([(float(u), float(v)) for u, v in marks], middles, _SIZES, _RADIUS)


@pytest.mark.parametrize("extent", [1.0, 15.0, 40.0, 150.0, 600.0])
def test_labels_lie_on_no_mark_and_on_no_other_label(extent: float) -> None:
    rng = np.random.default_rng(5)
    for _ in range(300):
        marks = 500 + rng.uniform(-extent, extent, (3, 2))
        disks = [(*(at - _RADIUS), *(at + _RADIUS)) for at in marks]
        places = _places(marks)
        found = [place for place in places if place is not None]
        assert len(found) == len(places), "both are told"
        assert not any(overlap(one, two) for one, two in combinations(found, 2))
        assert not any(overlap(one, disk) for one in found for disk in disks)


@pytest.mark.parametrize("angle", np.radians([0, 30, 60, 80, 90, 120, 200]))
def test_a_label_stays_on_its_line_where_it_has_room_in_any_direction(angle: float) -> None:
    """Steep lines lost theirs, which is wider than they are."""
    way = 170 * np.array([np.cos(angle), np.sin(angle)])
    marks = np.array([[300.0, 300.0], 300 + way])
    (place,) = _places(marks)
    assert place is not None
    middle = (place[0] + place[2]) / 2, (place[1] + place[3]) / 2
    np.testing.assert_allclose(middle, marks.mean(axis=0))
