"""Add a scene: shown where it fits, applied or cancelled, undone, or placed by hand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.splat_files import read_splats
from gaga_core.pipeline.align import addition_of
from gaga_core.progress import run_stage
from gaga_core.scene.bake import bake
from gaga_core.scene.frame import inverse
from gaga_core.scene.project import open_path_stage, save_project
from gaga_studio.features import add_scene, commands, objects, selection, transform
from gaga_studio.session.session import Session
from tests.app import told
from tests.app.looks import objects_of
from tests.core.scene.captures.scenes import any_similarity, write_furnished, write_scene
from tests.shares import falls


def test_a_scene_without_groups_becomes_one_of_its_name(tmp_path: Path) -> None:
    """Each was called "point_cloud"."""
    first, second = write_furnished(tmp_path, any_similarity(np.random.default_rng(5)))
    here, other = (run_stage(open_path_stage(path)) for path in (first, second))
    other.scene.labels = np.zeros_like(other.scene.labels)
    addition_of(here.scene, other, np.eye(4)).edit.apply(here.scene)
    assert second.name in here.scene.names.values()


@pytest.mark.usefixtures("few_draws")
def test_a_scene_is_added_where_it_fits_and_changes_are_listed(
    new_session: Callable[[], Session], tmp_path: Path
) -> None:
    world = any_similarity(np.random.default_rng(7))
    first, second = write_furnished(tmp_path, world)
    session = new_session()
    session.open(first)
    assert session.jobs.wait()
    document = session.need()
    scene, n = document.scene, len(document.scene)
    with told.by_job() as heard:
        add_scene.start(session, second)
        group = objects_of(session)[0]
        assert objects.rename(session, group, "kept")  # the alignment stays right
        assert session.jobs.wait(400)
    said, added_anew = heard.values()
    assert added_anew, "to the scene as it is now"
    assert falls(said) == [], "one share of all, which began again at each step"
    assert len({word.done for word in said}) > 30
    found = add_scene.shown(session)
    assert found is not None
    assert found.aligned is not None
    assert len(scene) > n
    assert add_scene.cancel(session)
    assert len(scene) == n

    document.show(found.addition.shown, waits_as=add_scene.TITLE)
    document.feature(add_scene.Adding).take(found, found.addition.shown)
    commands.run("scene.add_apply", session)
    added = np.arange(n, len(scene))
    assert np.array_equal(session.selected_indices(), added)
    back = inverse(world)
    expected = read_splats(second / "point_cloud.ply").means @ back[:3, :3].T + back[:3, 3]
    baked = bake(scene, indices=added)
    np.testing.assert_allclose(baked.means, expected, atol=0.03)
    assert (scene.placements.color[scene.placement[added]] == np.eye(3, 4)).all(), "no tint stays"

    listed = add_scene.changes(session).found
    assert sorted(change.kind for change, _ in listed) == ["came", "moved", "went"]
    for change, groups in listed:
        assert add_scene.select(session, groups)
        rows = session.selected_indices()
        assert (rows < n).any() == (change.kind != "came")
        assert (rows >= n).any() == (change.kind != "went")
    why_no_list = commands.command("scene.changes").enabled
    assert why_no_list(session) == ""
    saved = save_project(document.project)
    again = run_stage(open_path_stage(saved)).scene
    assert np.array_equal(bake(again).means, bake(scene).means)
    assert again.names[group] == "kept"
    while session.undo():
        pass
    assert len(scene) == n


@pytest.mark.usefixtures("few_draws")
def test_what_cannot_be_aligned_is_placed_by_hand(
    new_session: Callable[[], Session], tmp_path: Path
) -> None:
    """Photos of another corner, and nothing else in common."""
    first, second = write_furnished(tmp_path, any_similarity(np.random.default_rng(8)))
    write_scene(tmp_path / "other", 1, n=6, seed=1)
    (second / "point_cloud.ply").rename(tmp_path / "other" / "point_cloud.ply")
    session = new_session()
    session.open(first)
    assert session.jobs.wait()
    n = len(session.need().scene)
    add_scene.start(session, tmp_path / "other")
    selection.select_all(session)
    assert transform.move(session, transform.shift(np.ones(3)))
    assert session.jobs.wait(400)
    assert session.pending_question is None, "it was aligned with a scene that stands elsewhere now"
    assert session.undo()
    add_scene.start(session, tmp_path / "other")
    assert session.jobs.wait(400)
    assert add_scene.shown(session) is None
    question = session.pending_question
    assert question is not None
    assert "by hand" in question.text
    session.answer(question.choices[0])
    assert add_scene.shown(session) is not None
    assert add_scene.apply(session)
    assert len(session.need().scene) > n
    assert not add_scene.changes(session).found
    assert "placed by hand" in commands.command("scene.changes").enabled(session)
