"""What each edit means, how small it is, and what stays out of it."""

import re
from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest

from gaga_core.arrays import AnyArray, DoubleArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import compose_affine
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.values import Edit
from gaga_core.scene.index_set import IndexSet, PackedInts, Storage, sorted_indices
from gaga_core.scene.objects import group_indices, selected_indices
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.tint import mean_color, tint_affine
from tests.core.scene.edits.edit_walk import random_affine, walk_scene


def _do(scene: Scene, edit: Edit | None) -> None:
    assert edit is not None
    edit.apply(scene)


def _shift(x: float, y: float = 0, z: float = 0) -> DoubleArray:
    return np.column_stack([np.eye(3), [x, y, z]])


@pytest.mark.parametrize("n", [1, 7, 64, 1000])
def test_an_index_set_gives_back_what_went_in_in_its_smallest_form(n: int) -> None:
    rng = np.random.default_rng(n)
    for share in (0, 0.01, 0.3, 0.9, 1):
        for mask in (rng.random(n) < share, np.arange(n) < share * n):
            rows = np.flatnonzero(mask)
            packed = IndexSet.of(rows, n)
            assert packed.indices().tolist() == rows.tolist()
            assert packed.mask().tolist() == mask.tolist()
            assert packed.count == len(rows)
            assert packed.nbytes <= min(4 * len(rows), (n + 7) // 8)
    many_runs = np.flatnonzero(np.arange(100_000) % 1000 < 300)
    packed = IndexSet.of(many_runs, 100_000)
    assert packed.form is Storage.RUNS
    assert packed.nbytes == 800
    assert np.flatnonzero(packed.mask()).tolist() == many_runs.tolist()
    assert packed.indices().tolist() == many_runs.tolist()


def test_packed_ints_keep_every_value() -> None:
    for values in ([5, 5, 5], [0, 255], [0, 70_000], [-1, 300], []):
        array = np.array(values, np.int32)
        assert PackedInts.of(array).values().tolist() == values
        assert PackedInts.of(array).nbytes <= max(4, array.nbytes)


def test_rows_may_come_in_any_order_and_not_from_outside() -> None:
    assert sorted_indices(np.array([3, 1, 3]), 4).tolist() == [1, 3]
    for bad in (np.array([4]), np.array([-1, 2])):
        with pytest.raises(ValueError, match=r"0\.\.3"):
            sorted_indices(bad, 4)


def test_deleting_a_million_takes_less_than_a_byte_a_splat() -> None:
    n = 1_000_000
    one = np.zeros((n, 1), np.float32)
    scene = Scene.of(
        Gaussians(
            np.repeat(one, 3, 1),
            np.repeat(one, 4, 1),
            np.repeat(one, 3, 1),
            one[:, 0],
            one[..., None].repeat(3, 2),
        )
    )
    rng = np.random.default_rng(0)
    _do(scene, edits.select(scene, rng.random(n) < 0.5))
    for splats in (np.arange(n), rng.random(n) < 0.5):
        edit = edits.delete(scene, splats)
        assert edit is not None
        assert edit.nbytes <= n // 2


def test_selection_keeps_off_deleted_and_locked() -> None:
    scene = walk_scene(60)
    _do(scene, edits.delete(scene, np.arange(0, 10)))
    _do(scene, edits.lock(scene, np.arange(10, 20)))
    _do(scene, edits.select(scene, np.arange(0, 40)))
    assert selected_indices(scene).tolist() == list(range(20, 40))
    _do(scene, edits.select(scene, np.arange(35, 50), "add"))
    _do(scene, edits.select(scene, np.arange(20, 30), "remove"))
    _do(scene, edits.select(scene, np.arange(0, 45), "intersect"))
    assert selected_indices(scene).tolist() == list(range(30, 45))
    assert edits.select(scene, np.arange(30, 45)) is None
    with pytest.raises(ValueError, match="how"):
        edits.select(scene, np.arange(3), "toggle")  # type: ignore[arg-type]


def test_hide_isolate_and_delete_take_the_selection_along() -> None:
    scene = walk_scene(40)
    _do(scene, edits.delete(scene, np.arange(5)))
    _do(scene, edits.select(scene, np.arange(40)))
    _do(scene, edits.isolate(scene, np.arange(10, 20)))
    assert np.flatnonzero(scene.visible).tolist() == list(range(10, 20))
    assert selected_indices(scene).tolist() == list(range(10, 20))
    assert not (scene.has(State.DELETED) & scene.has(State.HIDDEN)).any()
    _do(scene, edits.hide(scene, np.arange(10, 15)))
    _do(scene, edits.delete(scene, np.arange(15, 17)))
    assert np.flatnonzero(scene.has(State.SELECTED)).tolist() == [17, 18, 19]
    _do(scene, edits.show_all(scene))
    _do(scene, edits.restore(scene))
    assert scene.visible.all()
    assert edits.show_all(scene) is None


def test_moves_compose_and_an_object_keeps_one_row() -> None:
    scene = walk_scene()
    rng = np.random.default_rng(1)
    splats, others = np.flatnonzero(scene.labels == 3), np.flatnonzero(scene.labels != 3)
    start, want = scene.gaussians.means.astype(np.float64), np.eye(3, 4)
    for _ in range(5):
        matrix = random_affine(rng)
        want = compose_affine(matrix, want)
        _do(scene, edits.transform(scene, splats, matrix))
        assert len(scene.placements) == 2
    moved = world_means(scene)
    assert np.allclose(moved[splats], start[splats] @ want[:, :3].T + want[:, 3], atol=1e-4)
    assert np.array_equal(moved[others], scene.gaussians.means[others])
    color = random_affine(rng)
    _do(scene, edits.recolor(scene, splats, color, 0.5))
    assert len(scene.placements) == 2
    assert np.array_equal(scene.placements.color[1], color)
    assert scene.placements.opacity[1] == 0.5


def test_a_part_of_a_moved_object_gets_a_row_of_its_own() -> None:
    scene = walk_scene(100)
    _do(scene, edits.transform(scene, np.arange(50), _shift(1)))
    _do(scene, edits.delete(scene, np.arange(5)))
    # 45 live splats of the row are moved; the 5 deleted ones must stand where they stood.
    _do(scene, edits.transform(scene, np.arange(5, 60), _shift(0, 2)))
    offset = world_means(scene) - scene.gaussians.means
    assert np.allclose(offset[:5], [1, 0, 0], atol=1e-6)
    assert np.allclose(offset[5:50], [1, 2, 0], atol=1e-6)
    assert np.allclose(offset[50:60], [0, 2, 0], atol=1e-6)
    assert np.allclose(offset[60:], 0)
    assert np.array_equal(scene.placements.matrix[0], np.eye(3, 4))


def test_edits_that_change_nothing_are_none() -> None:
    scene = walk_scene(50)
    nothing, some = np.zeros(0, np.int32), np.arange(9)
    assert edits.transform(scene, some, np.eye(3, 4)) is None
    assert edits.transform(scene, nothing, _shift(1)) is None
    assert edits.recolor(scene, some, np.eye(3, 4)) is None
    assert edits.duplicate(scene, nothing) is None
    assert edits.delete(scene, nothing) is None
    assert edits.set_labels(scene, some, scene.labels[some]) is None
    assert edits.rename(scene, 2, " mug ") is None
    assert edits.merge_groups(scene, [3, 3]) is None
    assert edits.set_grouping(scene, scene.labels, scene.bank, scene.names) is None
    assert edits.together("x", [None, None]) is None


@pytest.mark.parametrize("bad", [np.zeros((3, 4)), np.full((3, 4), np.nan), np.eye(2)])
def test_a_map_that_flattens_space_is_refused(bad: DoubleArray) -> None:
    with pytest.raises(ValueError, match="matrix"):
        edits.transform(walk_scene(9), np.arange(3), bad)


@pytest.mark.parametrize("seed", range(6))
def test_names_of_new_objects_are_of_no_other_and_count_on_in_their_family(seed: int) -> None:
    """By whatever makes them, a name that a person gave or a description that is shown."""
    rng = np.random.default_rng(seed)
    scene = walk_scene(seed=seed)
    groups = np.setdiff1d(scene.labels[scene.visible], 0)
    for k, group in enumerate(rng.permutation(groups).tolist()):
        said = scene.names if k % 2 else scene.described
        said[group] = ("mug", "Mug 2", "mug 3", "mug part", "tray 7")[k % 5]
    scene.names[int(groups[0])] = "mug"
    for _ in range(12):
        splats = group_indices(scene, int(rng.choice(groups)))
        how = int(rng.integers(3))
        if how == 0:
            edit = edits.duplicate(scene, splats)
        elif how == 1:
            edit = edits.separate(scene, splats[: len(splats) // 2])
        else:
            edit = edits.split(scene, int(scene.labels[splats[0]]), least=1)
        before = {*scene.names}
        others = {n.casefold() for n in (*scene.names.values(), *scene.described.values())}
        if edit is None:
            continue
        _do(scene, edit)
        new = [name.casefold() for group, name in scene.names.items() if group not in before]
        assert len({*new}) == len(new)
        assert not {*new} & others
        assert not any(re.search(r"mug \d+ \d+|tray 7 7", name) for name in new), new


def test_a_duplicate_is_a_new_named_group_and_becomes_the_selection() -> None:
    scene = walk_scene(300)
    g, n = scene.gaussians, len(scene)
    _do(scene, edits.delete(scene, np.flatnonzero(scene.labels == 2)[:3]))
    _do(scene, edits.select(scene, np.arange(20)))
    _do(scene, edits.transform(scene, group_indices(scene, 2), _shift(5)))
    splats = group_indices(scene, [2])
    _do(scene, edits.duplicate(scene, np.flatnonzero(scene.labels == 2), _shift(0, 0, 1)))
    new = np.arange(n, n + len(splats))
    fresh = 8  # the bank of walk_scene knows 7 groups
    assert selected_indices(scene).tolist() == new.tolist()
    assert (scene.labels[new] == fresh).all()
    assert scene.names == {2: "mug", fresh: "mug 2"}
    assert scene.source[new].tolist() == splats.tolist()
    assert np.allclose(world_means(scene)[new], world_means(scene)[splats] + [0, 0, 1], atol=1e-5)
    now = scene.gaussians
    pairs: list[tuple[AnyArray, AnyArray]] = [
        (now.means, g.means),
        (now.quats, g.quats),
        (now.log_scales, g.log_scales),
        (now.logit_opacities, g.logit_opacities),
        (now.sh, g.sh),
        *((now.extra[name], g.extra[name]) for name in g.extra),
    ]
    for column, original in pairs:
        assert np.array_equal(column, np.concatenate([original, original[splats]]))
    # The copy moves alone, and a copy of a part stays in its group.
    _do(scene, edits.transform(scene, new, _shift(0, 3)))
    assert np.allclose(world_means(scene)[splats], g.means[splats] + [5, 0, 0], atol=1e-5)
    _do(scene, edits.duplicate(scene, new[:4]))
    assert (scene.labels[-4:] == fresh).all()
    assert scene.source[-4:].tolist() == splats[:4].tolist()
    _do(scene, edits.duplicate(scene, np.flatnonzero(scene.labels == 3), new_group=False))
    assert (scene.labels[-3:] == 3).all()


def test_merging_takes_splats_names_and_the_bank_s_log_along() -> None:
    scene = walk_scene(200)
    assert scene.bank is not None
    n_of = np.bincount(scene.labels, minlength=8)
    joined = sum(d.group in (1, 2, 4) for d in scene.bank.log)
    rivals = [
        replace(d, runner_up=g) for d, g in zip(scene.bank.log, cycle((1, 3, 4)), strict=False)
    ]
    scene.bank = replace(scene.bank, log=rivals)
    _do(scene, edits.merge_groups(scene, [4, 2, 1]))
    assert (scene.labels == 4).sum() == n_of[[1, 2, 4]].sum()
    assert not np.isin(scene.labels, [1, 2]).any()
    assert scene.names == {4: "mug"}
    assert sum(d.group == 4 for d in scene.bank.log) == joined
    assert not np.isin(scene.bank.group, [1, 2]).any()
    for now, rival in zip(scene.bank.log, cycle((4, 3, 4)), strict=False):
        assert now.runner_up == (0 if now.group == rival else rival), "nothing is its own rival"
    with pytest.raises(GagaError, match="unassigned"):
        edits.merge_groups(scene, [0, 3])


def test_labels_one_a_splat_need_sorted_rows() -> None:
    scene = walk_scene(20)
    with pytest.raises(ValueError, match="sorted"):
        edits.set_labels(scene, np.array([5, 2]), np.array([7, 8], np.int32))
    with pytest.raises(ValueError, match=">= 0"):
        edits.set_labels(scene, np.array([5]), -1)
    _do(scene, edits.set_labels(scene, np.array([2, 5]), np.array([7, 8], np.int32)))
    assert scene.labels[[2, 5]].tolist() == [7, 8]


def test_a_tint_sends_the_mean_to_the_target_and_keeps_the_order_of_light() -> None:
    rng = np.random.default_rng(0)
    luma = np.array([0.2126, 0.7152, 0.0722])
    for target in ([0.9, 0.1, 0.1], [0, 0, 0], [1, 1, 1]):
        colors = rng.uniform(0, 1, (50, 3))
        mean = colors.mean(axis=0)
        full = tint_affine(mean, target)
        painted = colors @ full[:, :3].T + full[:, 3]
        assert np.allclose(painted.mean(axis=0), target)
        assert np.array_equal(np.argsort(painted @ luma), np.argsort(colors @ luma))
        assert np.allclose(tint_affine(mean, target, 0.0), np.eye(3, 4))
        half = tint_affine(mean, target, 0.5)
        assert np.allclose(half[:, :3] @ mean + half[:, 3], (mean + target) / 2)
    with pytest.raises(ValueError, match="strength"):
        tint_affine([0, 0, 0], [1, 1, 1], 1.5)


def test_the_mean_color_is_the_color_as_it_is_now() -> None:
    scene = walk_scene(200)
    splats = np.flatnonzero(scene.labels == 1)
    before = mean_color(scene, splats)
    _do(scene, edits.recolor(scene, splats, 0.5 * np.eye(3, 4)))
    assert np.allclose(mean_color(scene, splats), 0.5 * before, atol=0.02)
    assert np.allclose(mean_color(scene, np.zeros(0, np.int32)), 0.5)


def test_the_mean_color_is_that_of_what_is_seen_from_outside_where_it_is_known() -> None:
    """A recolor lands on its target with it, too."""
    scene = walk_scene(200)
    splats = np.flatnonzero(scene.labels == 1)
    seen = np.zeros((len(splats), 4), np.float32)
    seen[:3] = 0.2, 0.4, 0.6, 0.5  # the rest is hidden
    assert np.allclose(mean_color(scene, splats, seen), (0.2, 0.4, 0.6))
    affine = tint_affine(mean_color(scene, splats, seen), (0.7, 0.1, 0.3))
    _do(scene, edits.recolor(scene, splats, affine))
    assert np.allclose(mean_color(scene, splats, seen), (0.7, 0.1, 0.3))
    hidden = mean_color(scene, splats[3:], seen[3:])
    assert np.allclose(hidden, mean_color(scene, splats[3:])), "as without it where none is seen"


def test_a_kept_selection_outlives_undone_copies_and_locks() -> None:
    scene = walk_scene(100)
    history = History(scene)
    history.do(edits.duplicate(scene, np.arange(10)))
    history.do(edits.keep_selection(scene, "  my   set ", np.arange(90, 105)))
    assert list(scene.named_selections) == ["my set"]
    assert edits.keep_selection(scene, "my set", np.arange(90, 105)) is None
    history.do(edits.lock(scene, np.arange(95, 100)))
    assert edits.named_selection(scene, "my set").tolist() == [*range(90, 95), *range(100, 105)]
    while history.undo():
        pass
    assert scene.named_selections == {}
    with pytest.raises(GagaError, match='no selection named "my set"'):
        edits.named_selection(scene, "my set")
    history.go_to(2)
    history.do(edits.forget_selection(scene, "my set"))
    assert scene.named_selections == {}
    with pytest.raises(GagaError, match="needs a name"):
        edits.keep_selection(scene, "  ", np.arange(3))


def test_confidence_belongs_to_rows_of_the_file_and_copies_share_it() -> None:
    scene = walk_scene(100)
    sure = np.linspace(0, 1, 100).astype(np.float32)
    history = History(scene)
    history.do(edits.set_grouping(scene, scene.labels, scene.bank, {}, confidence=sure))
    history.do(edits.duplicate(scene, np.array([3, 99])))
    values = scene.confidence_of()
    assert values is not None
    assert values[[0, 99, 100, 101]].tolist() == [0, 255, values[3], 255]
    history.go_to(0)
    assert scene.confidence_of() is None
