""""""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.evaluate.group_scores import evaluate, score_pairs
from gaga_core.io.masks.label_maps import write_labels


def maps(seed: int, n: int = 4) -> list[IntArray]:
    """Blocky label maps with ids 0..7, so that every region has some area."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 8, (n, 6, 8)).astype(np.int32)
    return list(np.kron(coarse, np.ones((1, 5, 5), np.int32)))


@pytest.mark.parametrize("seed", range(3))
def test_a_perfect_answer_under_any_names_scores_one(seed: int) -> None:
    true = maps(seed)
    rename = np.r_[0, np.random.default_rng(seed).permutation(np.arange(300, 307))]
    pairs = [(t, rename[t].astype(np.int32)) for t in true]
    for score in score_pairs(pairs):
        assert (score.iou, score.precision, score.recall, score.pooled_iou) == (1, 1, 1, 1)


def test_scores_do_not_depend_on_order_or_names() -> None:
    rng = np.random.default_rng(5)
    true, pred = maps(1), maps(2)
    base = score_pairs(list(zip(true, pred, strict=True)))
    names = rng.permutation(np.arange(1, 300))[:8]
    renamed = [np.where(p > 0, names[p], 0).astype(np.int32) for p in pred]
    order = rng.permutation(len(true))
    again = score_pairs([(true[i], renamed[i]) for i in order])
    for a, b in zip(base, again, strict=True):
        assert a.iou == pytest.approx(b.iou)
        assert (a.precision, a.recall) == (b.precision, b.recall)


def test_a_small_example_by_hand() -> None:
    # One image of 10 pixels: true 1 on 4, true 2 on 4, void on 2.
    true = np.array([[1, 1, 1, 1, 2, 2, 2, 2, 0, 0]], np.int32)
    pred = np.array([[5, 5, 5, 0, 6, 6, 7, 7, 7, 5]], np.int32)
    with_void, without = score_pairs([(true, pred)])
    # Void left out: 1-5: 3/4; 2-6: 2/4, 2-7: 2/4 (pixels of true 0 do not count). Hits > 0.5: one.
    assert without.iou == pytest.approx((3 / 4 + 2 / 4) / 2)
    assert (without.n_true, without.n_predicted) == (2, 3)
    assert without.precision == pytest.approx(1 / 3)
    assert without.recall == pytest.approx(1 / 2)
    # With void: 1-5: 3/5, 2-6: 2/4; 0 pairs with what is left: 7 at 1/4 beats 0 at 0.
    assert with_void.iou == pytest.approx((3 / 5 + 2 / 4 + 1 / 4) / 3)
    assert (with_void.n_true, with_void.n_predicted) == (3, 4)


def test_iou_is_averaged_over_the_images_that_show_the_object() -> None:
    here = np.full((2, 4), 1, np.int32)
    elsewhere = np.full((2, 4), 2, np.int32)
    half = here.copy()
    half[0] = 9
    _, score = score_pairs([(here, here), (here, half), (elsewhere, elsewhere)])
    assert score.iou == pytest.approx(((1 + 0.5) / 2 + 1) / 2)


def test_extra_groups_cost_precision_and_missed_ones_recall() -> None:
    true = maps(3)
    split = []
    for t in true:
        s = t.copy()
        s[:, ::2] += 8 * (s[:, ::2] > 0)  # every object in two interleaved parts
        split.append(s)
    _, score = score_pairs(list(zip(true, split, strict=True)))
    assert score.n_predicted == 2 * score.n_true
    assert score.precision <= 0.5
    merged = [np.minimum(t, 1) for t in true]
    _, score = score_pairs(list(zip(true, merged, strict=True)))
    assert score.recall <= 1 / 7


def write_all(folder: Path, labels: list[IntArray]) -> Path:
    folder.mkdir()
    for i, m in enumerate(labels):
        write_labels(folder / f"{i:02d}.png", m)
    return folder


def test_a_missing_prediction_is_named_and_costs(tmp_path: Path) -> None:
    true = maps(4)
    gt = write_all(tmp_path / "gt", true)
    pred = write_all(tmp_path / "pred", true)
    whole = evaluate(pred, gt)
    assert whole.missing == ()
    assert whole.without_void.iou == 1
    (pred / "01.png").unlink()
    less = evaluate(pred, gt)
    assert less.missing == ("01",)
    assert less.without_void.iou < 1
    assert evaluate(pred, gt, views=["00", "02.jpg"]).without_void.iou == 1


def test_predictions_of_another_size_are_resized(tmp_path: Path) -> None:
    true = maps(4)
    gt = write_all(tmp_path / "gt", true)
    large = [np.kron(t, np.ones((2, 2), np.int32)) for t in true]
    assert evaluate(write_all(tmp_path / "pred", large), gt).without_void.iou == 1


def test_folders_without_maps_are_sentences(tmp_path: Path) -> None:
    (tmp_path / "gt").mkdir()
    with pytest.raises(GagaError, match="no label maps"):
        evaluate(tmp_path / "gt", tmp_path / "gt")
    with pytest.raises(GagaError, match="is not a folder"):
        evaluate(tmp_path / "gt", tmp_path / "none")


def a_scene(n: int = 3) -> list[IntArray]:
    """Two objects of 100 pixels each on void, in images of 100 x 100."""
    true = np.zeros((100, 100), np.int32)
    true[40:50, 20:30], true[40:50, 60:70] = 1, 2
    return [true] * n


def test_how_labels_on_void_touch_objects_does_not_change_precision() -> None:
    # A wall is one label on void; whether its outline takes a pixel of an object is decoding.
    clear = [np.where(t > 0, t, 9).astype(np.int32) for t in a_scene()]
    touching = [p.copy() for p in clear]
    for pred in touching:
        pred[40, 20] = 9
    for answers in (clear, touching):
        with_void, without = score_pairs(list(zip(a_scene(), answers, strict=True)))
        assert (without.precision, without.recall, without.n_predicted) == (1, 1, 2)
        assert with_void.n_predicted == 3  # published: every label counts
    wrong = [p.copy() for p in clear]
    for pred in wrong:
        pred[40:50, 20:24] = 7  # most of it on an object: a wrong object
    assert score_pairs(list(zip(a_scene(), wrong, strict=True)))[1].precision == 2 / 3


@pytest.mark.parametrize(("pixels", "counts"), [(1, False), (2, True)])
def test_a_label_smaller_than_any_mask_is_no_prediction(pixels: int, counts: bool) -> None:
    answers = [t.copy() for t in a_scene()]
    answers[1][44, 22 : 22 + pixels] = 5  # 2 of 10,000 pixels are `SMALLEST`
    with_void, without = score_pairs(list(zip(a_scene(), answers, strict=True)))
    assert without.n_predicted == 2 + counts
    assert with_void.n_predicted == 4


def test_a_label_that_found_an_object_counts_wherever_the_rest_of_it_lies() -> None:
    spilled = [np.where(t == 1, 1, 0).astype(np.int32) for t in a_scene()]
    for pred in spilled:
        pred[:20] = 1  # twenty times the object, all of it void
    score = score_pairs(list(zip(a_scene(), spilled, strict=True)))[1]
    assert (score.precision, score.recall, score.n_predicted) == (1, 1 / 2, 1)
