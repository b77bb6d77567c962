"""Edit scripts: every operation, and every mistake in one sentence."""

import base64
import tracemalloc
import zlib

import numpy as np
import pytest

from gaga_core.camera import Camera
from gaga_core.edit_script import parse_script, run_script
from gaga_core.errors import GagaError
from gaga_core.query.group_facts import outside_color
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import group_indices, selected_indices
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import world_means
from tests.core.scene.edits.edit_walk import snapshot, walk_scene
from tests.scenes import objects_scene

_BOMB = base64.b64encode(zlib.compress(bytes(200_000_000), 1)).decode()  # 200 MB of zeros


def test_a_script_does_what_the_window_does() -> None:
    scene = walk_scene()
    history = History(scene)
    three, four = group_indices(scene, 3), group_indices(scene, 4)
    start = world_means(scene).astype(np.float64)
    titles = run_script(
        scene,
        [
            {"op": "recolor", "groups": [3], "color": [0.9, 0.1, 0.1]},
            {"op": "move", "groups": [3], "by": [0, 0, 1]},
            {"op": "rotate", "groups": [4], "axis": [0, 0, 2], "degrees": 90, "about": [1, 0, 0]},
            {"op": "duplicate", "groups": ["mug"], "by": [5, 0, 0]},
            {"op": "delete", "groups": [5]},
            {"op": "rename", "groups": [3], "name": "bowl"},
            {"op": "merge", "groups": [6, 1]},
            {"op": "isolate", "groups": ["bowl", "mug 2"]},
        ],
        history,
    )
    assert titles == (
        "Recolor", "Move", "Rotate", "Duplicate", "Delete", "Rename", "Merge", "Isolate",
    )  # fmt: skip
    now = world_means(scene)
    assert np.allclose(now[three], start[three] + [0, 0, 1], atol=1e-5)
    x, y, z = (start[four] - [1, 0, 0]).T
    assert np.allclose(now[four], np.stack([1 - y, x, z], axis=1), atol=1e-5)
    assert np.allclose(outside_color(scene, three), [0.9, 0.1, 0.1], atol=1e-5)
    assert scene.has(State.DELETED)[scene.labels == 5].all()
    assert not (scene.labels == 1).any()
    assert set(np.unique(scene.labels[scene.visible])) == {3, 8}
    assert len(history.entries()) == 8


def test_operations_without_groups_act_on_the_selection() -> None:
    scene = walk_scene()
    start = snapshot(scene)
    run_script(
        scene,
        [
            {"op": "select", "groups": [2]},
            {"op": "select", "groups": [3], "how": "add"},
            {"op": "scale", "factor": 2},
            {"op": "delete"},
        ],
    )
    assert scene.has(State.DELETED).sum() == np.isin(scene.labels, [2, 3]).sum()
    with pytest.raises(GagaError, match=r'Operation 1 \("hide"\): nothing is selected'):
        run_script(scene, [{"op": "hide"}])
    titles = run_script(
        scene, [{"op": "restore"}, {"op": "select_all"}, {"op": "undo", "times": 2}]
    )
    assert titles == ("Restore deleted", "Select", "Undo Select, Restore deleted")
    assert start.names == scene.names


def test_scaling_keeps_the_middle_where_it_is() -> None:
    scene = walk_scene()
    splats = group_indices(scene, 2)
    before = world_means(scene, splats).astype(np.float64)
    run_script(scene, [{"op": "scale", "groups": [2], "factor": [2, 1, 3]}])
    centre = before.mean(axis=0)
    want = centre + (before - centre) * [2, 1, 3]
    assert np.allclose(world_means(scene, splats), want, atol=1e-5)


