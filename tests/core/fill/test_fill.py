"""Delete and fill: what was hidden comes back, in one edit to undo, save and script."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.fill.chart import Chart, chart_of, darker, tolerance_of
from gaga_core.fill.fill import Filling, accepted_stage, fill_stage, filled_edit
from gaga_core.fill.shadows import gains
from gaga_core.fill.surfaces import FillConfig, Seen, seen_stage, surfaces_around
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import Progress, run_stage
from gaga_core.raster import choose
from gaga_core.raster.base import Frame
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.values import joined
from gaga_core.scene.project import open_path_stage, save_project
from gaga_core.scene.scene import Scene, State
from tests.core.fill.tables import BOX, HALF, STEP, TABLE, Table, flat, psnr, table_with_box
from tests.core.scene.edits.edit_walk import snapshot

CPU = choose("cpu")


@pytest.fixture(scope="module")
def table() -> Table:
    return table_with_box(sh_degree=1)


@pytest.fixture(scope="module")
def found(table: Table) -> Filling:
    scene = Scene.of(table.gaussians, table.labels)
    return run_stage(fill_stage(scene, table.labels == BOX, table.cameras, CPU))


@pytest.fixture(scope="module")
def looked_at(table: Table) -> tuple[Seen, Chart]:
    """What the photos saw, and the table with its hole."""
    is_box, settings = table.labels == BOX, FillConfig()
    seen = run_stage(seen_stage(table.gaussians, is_box, table.cameras, CPU, settings))
    usable = seen.known & ~is_box
    own = table.gaussians.means[is_box].astype(np.float64)
    plane = surfaces_around(table.gaussians, table.labels, is_box, usable, settings)[0]
    return seen, chart_of(table.gaussians, plane, own, seen.views, CPU, settings)


def filled(table: Table, found: Filling) -> tuple[Scene, History]:
    scene = Scene.of(table.gaussians, table.labels)
    history = History(scene)
    assert history.do(filled_edit(scene, found, "Delete and fill box"))
    return scene, history


def test_the_place_under_a_box_looks_as_the_table_around_it(table: Table, found: Filling) -> None:
    scene, _ = filled(table, found)
    bare = table.gaussians.take(table.labels == TABLE)
    for camera in table.cameras[::4]:
        truth, hole, new = (CPU.render(g, camera) for g in (table.empty, bare, bake(scene)))
        inside = (hole.alpha < 0.5) & (truth.alpha > 0.9)
        assert inside.sum() > 100
        gain = psnr(new.image, truth.image, inside) - psnr(hole.image, truth.image, inside)
        assert gain > 15
        assert psnr(new.image, truth.image, ~inside) > psnr(hole.image, truth.image, ~inside) - 0.05


def test_one_share_counts_all_that_is_done_and_never_goes_back(table: Table) -> None:
    seen: list[Progress] = []
    scene = Scene.of(table.gaussians, table.labels)
    run_stage(fill_stage(scene, table.labels == BOX, table.cameras, CPU), seen.append)
    assert len({step.stage for step in seen if step.total}) == 1, "no share of a step alone"
    shares = [step.done / step.total for step in seen]
    assert shares == sorted(shares)
    assert shares[0] == 0
    assert max(np.diff([*shares, 1.0])) < 0.35, "it moves while the hole is filled, too"


class Counting(CpuRasterizer):
    """Counts how often a view is drawn."""

    n = 0

    def render(self, *args: Any, **options: Any) -> Frame:
        self.n += 1
        return super().render(*args, **options)

    def vote(self, *args: Any, **options: Any) -> None:
        self.n += 1
        super().vote(*args, **options)


def test_the_share_goes_as_views_are_drawn(table: Table) -> None:
    """Looking behind the object was said to be 30 % of it and is more: the time left grew."""
    counting, shares, drawn = Counting(), [], []
    scene = Scene.of(table.gaussians, table.labels)

    def heard(step: Progress) -> None:
        if step.message:  # a view behind the object
            drawn.append(counting.n)
            shares.append(step.done / step.total)

    run_stage(fill_stage(scene, table.labels == BOX, table.cameras, counting), heard)
    n = len(drawn) // 3
    assert n > 5
    np.testing.assert_allclose(shares, 0.4 * np.array(drawn) / (4 * n), atol=2e-3)


def test_new_splats_are_like_those_around_and_of_their_group(table: Table, found: Filling) -> None:
    n_true = int((np.abs(table.empty.means[:, :2]).max(axis=1) < HALF).sum())
    assert 0.6 * n_true < len(found.splats) < 1.6 * n_true
    assert (found.labels == TABLE).all()
    assert found.splats.sh_degree == 1
    # At the edge they are smaller, and all lie under what photos showed.
    inner = np.abs(found.splats.means[:, :2]).max(axis=1) < HALF - 2 * STEP
    assert np.isin(found.splats.log_scales[inner], table.empty.log_scales).all()
    edge = np.abs(found.splats.means[:, :2]).max(axis=1) > HALF - STEP / 2
    assert found.splats.scales[edge, 0].mean() < 0.8 * table.empty.scales.max()
    assert found.splats.means[:, 2].min() > -0.7 * STEP
    assert found.splats.means[:, 2].max() < -0.3 * STEP
    assert np.array_equal(found.removed, np.flatnonzero(table.labels == BOX))


@pytest.mark.parametrize("is_copied", [True, False])
def test_what_a_person_put_into_it_stays(table: Table, is_copied: bool) -> None:
    """No photo showed it there, as none showed what is in the object's body."""
    away = np.random.default_rng(0).uniform(-0.08, 0.08, (60, 3)) + np.array([0.6, 0.6, 0.08])
    ball = flat(away, np.full((60, 3), 0.4), 1)
    labels = np.append(table.labels, np.full(60, BOX + 1, np.int32)).astype(np.int32)
    scene, n = Scene.of(joined(table.gaussians, ball), labels), len(table.labels)
    into = np.eye(4)
    into[:2, 3] = -0.6
    put = edits.duplicate if is_copied else edits.transform
    assert History(scene).do(put(scene, np.arange(n, n + 60), into))
    found = run_stage(fill_stage(scene, scene.labels == BOX, table.cameras, CPU))
    assert len(found.splats) > 0
    assert (found.unseen < n).all()
    assert (found.stained < n).all()


