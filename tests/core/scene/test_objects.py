"""The object list against a slow count, one group at a time."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.color import group_palette
from gaga_core.scene import edits, objects
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import world_means
from tests.core.scene.edits.edit_walk import builders, walk_scene
from tests.scenes import random_gaussians


def _edited(seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    scene = walk_scene(seed=seed)
    history = History(scene)
    kinds = builders()
    for name in ("transform", "duplicate", "hide", "select", "lock", "delete", "rename"):
        for _ in range(2):
            history.do(kinds[name](rng, scene))
    return scene


@pytest.mark.parametrize("seed", range(3))
def test_rows_match_a_count_by_group(seed: int) -> None:
    scene = _edited(seed)
    table = objects.object_table(scene)
    live = ~scene.has(State.DELETED)
    assert table.ids.tolist() == np.unique(scene.labels[live]).tolist()
    where = world_means(scene).astype(np.float64)
    assert scene.bank is not None
    for row, group in enumerate(table.ids):
        mine = live & (scene.labels == group)
        assert table.counts[row] == mine.sum()
        for column, bit in (
            (table.n_selected, State.SELECTED),
            (table.n_hidden, State.HIDDEN),
            (table.n_locked, State.LOCKED),
        ):
            assert column[row] == (mine & scene.has(bit)).sum()
        assert table.n_views[row] == len({d.view for d in scene.bank.log if d.group == group})
        assert np.allclose(table.centre[row], where[mine].mean(axis=0), atol=1e-5)
        assert np.allclose(table.lo[row], where[mine].min(axis=0), atol=1e-5)
        assert np.allclose(table.hi[row], where[mine].max(axis=0), atol=1e-5)
        spread = ((where[mine] - where[mine].mean(axis=0)) ** 2).sum(axis=1).mean()
        assert np.isclose(table.radius[row], 2 * np.sqrt(spread), atol=1e-4)
        assert table.row(int(group)) == row
        assert objects.group_indices(scene, int(group)).tolist() == np.flatnonzero(mine).tolist()
    assert table.row(999) is None


def test_names_and_colors() -> None:
    scene = walk_scene()
    table = objects.object_table(scene)
    assert table.names[:4] == ("unassigned", "group 1", "mug", "group 3")
    assert np.array_equal(objects.group_colors(table.ids), group_palette(6)[table.ids])


def test_large_surfaces_are_muted_and_nothing_else() -> None:
    """By how far a group spreads, not by its number of splats; a chosen color stays."""
    rng = np.random.default_rng(0)
    wall = rng.uniform(-4, 4, (400, 3)) * [1, 1, 0]
    floor = wall[:, [0, 2, 1]]
    balls = [rng.normal(0, 0.15, (900, 3)) + centre for centre in rng.uniform(-2, 2, (4, 3))]
    means = np.concatenate([wall, floor, *balls])
    labels = np.repeat(np.arange(1, 7), [400, 400, 900, 900, 900, 900]).astype(np.int32)
    splats = replace(random_gaussians(len(means)), means=means.astype(np.float32))
    scene = Scene.of(splats, labels)

    def chroma(colors: np.ndarray) -> np.ndarray:
        return np.asarray(colors.max(axis=1) - colors.min(axis=1))

    table = objects.object_table(scene)
    plain = group_palette(6)[table.ids]
    rows = [row for row, group in enumerate(table.ids) if group in (1, 2)]
    small = [row for row, group in enumerate(table.ids) if group > 2]
    assert (chroma(table.colors)[rows] < 0.45 * chroma(plain)[rows]).all()
    assert np.array_equal(table.colors[small], plain[small])
    assert set(objects.muted_colors(table)) == {1, 2}
    History(scene).do(edits.set_color(scene, 1, (1.0, 0.0, 0.0)))
    own = objects.object_table(scene)
    assert own.colors[rows[0]].tolist() == [1.0, 0.0, 0.0]
    few = Scene.of(random_gaussians(300), np.repeat([1, 2], 150).astype(np.int32))
    assert not objects.muted_colors(objects.object_table(few))


def test_huge_ids_do_not_need_huge_tables() -> None:
    scene = walk_scene(50)
    far = replace(
        scene, labels=np.where(scene.labels == 3, 2_000_000_000, scene.labels).astype("i4")
    )
    table = objects.object_table(far)
    assert table.ids[-1] == 2_000_000_000
    assert table.counts[-1] == (scene.labels == 3).sum()


def test_selected_groups_leave_out_unassigned() -> None:
    scene = walk_scene(200)
    History(scene).do(edits.select(scene, np.isin(scene.labels, [0, 2, 5])))
    assert objects.selected_groups(scene).tolist() == [2, 5]
    assert (
        objects.group_indices(scene, [2, 5]).tolist()
        == np.flatnonzero(np.isin(scene.labels, [2, 5])).tolist()
    )


def test_an_empty_scene_has_an_empty_list() -> None:
    scene = walk_scene(30)
    History(scene).do(edits.delete(scene, np.arange(30)))
    assert len(objects.object_table(scene)) == 0
