"""A Segment Anything model asked for one thing, with random weights: every family, both signs."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.segmentation.choose import prompter_named
from gaga_core.segmentation.loading import load_folder
from gaga_core.segmentation.sam import sam_encoder
from tests.core.segmentation.conftest import SAM_KINDS

Folder = Callable[[str], Path]
_POINTS = np.array([[30.5, 20.5], [100.5, 70.5]], np.float32)


@pytest.mark.parametrize("kind", SAM_KINDS)
def test_every_family_answers_points_of_both_signs(
    kind: str, model_folder: Folder, photo: UInt8Array
) -> None:
    ask = prompter_named("tiny", weights=model_folder(kind), device="cpu")
    both = ask(photo, _POINTS, np.array([True, True]))
    other = ask(photo, _POINTS, np.array([True, False]))
    assert both.masks.shape == other.masks.shape == (3, *photo.shape[:2])
    assert both.masks.dtype == np.bool_
    assert (np.diff(both.scores) <= 0).all()
    assert not np.array_equal(both.scores, other.scores)  # the sign is heard
    again = ask(photo, _POINTS, np.array([True, True]))
    np.testing.assert_array_equal(again.masks, both.masks)


@pytest.mark.parametrize("kind", SAM_KINDS)
def test_one_point_is_answered_as_the_generator_is(
    kind: str, model_folder: Folder, photo: UInt8Array
) -> None:
    encoded = sam_encoder(load_folder("mask_generation", model_folder(kind)))(photo)
    for asked, found in zip(
        encoded.prompt(_POINTS[:1], np.array([True])), encoded.decode(_POINTS[:1]), strict=True
    ):
        np.testing.assert_allclose(asked.numpy(), found[0].numpy(), atol=1e-4)


@pytest.mark.parametrize("kind", SAM_KINDS)
def test_every_family_answers_boxes_one_mask_each(
    kind: str, model_folder: Folder, photo: UInt8Array
) -> None:
    """A box alone and a box among others give the same mask; another box another one."""
    ask = prompter_named("tiny", weights=model_folder(kind), device="cpu")
    corners = np.array([[10, 10, 60, 50], [40, 20, 110, 80]], np.float32)
    both = ask.in_boxes(photo, corners)
    assert both.shape == (2, *photo.shape[:2])
    assert both.dtype == np.bool_
    assert (both[0] != ask.in_boxes(photo, corners[:1])[0]).mean() < 0.001
    assert not np.array_equal(both[0], both[1])
    assert ask.in_boxes(photo, corners[:0]).shape == (0, *photo.shape[:2])


def test_wrong_questions_are_refused(model_folder: Folder, photo: UInt8Array) -> None:
    ask = prompter_named("tiny", weights=model_folder("sam2"), device="cpu")
    with pytest.raises(ValueError, match="at least one point on the object"):
        ask(photo, _POINTS, np.array([False, False]))
    with pytest.raises(ValueError, match="points"):
        ask(photo, _POINTS[:1], np.array([True, False]))
    with pytest.raises(GagaError, match="cannot segment a single object"):
        prompter_named("tiny", weights=model_folder("mask2former"), device="cpu")
