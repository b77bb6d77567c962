"""What panels read: sorted and filtered lists, and nothing computed twice."""

import numpy as np

from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import object_table
from gaga_core.scene.scene import Scene
from gaga_studio.features.transform import motion, shift
from gaga_studio.session.scene_cache import SceneCache, SortKey, listed
from tests.scenes import objects_scene


def _scene() -> Scene:
    made = objects_scene(12, 20)
    scene = Scene.of(made.gaussians, made.labels)
    scene.names.update({3: "red Mug", 7: "mug 2", 10: "Bowl"})
    scene.labels[-5:] = 2
    return scene


def _ids(
    scene: Scene, text: str = "", sort: SortKey = "id", *, descending: bool = False
) -> list[int]:
    table = object_table(scene)
    return [int(g) for g in table.ids[listed(table, text, sort, descending)]]


def test_list_is_by_id_and_what_belongs_to_no_group_stands_last() -> None:
    scene = _scene()
    assert _ids(scene) == [*range(1, 13), 0]
    assert _ids(scene, "", "id", descending=True) == [*range(12, 0, -1), 0]


def test_names_sort_as_people_count() -> None:
    scene = _scene()
    assert _ids(scene, "", "name")[:4] == [10, 1, 2, 4]  # Bowl, group 1, group 2, group 4
    assert _ids(scene, "", "name")[-5:] == [11, 12, 7, 3, 0]


def test_splats_sort_by_number_and_equal_ones_by_id() -> None:
    scene = _scene()
    order = _ids(scene, "", "splats", descending=True)
    assert order[0] == 2
    assert order[1:-2] == [1, *range(3, 12)]
    assert order[-2:] == [12, 0]


def test_filter_takes_a_part_of_the_name_in_any_case_or_the_id() -> None:
    scene = _scene()
    assert _ids(scene, "MUG") == [3, 7]
    assert _ids(scene, " 12 ") == [12]
    assert _ids(scene, "10") == [10]  # its name is Bowl
    assert _ids(scene, "no such") == []


def test_nothing_is_computed_twice_and_nothing_is_stale() -> None:
    scene = _scene()
    history, read = History(scene), SceneCache(scene)
    table = read.objects(None, False)
    assert read.objects(None, False) is table
    assert read.selected_groups() == ()
    history.do(edits.select(scene, np.flatnonzero(scene.labels == 4)))
    assert read.selected_groups() == (4,)
    assert read.selected_indices() is read.selected_indices()
    assert read.objects(None, False) is not table
    lo, hi = read.selected_box(False)
    history.do(edits.transform(scene, read.selected_indices(), shift(np.array([1.0, 0, 0]))))
    moved = read.selected_box(False)
    np.testing.assert_allclose(moved[0] - lo, [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(moved[1] - hi, [1, 0, 0], atol=1e-6)
    history.do(edits.select(scene, np.flatnonzero(scene.labels > 0)))
    as_objects = read.selected_box(False)
    history.do(edits.merge_groups(scene, np.unique(scene.labels[scene.labels > 0]).tolist()))
    as_one = read.selected_box(False)
    assert not np.allclose(as_one, as_objects), "strays are judged in other objects now"


def test_during_a_drag_the_list_and_the_handles_stand_still() -> None:
    scene = _scene()
    history, read = History(scene), SceneCache(scene)
    history.do(edits.select(scene, np.flatnonzero(scene.labels == 4)))
    table, box = read.objects(None, False), read.selected_box(False)
    chosen, step = read.selected_indices(), shift(np.ones(3))
    history.preview_with(lambda base: edits.transform(base, chosen, step))
    assert read.objects(None, history.is_previewing) is table
    assert read.selected_box(history.is_previewing) is box
    history.commit_preview()
    assert read.objects(None, history.is_previewing) is not table


def test_motion_by_numbers() -> None:
    pivot = np.array([1.0, 2.0, 3.0])
    turn = motion(pivot, turn_degrees=(0, 0, 90))
    np.testing.assert_allclose(turn @ [2, 2, 3, 1], [1, 3, 3], atol=1e-12)
    np.testing.assert_allclose(turn @ [*pivot, 1], pivot, atol=1e-12)
    grow = motion(pivot, move=(1, 0, 0), scale=2)
    np.testing.assert_allclose(grow @ [1, 2, 4, 1], [2, 2, 5], atol=1e-12)
    # x first, then z: what points along y turns to z and stays there.
    both = motion(np.zeros(3), turn_degrees=(90, 0, 90))
    np.testing.assert_allclose(both @ [0, 1, 0, 1], [0, 0, 1], atol=1e-12)
