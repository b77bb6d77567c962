"""Folders of the object list: what goes where, what follows, and what nobody loses."""

import numpy as np
import pytest

from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.folders import MOST_DEPTH, MOST_LETTERS, Folders
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene
from tests.core.scene.edits.edit_walk import walk_scene


def _do(scene: Scene, edit: Edit | None) -> None:
    assert edit is not None
    History(scene).do(edit)


def _furnished() -> Scene:
    scene = walk_scene()
    _do(scene, edits.put_in_folder(scene, (1, 2), "Kitchen"))
    _do(scene, edits.put_in_folder(scene, (3,), "Kitchen/Cups"))
    _do(scene, edits.put_in_folder(scene, (4,), "Room"))
    return scene


def test_a_folder_holds_its_objects_and_other_folders() -> None:
    scene = _furnished()
    assert scene.folders.paths == ("Kitchen", "Kitchen/Cups", "Room")
    assert scene.folders.groups("Kitchen") == (1, 2, 3)
    assert scene.folders.groups("Kit") == ()
    _do(scene, edits.put_in_folder(scene, (5,), "Room", ["Kitchen"]))
    assert scene.folders.home == {
        1: "Room/Kitchen", 2: "Room/Kitchen", 3: "Room/Kitchen/Cups", 4: "Room", 5: "Room",
    }  # fmt: skip
    _do(scene, edits.put_in_folder(scene, (3, 5), ""))
    assert scene.folders.groups("Room") == (1, 2, 4)
    assert "Room/Kitchen/Cups" in scene.folders.paths, "an empty folder stays"


def test_objects_of_a_moved_folder_stay_in_it() -> None:
    scene = _furnished()
    _do(scene, edits.put_in_folder(scene, (1, 3, 4), "New", ["Kitchen", "Kitchen/Cups"]))
    assert scene.folders.home == {
        1: "New/Kitchen",
        2: "New/Kitchen",
        3: "New/Kitchen/Cups",
        4: "New",
    }


@pytest.mark.parametrize("into", ["Kitchen", "Kitchen/Cups", "Kitchen/New"])
def test_no_folder_goes_into_itself(into: str) -> None:
    scene = _furnished()
    with pytest.raises(GagaError, match="into itself"):
        edits.put_in_folder(scene, (), into, ["Kitchen"])


def test_equal_names_get_numbers_and_paths_stay_unique() -> None:
    scene = _furnished()
    _do(scene, edits.put_in_folder(scene, (5,), "Room/Cups"))
    _do(scene, edits.put_in_folder(scene, (), "", ["Kitchen/Cups", "Room/Cups"]))
    assert scene.folders.groups("Cups") == (3,)
    assert scene.folders.groups("Cups 2") == (5,)
    with pytest.raises(GagaError, match="already"):
        edits.rename_folder(scene, "Cups", "Room")
    for name in ("", "  ", "a/b"):
        with pytest.raises(GagaError):
            edits.rename_folder(scene, "Cups", name)


def test_deleting_a_folder_keeps_what_is_in_it() -> None:
    scene = _furnished()
    _do(scene, edits.new_folder(scene, "Cups"))
    labels = scene.labels.copy()
    _do(scene, edits.delete_folder(scene, "Kitchen"))
    assert scene.folders.paths == ("Cups", "Cups 2", "Room")
    assert scene.folders.home == {3: "Cups 2", 4: "Room"}
    assert np.array_equal(scene.labels, labels)
    _do(scene, edits.put_in_folder(scene, (1,), "Room/Shelf/Top"))
    _do(scene, edits.delete_folder(scene, "Room/Shelf"))
    assert scene.folders.home[1] == "Room/Top"


def test_new_objects_go_where_those_are_that_they_come_from() -> None:
    scene = _furnished()
    rows = group_indices(scene, 3)
    _do(scene, edits.separate(scene, rows[:20]))
    _do(scene, edits.duplicate(scene, group_indices(scene, 4)))
    copy = int(scene.labels[-1])
    part = int(scene.labels[rows[0]])
    assert {scene.folders.home[3], scene.folders.home[part]} == {"Kitchen/Cups"}
    assert scene.folders.home[copy] == "Room"
    _do(scene, edits.merge_groups(scene, (1, part, copy)))
    assert scene.folders.home.keys() == {1, 2, 3, 4}
    _do(scene, edits.put_in_folder(scene, (50,), "Room"))
    assert edits.free_group(scene) == 51, "no new object is in a folder by its number"


