"""Cleaning an object: what is planted is found, what belongs is left alone."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.progress import run_stage
from gaga_core.scene.bake import bake
from gaga_core.scene.cleanup import (
    DROPPED,
    TAKEN_IN,
    CleanConfig,
    CleanReason,
    clean_object,
    clean_objects_stage,
    cleaned_copy,
    cleaned_edit,
    cleaned_labels,
    cleaning_tint,
    delete_cleaned,
    isolate_cleaned,
    whole_objects,
)
from gaga_core.scene.edits import delete, hide, isolate, lock, select, transform
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene, State
from tests.app.looks import snapshot
from tests.scenes import objects_scene


def splats(points: DoubleArray, rgb: DoubleArray, *, size: float = 0.02) -> Gaussians:
    n = len(points)
    sh = (np.broadcast_to(rgb, (n, 3)) - 0.5) / 0.28209479177387814
    return Gaussians(
        means=points.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.full((n, 3), np.log(size), np.float32),
        logit_opacities=np.full(n, 3, np.float32),
        sh=sh[:, None].astype(np.float32),
    )


def joined(*parts: Gaussians) -> Gaussians:
    return Gaussians(
        means=np.concatenate([p.means for p in parts]),
        quats=np.concatenate([p.quats for p in parts]),
        log_scales=np.concatenate([p.log_scales for p in parts]),
        logit_opacities=np.concatenate([p.logit_opacities for p in parts]),
        sh=np.concatenate([p.sh for p in parts]),
    )


def ball(rng: np.random.Generator, n: int, centre: tuple[float, float, float]) -> DoubleArray:
    out = rng.normal(size=(n, 3))
    points: DoubleArray = 0.5 * out / np.linalg.norm(out, axis=1, keepdims=True)
    points += centre
    return points


def with_parts(*planted: Gaussians, seed: int = 0) -> tuple[Gaussians, int]:
    """A red ball (group 1) over a gray floor (group 2), then what is planted; its first row."""
    rng = np.random.default_rng(seed)
    floor = np.c_[rng.uniform(-2, 2, (4000, 2)), rng.normal(-0.52, 0.003, 4000)]
    base = (
        splats(ball(rng, 2000, (0, 0, 0)), np.array([0.8, 0.2, 0.2])),
        splats(floor, np.full(3, 0.5)),
    )
    return joined(*base, *planted), 6000


def labels_of(gaussians: Gaussians, planted: int) -> IntArray:
    labels = np.full(len(gaussians), planted, np.int32)
    labels[:2000], labels[2000:6000] = 1, 2
    return labels


@pytest.mark.parametrize("seed", range(3))
def test_planted_floaters_go(seed: int) -> None:
    rng = np.random.default_rng(seed)
    air = rng.uniform(-2, 2, (40, 3)) + np.array([0, 0, 2.8])
    gaussians, first = with_parts(splats(air, np.array([0.8, 0.2, 0.2])), seed=seed)
    preview = clean_object(Scene.of(gaussians, labels_of(gaussians, 1)), 1)
    assert np.isin(np.arange(first, first + 40), preview.remove).mean() > 0.95
    assert (preview.remove_reasons == CleanReason.STRAY).sum() >= 38
    assert (preview.remove < 2000).sum() <= 4
    assert (preview.remove_groups[preview.remove >= first] == 0).all()


def test_haze_near_the_object_goes_sooner_when_faint_and_later_when_large() -> None:
    up = ball(np.random.default_rng(9), 400, (0, 0, 0))
    up = up[up[:, 2] > 0.2][::12] * 1.24  # single splats, 0.12 above the surface
    haze = splats(up, np.array([0.8, 0.2, 0.2]))
    gaussians, first = with_parts(haze, replace(haze, means=haze.means * np.float32(1.2)))
    half = first + len(up)
    labels = labels_of(gaussians, 1)
    removed = clean_object(Scene.of(gaussians, labels), 1).remove
    assert not np.isin(np.arange(first, half), removed).any()  # near enough, and solid
    assert np.isin(np.arange(half, len(gaussians)), removed).all()
    opacities = gaussians.logit_opacities.copy()
    opacities[first:] = -3
    faint = replace(gaussians, logit_opacities=opacities)
    removed = clean_object(Scene.of(faint, labels), 1).remove
    assert np.isin(np.arange(first, len(gaussians)), removed).all()
    sizes = gaussians.log_scales.copy()
    sizes[half:] += np.log(8).astype(np.float32)  # what large splats leave between them is no gap
    removed = clean_object(Scene.of(replace(gaussians, log_scales=sizes), labels), 1).remove
    assert not np.isin(np.arange(half, len(gaussians)), removed).any()


def test_a_clump_of_floaters_is_a_part_apart() -> None:
    clump = np.random.default_rng(2).normal([0, 0, 2], 0.03, (25, 3))
    gaussians, first = with_parts(splats(clump, np.array([0.8, 0.2, 0.2])))
    preview = clean_object(Scene.of(gaussians, labels_of(gaussians, 1)), 1)
    assert np.isin(np.arange(first, first + 25), preview.remove).all()


@pytest.mark.parametrize("label", [0, 5])
def test_planted_interior_splats_come_in(label: int) -> None:
    inner = np.random.default_rng(3).normal(0, 0.12, (200, 3))
    gaussians, first = with_parts(splats(inner, np.array([0.1, 0.6, 0.9])))
    labels = labels_of(gaussians, label)
    if label:  # scattered wrong groups: nothing that its neighbours confirm
        labels[first:] = 3 + np.arange(200) % 40
    preview = clean_object(Scene.of(gaussians, labels), 1)
    assert np.isin(np.arange(first, first + 200), preview.add).mean() > 0.97
    assert (preview.add < first).sum() <= 4
    outside = CleanConfig(hull="none")
    assert len(clean_object(Scene.of(gaussians, labels), 1, outside).add) < 60


def test_another_object_inside_keeps_its_splats() -> None:
    inner = ball(np.random.default_rng(4), 600, (0, 0, 0)) * 0.4
    gaussians, first = with_parts(splats(inner, np.array([0.1, 0.6, 0.9])))
    for config in (CleanConfig(hull="surrounded"), CleanConfig(hull="convex")):
        preview = clean_object(Scene.of(gaussians, labels_of(gaussians, 3)), 1, config)
        assert (preview.add >= first).sum() == 0


@pytest.mark.parametrize("table", [0, 2])
@pytest.mark.parametrize("same_color", [False, True])
def test_the_table_under_a_mug_is_not_eaten(table: int, same_color: bool) -> None:
    rng = np.random.default_rng(5)
    angle, height = rng.uniform(0, 2 * np.pi, 3000), rng.uniform(0, 1, 3000)
    mug = np.c_[0.4 * np.cos(angle), 0.4 * np.sin(angle), height]
    top = np.c_[rng.uniform(-1.5, 1.5, (6000, 2)), np.full(6000, -0.01)]
    color = np.array([0.2, 0.3, 0.7])
    gaussians = joined(splats(mug, color), splats(top, color if same_color else np.full(3, 0.6)))
    labels = np.where(np.arange(9000) < 3000, 1, table).astype(np.int32)
    preview = clean_object(Scene.of(gaussians, labels), 1)
    radius = np.hypot(*gaussians.means[preview.add, :2].T)
    assert (np.abs(radius - 0.4) < 0.08).all()  # at most some that touch the wall's foot
    assert len(preview.add) <= (40 if same_color else 0)
    assert len(preview.remove) <= (40 if same_color else 0)


def test_a_true_object_stays_as_it_is_and_cleaning_twice_is_cleaning_once() -> None:
    made = objects_scene(per_object=1500, seed=7)
    labels = np.where(made.labels > 0, made.labels, 9).astype(np.int32)
    for group in range(1, 7):
        preview = clean_object(Scene.of(made.gaussians, labels), group)
        assert len(preview.add) + len(preview.remove) <= 0.005 * 1500
    rng = np.random.default_rng(7)
    wrong = rng.random(len(labels)) < 0.08
    labels[wrong] = rng.integers(0, 9, wrong.sum())
    scene = Scene.of(made.gaussians, labels)
    for _ in range(2):
        preview = clean_object(scene, 2)
        edit = cleaned_labels(scene, preview)
        if edit is not None:
            edit.apply(scene)
    assert len(preview.add) + len(preview.remove) <= 0.005 * 1500


def test_boundary_splats_find_their_way_home() -> None:
    """A tenth of the foot of an object has the floor's label, and a tenth of the floor its."""
    rng = np.random.default_rng(6)
    gaussians, _ = with_parts()
    truth = labels_of(gaussians, 0)
    ours, floor = np.flatnonzero(truth == 1), np.flatnonzero(truth == 2)
    low = ours[gaussians.means[ours, 2] < -0.4]
    near = floor[np.hypot(*gaussians.means[floor, :2].T) < 0.5]
    labels = truth.copy()
    labels[rng.choice(low, len(low) // 10, replace=False)] = 2
    labels[rng.choice(near, len(near) // 10, replace=False)] = 1
    scene = Scene.of(gaussians, labels)
    n_wrong = (labels != truth).sum()
    History(scene).do(cleaned_labels(scene, clean_object(scene, 1)))
    assert (scene.labels != truth).sum() < 0.2 * n_wrong


@pytest.mark.parametrize("seed", range(2))
def test_planted_errors_of_all_kinds_mostly_go(seed: int) -> None:
    made = objects_scene(per_object=1000, seed=seed)
    truth = np.where(made.labels > 0, made.labels, 9).astype(np.int32)
    rng = np.random.default_rng(seed)
    labels = truth.copy()
    wrong = rng.random(len(labels)) < 0.1
    labels[wrong] = rng.integers(0, 10, wrong.sum())
    scene = Scene.of(made.gaussians, labels)
    for group in range(1, 7):
        own = truth == group
        before = np.isin(np.arange(len(labels)), group_indices(scene, group))
        after = np.isin(np.arange(len(labels)), clean_object(scene, group).after)
        errors = (before != own).sum(), (after != own).sum()
        assert errors[1] < 0.2 * errors[0]


def test_a_preview_changes_nothing_and_is_always_the_same() -> None:
    made = objects_scene(per_object=500)
    rng = np.random.default_rng(8)
    labels = np.where(rng.random(len(made.labels)) < 0.1, 0, made.labels).astype(np.int32)
    scene = Scene.of(made.gaussians, labels)
    first, second = clean_object(scene, 3), clean_object(scene, 3)
    assert scene.revision.total() == 0
    assert (scene.labels == labels).all()
    for name in ("before", "add", "add_reasons", "remove", "remove_reasons", "remove_groups"):
        assert (getattr(first, name) == getattr(second, name)).all()
    assert sum(first.counts.values()) == len(first.add) + len(first.remove)
    assert first.sentence().startswith("Adds")


def test_a_choice_of_splats_is_cleaned_like_a_group() -> None:
    made = objects_scene(per_object=500)
    labels = np.where(made.labels == 3, 0, made.labels).astype(np.int32)
    labels[np.flatnonzero(made.labels == 3)[::7]] = 4
    grouped = np.where(made.labels == 3, 3, labels).astype(np.int32)
    chosen = np.flatnonzero(made.labels == 3)
    free = clean_object(Scene.of(made.gaussians, labels), chosen)
    group = clean_object(Scene.of(made.gaussians, grouped), 3)
    assert (free.after == group.after).all()
    scene = Scene.of(made.gaussians, labels)
    History(scene).do(select(scene, free.after))
    assert (np.flatnonzero(scene.state) == free.after).all()
    with pytest.raises(GagaError, match="not one group"):
        cleaned_labels(scene, free)


def test_deleted_and_locked_splats_take_no_part() -> None:
    inner = np.random.default_rng(3).normal(0, 0.1, (100, 3))
    gaussians, first = with_parts(splats(inner, np.array([0.1, 0.6, 0.9])))
    scene = Scene.of(gaussians, labels_of(gaussians, 0))
    for edit in (
        delete(scene, np.arange(first, first + 50)),
        lock(scene, np.arange(first + 50, first + 70)),
    ):
        History(scene).do(edit)
    preview = clean_object(scene, 1)
    assert not np.isin(np.arange(first, first + 70), preview.add).any()
    assert np.isin(np.arange(first + 70, first + 100), preview.add).all()
    History(scene).do(delete(scene, group_indices(scene, 1)))
    with pytest.raises(GagaError, match="no splats"):
        clean_object(scene, 1)
    with pytest.raises(GagaError, match="no object"):
        clean_object(scene, 0)


def test_what_is_judged_is_what_lies_there_now() -> None:
    """An interior splat comes in; moved out of the ball, it does not."""
    inner = np.random.default_rng(3).normal(0, 0.1, (100, 3))
    gaussians, first = with_parts(splats(inner, np.array([0.1, 0.6, 0.9])))
    scene = Scene.of(gaussians, labels_of(gaussians, 0))
    history = History(scene, 1 << 20)
    away = np.eye(3, 4)
    away[2, 3] = 1.5
    edit = transform(scene, np.arange(first, first + 100), away, "Move")
    assert edit is not None
    history.do(edit)
    assert len(clean_object(scene, 1).add) == 0
    history.undo()
    assert len(clean_object(scene, 1).add) == 100


def test_splats_at_no_place_and_tiny_objects_do_no_harm() -> None:
    gaussians, _ = with_parts()
    means = gaussians.means.copy()
    means[:5] = np.nan
    scene = Scene.of(replace(gaussians, means=means), labels_of(gaussians, 0))
    assert not np.isin(np.arange(5), clean_object(scene, 1).add).any()
    for n in (1, 2, 3, 5):
        few = gaussians.take(np.arange(n))
        assert not clean_object(Scene.of(few, np.ones(n, np.int32)), 1)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 10])
def test_a_few_scattered_splats_can_be_cleaned(n: int) -> None:
    for seed in range(6):
        scene = objects_scene(seed=seed)
        rng = np.random.default_rng(seed)
        labels = scene.labels.copy()
        labels[rng.choice(len(labels), n, replace=False)] = 77
        found = clean_object(Scene.of(scene.gaussians, labels), 77)
        assert set(found.remove) <= set(np.flatnonzero(labels == 77))


# --- Edits made of cleaning: tints that revert, several objects in turn, the script's operation.


def floating(groups: tuple[int, ...] = (1, 3), n: int = 15) -> tuple[Scene, LongArray]:
    """Balls of which some have floaters high above them; their rows."""
    made = objects_scene(4, 300)
    rows = np.concatenate([np.flatnonzero(made.labels == g)[:n] for g in groups])
    means = made.gaussians.means.copy()
    rng = np.random.default_rng(0)
    means[rows] += rng.uniform([-1, -1, 2], [1, 1, 3], (len(rows), 3)).astype(np.float32)
    return Scene.of(replace(made.gaussians, means=means), made.labels), rows


def test_the_tint_colors_what_comes_and_goes_and_reverts() -> None:
    scene, rows = floating()
    scene.labels[group_indices(scene, 2)[:5]] = 0  # to be taken in again
    History(scene).do(select(scene, group_indices(scene, 1)[:7]))
    for group in (1, 2):
        preview = clean_object(scene, group)
        before = snapshot(scene)
        tint = cleaning_tint(scene, preview)
        assert tint is not None
        tint.apply(scene)
        shown = np.clip(0.5 + 0.28209479177387814 * bake(scene).sh[:, 0], 0, 1)
        np.testing.assert_allclose(
            shown[preview.remove], np.tile(DROPPED, (len(preview.remove), 1)), atol=1e-5
        )
        np.testing.assert_allclose(
            shown[preview.add], np.tile(TAKEN_IN, (len(preview.add), 1)), atol=1e-5
        )
        rest = np.setdiff1d(np.arange(len(scene)), np.r_[preview.remove, preview.add])
        assert np.ptp(shown[rest], axis=1).max() < 1e-5, "all else is gray"
        tint.revert(scene)
        assert snapshot(scene) == before
    assert len(clean_object(scene, 1).remove) > 10
    assert len(clean_object(scene, 2).add) > 0
    assert len(rows) == 30


def test_objects_are_cleaned_in_turn_and_the_scene_is_not() -> None:
    scene, rows = floating()
    before = snapshot(scene)
    revision = scene.revision.total()
    labels = run_stage(clean_objects_stage(scene, (1, 3)))
    assert snapshot(scene) == before
    assert scene.revision.total() == revision
    assert (labels[rows] == 0).mean() > 0.9
    # What the first gave to the second is seen by the second: the same as one edit after another.
    history = History(scene)
    for group in (1, 3):
        history.do(cleaned_edit(scene, clean_object(scene, group), "Clean"))
    np.testing.assert_array_equal(labels, scene.labels)


def test_an_isolated_object_stays_alone_when_it_is_cleaned() -> None:
    scene, rows = floating()
    history = History(scene)
    history.do(isolate(scene, group_indices(scene, 1)))
    history.do(cleaned_edit(scene, clean_object(scene, 1), "Clean"))
    assert (scene.labels[scene.visible] == 1).all()
    assert not scene.visible[rows[:15]].any()  # its floaters are hidden, too
    history.undo()
    assert scene.visible[rows[:15]].all()


@pytest.mark.parametrize("build", [isolate_cleaned, delete_cleaned])
def test_cleaned_acts_are_one_entry(build: type) -> None:
    scene, rows = floating()
    history = History(scene)
    history.do(select(scene, group_indices(scene, 1)))
    before = snapshot(scene)
    labels = run_stage(clean_objects_stage(scene, (1,)))
    history.do(build(scene, (1,), labels, "Act"))
    assert history.cursor == 2
    mine = rows[:15]
    strays = mine[scene.labels[mine] == 0]
    assert len(strays) > 10
    if build is isolate_cleaned:
        assert set(scene.labels[scene.visible]) == {1}
        assert not scene.visible[strays].any()
    else:
        assert scene.has(State.DELETED)[strays].all()
        assert len(group_indices(scene, 1)) == 0
    history.undo()
    assert snapshot(scene) == before


def test_a_copy_is_cleaned_and_selected() -> None:
    scene, rows = floating()
    before = snapshot(scene)
    labels = run_stage(clean_objects_stage(scene, (1,)))
    copy = cleaned_copy(scene, (1,), labels)
    assert snapshot(scene) == before
    np.testing.assert_array_equal(copy.has(State.SELECTED), copy.labels == 1)
    assert not copy.has(State.SELECTED)[rows[copy.labels[rows] == 0]].any()


def test_whole_objects() -> None:
    scene, _ = floating()
    history = History(scene)
    assert whole_objects(scene) == ()
    both = np.concatenate([group_indices(scene, 2), group_indices(scene, 4)])
    history.do(select(scene, both))
    assert whole_objects(scene) == (2, 4)
    history.do(select(scene, both[1:]))
    assert whole_objects(scene) == ()
    history.do(hide(scene, both[:1]))
    assert whole_objects(scene) == (2, 4), "what is hidden need not be chosen"
    history.undo()
    history.do(lock(scene, both[:1]))
    assert whole_objects(scene) == (2, 4), "what is locked cannot be chosen"
    history.do(select(scene, np.flatnonzero(scene.labels == 0)[:1], "add"))
    assert whole_objects(scene) == (), "a loose splat is no object"


def test_the_script_cleans() -> None:
    scene, rows = floating()
    wanted = run_stage(clean_objects_stage(scene, (1, 3)))
    assert run_script(scene, [{"op": "clean", "groups": [1, 3]}]) == ("Clean",)
    np.testing.assert_array_equal(scene.labels, wanted)
    assert (scene.labels[rows] == 0).mean() > 0.9
    with pytest.raises(GagaError, match="no object is selected"):
        run_script(scene, [{"op": "clean"}])
