"""Search by words alone: facts of groups, the grammar, and answers."""

import numpy as np
import pytest

from gaga_core.camera import Camera
from gaga_core.color import dc_from_rgb
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.pipeline.search import search
from gaga_core.query.colors import NAMES
from gaga_core.query.descriptions import describe_groups
from gaga_core.query.grammar import parse
from gaga_core.query.group_facts import facts_of, group_facts
from gaga_core.query.search import FITS, Answer, name_scores
from gaga_core.query.spatial_relations import canonical_view
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from tests.core.query.made_scenes import BACK, FRONT, TABLE, UP, ball, boxes_scene, shells

NAMED = {1: "apple", 2: "toolbox", 3: "sponge", 4: "die", 5: "photo album"}


@pytest.fixture(scope="module")
def table() -> Scene:
    scene = boxes_scene(TABLE)
    scene.names = dict(NAMED)
    return scene


def ask(scene: Scene, text: str, camera: Camera | None = FRONT) -> Answer:
    return search(scene, text, cameras=(FRONT, BACK), camera=camera)


def meant(answer: Answer) -> set[int]:
    return set(answer.groups[: answer.n_meant].tolist())


# --- facts ----------------------------------------------------------------------------------------


def test_facts_measure_boxes_as_they_were_made(table: Scene) -> None:
    facts = group_facts(table, (FRONT, BACK))
    for row, (centre, sides, _) in enumerate(TABLE):
        world = facts.frame.T @ facts.centre[row]
        assert np.allclose(world, centre, atol=0.06 * max(sides))
        assert np.allclose(facts.extents[row], sorted(sides, reverse=True), rtol=0.15, atol=0.02)
        assert facts.counts[row] == 300
    assert facts.background.tolist() == [False] * 5 + [True]


def test_strays_do_not_change_a_group_much(table: Scene) -> None:
    clean = group_facts(table, (FRONT, BACK))
    means = table.gaussians.means.copy()
    means[:3] += 40  # of 300 splats of group 1
    g = table.gaussians
    strayed = Scene.of(
        Gaussians(means, g.quats, g.log_scales, g.logit_opacities, g.sh), table.labels
    )
    facts = group_facts(strayed, (FRONT, BACK))
    assert np.allclose(facts.extents[0], clean.extents[0], rtol=0.2)
    assert np.allclose(facts.centre[0], clean.centre[0], atol=0.03)


@pytest.mark.parametrize("cameras", [(), (FRONT, BACK)], ids=["alone", "views"])
def test_what_is_inside_a_thing_does_not_color_it(cameras: tuple[Camera, ...]) -> None:
    scene = ball(3000, 1.0)
    g = scene.gaussians
    inside = np.arange(3000) % 2 == 0
    g.means[inside] *= 0.6
    g.sh[:, 0] = dc_from_rgb(np.where(inside[:, None], (1, 1, 1), (0.1, 0.3, 0.8)))
    facts = group_facts(scene, cameras)
    assert facts.colors[0, NAMES.index("blue")] > 0.7


def test_the_color_of_a_thing_is_the_one_that_it_has_from_outside() -> None:
    """A red ball that shines white towards its own middle, from where nobody looks."""
    scene = ball(3000, 1.0)
    g, out = scene.gaussians, scene.gaussians.means
    sh = np.zeros((3000, 4, 3), np.float32)
    sh[:, 0] = dc_from_rgb(np.tile(np.array([0.85, 0.55, 0.55], np.float32), (3000, 1)))
    sh[:, 1:, 1:] = np.stack([-out[:, 1], out[:, 2], -out[:, 0]], axis=1)[:, :, None]
    shining = Gaussians(g.means, g.quats, g.log_scales, g.logit_opacities, sh)
    facts = group_facts(Scene.of(shining, scene.labels))
    assert facts.colors[0, NAMES.index("red")] > 0.5


def test_wood_is_brown_and_not_yellow() -> None:
    scene = boxes_scene([((0, 0, 0), (0.2,) * 3, "9a6a3a"), ((0, 0, 0), (0.2,) * 3, "c8981e"),
                         ((1, 0, 0), (0.2,) * 3, "f0d010")])  # fmt: skip
    scene.labels[:600] = 1
    scene.gaussians.sh[300:400] = scene.gaussians.sh[0]  # the grain: more brown than gold
    assert meant(ask(scene, "yellow")) == {3}
    assert meant(ask(scene, "brown")) == {1}


