"""Label maps with errors of a scene with known groups: what every way to identity starts from."""

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.grouping.votes import LabelMap, vote_labels
from gaga_core.identity.closed_form import ClosedForm, Voted, vote_identity
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import true_map
from tests.core.identity.noisy import HELD_OUT, G, Views
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=G - 1, per_object=250, n_cameras=10, seed=2)


@pytest.fixture(scope="module")
def maps(scene: Synthetic) -> dict[str, IntArray]:
    """True label maps of which 15 % of the 12 x 12 blocks have a random label, view by view."""
    result = {}
    for i, camera in enumerate(scene.cameras):
        rng = np.random.default_rng(i)
        blocks = (-(-camera.height // 12), -(-camera.width // 12))
        other = rng.integers(1, G + 1, blocks).repeat(12, axis=0).repeat(12, axis=1)
        wrong = (rng.random(blocks) < 0.15).repeat(12, axis=0).repeat(12, axis=1)
        here = (slice(camera.height), slice(camera.width))
        truth = true_map(scene, camera)
        result[camera.name] = np.where(wrong[here] & (truth > 0), other[here], truth).astype(
            np.int32
        )
    return result


@pytest.fixture(scope="module")
def label_map(maps: dict[str, IntArray]) -> LabelMap:
    return lambda camera: maps[camera.name]


@pytest.fixture(scope="module")
def train(scene: Synthetic) -> Views:
    return [camera for i, camera in enumerate(scene.cameras) if i not in HELD_OUT]


@pytest.fixture(scope="module")
def closed(scene: Synthetic, train: Views, label_map: LabelMap) -> ClosedForm:
    votes = run_stage(vote_labels(scene.gaussians, train, label_map, G, choose()))
    nobody = np.full(len(scene.gaussians), -1, np.int32)
    voted = Voted(votes.labels, votes.confidence)
    return run_stage(vote_identity(scene.gaussians, voted, nobody, G, train, choose()))