@pytest.mark.parametrize("how", ["copied", "moved", "nudged"])
def test_what_a_person_put_there_hid_nothing_and_leaves_no_hole(table: Table, how: str) -> None:
    """A copy of the teapot took half of the cup next to it along; one that was moved by a little
    still stands where nothing was seen."""
    scene = Scene.of(table.gaussians, table.labels)
    box = np.flatnonzero(table.labels == BOX)
    aside = np.eye(4)
    aside[0, 3] = 0.02 if how == "nudged" else 0.5
    history, n = History(scene), len(table.labels)
    if how == "copied":
        assert history.do(edits.duplicate(scene, box, aside))
        box = np.arange(n, len(scene))
    else:
        assert history.do(edits.transform(scene, box, aside))
    found = run_stage(fill_stage(scene, box, table.cameras, CPU))
    assert np.array_equal(found.removed, box)
    assert found.was_put == (how != "nudged")
    assert bool(found) == (how == "nudged")


def test_what_photos_saw_behind_it_is_not_filled_again(table: Table) -> None:
    whole = replace(table.empty)
    box = table.gaussians.take(table.labels == BOX)
    box = replace(box, means=box.means + np.array([0, 0, 0.5], np.float32))  # in the air
    labels = np.repeat(np.array([TABLE, BOX], np.int32), [len(whole), len(box)])
    scene = Scene.of(joined(whole, box), labels)
    found = run_stage(fill_stage(scene, labels == BOX, table.cameras, CPU))
    assert len(found.splats) == 0


