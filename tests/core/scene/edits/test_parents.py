"""Objects under other objects: what goes along, what nobody can do, and what stays sane."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History, HistoryRecord
from gaga_core.scene.edits.wire import of_json, to_json
from gaga_core.scene.folders import Folders
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene
from tests.core.scene.edits.edit_walk import walk_scene


def _do(scene: Scene, edit: Edit | None) -> None:
    assert edit is not None
    History(scene).do(edit)


def _laid() -> Scene:
    """3 under 2 under 1, which is in a folder; 5 under 4."""
    scene = walk_scene()
    _do(scene, edits.put_in_folder(scene, (1,), "Kitchen"))
    for child, parent in ((2, 1), (3, 2), (5, 4)):
        _do(scene, edits.set_parent(scene, (child,), parent))
    return scene


def test_what_lies_under_an_object_goes_where_it_goes() -> None:
    scene = _laid()
    assert scene.folders.under(1) == (2, 3)
    assert scene.folders.groups("Kitchen") == (1, 2, 3)
    _do(scene, edits.set_parent(scene, (2,), 5))
    assert scene.folders.under(4) == (2, 3, 5)
    assert scene.folders.groups("Kitchen") == (1,)
    _do(scene, edits.put_in_folder(scene, (4, 3), "Room"))
    assert scene.folders.home == {1: "Kitchen", 4: "Room"}, "3 lies under 4: it stays there"
    assert scene.folders.groups("Room") == (2, 3, 4, 5)
    _do(scene, edits.put_in_folder(scene, (3,), ""))
    assert scene.folders.parent == {2: 5, 5: 4}, "the top is under nothing"


def test_an_object_that_leaves_goes_next_to_what_it_lay_under() -> None:
    scene = _laid()
    _do(scene, edits.leave_parent(scene, (3,)))
    assert scene.folders.parent == {2: 1, 3: 1, 5: 4}
    _do(scene, edits.leave_parent(scene, (2, 3, 5)))
    assert scene.folders == Folders(("Kitchen",), {1: "Kitchen", 2: "Kitchen", 3: "Kitchen"})
    assert edits.leave_parent(scene, (1, 2)) is None


@pytest.mark.parametrize(("groups", "parent"), [((1,), 1), ((1,), 3), ((4, 2), 3), ((1, 2), 3)])
def test_no_object_goes_under_itself(groups: tuple[int, ...], parent: int) -> None:
    scene = _laid()
    with pytest.raises(GagaError, match="under itself"):
        edits.set_parent(scene, groups, parent)


@pytest.mark.parametrize(("groups", "parent"), [((0,), 1), ((1,), 0)])
def test_nothing_lies_under_unassigned(groups: tuple[int, ...], parent: int) -> None:
    with pytest.raises(GagaError, match="no object"):
        edits.set_parent(walk_scene(), groups, parent)


def test_copies_lie_under_copies_and_parts_next_to_what_they_come_from() -> None:
    scene = _laid()
    _do(scene, edits.duplicate(scene, group_indices(scene, (1, 2, 3))))
    one, two, three = 8, 9, 10  # the bank knows of 7
    assert scene.folders.parent == {2: 1, 3: 2, 5: 4, two: one, three: two}
    assert scene.folders.home == {1: "Kitchen", one: "Kitchen"}
    _do(scene, edits.duplicate(scene, group_indices(scene, 3)))
    assert scene.folders.parent[11] == 2, "a copy of the lid alone belongs to the same teapot"
    _do(scene, edits.separate(scene, group_indices(scene, 5)[:9]))
    assert scene.folders.parent[12] == 4
    _do(scene, edits.set_parent(scene, (40,), 50))
    assert edits.free_group(scene) == 51


@pytest.mark.parametrize(
    ("merged", "parent", "home"),
    [
        ((2, 1), {3: 2, 5: 4}, {2: "Kitchen"}),  # goes where what it lay under was
        ((1, 2), {3: 1, 5: 4}, {1: "Kitchen"}),
        ((3, 1), {2: 3, 5: 4}, {3: "Kitchen"}),  # 2 was between them
        ((3, 4), {2: 1, 3: 2, 5: 3}, {1: "Kitchen"}),
        ((5, 1, 4), {2: 5, 3: 2}, {}),
        ((4, 1, 3), {2: 4, 5: 4}, {}),
    ],
)
def test_what_lay_under_merged_objects_lies_under_the_one(
    merged: tuple[int, ...], parent: dict[int, int], home: dict[int, str]
) -> None:
    scene = _laid()
    _do(scene, edits.merge_groups(scene, merged))
    assert scene.folders == Folders(("Kitchen",), home, parent)


def test_other_ids_keep_the_order_and_skip_what_is_gone() -> None:
    order = _laid().folders
    assert order.renumbered({1: 1, 3: 30, 5: 6}) == Folders(("Kitchen",), {1: "Kitchen"}, {30: 1})
    assert order.renumbered({2: 20, 3: 30}) == Folders(("Kitchen",), {20: "Kitchen"}, {30: 20})


@pytest.mark.parametrize(
    ("home", "parent"), [({}, {1: 1}), ({}, {1: 2, 2: 3, 3: 1}), ({}, {1: 0}), ({1: "a"}, {1: 2})]
)
def test_an_order_that_cannot_be_is_refused(home: dict[int, str], parent: dict[int, int]) -> None:
    with pytest.raises(ValueError, match=r"parent|home"):
        Folders(("a",), home, parent)


def test_a_long_chain_is_read_in_one_pass() -> None:
    n = 200_000
    order = Folders.of((), {1: "a"}, {i + 1: i for i in range(1, n)})
    assert len(order.under(1)) == n - 1
    assert order.places[n] == "a"
    with pytest.raises(ValueError, match="under itself"):
        Folders.of((), {}, {**order.parent, 1: n})


def test_a_script_puts_objects_under_others_and_names_them_with_what_is_under_them() -> None:
    scene = walk_scene()
    titles = run_script(
        scene,
        [
            {"op": "set_parent", "groups": [3, "group 4"], "parent": "mug"},
            {"op": "set_parent", "groups": [5], "parent": 3},
            {"op": "hide", "groups": ["mug/"]},
            {"op": "lock", "groups": ["3/"]},
            {"op": "leave_parent", "groups": [3]},
        ],
    )
    assert len(titles) == 5
    assert scene.folders.parent == {4: 2, 5: 3}
    hidden, locked = (sorted(set(scene.labels[scene.state & bit > 0].tolist())) for bit in (2, 4))
    assert (hidden, locked) == ([2, 3, 4, 5], [3, 5])
    with pytest.raises(GagaError, match="under itself"):
        run_script(scene, [{"op": "set_parent", "groups": ["mug"], "parent": 4}])
    with pytest.raises(GagaError, match='no folder "0/"'):
        run_script(scene, [{"op": "hide", "groups": ["0/"]}])


_GROUP = st.integers(1, 6)
_STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("under"), st.lists(_GROUP, min_size=1, max_size=3), _GROUP),
        st.tuples(st.just("leave"), st.lists(_GROUP, min_size=1, max_size=3), st.just(0)),
        st.tuples(st.just("merge"), st.lists(_GROUP, min_size=2, max_size=3), st.just(0)),
        st.tuples(st.just("folder"), st.lists(_GROUP, min_size=1, max_size=3), st.just(0)),
        st.tuples(st.just("copy"), st.lists(_GROUP, min_size=1, max_size=3), st.just(0)),
        st.tuples(st.just("undo"), st.just([1]), st.just(0)),
    ),
    max_size=12,
)


def _built(scene: Scene, step: tuple[str, list[int], int]) -> Edit | None:
    kind, groups, parent = step
    if kind == "under":
        return edits.set_parent(scene, groups, parent)
    if kind == "leave":
        return edits.leave_parent(scene, groups)
    if kind == "merge":
        return edits.merge_groups(scene, groups)
    if kind == "folder":
        return edits.put_in_folder(scene, groups, "a/b")
    return edits.duplicate(scene, group_indices(scene, groups))


@settings(max_examples=60, deadline=None)
@given(_STEPS)
def test_no_order_of_steps_makes_a_cycle_or_loses_an_order(
    steps: list[tuple[str, list[int], int]],
) -> None:
    scene = walk_scene(40, sh_degree=0)
    history, seen = History(scene), [scene.folders]
    for step in steps:
        if step[0] == "undo":
            if history.undo() is not None:
                seen.pop()
            continue
        before = scene.folders
        try:
            edit = _built(scene, step)
        except GagaError:
            parent = step[2]
            tops = before.tops_of(step[1])
            assert not {parent, *before.above(parent)}.isdisjoint(tops), "refused without a cycle"
            continue
        if edit is None or not history.do(edit):
            continue
        content = to_json(edit)
        assert to_json(of_json(content)) == content
        seen.append(scene.folders)
    while len(seen) > 1:
        assert scene.folders == seen.pop()
        assert history.undo() is not None
    assert scene.folders == seen.pop()


def test_a_damaged_step_that_puts_an_object_under_itself_is_one_sentence() -> None:
    """Redo raised a `ValueError`: a project's history is checked when a step is done again."""
    scene = _laid()
    _do(scene, edits.put_in_folder(scene, (1,), ""))
    edit = edits.set_parent(scene, (4,), 3)
    assert edit is not None
    damaged = of_json({**to_json(edit), "moved": [], "parents": [[1, None, 3]]}, len(scene))
    before, history = scene.folders, History(scene)
    history.resume(HistoryRecord((damaged,), 0, ()))
    with pytest.raises(GagaError, match=r"is damaged .* lies under itself"):
        history.redo()
    assert scene.folders is before
