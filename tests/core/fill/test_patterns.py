"""Filling on surfaces with a pattern: it goes on in the hole, and is not taken for a shadow."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.fill import chart as texture
from gaga_core.fill.chart import STYLES, Chart, continued_color
from gaga_core.fill.fill import with_rim
from gaga_core.fill.shadows import foot_cells, gains, shadow_of, splat_gains, taken_cells
from gaga_core.fill.surfaces import Plane

SIDE, CELL = 90, 10  # cells of the chart and of a square on it
LIGHT, DARK = np.array([0.8, 0.75, 0.7]), np.array([0.35, 0.15, 0.12])


def disc(radius: float, row: float = SIDE / 2, column: float = SIDE / 2) -> BoolArray:
    rows, columns = np.indices((SIDE, SIDE))
    return np.hypot(rows - row, columns - column) < radius


def lightening(shaded: Chart, taken: BoolArray | None = None) -> DoubleArray:
    """`gains` around the hole."""
    return gains(shaded, shaded.hole, taken)


def pattern(*, stripes: bool = False) -> DoubleArray:
    rows, columns = np.indices((SIDE, SIDE)) // CELL
    odd = columns % 2 if stripes else (rows + columns) % 2
    grain = 1 + 0.02 * np.random.default_rng(0).normal(size=(SIDE, SIDE, 1))
    return ndimage.gaussian_filter(
        np.where(odd[:, :, None] == 1, LIGHT, DARK) * grain, (0.8, 0.8, 0)
    )


def chart(color: DoubleArray) -> Chart:
    plane = Plane(np.zeros(3), np.eye(3), np.zeros(0, np.int64), 2.0, 0.01, 1)
    hole = disc(12)
    height = np.zeros((SIDE, SIDE))
    again = np.zeros_like(hole)
    return Chart(plane, np.array([0.0, SIDE]), 1.0, color, height, ~hole, hole, again)


def test_stripes_go_on_through_a_hole(monkeypatch: pytest.MonkeyPatch) -> None:
    color, hole = pattern(stripes=True), disc(12)

    def wrong() -> float:
        found = continued_color(np.where(hole[:, :, None], 0, color), ~hole, hole)
        assert np.array_equal(found[~hole], color[~hole])
        return float(((found - color)[hole] ** 2).mean())

    chosen = wrong()
    monkeypatch.setattr(texture, "STYLES", STYLES[:1])
    assert chosen < 0.4 * wrong()


def cloth_on_a_table() -> DoubleArray:
    """Grained wood, and from the middle on a light cloth with a stripe along its edge."""
    rows = np.indices((SIDE, SIDE))[0]
    color = np.where((rows < SIDE / 2)[:, :, None], [0.7, 0.45, 0.2], [0.9, 0.88, 0.82])
    color = np.where((np.abs(rows - SIDE / 2 - 6) < 2)[:, :, None], [0.2, 0.5, 0.6], color)
    grain = 1 + 0.01 * np.random.default_rng(0).normal(size=(SIDE, SIDE, 1))
    return ndimage.gaussian_filter(color * grain, (0.6, 0.6, 0))


def test_the_edge_of_a_cloth_goes_on_through_a_hole(monkeypatch: pytest.MonkeyPatch) -> None:
    color, hole = cloth_on_a_table(), disc(12)

    def wrong() -> float:
        found = continued_color(np.where(hole[:, :, None], 0, color), ~hole, hole)
        return float(((found - color)[hole] ** 2).mean())

    chosen = wrong()
    monkeypatch.setattr(texture, "STYLES", STYLES[:2])
    assert chosen < 0.5 * wrong()


def test_a_shadow_over_a_cloth_and_its_table_is_found_by_its_outline() -> None:
    """What these two differ by explains more of the brightness than any shadow does."""
    none = np.zeros((SIDE, SIDE), np.bool_)
    for depth, is_found in ((0.65, True), (1.0, False)):
        bare = chart(cast_on(cloth_on_a_table(), 14.0, depth))
        shaded = replace(bare, plane=replace(bare.plane, is_layered=True))
        cast = shadow_of(shaded, shaded.hole, cylinder(), none)
        assert (cast is not None) == is_found
        if cast is not None:
            true = disc(14, column=SIDE / 2 + 14) & ~shaded.hole
            assert (cast.mask & true).sum() > 0.8 * true.sum()
            assert cast.depth == pytest.approx(-np.log(depth), abs=0.15)


def test_what_no_photo_showed_next_to_a_hole_in_layers_is_made_again() -> None:
    bare, ones = chart(cloth_on_a_table()), np.ones((SIDE, SIDE, 3))
    around = disc(14) & bare.known & (np.random.default_rng(0).random((SIDE, SIDE)) < 0.8)
    far = np.zeros((SIDE, SIDE), np.bool_)
    far[2:5, 2:5] = True
    found = with_rim(bare, ones, around | far)
    assert found.hole[around].all()
    assert not (far & found.hole).any()
    assert not (found.hole & found.known).any()
    assert (found.again == found.hole & bare.known).all()
    same = with_rim(bare, ones, np.zeros((SIDE, SIDE), np.bool_))
    assert (same.hole == bare.hole).all()


def test_a_hole_with_no_room_for_a_piece_around_it_is_filled_smoothly() -> None:
    color = np.full((36, 36, 3), 0.6) + np.random.default_rng(0).normal(0, 0.02, (36, 36, 1))
    hole = np.zeros((36, 36), np.bool_)
    hole[11:25, 11:25] = True
    for rows in (slice(None), slice(8, 28)):  # no piece of the larger style, of the smaller either
        part = hole[rows, rows]
        unknown = np.where(part[:, :, None], 0, color[rows, rows])
        found = continued_color(unknown, ~part, part)
        assert np.abs(found[part] - 0.6).max() < 0.1


def cylinder() -> DoubleArray:
    """Splats (K, 3) of one that stands on the hole, 10 cells high."""
    rows, columns = np.nonzero(disc(14))
    return np.concatenate(
        [np.column_stack([columns, SIDE - rows, np.full(len(rows), h)]) for h in (0.1, 5.0, 10.0)]
    )


def cast_on(color: DoubleArray, away: float, depth: float = 0.5) -> DoubleArray:
    """``color`` with the shadow of the `cylinder`, its top so many columns to the right."""
    mask = np.any([disc(14, column=SIDE / 2 + x) for x in np.arange(0, away, 0.5)], axis=0)
    shade = ndimage.gaussian_filter(np.where(mask, depth, 1.0), 1.0)
    return color * shade[:, :, None]


@pytest.mark.parametrize("away", [10.0, 18.0])
def test_a_shadow_over_squares_is_found_and_taken_off(away: float) -> None:
    color = pattern()
    shaded = chart(cast_on(color, away))
    none = np.zeros_like(shaded.hole)
    cast = shadow_of(shaded, shaded.hole, cylinder(), none)
    assert cast is not None
    true = disc(14, column=SIDE / 2 + away) & ~shaded.hole
    assert (cast.mask & true).sum() > 0.85 * true.sum()
    assert (cast.mask & ~disc(16, column=SIDE / 2 + away) & ~disc(16 + away)).sum() == 0
    assert cast.depth == pytest.approx(np.log(2), abs=0.25)
    factors = gains(shaded, shaded.hole, none, cast)
    core = disc(10, column=SIDE / 2 + away) & ~disc(15)
    lit = np.median(factors[core] * 0.5)
    assert 0.85 < lit < 1.15
    far = disc(44) & ~disc(18, column=SIDE / 2 + away) & ~disc(32)
    assert np.median(factors[far]) < 1.02


def test_a_thing_stands_only_on_a_surface_that_touches_it_from_below() -> None:
    flat, own = chart(plain_table()), cylinder()
    foot = foot_cells(flat, own)
    assert foot[disc(12)].all()
    assert not foot[~disc(17)].any()
    for lifted in (5.0, -5.0):  # it hangs over the plane, or the plane goes through it
        assert not foot_cells(flat, own + np.array([0, 0, lifted])).any()


def darkened(*places: BoolArray) -> DoubleArray:
    """A plain table that is half as bright there."""
    shade = ndimage.gaussian_filter(np.where(np.any(places, axis=0), 0.5, 1.0), 1.0)
    return plain_table() * shade[:, :, None]


def test_dark_places_of_another_outline_are_no_shadow_of_the_object() -> None:
    blot, across = disc(9, 15, 20), np.abs(np.indices((SIDE, SIDE))[0] - SIDE / 2) < 13
    wide = disc(26, column=75)  # it goes on where no light would throw a shadow
    corners = [disc(12, row, column) for row in (15, 75) for column in (15, 75)]
    among_others = cast_on(darkened(*corners), 10.0)  # what darkens elsewhere as well is none
    tables = (plain_table(), darkened(blot), darkened(across), darkened(wide), among_others)
    for color in (pattern(), pattern(stripes=True), *tables):
        bare = chart(color)
        assert shadow_of(bare, bare.hole, cylinder(), np.zeros_like(bare.hole)) is None
    for color in (pattern(), pattern(stripes=True)):
        assert (lightening(chart(color)) == 1).all(), "without a cast shadow no stain either"


def test_what_is_dark_along_a_part_of_the_outline_only_is_no_stain() -> None:
    """Without the outline of a shadow, what an object darkens lies all around it."""
    side = disc(12, column=SIDE / 2 + 10)
    shade = ndimage.gaussian_filter(np.where(side, 0.6, 1.0), 1.0)
    assert (lightening(chart(plain_table() * shade[:, :, None])) == 1).all()


def test_the_shadow_of_another_thing_stays() -> None:
    shade = np.where(disc(13) | disc(13, SIDE / 2, SIDE / 2 + 26), 0.5, 1.0)
    shaded = chart(pattern() * ndimage.gaussian_filter(shade, 1.0)[:, :, None])
    shaded = chart(np.where(disc(16)[:, :, None], 0.5 * pattern(), shaded.color))
    other = disc(9, SIDE / 2, SIDE / 2 + 30)
    rows, columns = np.nonzero(other)
    points = np.stack([columns + 0.5, SIDE - rows - 0.5, np.full(len(rows), 3.0)], axis=1)
    taken = taken_cells(shaded, points, 20.0)
    assert (taken & other).sum() > 0.7 * other.sum()
    beyond = disc(11, SIDE / 2, SIDE / 2 + 34) & ~disc(24)
    assert lightening(shaded)[beyond].mean() > 1.1
    assert lightening(shaded, taken)[beyond].mean() < 1.03


def test_no_splat_becomes_brighter_than_those_in_the_light() -> None:
    flat = chart(np.full((SIDE, SIDE, 3), 0.4))
    factors = np.where(disc(20)[:, :, None], 2.0, 1.0) * np.ones(3)
    local = np.array([[45.0, 45.0, 0], [46.0, 45.0, 0], [5.0, 5.0, 0], [80.0, 80.0, 0]])
    rgb = np.array([[0.3] * 3, [0.7] * 3, [0.8] * 3, [0.8] * 3])
    found = splat_gains(flat, factors, local, rgb) * rgb
    assert np.allclose(found[0], 0.6)
    assert found.max() < 0.81


def test_no_splat_becomes_a_color_of_a_hue_that_is_only_darker_elsewhere() -> None:
    """Dark red buds on pale paper, at the edge of what looks like a shadow."""
    flat = chart(np.full((SIDE, SIDE, 3), 0.4))
    factors = np.where(disc(20)[:, :, None], 3.0, 1.0) * np.ones(3)
    paper = np.tile([[5.0, 5.0, 0]], (40, 1))
    local = np.concatenate([[[45.0, 45.0, 0], [46.0, 45.0, 0]], paper])
    red, pale = np.array([0.24, 0.04, 0.04]), np.array([0.9, 0.85, 0.8])
    for last in (red, pale):  # another bud in the light, or none
        rest = np.concatenate([np.tile(pale, (39, 1)), [last]])
        rgb = np.concatenate([[red, pale / 3], rest])
        found = splat_gains(flat, factors, local, rgb) * rgb
        np.testing.assert_allclose(found[0], red, rtol=0.02)
        np.testing.assert_allclose(found[1], pale, rtol=0.02)


def plain_table() -> DoubleArray:
    grain = np.random.default_rng(1).normal(size=(SIDE, SIDE, 1))
    return LIGHT * (1 + 0.02 * ndimage.gaussian_filter(grain, (0.8, 0.8, 0)))


def test_dark_places_here_and_there_at_the_outline_are_no_shadow() -> None:
    middle = SIDE / 2
    angles = np.radians([20, 110, 200, 290])
    places = [disc(5, middle + 14 * np.sin(a), middle + 14 * np.cos(a)) for a in angles]
    spots = ndimage.gaussian_filter(np.where(np.any(places, axis=0), 0.5, 1.0), 1.0)
    assert (lightening(chart(plain_table() * spots[:, :, None])) == 1).all()
    around = ndimage.gaussian_filter(np.where(disc(17), 0.5, 1.0), 1.0)
    assert lightening(chart(plain_table() * around[:, :, None])).max() > 1.5


def test_what_is_darker_than_the_way_to_it_is_no_shadow_of_the_object() -> None:
    shade = np.where(disc(16), 0.6, 1.0)
    shade[42:48, 58:70] = 0.85
    shade[35:55, 66:80] = 0.45
    found = lightening(chart(plain_table() * ndimage.gaussian_filter(shade, 1.0)[:, :, None]))
    assert np.median(found[disc(15) & ~disc(12)]) > 1.3
    assert found[38:52, 70:78].max() < 1.1