def test_a_floor_that_is_covered_already_is_left_as_it_is(table: Table) -> None:
    box = table.gaussians.take(table.labels == BOX)
    bare = table.gaussians.take(table.labels == TABLE)
    # Large splats of what lies around cover the place under the box, as after a training.
    log_scales = bare.log_scales.copy()
    at_rim = np.abs(bare.means[:, :2]).max(axis=1) < HALF + STEP
    log_scales[at_rim, :2] = np.log(HALF)
    covered = replace(bare, log_scales=log_scales)
    # So do small ones that no photo showed; they are of the table, although the box is around them.
    low = np.array([[x, y, 0.01] for x in (-0.1, 0, 0.1) for y in (-0.1, 0, 0.1)], np.float32)
    covered = joined(covered, replace(table.empty.take(np.arange(9)), means=low))
    labels = np.repeat(np.array([TABLE, BOX], np.int32), [len(covered), len(box)])
    scene = Scene.of(joined(covered, box), labels)
    before = bake(scene, indices=np.flatnonzero(labels == TABLE))
    found = run_stage(fill_stage(scene, labels == BOX, table.cameras, CPU))
    assert not found
    assert len(found.unseen) == 0
    History(scene).do(filled_edit(scene, found, "Delete and fill"))
    after = bake(scene)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert np.array_equal(getattr(after, name), getattr(before, name)), name


def test_splats_that_change_what_is_next_to_a_hole_are_taken_out(
    table: Table, found: Filling, looked_at: tuple[Seen, Chart]
) -> None:
    seen, chart = looked_at
    bare = table.gaussians.take(table.labels == TABLE)
    nothing = np.zeros(len(bare), np.bool_)

    def kept(fresh: Gaussians) -> np.ndarray:
        return run_stage(accepted_stage(bare, fresh, nothing, chart, seen.views, CPU))

    assert kept(found.splats).all()
    stray = found.splats.take(np.arange(0, len(found.splats), 8))
    black = np.full_like(stray.sh, -1.5)
    aside = replace(stray, means=stray.means + np.array([0.55, 0, 0.01], np.float32), sh=black)
    above = replace(stray, means=stray.means + np.array([0, 0, 0.9], np.float32), sh=black)
    for wrong in (aside, above):
        result = kept(joined(found.splats, wrong))
        assert result[: len(found.splats)].mean() > 0.9
        assert result[len(found.splats) :].mean() < 0.05
    assert not kept(aside).any()


def test_what_photos_showed_at_the_foot_stays(
    table: Table, found: Filling, looked_at: tuple[Seen, Chart]
) -> None:
    seen, chart = looked_at
    bare = table.gaussians.take(table.labels == TABLE)
    nothing = np.zeros(len(bare), np.bool_)
    stray = found.splats.take(np.arange(40))
    along = np.linspace(-HALF, HALF, 40)
    ring = np.stack([along, np.full(40, -HALF - 1.8 * STEP), np.full(40, 0.004)], axis=1)
    small, black = np.full_like(stray.log_scales, np.log(0.2 * STEP)), np.full_like(stray.sh, -1.5)
    stray = replace(stray, means=ring.astype(np.float32), log_scales=small, sh=black)
    both = joined(found.splats, stray)
    kept = run_stage(accepted_stage(bare, both, nothing, chart, seen.views, CPU))
    assert kept[: len(found.splats)].mean() > 0.9
    assert kept[len(found.splats) :].mean() < 0.3


def test_nothing_is_left_between_the_body_and_the_surface(
    table: Table, looked_at: tuple[Seen, Chart]
) -> None:
    """A dark splat just over the cloth was neither in the teapot nor on the cloth."""
    _, chart = looked_at
    dark = table.empty.take(np.arange(1))
    dark = replace(dark, sh=np.full_like(dark.sh, -1.5))
    for height in (1.25 * chart.step, 0.999 * tolerance_of(chart), 1.5 * tolerance_of(chart)):
        over = replace(dark, means=np.array([[0.03, 0.02, height]], np.float32))
        scene = Scene.of(joined(table.gaussians, over), np.append(table.labels, np.int32(TABLE)))
        found = run_stage(fill_stage(scene, scene.labels == BOX, table.cameras, CPU))
        assert len(scene) - 1 in found.unseen, height


