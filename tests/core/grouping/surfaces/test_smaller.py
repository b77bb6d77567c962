"""Pieces smaller than parts: where color tells things apart that shape and regions do not."""

from dataclasses import replace

import numpy as np

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.color import lab_from_rgb, rgb_from_dc
from gaga_core.grouping.surfaces.objects import (
    carriers_by_color,
    colors_of_samples,
    hue_of,
    smaller_levels,
)
from gaga_core.grouping.surfaces.surfels import Neighbourhood, Surfels, small_pieces
from tests.scenes import objects_scene

_RED, _TEAL = (70.0, 60.0, 45.0), (70.0, -25.0, -10.0)


def _row_of_books() -> tuple[Surfels, Neighbourhood, LongArray]:
    """Samples of an even front, each of its six strips four samples wide a book; their books."""
    x, y = np.meshgrid(np.arange(24.0), np.arange(10.0))
    points: DoubleArray = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * 0.1
    n = len(points)
    facing = np.tile([0, 0, 1.0], (n, 1))
    ones, none = np.ones((n, 4), np.int32), np.zeros((n, 0), np.int32)
    surfels = Surfels(points, facing, ones, np.full(n, 4, np.int32), none)
    return surfels, Neighbourhood.of(points), (x.ravel() // 4).astype(np.int64)


def _colors(book: LongArray) -> DoubleArray:
    """Neighbouring books differ, and each is lit from above."""
    color = np.where((book % 2 == 0)[:, None], _RED, _TEAL)
    return color + np.random.default_rng(0).normal(0, 2, color.shape)


def test_small_pieces_end_where_the_color_changes() -> None:
    surfels, near, book = _row_of_books()
    assert _is_refined(small_pieces(surfels, near, _colors(book)), book)
    assert not _is_refined(small_pieces(surfels, near), book)


def test_lightness_counts_less_than_hue() -> None:
    rgb = np.array([[0.8, 0.8, 0.8], [0.35, 0.35, 0.35], [0.8, 0.2, 0.2], [0.1, 0.45, 0.3]])
    lab, found = lab_from_rgb(rgb), hue_of(rgb.astype(np.float32))
    share = np.linalg.norm(np.diff(found, axis=0), axis=1) / np.linalg.norm(
        np.diff(lab, axis=0), axis=1
    )
    assert share[0] < 0.5  # one grey, lit and in shade
    assert share[2] > 0.95  # red and green


def _levels(color: DoubleArray, part: LongArray) -> LongArray:
    surfels, near, _ = _row_of_books()
    return smaller_levels(surfels, near, part, color, np.ones(len(part)), (1.5, 3.0), 4.0)


def _is_refined(fine: LongArray, coarse: LongArray) -> bool:
    pairs = np.unique(np.stack([fine, coarse]), axis=1)
    return int(pairs.shape[1]) == len(np.unique(fine))


def test_books_of_other_colors_part_where_all_views_show_one_region() -> None:
    _, _, book = _row_of_books()
    one = np.zeros(len(book), np.int64)
    coarse, fine = _levels(_colors(book), one)
    assert _is_refined(fine, coarse)
    assert _is_refined(coarse, book)  # no piece lies on two books
    assert len(np.unique(coarse)) == 6
    plain = _levels(np.tile(_RED, (len(book), 1)), one)
    assert len(np.unique(plain[0])) == 1  # of one color they are one thing


def test_pieces_stay_inside_of_parts_and_what_stays_whole_is_one() -> None:
    _, _, book = _row_of_books()
    part = book % 3 - 1  # of strips that do not touch: books 0 and 3 stay whole
    for level in _levels(_colors(book), part):
        assert _is_refined(level, part)
        assert len(np.unique(level[part < 0])) == 1
    none = np.zeros((0, len(book)))
    surfels, near, _ = _row_of_books()
    assert smaller_levels(surfels, near, part, _colors(book), none, (), 4.0).shape == none.shape


def test_a_splat_takes_the_sample_of_its_color_in_its_part() -> None:
    rgb = np.array([[0.8, 0.2, 0.2], [0.1, 0.45, 0.5], [0.1, 0.45, 0.5]], np.float32)
    part, spacing = np.array([0, 0, 1]), np.full(3, 0.1)
    samples = np.tile([0, 2, 1], (3, 1)).astype(np.int32)
    distance = np.tile([0.04, 0.05, 0.09], (3, 1))
    carriers = np.array([0, 0, 2])
    found = carriers_by_color(distance, samples, carriers, part, (rgb, hue_of(rgb)), spacing)
    assert found.tolist() == [0, 1, 2]


def test_samples_have_the_color_of_the_opaque_splats_around() -> None:
    scene = objects_scene(2, 300)
    ghosts = scene.labels == 0
    logits = np.where(ghosts, np.float32(-5), scene.gaussians.logit_opacities)
    g = replace(scene.gaussians, logit_opacities=logits)
    rgb = rgb_from_dc(g.sh[:, 0])
    rgb[ghosts] = [0, 1, 0]
    rows = np.arange(len(g), dtype=np.int64)
    found, own = colors_of_samples(g, rows, rgb, g.means.astype(np.float64)), hue_of(rgb)
    np.testing.assert_allclose(found[~ghosts], own[~ghosts])
    assert (np.linalg.norm(found[ghosts] - own[ghosts], axis=1) > 10).all()
    shown = colors_of_samples(g, rows[ghosts], rgb[ghosts], g.means[:5].astype(np.float64))
    np.testing.assert_allclose(shown, own[:5])  # where nothing is opaque, what there is
