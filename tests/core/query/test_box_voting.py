"""From boxes to groups, and the detectors that make boxes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.query.detector import (
    Boxes,
    DetectConfig,
    as_boxes,
    contained,
    groups_of_box,
    load_detector,
    vote_boxes,
)
from tests.core.query.tiny_query_models import write_clip, write_grounding_dino, write_owlv2


def _map() -> IntArray:
    """A bowl (1) with an apple (2) in it, a cup (3) beside, a table (4) under all."""
    labels = np.zeros((100, 160), np.int32)
    labels[40:] = 4
    labels[30:70, 20:80] = 1
    labels[25:45, 40:60] = 2
    labels[35:65, 100:130] = 3
    return labels


def _box(*corners: float, score: float = 1.0) -> Boxes:
    return as_boxes([corners], [score], (100, 160))


def test_boxes_are_clipped_and_sorted_and_empty_ones_go() -> None:
    corners = [[-5, -5, 20, 20], [30, 30, 30, 60], [50, 50, 500, 500], [200, 0, 300, 9]]
    boxes = as_boxes(corners, [0.2, 0.9, 0.7, 0.8], (100, 160))
    assert boxes.scores.tolist() == pytest.approx([0.7, 0.2])
    assert boxes.corners.tolist() == [[50, 50, 160, 100], [0, 0, 20, 20]]


def test_the_published_rule_takes_what_lies_inside() -> None:
    labels = _map()
    bowl = np.zeros(labels.shape, np.bool_)
    bowl[23:72, 18:82] = True
    assert contained(labels, bowl).tolist() == [1, 2]  # the apple too: it lies inside
    assert contained(labels, bowl, share=0.0).tolist() == [1, 2, 4]
    assert contained(labels, np.zeros(labels.shape, np.bool_)).tolist() == []
    assert contained(labels, np.ones(labels.shape, np.bool_)).tolist() == [1, 2, 3, 4]
    half = np.zeros(labels.shape, np.bool_)
    half[:, :115] = True  # half of the cup
    assert 3 not in contained(labels, half)


def test_our_rule_takes_the_group_that_fills_the_box() -> None:
    labels = _map()
    assert groups_of_box(labels, _box(18, 23, 82, 72).corners[0]).groups.tolist()[0] == 1
    swapped = np.array([0, 2, 1, 3, 4], np.int32)[labels]  # whatever the ids are
    assert groups_of_box(swapped, _box(18, 23, 82, 72).corners[0]).groups.tolist()[0] == 2
    assert groups_of_box(labels, _box(39, 24, 61, 46).corners[0]).groups.tolist() == [2]
    assert groups_of_box(labels, _box(98, 33, 132, 67).corners[0]).groups.tolist() == [3]
    assert groups_of_box(labels, _box(0, 0, 160, 24).corners[0]).groups.tolist() == []  # only none
    assert groups_of_box(labels, _box(0, 38, 160, 100).corners[0]).groups.tolist()[0] == 4


def test_an_object_in_two_groups_is_found_whole() -> None:
    labels = np.zeros((50, 50), np.int32)
    labels[10:40, 10:25], labels[10:40, 25:40] = 7, 8
    labels[20:24, 12:16] = 9  # a sticker on it is not a part worth naming
    found = groups_of_box(labels, np.array([9, 9, 41, 41], np.float32))
    assert sorted(found.groups.tolist()) == [7, 8]
    assert ((found.scores > 0) & (found.scores <= 1)).all()


def test_every_group_is_found_by_its_own_box() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        labels = np.zeros((80, 80), np.int32)
        boxes = {}
        for group in range(1, 6):
            y, x = rng.integers(0, 60, 2)
            labels[y : y + rng.integers(8, 20), x : x + rng.integers(8, 20)] = group
        for group in np.unique(labels[labels > 0]):
            rows, columns = np.nonzero(labels == group)
            box = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
            boxes[int(group)] = np.array(box, np.float32)
            inside = labels[box[1] : box[3], box[0] : box[2]] == group
            if inside.mean() > 0.6:
                assert groups_of_box(labels, boxes[int(group)]).groups[0] == group


def test_views_vote_weighted_by_score() -> None:
    labels = _map()
    cup, apple = _box(98, 33, 132, 67, score=0.9), _box(39, 24, 61, 46, score=0.4)
    both = Boxes(np.concatenate([cup.corners, apple.corners]), np.array([0.9, 0.4], np.float32))
    found = vote_boxes([(labels, both)])
    assert found.groups.tolist() == [3, 2]
    assert found.scores[0] == 1
    assert 0.3 < found.scores[1] < 0.6
    # One view is mistaken, two are not.
    wrong = _box(18, 23, 82, 72, score=0.5)
    assert vote_boxes([(labels, wrong), (labels, cup), (labels, cup)]).groups[0] == 3
    # A view that does not show a group does not count against it.
    without = np.where(labels == 3, 4, labels).astype(np.int32)
    nothing = as_boxes([], [], (100, 160))
    assert vote_boxes([(labels, cup), (without, nothing)]).groups.tolist() == [3]
    assert len(vote_boxes([(labels, nothing)]).groups) == 0
    # Surely found in the only view that shows it, against doubtfully in both views.
    doubtful = _box(39, 24, 61, 46, score=0.55)
    first = Boxes(np.concatenate([cup.corners, doubtful.corners]), np.array([0.9, 0.55], "f4"))
    assert vote_boxes([(labels, first), (without, doubtful)]).groups.tolist() == [3, 2]


@pytest.mark.parametrize("write", [write_grounding_dino, write_owlv2])
def test_detectors_load_from_a_folder_and_find_boxes(
    tmp_path: Path, write: Callable[[Path], Path]
) -> None:
    detector = load_detector(write(tmp_path / "model"), "cpu")
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 255, (96, 128, 3), dtype=np.uint8)
    everything = DetectConfig(box_threshold=0.0, text_threshold=0.0)
    boxes = detector.detect(picture, "A red chair", everything)
    assert len(boxes) > 0
    assert boxes.corners.shape == (len(boxes), 4)
    assert (boxes.corners >= 0).all()
    assert (boxes.corners <= [128, 96, 128, 96]).all()
    assert (np.diff(boxes.scores) <= 0).all()
    again = detector.detect(picture, "a red chair.", everything)
    assert np.array_equal(again.corners, boxes.corners)  # writing does not matter
    nothing = detector.detect(picture, "fox", DetectConfig(box_threshold=1.01))
    assert len(nothing) == 0
    assert len(vote_boxes([(np.ones((96, 128), np.int32), boxes)]).groups) == 1


def test_other_models_are_refused_as_detectors(tmp_path: Path) -> None:
    with pytest.raises(GagaError, match="no Grounding DINO or OWLv2"):
        load_detector(write_clip(tmp_path / "clip"))
    with pytest.raises(GagaError, match=r"no config\.json"):
        load_detector(tmp_path)
