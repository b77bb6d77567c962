"""Color grades against the steps done one by one, and their limits."""

import numpy as np
import pytest

from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.selection.by_value import shown_colors
from gaga_core.scene.tint import Grade, grade_affine
from tests.core.scene.edits.edit_walk import walk_scene

LUMA = np.array([0.2126, 0.7152, 0.0722])


def _graded(grade: Grade, rgb: np.ndarray) -> np.ndarray:
    affine = grade_affine(grade)
    return np.asarray(rgb @ affine[:, :3].T + affine[:, 3])


def test_the_defaults_change_nothing() -> None:
    assert np.array_equal(grade_affine(Grade()), np.eye(3, 4))
    assert Grade().changes_nothing
    assert not Grade(green=0.1).changes_nothing


def test_a_grade_is_balance_saturation_brightness_levels_in_this_order() -> None:
    rng = np.random.default_rng(0)
    rgb = rng.random((50, 3))
    grade = Grade((1.2, 0.9, 0.7), 0.4, -0.3, 1.7, 0.05, 0.1, 0.8)
    gain = np.array([1 + 0.1 + 0.03, 1 - 0.06, 1 - 0.1 + 0.03]) * np.array([1.2, 0.9, 0.7])
    balanced = rgb * gain
    grey = balanced @ LUMA
    saturated = grey[:, None] + 1.7 * (balanced - grey[:, None])
    want = (saturated + 0.05 - 0.1) / (0.8 - 0.1)
    assert np.abs(_graded(grade, rgb) - want).max() < 1e-12


@pytest.mark.parametrize(
    "wrong",
    [
        {"temperature": 2},
        {"saturation": -1},
        {"white": 0.3, "black": 0.3},
        {"tint": (1, 1, 9)},
        {"opacity": float("nan")},
    ],
)
def test_values_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Grade(**wrong)  # type: ignore[arg-type]


def test_a_grade_of_a_selection_recolors_only_it() -> None:
    scene = walk_scene(200)
    before = shown_colors(scene)
    grade = Grade(saturation=0)
    mug = np.flatnonzero(scene.labels == 2)
    History(scene).do(edits.recolor(scene, mug, grade_affine(grade)))
    after = shown_colors(scene)
    others = np.setdiff1d(np.arange(200), mug)
    assert np.array_equal(after[others], before[others])
    assert np.ptp(after[mug], axis=1).max() < 1e-5