def test_one_huge_splat_does_not_color_a_group() -> None:
    scene = boxes_scene(TABLE)
    g = scene.gaussians
    scales, sh = g.log_scales.copy(), g.sh.copy()
    scales[5] += np.log(20)  # as large as all others of group 1 together, and white
    sh[5] = dc_from_rgb(np.ones((1, 3), np.float32))
    huge = Scene.of(Gaussians(g.means, g.quats, scales, g.logit_opacities, sh), scene.labels)
    assert 1 in meant(ask(huge, "red"))
    assert 1 not in meant(ask(huge, "white"))


def test_crumbs_over_a_large_place_are_no_object() -> None:
    """A few splats of the floor and the walls that an association left in a group of their own."""
    scene = boxes_scene([*TABLE, ((0, 0, 0.3), (2.5, 2.5, 0.8), "8a8a8a")])
    few = np.flatnonzero(scene.labels == 7)[60:]
    gone = edits.delete(scene, few)
    assert gone is not None
    History(scene).do(gone)
    assert ask(scene, "largest").groups[0] == 2
    assert ask(scene, "tallest").groups[0] in (2, 4)
    whole = boxes_scene([*TABLE, ((0, 0, 0.3), (2.5, 2.5, 0.8), "8a8a8a")], per_box=30_000)
    assert ask(whole, "largest").groups[0] == 7  # the same place filled is a thing


def test_facts_do_not_depend_on_ids_order_or_the_way_up() -> None:
    plain = boxes_scene(TABLE)
    rng = np.random.default_rng(1)
    order = rng.permutation(len(plain))
    ids = np.array([0, 900_000_000, 5, 77, 3, 12, 40], np.int32)  # too large for a table
    g = plain.gaussians.take(order)
    mixed = Scene.of(g, ids[plain.labels[order]])
    a, b = group_facts(plain, (FRONT, BACK)), group_facts(mixed, (FRONT, BACK))
    rows = np.array([b.row(int(i)) for i in ids[1:]])
    assert np.allclose(a.extents, b.extents[rows], rtol=1e-3)
    assert np.allclose(a.colors, b.colors[rows], atol=1e-5)
    assert np.allclose(a.centre, b.centre[rows], atol=1e-4)
    # The same scene lying on its side, cameras turned along.
    turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]])
    moved = plain.gaussians.means @ turn.T.astype(np.float32)
    lying = Scene.of(
        Gaussians(np.ascontiguousarray(moved), g.quats, g.log_scales, g.logit_opacities,
                  plain.gaussians.sh),
        plain.labels,
    )  # fmt: skip
    pose = np.eye(4)
    pose[:3, :3] = turn.T
    turned = [
        Camera(c.K, c.cam_from_world @ pose, c.width, c.height, c.name) for c in (FRONT, BACK)
    ]
    c = group_facts(lying, turned)
    assert np.allclose(a.height, c.height, rtol=0.02)
    assert np.allclose(a.extents, c.extents, rtol=0.02)


def test_facts_are_kept_until_the_scene_changes(table: Scene) -> None:
    scene = boxes_scene(TABLE)
    cameras = (FRONT, BACK)
    first = facts_of(scene, cameras)
    assert facts_of(scene, cameras) is first
    history = History(scene)
    rename = edits.rename(scene, 1, "thing")
    assert rename is not None
    history.do(rename)
    assert facts_of(scene, cameras) is first
    gone = edits.delete(scene, np.flatnonzero(scene.labels == 2))
    assert gone is not None
    history.do(gone)
    assert 2 not in facts_of(scene, cameras).ids
    history.undo()
    assert 2 in facts_of(scene, cameras).ids


# --- the grammar ----------------------------------------------------------------------------------


def test_what_phrases_are_made_of() -> None:
    phrase = parse("the second largest red or blue mug to the left of the big bowl")
    assert phrase.superlative is not None
    assert (phrase.superlative.word, phrase.superlative.rank) == ("largest", 2)
    assert [(t.kind, t.words) for t in phrase.traits] == [
        ("color", ("red", "blue")),
        ("noun", ("mug",)),
    ]
    (relation,) = phrase.relations
    assert relation.kind == "left"
    assert [t.words for t in relation.anchors[0].traits] == [("big",), ("bowl",)]
    between = parse("between the cup and the blue jar").relations[0]
    assert [t.words for a in between.anchors for t in a.traits] == [("cup",), ("blue",), ("jar",)]
    assert parse("power drill").traits[0].words == ("power drill",)
    assert parse("").is_empty
    assert parse("the thing").is_empty
    assert parse("not red").traits[0].negated


@pytest.mark.parametrize(
    "texts",
    [
        ("red", "RED", "the red one", "show me all red objects", "objects that are red"),
        ("largest", "biggest", "the largest object", "find the bigest thing"),
        ("leftmost", "far left", "the one on the left", "most left"),
        ("the red one left of the blue one", "red to the left of the blue box"),
        ("closest to the die", "nearest to the die"),
    ],
)
def test_ways_to_say_the_same_have_the_same_answer(table: Scene, texts: tuple[str, ...]) -> None:
    answers = [ask(table, text) for text in texts]
    for answer in answers[1:]:
        assert answer.groups[0] == answers[0].groups[0], texts
        assert meant(answer) == meant(answers[0])


