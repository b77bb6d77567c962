"""The tree: nothing is lost on the way up, and a file that does not fit is not used."""

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.progress import run_stage
from gaga_core.scene.lod.build import alike_runs, build_lod_stage, curve_order
from gaga_core.scene.lod.tree import (
    FAN,
    FILE,
    NODE,
    NODES,
    ORDER,
    WINDOW,
    LodTree,
    level_file,
    level_sizes,
    open_lod,
)
from gaga_core.scene.merge_splats import merge_splats
from tests.core.scene.lod.conftest import Built, N
from tests.scenes import random_gaussians


def test_neighbours_on_the_curve_are_neighbours_in_space() -> None:
    means = np.random.default_rng(3).uniform(-1, 1, (20_000, 3)).astype(np.float32)
    order = curve_order(means)
    assert np.array_equal(np.sort(order), np.arange(len(means)))
    steps = np.linalg.norm(np.diff(means[order], axis=0), axis=1)
    grid = (8 / 20_000) ** (1 / 3)  # distance of points of a lattice as dense
    assert np.mean(steps) < 1.5 * grid


def test_nodes_of_every_level_stand_for_each_splat_once(built: Built) -> None:
    tree = built.tree
    assert tree.sizes == (N, 22_501, 5_626, 1_407) == tuple(level_sizes(N))
    for level in range(len(tree.sizes)):
        nodes = range(tree.first_nodes[level], tree.first_nodes[level + 1])
        spans = [tree.opened_span(node) for node in nodes]
        assert spans[0][0] == 0
        assert spans[-1][1] == N
        assert all(a[1] == b[0] for a, b in pairwise(spans))


def test_level_one_is_the_merge_of_its_windows(built: Built) -> None:
    tree, opened = built.tree, built.gaussians
    first = int(tree.first_nodes[1])
    splats, rows = tree.read(first + 1, opened)
    start, stop = tree.opened_span(first + 1)
    below = tree.order[start:stop]
    order, starts = alike_runs(opened.take(below))
    assert len(starts) == len(splats)
    # Each window of neighbours on the curve has a quarter as many splats.
    assert np.array_equal(np.sort(order.reshape(-1, WINDOW)), np.arange(len(below)).reshape(-1, 64))
    assert np.array_equal(starts[:: WINDOW // FAN], np.arange(0, len(below), WINDOW))
    runs = np.repeat(np.arange(len(starts)), np.diff([*starts, len(below)]))
    expected = merge_splats(opened.take(below[order]), runs)
    for name in ("means", "quats", "logit_opacities", "sh"):
        assert np.array_equal(getattr(splats, name), getattr(expected, name)), name
    # Larger, all sides alike, where the opacity has come to its end, and only there.
    growth = splats.log_scales - expected.log_scales
    assert np.ptp(growth, axis=1).max() < 1e-5
    assert growth.min() > -1e-6
    assert (growth[expected.opacities < 0.999] < 1e-5).all()
    members = np.split(below[order], starts[1:])
    assert all(row in run for row, run in zip(rows, members, strict=True))


def test_splats_that_are_alike_become_one() -> None:
    """Two colors, and two sheets one behind the other, that neighbours on the curve go through."""
    rng = np.random.default_rng(0)
    splats = random_gaussians(8 * WINDOW)
    splats.log_scales[:] = np.log([0.04, 0.04, 0.002])
    splats.quats[:] = (1, 0, 0, 0)
    splats.logit_opacities[:] = 2
    splats.means[:, :2] = rng.uniform(0, 0.3, (len(splats), 2))
    kinds = rng.integers(0, 2, (len(splats), 2))
    splats.means[:, 2] = 0.05 * kinds[:, 0]
    splats.sh[:] = (kinds[:, 1] * 2 - 1)[:, None, None]
    order, starts = alike_runs(splats)
    for run in np.split(order, starts[1:]):
        assert (kinds[run] == kinds[run[0]]).all()
    # What is not finite is merged all the same.
    splats.means[3], splats.log_scales[70], splats.logit_opacities[200] = np.nan, np.inf, -np.inf
    order, starts = alike_runs(splats.take(np.arange(8 * WINDOW - 5)))
    assert np.array_equal(np.sort(order), np.arange(8 * WINDOW - 5))
    assert len(starts) == 127
    assert (np.diff(starts) > 0).all()


def test_a_tree_without_one_finite_size_opens_again(tmp_path: Path) -> None:
    splats = random_gaussians(2 * NODE)
    splats.log_scales[:] = -np.inf
    tree = run_stage(build_lod_stage(splats, tmp_path / "lod", "digest"))
    assert tree.log_scale_range == (0.0, 0.0)


def test_level_zero_is_the_model_bit_for_bit(built: Built) -> None:
    splats, rows = built.tree.read(2, built.gaussians)
    assert np.array_equal(splats.sh, built.gaussians.sh[rows])
    assert np.array_equal(splats.means, built.gaussians.means[rows])


def test_boxes_hold_what_their_nodes_reach_and_details_grow(built: Built) -> None:
    tree = built.tree
    middles = []
    for level in range(len(tree.sizes)):
        for node in range(tree.first_nodes[level], tree.first_nodes[level + 1]):
            splats, _ = tree.read(node, built.gaussians)
            reach = 3 * splats.scales.max(axis=1, keepdims=True)
            assert (splats.means - reach >= tree.boxes[node, :3]).all()
            assert (splats.means + reach <= tree.boxes[node, 3:]).all()
        middles.append(
            np.median(tree.details[tree.first_nodes[level] : tree.first_nodes[level + 1]])
        )
    assert middles[0] == 0
    assert (np.diff(middles) > 0).all()


def test_tree_of_another_model_is_not_used(built: Built) -> None:
    folder, n_sh = built.tree.folder, built.tree.n_sh
    again = open_lod(folder, "digest", N, n_sh)
    assert again is not None
    assert np.array_equal(again.boxes, built.tree.boxes)
    assert open_lod(folder, "other", N, n_sh) is None
    assert open_lod(folder, "digest", N + 1, n_sh) is None
    assert open_lod(folder / "none", "digest", N, n_sh) is None


@pytest.mark.parametrize("name", [FILE, ORDER, NODES, level_file(1)])
def test_truncated_file_is_told_in_a_sentence(built: Built, tmp_path: Path, name: str) -> None:
    shutil.copytree(built.tree.folder, tmp_path / "lod")
    path = tmp_path / "lod" / name
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(GagaError, match=r"Build the level of detail again"):
        open_lod(tmp_path / "lod", "digest", N, built.tree.n_sh)


def test_file_truncated_while_open_is_told_in_a_sentence(built: Built, tmp_path: Path) -> None:
    shutil.copytree(built.tree.folder, tmp_path / "lod")
    tree = open_lod(tmp_path / "lod", "digest", N, built.tree.n_sh)
    assert tree is not None
    (tmp_path / "lod" / level_file(1)).write_bytes(b"")
    with pytest.raises(GagaError, match="truncated"):
        tree.read(int(tree.first_nodes[1]), built.gaussians)


def test_cancelled_build_leaves_the_former_tree(tmp_path: Path) -> None:
    folder = tmp_path / "lod"
    small = random_gaussians(5_000)
    run_stage(build_lod_stage(small, folder, "first"))
    stage = build_lod_stage(random_gaussians(5_000, seed=1), folder, "second")
    for _ in range(3):
        next(stage)
    stage.close()
    assert isinstance(open_lod(folder, "first", 5_000, 1), LodTree)
    assert [path.name for path in tmp_path.iterdir()] == ["lod"]
