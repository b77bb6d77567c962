"""The cut: all of the scene once, within the budget, finer where it is near."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.scene.lod.cut import Cut, choose_cut, drawn_nodes, parent_of
from tests.core.scene.lod.conftest import Built, N
from tests.scenes import orbit_cameras

CAMERAS = orbit_cameras(6, width=320, height=240, radius=1.6)


def cut_of(built: Built, budget: int, camera: int = 0, **options: np.ndarray) -> Cut:
    tree = built.tree
    return choose_cut(tree, tree.boxes, CAMERAS[camera], budget, **options)


@pytest.mark.parametrize("budget", [2_000, 10_000, 30_000, 60_000, 200_000])
def test_cut_holds_every_splat_once_within_the_budget(built: Built, budget: int) -> None:
    tree = built.tree
    for camera in range(len(CAMERAS)):
        cut = cut_of(built, budget, camera)
        spans = sorted(tree.opened_span(int(node)) for node in drawn_nodes(tree, cut.divided))
        assert spans[0][0] == 0
        assert spans[-1][1] == N
        assert all(a[1] == b[0] for a, b in pairwise(spans))
        assert cut.n_seen <= budget


def test_large_budget_draws_the_opened_splats_that_are_seen(built: Built) -> None:
    narrow = np.diag([8.0, 8.0, 1.0])
    narrow[:2, 2] = -7 * CAMERAS[0].K[:2, 2]  # about the middle of the picture
    near = replace(CAMERAS[0], K=narrow @ CAMERAS[0].K)
    tree = built.tree
    cut = choose_cut(tree, tree.boxes, near, N)
    seen = [node for node in drawn_nodes(tree, cut.divided) if cut.seen[node]]
    assert {tree.level_of(int(node)) for node in seen} == {0}


def test_more_budget_never_has_a_larger_error(built: Built) -> None:
    errors = [cut_of(built, budget).least_error for budget in (3_000, 9_000, 30_000, 90_000)]
    assert errors == sorted(errors, reverse=True)


def test_what_is_near_is_finer(built: Built) -> None:
    tree = built.tree
    cut = cut_of(built, 40_000)
    nodes = drawn_nodes(tree, cut.divided)
    middles = (tree.boxes[nodes, :3] + tree.boxes[nodes, 3:]) / 2
    depths = middles @ CAMERAS[0].cam_from_world[2, :3] + CAMERAS[0].cam_from_world[2, 3]
    fine = np.array([tree.level_of(int(node)) == 0 for node in nodes])
    assert 0 < fine.sum() < len(fine)
    assert np.median(depths[fine]) < np.median(depths[~fine])


def test_divided_nodes_stay_so_for_a_small_motion(built: Built) -> None:
    tree = built.tree
    changes = {True: 0, False: 0}  # with the last cut in mind, and without
    for start in CAMERAS:
        for keeps in changes:
            divided: BoolArray | None = None
            for step in range(12):  # to and fro
                pose = start.cam_from_world.copy()
                pose[2, 3] += 0.08 * (-1) ** step
                camera = replace(start, cam_from_world=pose)
                last = divided if keeps else None
                now = choose_cut(tree, tree.boxes, camera, 25_000, before=last).divided
                changes[keeps] += 0 if divided is None else int((now != divided).sum())
                divided = now
    assert changes[False] > 20
    assert changes[True] < changes[False] / 4


def test_exact_nodes_are_divided_first(built: Built) -> None:
    tree = built.tree
    before = cut_of(built, 50_000)
    plain = before.divided
    far = [
        node
        for node in range(int(tree.first_nodes[1]), int(tree.first_nodes[2]))
        if before.seen[node] and not plain[node]
    ][:2]
    exact = np.zeros(tree.n_nodes, np.bool_)
    parents = parent_of(tree)
    above = np.array(far)
    while above.max() >= 0:
        exact[above[above >= 0]] = True
        above = parents[above]
    cut = cut_of(built, 50_000, exact=exact)
    assert cut.divided[far].all()
    assert cut.n_seen <= 50_000