def test_random_words_never_break_the_parser(table: Scene) -> None:
    rng = np.random.default_rng(0)
    words = [
        "red", "not", "the", "left", "of", "between", "and", "or", "largest", "mug", "on", "top",
        "nearest", "to", "second", "bowl", "in", "front", "dark", "than", "bigger", "12", "zebra",
    ]  # fmt: skip
    texts = [" ".join(rng.choice(words, rng.integers(1, 9))) for _ in range(300)]
    for text in (*texts, "", "   ", "?!", "of the", "and or not", "left of", "(((", "\0"):
        answer = ask(table, text)
        assert ((answer.scores >= 0) & (answer.scores <= 1)).all(), text
        assert (np.diff(answer.scores) <= 1e-6).all()
        assert 0 <= answer.n_meant <= len(answer.groups)
        assert answer.sentence.endswith("."), text
        assert len(set(answer.groups.tolist())) == len(answer.groups)


def test_names_fit_exact_plural_prefix_misspelt_in_that_order() -> None:
    names = ["mug", "mugs", "table lamp", "lamp", "005_tomato_soup_can", "group 12"]
    assert name_scores("mug", names)[0] == 1
    exact, plural = name_scores("mug", names)[:2]
    assert exact > plural >= 0.9
    assert name_scores("lamp", names)[3] > name_scores("lamp", names)[2] >= FITS
    assert name_scores("soup can", names)[4] >= 0.8
    assert name_scores("tomto soup can", names)[4] >= FITS
    assert name_scores("toma", names)[4] > 0
    assert name_scores("12", names)[5] > 0.8
    assert name_scores("zebra", names).max() == 0


# --- answers --------------------------------------------------------------------------------------


def test_colors_sizes_and_places_on_the_made_table(table: Scene) -> None:
    assert meant(ask(table, "red")) == {1, 5}
    assert meant(ask(table, "not red")) == {2, 3, 4}
    assert meant(ask(table, "red or yellow")) == {1, 3, 5}
    assert ask(table, "largest").groups[0] == 2
    assert ask(table, "smallest").groups[0] == 4
    assert ask(table, "second largest").groups[0] != 2
    assert ask(table, "largest red").groups[0] == 5
    assert ask(table, "leftmost").groups[0] == 1
    assert ask(table, "leftmost", BACK).groups[0] == 3
    assert ask(table, "rightmost").groups[0] == 3
    assert ask(table, "farthest").groups[0] == 5
    assert ask(table, "nearest", BACK).groups[0] == 5
    assert meant(ask(table, "nearest red")) == {1}
    assert meant(ask(table, "nearest to the die")) == {2}
    assert ask(table, "highest").groups[0] == 4
    assert meant(ask(table, "on the toolbox")) == {4}
    assert meant(ask(table, "on top of the blue one")) == {4}
    assert meant(ask(table, "under the die")) == {2}
    assert meant(ask(table, "red left of the toolbox")) == {1}
    assert meant(ask(table, "between the apple and the sponge")) >= {2}
    assert meant(ask(table, "red behind the toolbox")) == {5}
    assert meant(ask(table, "in front of the photo album")) >= {2, 3}
    assert meant(ask(table, "bigger than the sponge")) >= {2}
    assert meant(ask(table, "the sponge that is not yellow")) == set()


def test_sentences_say_what_was_understood(table: Scene) -> None:
    assert ask(table, "red").sentence == "2 red objects."
    assert ask(table, "largest red").sentence == (
        "The largest of the 2 red objects, background and supports aside."
    )
    front = ask(table, "leftmost", None).sentence
    assert front == "The leftmost of the 5 objects, as seen from front.png."
    answer = ask(table, "red zebra")
    assert answer.unknown == ("zebra",)
    assert answer.sentence == (
        "2 red objects. Nothing here is called “zebra”: name it, or index the scene with a model."
    )
    lost = ask(table, "zebra")
    assert (len(lost.groups), lost.n_meant) == (0, 0)
    assert "Try a name, a color, a size or a place." in lost.sentence
    nowhere = search(boxes_scene(TABLE), "leftmost")
    assert nowhere.sentence.endswith("Places need a view.")


def test_the_floor_wins_no_superlative_but_is_found_by_its_word(table: Scene) -> None:
    for text in ("largest", "longest", "widest", "grey", "lowest"):
        assert 6 not in ask(table, text).groups, text
    assert ask(table, "floor").groups[0] == 6
    assert ask(table, "the background").groups[0] == 6
    assert meant(ask(table, "red on the floor")) == {1, 5}


