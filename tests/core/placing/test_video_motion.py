"""Frames are chosen by how a film moves."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.placing.video import (
    FilmMotion,
    MotionConfig,
    choose_frames,
    displacement,
    frames_between,
)


@pytest.mark.parametrize("moved", [(0, 0), (3, 0), (-5, 4)])
def test_a_shift_is_measured(moved: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    wide = rng.uniform(0, 255, (160, 200)).astype(np.float32)
    before = wide[16:144, 20:180]
    after = wide[16 + moved[0] : 144 + moved[0], 20 + moved[1] : 180 + moved[1]]
    assert displacement(before, after, 0.25) == pytest.approx(np.hypot(*moved) / 160, abs=1e-6)


def test_pictures_of_other_things_count_as_far_apart() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0, 255, (2, 128, 160)).astype(np.float32)
    assert displacement(a, b, 0.25) == 0.25


def film(motion: list[float], seed: int = 0) -> FilmMotion:
    sharp = np.random.default_rng(seed).uniform(0.1, 1, len(motion))
    return FilmMotion(12.0, sharp, np.array(motion))


def test_a_film_that_rests_gives_frames_where_it_moves() -> None:
    moving = [0.0, *[0.01] * 200]
    rests = [*moving[:100], *[0.0] * 150, *moving[100:]]
    chosen = choose_frames(film(rests))
    assert sum(105 < i < 245 for i in chosen) <= 1
    assert len(chosen) == pytest.approx(200 * 0.01 / MotionConfig().step, abs=2)
    assert list(chosen) == sorted(set(chosen))


def test_the_sharpest_of_a_place_is_taken() -> None:
    slow = film([0.0, *[0.004] * 400])
    sharp = np.full(401, 0.1)
    sharp[::10] = 1.0
    chosen = choose_frames(replace(slow, sharpness=sharp))
    assert all(i % 10 == 0 for i in chosen)


def test_a_hurried_film_gives_every_frame_and_a_long_one_not_too_many() -> None:
    assert choose_frames(film([0.0, *[0.2] * 40])) == tuple(range(41))
    assert len(choose_frames(film([0.0, *[0.1] * 2000]))) <= MotionConfig().most
    assert choose_frames(film([])) == ()


def test_more_frames_come_from_the_gap() -> None:
    walk = film([0.0, *[0.01] * 100])
    chosen = (0, 20, 40, 60, 80, 100)
    more = frames_between(walk, chosen, [(20, 40)])
    assert more
    assert all(20 < i < 40 for i in more)
    assert frames_between(walk, chosen, []) == ()
    assert frames_between(walk, (0, 1), [(0, 1)]) == ()  # the film has none in between