def test_only_what_is_dark_is_a_gap() -> None:
    color = np.full((40, 40, 3), 0.6) * np.linspace(0.7, 1.0, 40)[:, None]
    known, asked, dark = (np.zeros((40, 40), np.bool_) for _ in range(3))
    known[2:] = asked[10:30, 10:30] = dark[15:25, 12:18] = True
    color[dark] *= 0.5
    found = darker(color, known, asked)
    assert found[dark].all()
    assert not found[~ndimage.binary_dilation(dark, iterations=3)].any()
    assert not darker(color / 2, known, asked & ~ndimage.binary_dilation(dark, iterations=9)).any()


def test_a_surface_is_found_whatever_its_number_and_a_cloth_on_it_is_part_of_it(
    table: Table,
) -> None:
    """Things that lie around have planes, too: only so many are looked at."""
    rng, made, labels = np.random.default_rng(0), [table.gaussians], [table.labels + 90]
    for k in range(20):  # small leaning plates
        points = np.column_stack([rng.uniform(-0.08, 0.08, (60, 2)), np.zeros(60)])
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        points = points @ turn.T + [0.4 * np.cos(k), 0.4 * np.sin(k), 0.15]
        made.append(flat(points, np.full((60, 3), 0.5), 0))
        labels.append(np.full(60, k + 1))
    whole = made[0]
    for plate in made[1:]:
        whole = joined(whole, plate)
    groups = np.concatenate(labels).astype(np.int32)
    cloth = (groups == TABLE + 90) & (whole.means[:, 0] > 0)
    groups[cloth] = 200
    whole.means[cloth, 2] += 0.012
    known = np.ones(len(groups), np.bool_)
    found = surfaces_around(whole, groups, groups == BOX + 90, known, FillConfig())
    assert found[0].is_layered
    assert len(np.intersect1d(found[0].splats, np.flatnonzero(cloth))) > 0.9 * cloth.sum()
    bare = (groups == TABLE + 90).sum()
    assert len(np.setdiff1d(found[0].splats, np.flatnonzero(cloth))) > 0.9 * bare
    own = whole.means[groups == BOX + 90].astype(np.float64)
    assert tolerance_of(chart_of(whole, found[0], own, (), CPU, FillConfig())) > 0.012


def test_the_edge_of_a_table_is_not_continued_into_the_air(table: Table) -> None:
    on_table = table.gaussians.means[:, 0] < 0.09
    kept = on_table | (table.labels == BOX)  # the box stands half over the edge
    scene = Scene.of(table.gaussians.take(kept), table.labels[kept])
    found = run_stage(fill_stage(scene, scene.labels == BOX, table.cameras, CPU))
    assert len(found.splats) > 50
    assert found.splats.means[:, 0].max() < 0.09 + 0.15


def test_what_is_dark_is_lightened_only_where_it_is_a_shadow(
    looked_at: tuple[Seen, Chart],
) -> None:
    _, chart = looked_at
    away = np.maximum(np.abs(chart.uv()).max(axis=2) - HALF, 0)
    shadow = 1 - 0.5 * np.exp(-((away / 0.12) ** 2))
    for seed in range(6):
        # Patches a few splats wide, darker and brighter by a fifth: some of them touch the hole.
        rng = np.random.default_rng(seed)
        noise = ndimage.gaussian_filter(rng.normal(size=chart.shape), 3)
        patches = np.clip(1 + 0.2 * noise / noise.std(), 0.4, 1.6)
        for dark, is_shadow in ((patches, False), (shadow, True)):
            factors = gains(replace(chart, color=chart.color * dark[:, :, None]), chart.hole)
            assert (factors.max() > 1.4) == is_shadow, seed
            assert is_shadow or (factors == 1).all()