def test_left_and_right_are_opposite_and_turn_with_the_view(table: Scene) -> None:
    for camera, other in ((FRONT, BACK), (BACK, FRONT)):
        left = {
            (a, b)
            for b, name in NAMED.items()
            for a in meant(ask(table, f"left of the {name}", camera))
        }
        right = {
            (b, a)
            for b, name in NAMED.items()
            for a in meant(ask(table, f"right of the {name}", camera))
        }
        turned = {
            (a, b)
            for b, name in NAMED.items()
            for a in meant(ask(table, f"right of the {name}", other))
        }
        assert left == right
        assert len(left) >= 6
        assert len(left & turned) >= 6


def test_names_beat_colors_where_a_word_is_both() -> None:
    scene = boxes_scene([((0, 0, 0), (0.1,) * 3, "209030"), ((1, 0, 0), (0.1,) * 3, "f08020")])
    scene.names = {1: "orange"}
    answer = ask(scene, "orange")
    assert meant(answer) == {1, 2}
    assert answer.groups[0] == 1


@pytest.mark.parametrize("color", ["red", "blue", "yellow"])
def test_a_superlative_is_the_extreme_of_what_fits(table: Scene, color: str) -> None:
    facts = facts_of(table, (FRONT, BACK))
    sizes = {group: facts.size[facts.row(group) or 0] for group in meant(ask(table, color))}
    assert ask(table, f"largest {color}").groups[0] == max(sizes, key=lambda g: sizes[g])
    assert ask(table, f"smallest {color}").groups[0] == min(sizes, key=lambda g: sizes[g])


def test_a_recolored_object_is_found_by_its_new_color() -> None:
    scene = boxes_scene(TABLE)
    color = np.concatenate([np.zeros((3, 3)), np.array([[0.1], [0.6], [0.15]])], axis=1)
    edit = edits.recolor(scene, np.flatnonzero(scene.labels == 1).astype(np.int32), color)
    assert edit is not None
    assert 1 in meant(ask(scene, "red")) - meant(ask(scene, "green"))
    History(scene).do(edit)
    assert 1 in meant(ask(scene, "green")) - meant(ask(scene, "red"))


def test_an_object_of_many_colors_has_none_of_them() -> None:
    codes = ("c81414", "1e50c8", "209030", "f57c14", "f0d010")
    scene = boxes_scene([((0, 0, 0.1 * k), (0.3, 0.3, 0.1), c) for k, c in enumerate(codes)])
    scene.labels[:] = 1
    assert not any(meant(ask(scene, color)) for color in ("red", "blue", "green"))


def test_canonical_view_is_the_one_that_shows_most(table: Scene) -> None:
    facts = facts_of(table, (FRONT, BACK))
    away = Camera(FRONT.K, look_at(np.array([0, -4.0, 1]), np.array([0, -9.0, 1]), UP), 640, 480)
    assert canonical_view(facts, (away, BACK)) is BACK
    assert canonical_view(facts, (BACK, FRONT)) is FRONT  # the first by name of equals
    assert canonical_view(facts, ()) is None


def test_a_name_of_words_that_say_nothing_alone_is_found() -> None:
    """ "Nothing to look for", though an object was called so."""
    scene = boxes_scene(TABLE)
    for group, name in enumerate(("Second", "the other", "of and"), 1):
        scene.names = {group: name}
        assert meant(ask(scene, name)) == {group}


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_what_is_called_by_a_color_is_meant_by_it(seed: int) -> None:
    """Four objects were called red, and "red" counted three."""
    rng = np.random.default_rng(seed)
    rows = [((float(k % 8), float(k // 8), 0.2), (0.4, 0.4, 0.4), "808080") for k in range(40)]
    scene = shells([*rows, ((4.0, 2.5, -0.01), (30.0, 30.0, 0.02), "8a8a8a")])
    for group in range(1, 41):  # of up to five colors
        own = np.flatnonzero(scene.labels == group)
        n = int(rng.integers(1, 6))
        which, shades = (
            rng.choice(n, len(own), p=rng.dirichlet((2,) * n)),
            rng.uniform(0.1, 0.9, (n, 3)),
        )
        scene.gaussians.sh[own, 0] = dc_from_rgb(shades.astype(np.float32))[which]
    facts = group_facts(scene, (FRONT, BACK))
    scene.described = describe_groups(scene, facts, (FRONT, BACK))
    for name in NAMES:
        called = {g for g, w in scene.described.items() if w.split()[0] == name and g <= 40}
        assert called <= meant(ask(scene, name)), name
