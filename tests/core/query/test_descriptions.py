"""What groups are called that nobody has named."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gaga_core.color import dc_from_rgb
from gaga_core.query.colors import NAMES
from gaga_core.query.descriptions import describe_groups, shapes_of
from gaga_core.query.group_facts import group_facts
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.frame import carried_cameras
from gaga_core.scene.objects import group_indices, object_table
from gaga_core.scene.scene import Scene
from tests.core.query.made_scenes import BACK, FRONT, TABLE, Boxes, ball, boxes_scene, shells

VIEWS = (FRONT, BACK)


def described(scene: Scene, kept: dict[int, str] | None = None) -> dict[int, str]:
    return describe_groups(scene, group_facts(scene, VIEWS), VIEWS, kept)


@pytest.fixture
def table() -> Scene:
    return shells(TABLE)


def test_things_are_called_by_color_shape_and_size() -> None:
    words = described(shells([TABLE[0], ((0, 0, 0.4), (0.8, 0.8, 0.8), "1e50c8"), *TABLE[2:]]))
    assert words[1] == "red box"
    assert words[2] == "blue box, large"
    assert words[3] == "yellow box"
    assert words[5] == "red flat object"
    assert words[6] == "grey floor"


@pytest.mark.parametrize("factor", [0.01, 2.0, 100.0])
def test_a_scale_of_the_scene_changes_no_name_and_no_background(factor: float) -> None:
    """Areas of splats stayed as they were: a table that had grown was scattered bits."""
    things: Boxes = [((x, 0.5 * x, 0), (0.2,) * 3, "c81414") for x in (-1.2, -0.4, 0.4, 1.2)]
    table = shells([*things, ((0, 0, -0.7), (2.6, 1.6, 1.1), "8a5a2a")])
    before, facts = described(table), group_facts(table, VIEWS)
    edit = edits.set_scale(table, 1.0, factor, np.zeros(3))
    assert edit is not None
    edit.apply(table)
    views = carried_cameras(VIEWS, table.frame.world)
    after = group_facts(table, views)
    np.testing.assert_array_equal(after.background, facts.background)
    assert describe_groups(table, after, views) == before


def test_a_place_tells_apart_what_would_be_called_the_same() -> None:
    row: Boxes = [((x, 0, 0), (0.2,) * 3, "c81414") for x in (-1.2, -0.4, 0.4, 1.2)]
    words = described(shells(row))
    assert words[1] == "red box on the left"
    assert words[4] == "red box on the right"


@pytest.mark.parametrize(
    ("part", "share", "word"),
    [("f4f4f4", 0.3, "white"), ("f4f4f4", 0.05, "grey"), ("c81414", 0.4, "red"),
     ("c81414", 0.1, "grey"), ("1e50c8", 0.4, "blue")],
)  # fmt: skip
def test_white_in_shade_is_white_and_a_label_tells_more_than_its_can(
    part: str, share: float, word: str
) -> None:
    """Of a grey thing a share has another color."""
    scene = shells([((0, 0, 0), (0.2,) * 3, "a0a0a0"), *TABLE[2:]])
    own = np.flatnonzero(scene.labels == 1)
    rgb = np.array([int(part[i : i + 2], 16) / 255 for i in (0, 2, 4)])
    scene.gaussians.sh[own[: round(share * len(own))], 0] = dc_from_rgb(rgb)
    assert described(scene)[1].split()[0] == word


@pytest.mark.parametrize(("black", "word"), [(0.31, "grey"), (0.05, "white")])
def test_grey_with_more_black_than_white_is_no_white_thing(
    table: Scene, black: float, word: str
) -> None:
    """As a black suit in the light: 41 % grey, 14 % white."""
    facts = group_facts(table, VIEWS)
    colors = facts.colors.copy()
    colors[1] = 0
    for name, share in (("grey", 0.41), ("white", 0.14), ("black", black)):
        colors[1, NAMES.index(name)] = share
    said = describe_groups(table, replace(facts, colors=colors), VIEWS)
    assert said[int(facts.ids[1])].split()[0] == word


def test_of_two_alike_each_has_the_place_where_it_is_farther_out() -> None:
    """Both are on the left; one of them in front."""
    centres = ((-1.2, 0.4, 0), (-1.0, -0.6, 0))
    things: Boxes = [((x, y, z), (0.2,) * 3, "c81414") for x, y, z in centres]
    others: Boxes = [((0.3 * k, 0.1 * k, 0), (0.2,) * 3, "1e50c8") for k in range(6)]
    words = described(shells([*things, *others]))
    assert {words[1], words[2]} == {"red box on the left", "red box in front"}


def test_words_are_unique_and_never_those_of_a_name(table: Scene) -> None:
    many: Boxes = [((0.01 * k, 0.3 * k, 0), (0.2,) * 3, "c81414") for k in range(9)]
    scene = boxes_scene(many, 100)
    scene.names = {4: "red box", 5: "red box 2"}
    words = described(scene)
    assert sorted(words) == [1, 2, 3, 6, 7, 8, 9]
    assert len({*words.values(), *scene.names.values()}) == 9


def test_words_that_are_still_true_stay(table: Scene) -> None:
    """Through edits of other groups, in any order; a name always stays."""
    many: Boxes = [((0.01 * k, 0.3 * k, 0), (0.2,) * 3, "c81414") for k in range(9)]
    scene = boxes_scene(many, 100)
    history, before = History(scene), described(scene)
    for gone in (1, 3):
        history.do(edits.delete(scene, group_indices(scene, gone)))
    history.do(edits.rename(scene, 5, "Ada"))
    after = described(scene, before)
    assert after == {g: text for g, text in before.items() if g not in (1, 3, 5)}
    history.do(
        edits.recolor(scene, group_indices(scene, 2), np.diag([0.1, 0.2, 4.0]) @ np.eye(3, 4))
    )
    again = described(scene, after)
    assert not again[2].startswith("red")
    assert {g: t for g, t in again.items() if g != 2} == {g: t for g, t in after.items() if g != 2}


def test_a_size_stays_while_it_is_not_wrong() -> None:
    """It came and went as others were deleted, which move the median."""
    rows: Boxes = [
        ((1.2 * k, 0, 0), (side,) * 3, "c81414")
        for k, side in enumerate((0.4, 0.4, 0.4, 0.15, 0.3))
    ]
    before = described(shells(rows))
    assert "small" in before[4]
    fewer = shells([rows[0], *rows[3:]])
    assert "small" not in described(fewer)[2]
    assert described(fewer, {2: before[4]})[2] == before[4]
    assert "large" not in described(fewer, {2: "red box, large"})[2]


def test_words_stay_when_another_object_moves_past(table: Scene) -> None:
    """And so are the same when the move is undone."""
    ways = [-0.3, -0.6, -0.9, -1.2, -1.5, 0.3, 0.6, 0.9, 1.2]
    red: Boxes = [((0, 0, 0), (0.2,) * 3, "c81414"), ((0.05, -2.1, 0), (0.2,) * 3, "c81414")]
    others: Boxes = [
        ((0.3 * (k % 2) - 0.15, y, 0), (0.2,) * 3, "1e50c8") for k, y in enumerate(ways)
    ]
    scene = boxes_scene([*red, *others], 100)
    history, before = History(scene), described(scene)
    assert before[1].endswith("behind")
    shift = np.column_stack([np.eye(3), [0, 3.5, 0]])
    history.do(edits.transform(scene, group_indices(scene, 3), shift))
    after = described(scene, before)
    assert after[1] == before[1]
    history.undo()
    assert described(scene, after)[1] == before[1]


def test_the_list_shows_them_until_a_person_names_the_group(table: Scene) -> None:
    history = History(table)
    table.described = described(table)
    history.do(edits.rename(table, 1, "apple"))
    names = object_table(table).names
    assert names[:2] == ("apple", table.described[2])
    assert not any(re.match(r"group \d", name) for name in names)


def test_shape_words_are_those_of_the_shapes() -> None:
    def box(sides: tuple[float, float, float]) -> str:
        scene = shells([((0, 0, 0), sides, "808080")], 1200)
        return shapes_of(scene, group_facts(scene, VIEWS))[0]

    assert box((0.2, 0.2, 0.2)) == box((0.3, 0.15, 0.2)) == "box"
    assert box((0.4, 0.3, 0.04)) == "flat"
    assert box((0.9, 0.1, 0.1)) == "long"
    assert box((0.1, 0.1, 0.9)) == "tall"
    sphere = ball(1200, 0.5)
    assert shapes_of(sphere, group_facts(sphere))[0] == "round"


def test_a_wide_wall_is_no_object() -> None:
    """ "The largest green plant" was the left wall of the demo: it is thin, so of little volume."""
    room = [
        ((0, 0, -0.01), (4.2, 3.2, 0.02), "8a8a8a"),
        ((-2.1, 0.1, 1.1), (0.02, 2.3, 2.2), "209030"),
        ((1.0, 0.9, 0.4), (0.8, 0.5, 0.8), "209030"),
        ((1.6, 0.2, 0.5), (0.6, 0.02, 0.4), "1e50c8"),
        *[((0.3 * k - 0.5, -0.5, 0.1), (0.2, 0.2, 0.2), "c81414") for k in range(6)],
    ]
    scene = shells(room, 12_000)
    background = group_facts(scene, VIEWS).background
    assert background.tolist() == [True, True] + [False] * 8


def test_what_is_alone_is_no_wall() -> None:
    """A guitar that was clicked in its file was a "brown wall"."""
    guitar: Boxes = [((0, 0, 0), (1.0, 0.7, 0.06), "8a5a2a")]
    assert described(shells(guitar))[1].split()[-1] in ("object", "box")
    pair: Boxes = [((x, 0, 0), (x + 0.35, 0.05, 1.0), "8a5a2a") for x in (0.0, 0.4)]
    for name in described(shells(pair)).values():
        assert "wall" not in name, "nor next to its copy"


def test_what_is_in_no_group_gets_no_words() -> None:
    """Also where it is flat, and nothing else is background."""
    things = shells(TABLE[:4])
    means = things.gaussians.means
    loose = np.flatnonzero(things.labels == 4)
    things.labels[loose] = 0
    means[loose] = means[loose] * np.array([30, 30, 0], np.float32)
    words = described(things)
    assert sorted(words) == [1, 2, 3]