@pytest.mark.parametrize("lighten", [True, False])
def test_a_shadow_around_a_hole_goes_when_it_is_to_and_stays_when_not(lighten: bool) -> None:
    table = table_with_box(shade=0.5)
    away = np.abs(table.gaussians.means[:, :2]).max(axis=1) - HALF
    scene, config = Scene.of(table.gaussians, table.labels), FillConfig(lighten=lighten)
    made = run_stage(fill_stage(scene, table.labels == BOX, table.cameras, CPU, config))
    factors = np.ones((len(scene), 3))
    factors[made.stained] = made.gains
    rim, far = (factors[where & (table.labels == TABLE)] for where in (away < 0.08, away > 0.35))
    assert (rim.mean() > 1.25) == lighten
    assert far.max() < 1.1
    assert lighten or len(made.stained) == 0


def test_undo_redo_script_and_project_give_the_same_splats(
    table: Table, found: Filling, tmp_path: Path
) -> None:
    write_ply(tmp_path / "table.ply", table.gaussians)
    project = run_stage(open_path_stage(tmp_path / "table.ply"))
    scene, history = project.scene, History(project.scene)
    history.do(edits.set_labels(scene, np.arange(len(scene)), table.labels, "Groups"))
    before = snapshot(scene)
    assert history.do(filled_edit(scene, found, "Delete and fill box"))
    after, splats = snapshot(scene), bake(scene)
    history.undo()
    assert snapshot(scene) == before
    history.redo()
    assert snapshot(scene) == after
    history.do(edits.transform(scene, np.flatnonzero(scene.labels == TABLE), np.eye(3, 4) * 2))
    history.undo()

    script = json.loads(json.dumps(history.recorded()))
    other = run_stage(open_path_stage(tmp_path / "table.ply")).scene
    run_script(other, script)
    assert snapshot(other) == after

    saved = save_project(project, tmp_path / "table.gaga")
    reopened = run_stage(open_path_stage(saved))
    again = bake(reopened.scene)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert np.array_equal(getattr(again, name), getattr(splats, name)), name
    assert np.array_equal(reopened.scene.labels, scene.labels)
    save_project(reopened)
    assert len(run_stage(open_path_stage(saved)).scene) == len(scene)

    file = next(saved.glob("scene-*.npz"))
    arrays = dict(np.load(file))
    arrays["made_0:means"] = arrays["made_0:means"][:-1]
    np.savez_compressed(file, **arrays)
    with pytest.raises(GagaError, match=r"scene-.*damaged"):
        run_stage(open_path_stage(saved))


def test_a_script_fills_by_name_and_what_was_deleted_before(table: Table) -> None:
    counts = []
    for script in (
        [{"op": "fill", "groups": ["box"], "lighten": False}],
        [{"op": "delete", "groups": ["box"]}, {"op": "fill", "lighten": False}],
    ):
        scene = Scene.of(table.gaussians, table.labels)
        scene.names = {BOX: "box"}
        titles = run_script(scene, script, views=lambda: table.cameras)
        assert titles[-1] in ("Delete and fill box", "Fill what was deleted")
        assert scene.has(State.DELETED)[: len(table.labels)][table.labels == BOX].all()
        counts.append(int(scene.visible.sum()))
    assert counts[0] == counts[1] > int((table.labels == TABLE).sum())
    with pytest.raises(GagaError, match="Nothing is selected"):
        run_script(Scene.of(table.gaussians, table.labels), [{"op": "fill"}])


def test_without_photos_it_is_looked_at_from_all_around(table: Table) -> None:
    scene = Scene.of(table.gaussians, table.labels)
    coarse = FillConfig(most_cells=60, view_pixels=160)
    found = run_stage(fill_stage(scene, table.labels == BOX, (), CPU, coarse))
    assert len(found.splats) > 50