def test_what_is_kept_under_a_name_is_selected_again_and_inverted() -> None:
    scene = walk_scene()
    kept = [{"op": "keep_set", "name": "a", "groups": [2]}, {"op": "select_set", "name": "a"}]
    run_script(scene, kept)
    assert selected_indices(scene).tolist() == group_indices(scene, 2).tolist()
    run_script(scene, [{"op": "select_all"}, {"op": "invert"}])
    assert len(selected_indices(scene)) == 0


def test_the_scene_is_aligned_as_one() -> None:
    scene = walk_scene()
    points = {"points": [[0, 0, 0], [1, 0, 0], [0, 1, 1]], "seen_from": [0, 0, 9]}
    hidden = [{"op": "hide", "groups": [2]}, {"op": "lock", "groups": [3]}]
    run_script(scene, [*hidden, {"op": "align_to_ground", **points}])
    assert (scene.placement > 0).all()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ({"op": "hide"}, "must be a JSON list"),
        (["hide"], r'Operation 1 .*"op"'),
        ([{"op": "hide", "groups": [1]}, {"op": "explode"}], r'Operation 2: "explode" is unknown'),
        ([{"op": "move", "groups": [3]}], r'Operation 1 \("move"\): field "by" is missing'),
        (
            [{"op": "move", "by": [1, 2]}],
            r'field "by" must be a list of 3 numbers up to 1e\+18, not \[1, 2\]',
        ),
        ([{"op": "move", "by": [1, 2, "x"]}], r'field "by" must be a list of 3 numbers'),
        ([{"op": "move", "by": [1, 2, float("nan")]}], r'field "by" must be a list of 3 numbers'),
        ([{"op": "move", "by": [1, 2, True]}], r'field "by" must be a list of 3 numbers'),
        ([{"op": "delete", "group": [3]}], r'field "group" is unknown; it takes groups'),
        ([{"op": "show_all", "groups": [3]}], r"it takes no fields"),
        ([{"op": "delete", "groups": []}], r'field "groups" must be a list of group ids'),
        ([{"op": "delete", "groups": 3}], r'field "groups" must be a list of group ids'),
        ([{"op": "recolor", "color": [2, 0, 0]}], r"between 0 and 1"),
        ([{"op": "scale", "factor": 0}], r'field "factor" must be above 0'),
        ([{"op": "undo", "times": 0}], r'field "times" must be a whole number'),
        ([{"op": "duplicate", "new_group": 1}], r'field "new_group" must be true or false'),
        ([{"op": "rename", "groups": [2], "name": 3}], r'field "name" must be a text'),
        ([{"op": "transform", "matrix": [[1, 0, 0, 0]]}], r'field "matrix" must be 3 rows'),
        ([{"op": "select", "groups": [1], "how": "xor"}], r'field "how" must be set'),
        ([{"op": "rotate", "groups": [2], "axis": [0, 0, 0], "degrees": 3}], r"must not be zero"),
        ([{"op": "transform", "groups": [2], "matrix": [[0] * 4] * 3}], r"flattens space"),
        ([{"op": "recolor", "groups": [2]}], r'give "color", "opacity" or both'),
        ([{"op": "rename", "groups": [2, 3], "name": "x"}], r"give one object"),
        ([{"op": "merge", "groups": [0, 3]}], r"unassigned"),
        ([{"op": "delete", "groups": [77]}], r'Operation 1 \("delete"\): there is no group 77'),
        ([{"op": "delete", "groups": ["cup"]}], r"there is no group 'cup'"),
        ([{"op": "select_range", "column": "weight"}], r"'weight' is not one of opacity"),
        ([{"op": "select_box", "lo": [0, 0, 0]}], r'give "lo" and "hi", or "matrix"'),
        ([{"op": "crop", "lo": [0, 0, 0], "hi": [1, 0, 1]}], r"no length"),
        ([{"op": "select_set", "name": "a"}], r'no selection named "a"'),
        ([{"op": "grade", "groups": [2], "temperature": 3}], r"between -1 and 1"),
        ([{"op": "grade", "groups": [2], "saturation": 9}], r"saturation: expected 0..4, got 9"),
        ([{"op": "mirror", "groups": [2], "axis": "up"}], r"must be x, y or z"),
        (
            [{"op": "align_to_ground", "points": [[0, 0, 0]], "seen_from": [0, 0, 1]}],
            r"must be 3 points",
        ),
        ([{"op": "separate"}], r"nothing is selected"),
        ([{"op": "split", "groups": [2, 3]}], r"give one object"),
    ],
)
def test_mistakes_are_one_plain_sentence(content: object, sentence: str) -> None:
    scene = walk_scene()
    before = snapshot(scene)
    with pytest.raises(GagaError, match=sentence) as error:
        run_script(scene, content)
    assert "\n" not in str(error.value)
    assert snapshot(scene) == before