def test_other_groups_have_other_folders_unless_they_are_the_same() -> None:
    scene = _furnished()
    labels = scene.labels[::-1].copy()
    before = scene.folders
    history = History(scene)
    history.do(
        edits.set_grouping(scene, labels, None, folders=Folders.of(before.paths, {2: "Room"}))
    )
    assert scene.folders == Folders(before.paths, {2: "Room"})
    history.undo()
    assert scene.folders == before


def test_unassigned_splats_go_into_no_folder() -> None:
    with pytest.raises(GagaError, match="no object"):
        edits.put_in_folder(walk_scene(), (0,), "Kitchen")


def test_a_script_names_folders_and_acts_on_all_that_is_in_them() -> None:
    scene = walk_scene()
    titles = run_script(
        scene,
        [
            {"op": "put_in_folder", "groups": ["mug", 3], "folder": "Kitchen/Cups"},
            {"op": "put_in_folder", "groups": [4], "folder": "Kitchen"},
            {"op": "new_folder", "folder": "Room"},
            {"op": "move_folder", "folder": "Kitchen", "into": "Room"},
            {"op": "rename_folder", "folder": "Room/Kitchen", "name": "Table"},
            {"op": "hide", "groups": ["Room/"]},
            {"op": "lock", "groups": ["Room/Table/Cups/"]},
            {"op": "delete_folder", "folder": "Room/Table/Cups"},
        ],
    )
    assert len(titles) == 8
    assert scene.folders == Folders(("Room", "Room/Table"), dict.fromkeys((2, 3, 4), "Room/Table"))
    assert set(np.unique(scene.labels[scene.state == 2])) == {4}
    assert set(np.unique(scene.labels[scene.state == 6])) == {2, 3}
    with pytest.raises(GagaError, match=r'Operation 1 .*no folder "Attic/"'):
        run_script(scene, [{"op": "hide", "groups": ["Attic/"]}])
    with pytest.raises(GagaError, match="no object is selected"):
        run_script(scene, [{"op": "put_in_folder", "folder": "Room"}])


@pytest.mark.parametrize(
    ("paths", "home"),
    [(("b", "a"), {}), (("a/b",), {}), (("a", "a/"), {}), (("a",), {1: "b"}), (("a", "a"), {})],
)
def test_folders_that_do_not_fit_each_other_are_refused(
    paths: tuple[str, ...], home: dict[int, str]
) -> None:
    with pytest.raises(ValueError, match=r"paths|home"):
        Folders(paths, home)


def test_any_paths_become_a_tree() -> None:
    made = Folders.of([" a / b ", "//", ""], {3: "c//d", 4: " "})
    assert made == Folders(("a", "a/b", "c", "c/d"), {3: "c/d"})


def test_no_name_is_so_long_that_two_folders_become_one() -> None:
    scene = walk_scene()
    long = "x" * MOST_LETTERS
    _do(scene, edits.put_in_folder(scene, (1,), f"A/{long}"))
    _do(scene, edits.put_in_folder(scene, (2,), f"B/{long}"))
    _do(scene, edits.put_in_folder(scene, (), "B", [f"A/{long}"]))
    assert len(scene.folders.paths) == 4
    assert scene.folders.home[1] != scene.folders.home[2]


def test_folders_lie_in_each_other_to_a_depth_that_a_list_can_show() -> None:
    scene = walk_scene()
    assert max(path.count("/") for path in Folders.of(["a/" * 900], {}).paths) == MOST_DEPTH - 1
    _do(scene, edits.put_in_folder(scene, (1,), "a/" * (MOST_DEPTH - 1)))
    _do(scene, edits.put_in_folder(scene, (2,), "b/c"))
    with pytest.raises(GagaError, match="nested"):
        edits.put_in_folder(scene, (), scene.folders.home[1], ["b"])
