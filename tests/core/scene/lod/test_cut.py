"""The cut: all of the scene once, within the budget, finer where it is near."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.camera import Camera
from gaga_core.scene.lod.cut import Cut, choose_cut, covers_of, drawn_nodes, hidden_nodes, parent_of
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


# --- What lies behind opaque splats: a wall hides, a wall with a door or of glass does not.


K = np.array([[160.0, 0, 160], [0, 160, 120], [0, 0, 1]])
CAMERA = Camera(K, np.eye(4), 320, 240, "")  # looks along +z
# Wholly behind the wall at z = 2, before it, through it, out of the picture, around the camera.
BOXES = np.array(
    [
        [-0.5, -0.5, 3, 0.5, 0.5, 4],
        [-0.5, -0.5, 1, 0.5, 0.5, 1.5],
        [-0.5, -0.5, 1, 0.5, 0.5, 4],
        [90, -0.5, 3, 91, 0.5, 4],
        [-0.5, -0.5, -4, 0.5, 0.5, 4],
    ],
    np.float32,
)


def behind_wall(side: float, *, hole: float = 0.0, logit: float = 4.0) -> BoolArray:
    """Hidden boxes behind a wall of this half side in which a square is open."""
    rng = np.random.default_rng(0)
    means = np.column_stack([rng.uniform(-side, side, (400_000, 2)), np.full(400_000, 2.0)])
    means = means[np.abs(means[:, :2]).max(axis=1) >= hole].astype(np.float32)
    size = np.log(2 * side / 632)
    log_scales = np.full((len(means), 3), [size, size, size - 5], np.float32)
    covers = covers_of(log_scales, np.full(len(means), logit, np.float32))
    return hidden_nodes(BOXES, means, covers, CAMERA)


def test_a_wall_hides_what_is_wholly_behind_it() -> None:
    assert behind_wall(3.0).tolist() == [True, False, False, False, False]


@pytest.mark.parametrize(
    ("side", "hole", "logit"),
    [(3.0, 0.1, 4.0), (0.3, 0.0, 4.0), (3.0, 0.0, -2.0)],
    ids=["with a hole", "too small", "see-through"],
)
def test_a_wall_that_shows_what_is_behind_hides_nothing(
    side: float, hole: float, logit: float
) -> None:
    assert not behind_wall(side, hole=hole, logit=logit).any()


def test_hidden_nodes_are_drawn_coarser_and_the_others_finer(built: Built) -> None:
    tree = built.tree
    camera = orbit_cameras(6, width=320, height=240, radius=1.6)[0]
    hidden = np.arange(tree.n_nodes) % 2 == 0
    hidden[tree.first_nodes[1] :] = False
    hidden[tree.first_nodes[1] : tree.first_nodes[2] : 2] = True
    plain = choose_cut(tree, tree.boxes, camera, N // 3)
    found = choose_cut(tree, tree.boxes, camera, N // 3, hidden=hidden)
    divided = np.arange(tree.first_nodes[1], tree.first_nodes[2])
    assert found.least_error < plain.least_error
    assert found.divided[divided[::2]].sum() < plain.divided[divided[::2]].sum()
    assert found.divided[divided[1::2]].sum() > plain.divided[divided[1::2]].sum()
    assert found.n_seen <= N // 3