def test_the_whole_script_is_checked_before_anything_is_done() -> None:
    scene = walk_scene()
    before = snapshot(scene)
    with pytest.raises(GagaError, match="Operation 2"):
        run_script(scene, [{"op": "hide", "groups": [1]}, {"op": "move"}])
    assert snapshot(scene) == before
    assert [op.kind for op in parse_script([{"op": "show_all"}])] == ["show_all"]


def test_undoing_more_than_there_is_ends_at_once() -> None:
    scene = Scene.of(objects_scene().gaussians, objects_scene().labels)
    times = {"times": 1_000_000_000}
    steps = [{"op": "hide", "groups": [1]}, {"op": "undo", **times}, {"op": "redo", **times}]
    assert run_script(scene, steps) == ("Hide", "Undo Hide", "Redo Hide")


_N = 2**31 - 1
_HUGE: list[dict[str, object]] = [
    {"kind": "flip", "n": _N, "flips": [[1, {"n": _N, "count": _N, "runs": [[0, _N]]}]]},
    {"kind": "flip", "n": 10**18, "flips": []},
    {"kind": "flip", "n": 9, "flips": [[1, {"n": 9, "count": 9, "runs": [[0, 10**12]]}]]},
    {"kind": "flip", "n": 9, "flips": [[10**9, {"n": 9, "count": 0, "runs": []}]]},
    {
        "kind": "labels",
        "splats": {"n": 9, "count": 1, "runs": [[0, 1]]},
        "before": {"count": _N, "all": 1},
        "after": {"count": 1, "dtype": "int32", "data": _BOMB},
    },
    {"kind": "flip", "n": 9, "flips": [[1, {"n": 9, "count": 3, "list": _BOMB}]]},
]


@pytest.mark.parametrize("edit", _HUGE, ids=range(len(_HUGE)))
def test_recorded_edits_of_more_rows_than_there_are_take_no_memory(
    edit: dict[str, object],
) -> None:
    scene = Scene.of(objects_scene().gaussians, objects_scene().labels)
    tracemalloc.start()
    try:
        with pytest.raises(GagaError, match=r"damaged|another scene"):
            run_script(scene, [{"op": "edit", "title": "x", **edit}])
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "step",
    [
        {"op": "move", "groups": [1], "by": [10**400, 0, 0]},
        {"op": "move", "groups": [1], "by": [1e300, 0, 0]},
        {"op": "select", "groups": [10**30]},
        {"op": "select_range", "column": "x", "low": 10**400},
    ],
    ids=range(4),
)
def test_numbers_beyond_all_scenes_are_a_sentence(step: dict[str, object]) -> None:
    scene = Scene.of(objects_scene().gaussians, objects_scene().labels)
    with pytest.raises(GagaError, match="Operation 1"):
        run_script(scene, [step])


def test_cameras_are_placed_only_for_what_looks_through_them() -> None:
    def views() -> tuple[Camera, ...]:
        raise AssertionError("nothing was filled")

    scene = walk_scene()
    assert run_script(scene, [{"op": "hide", "groups": [3]}, {"op": "undo"}], views=views)