def test_locked_splats_that_it_hid_stay(table: Table) -> None:
    labels = np.append(table.labels, np.full(9, 3, np.int32))
    inside = table.empty.take(np.arange(9))
    low = np.array([[x, y, 0.2] for x in (-0.05, 0, 0.05) for y in (-0.05, 0, 0.05)], np.float32)
    scene = Scene.of(joined(table.gaussians, replace(inside, means=low)), labels)
    free, locked = np.flatnonzero(labels == 3)[::2], np.flatnonzero(labels == 3)[1::2]
    History(scene).do(edits.lock(scene, locked))
    coarse = FillConfig(most_cells=40)
    hid = run_stage(fill_stage(scene, labels == BOX, table.cameras[::4], CPU, coarse)).unseen
    assert np.isin(free, hid).all()
    assert not np.isin(locked, hid).any()


def test_a_thing_in_an_open_box_stays_as_far_as_photos_show_it(table: Table) -> None:
    is_open = ~((table.labels == BOX) & (table.gaussians.means[:, 2] > 2 * HALF - 1e-4))
    rng = np.random.default_rng(0)
    around = rng.normal(size=(400, 3))
    ball = 0.15 * around / np.linalg.norm(around, axis=1, keepdims=True) + [0, 0, 2 * HALF]
    thing = flat(ball, np.tile([0.9, 0.1, 0.1], (400, 1)), 1)
    thing = replace(thing, log_scales=np.full_like(thing.log_scales, np.log(0.02)))
    gaussians = joined(table.gaussians.take(np.flatnonzero(is_open)), thing)
    labels = np.append(table.labels[is_open], np.full(400, 3)).astype(np.int32)
    is_box, cameras, settings = labels == BOX, table.cameras[::3], FillConfig()
    seen = run_stage(seen_stage(gaussians, is_box, cameras, CPU, settings))
    found = run_stage(fill_stage(Scene.of(gaussians, labels), is_box, cameras, CPU))
    assert (seen.known & (labels == 3)).sum() > 10
    assert not (seen.known & (labels == 3))[found.unseen].any()


def test_splats_without_a_place_go_with_the_object_and_hide_nothing(
    table: Table, found: Filling
) -> None:
    lost = np.flatnonzero(table.labels == BOX)[3:5]
    means = table.gaussians.means.copy()
    means[lost] = [[np.nan, 0, 0], [0, np.inf, 0]]
    scene = Scene.of(replace(table.gaussians, means=means), table.labels)
    again = run_stage(fill_stage(scene, table.labels == BOX, table.cameras[::3], CPU))
    assert np.array_equal(again.removed, found.removed)
    assert len(again.splats) > 0.8 * len(found.splats)
    for none in (lost, lost[:0]):
        nothing = run_stage(fill_stage(scene, none, table.cameras, CPU))
        assert not nothing
        assert np.array_equal(nothing.removed, none)
    assert filled_edit(scene, nothing, "Delete and fill") is None


def test_what_is_filled_is_no_hole_any_more(table: Table, found: Filling) -> None:
    scene, _ = filled(table, found)
    deleted = np.flatnonzero(scene.has(State.DELETED))
    assert np.isin(np.flatnonzero(table.labels == BOX), deleted).all()
    again = run_stage(fill_stage(scene, deleted, table.cameras, CPU))
    assert len(again.splats) < 0.01 * len(found.splats)
    assert not np.isin(again.unseen, np.arange(len(table.labels), len(scene))).any()


def test_locked_splats_of_the_rim_stay_as_they_are() -> None:
    table = table_with_box(shade=0.5)
    scene = Scene.of(table.gaussians, table.labels)
    near = np.abs(table.gaussians.means[:, :2]).max(axis=1) < HALF + 3 * STEP
    locked = np.flatnonzero(near & (table.labels == TABLE))[::2]
    History(scene).do(edits.lock(scene, locked))
    before = bake(scene, indices=locked)
    found = run_stage(fill_stage(scene, table.labels == BOX, table.cameras[::2], CPU))
    assert len(found.stained) > 0
    History(scene).do(filled_edit(scene, found, "Delete and fill"))
    assert not scene.has(State.DELETED)[locked].any()
    after = bake(scene, indices=locked)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert np.array_equal(getattr(after, name), getattr(before, name)), name
