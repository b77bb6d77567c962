"""What lies behind opaque splats: a wall hides, a wall with a door or of glass does not."""

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.camera import Camera
from gaga_core.scene.lod.cut import choose_cut, covers_of, hidden_nodes
from tests.core.scene.lod.conftest import Built, N
from tests.scenes import orbit_cameras

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
