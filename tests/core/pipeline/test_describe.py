"""What is said of groups: which are background, and what they lie under."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.cli.output import object_names
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline.search import describe, describe_project, list_objects
from gaga_core.progress import run_stage
from gaga_core.query.group_facts import group_facts
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.frame import carried_cameras
from gaga_core.scene.objects import group_indices
from gaga_core.scene.project import Project, open_path_stage, save_project
from tests.core.query.made_scenes import BACK, FRONT, TABLE, boxes_scene, camera_at, shells

VIEWS = (FRONT, BACK)
_BLOCK = 2  # of TABLE: the large blue box, which by itself is a thing


def test_what_the_association_found_to_surround_the_scene_is_called_background() -> None:
    scene = boxes_scene(TABLE)
    alone = describe(scene, group_facts(scene, VIEWS), VIEWS)
    assert _BLOCK not in alone.background
    assert "box" in alone.words[_BLOCK] or "object" in alone.words[_BLOCK]
    levels = Levels(scene.labels[None], 0, background=_BLOCK)
    scene.bank = MemoryBank(scene.labels, int(scene.labels.max()), preset="robust", levels=levels)
    found = describe(scene, group_facts(scene, VIEWS), VIEWS)
    assert _BLOCK in found.background
    assert found.words[_BLOCK] == "blue background"
    things = set(np.unique(scene.labels).tolist()) - found.background
    assert all("background" not in found.words[group] for group in things)


def test_the_parent_of_a_listed_object_is_listed() -> None:
    """The one between them was deleted: `gaga info --json` named an id that it did not list."""
    scene = boxes_scene(TABLE)
    top, between, lid = sorted(set(scene.labels.tolist()) - {0, _BLOCK})[:3]

    def do(edit: Edit | None) -> None:
        assert edit is not None
        History(scene).do(edit)

    do(edits.set_parent(scene, (between,), top))
    do(edits.set_parent(scene, (lid,), between))
    do(edits.rename(scene, top, "teapot"))
    do(edits.rename(scene, lid, "lid"))
    do(edits.delete(scene, group_indices(scene, between)))
    listed = list_objects(Project(scene, Path("a.ply")))
    parents = {entry["group"]: entry["parent"] for entry in listed}
    assert parents == {**dict.fromkeys(parents, 0), lid: top}
    assert "lid (under teapot)" in object_names(listed)
    assert object_names(listed, 1).endswith(f"; and {len(listed) - 1} more (gaga info has all)")


@pytest.mark.parametrize("factor", [0.2, 1.0, 6.0])
@pytest.mark.parametrize("copied", [False, True])
def test_what_a_thing_is_does_not_change_with_where_a_person_puts_it(
    factor: float, *, copied: bool
) -> None:
    """A bottle that is made large and moved to the wall was a wall, among the background."""
    scene = shells(TABLE)
    edit = edits.move_scene(scene, np.array([[0, -2, 0, 1], [2, 0, 0, 0], [0, 0, 2, 5.0]]), "Turn")
    assert edit is not None
    edit.apply(scene)
    views = carried_cameras(VIEWS, scene.frame.world)
    found = describe(scene, group_facts(scene, views), views)
    for group in sorted(set(found.words) - found.background):
        changed, splats = replace(scene), group_indices(scene, group)
        way = factor * np.diag([1.0, 0.05, 1.0])
        matrix = np.column_stack([way, [30.0, 4.0, -2.0]])
        do = edits.duplicate if copied else edits.transform
        edit = do(scene, splats, matrix)
        assert edit is not None
        edit.apply(changed)
        then = describe(changed, group_facts(changed, views), views)
        moved = max(then.words) if copied else group
        assert moved not in then.background
        assert _what(then.words[moved]) == _what(found.words[group])


def test_deleting_a_thing_changes_no_other() -> None:
    """The view that left and right are meant from was another then, and so was the usual size."""
    alike = [((x, 0, 0.1), (0.2,) * 3, "c81414") for x in (-1.5, -0.5, 0.5, 1.5)]
    large = [((x, 0.4, 0.3), (0.6,) * 3, "1428c8") for x in (-2.4, -1.9, 1.9, 2.4)]
    board = [((0, 0.3, 0.5), (0.8, 0.05, 0.6), "14a028")]
    scene = shells([*alike, *large, *board])
    views = (FRONT, replace(camera_at((0, 4, 1), "back.png"), width=400))  # sees half of them
    found = describe(scene, group_facts(scene, views), views)
    assert "on the left" in found.words[1]
    assert not found.background
    for gone in ((5, 6), (7, 8), (5, 6, 7, 8), (1,), (9,)):
        left = replace(scene)
        for group in gone:
            edit = edits.delete(left, group_indices(left, group))
            assert edit is not None
            edit.apply(left)
        then = describe(left, group_facts(left, views), views, kept=found.words)
        assert then.words == {g: text for g, text in found.words.items() if g not in gone}
        assert not then.background


def test_objects_are_called_after_reopening_as_before(tmp_path: Path) -> None:
    """Without the first one, the second was given its name."""
    alike = shells([((x, 0, 0), (0.2,) * 3, "c81414") for x in (-1.2, -0.4, 0.4, 1.2)])
    write_ply(tmp_path / "row.ply", alike.gaussians)
    project = run_stage(open_path_stage(tmp_path / "row.ply"))
    edit = edits.set_grouping(project.scene, alike.labels, None, {}, "Find objects")
    history = History(project.scene)
    for done in (edit, edits.rename(project.scene, 4, "lid")):
        assert done is not None
        history.do(done)
    before = describe_project(project).words
    gone = next(group for group in before if before[group] == "red box")
    history.do(edits.delete(project.scene, group_indices(project.scene, gone)))
    words = describe_project(project).words
    assert words == {group: text for group, text in before.items() if group != gone}
    again = run_stage(open_path_stage(save_project(project)))
    assert describe_project(again).words == words


def _what(words: str) -> str:
    """Without size, place and number."""
    return re.sub(r"(,| on the| in front| behind| \d).*", "", words)
