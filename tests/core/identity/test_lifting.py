"""Linear assignment inside the training: consistent where one view decides, blind between views."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.evaluate.baselines import LiftingConfig, assigned, lift_by_assignment
from gaga_core.identity.rows import RowConfig, sample_rows, view_batches
from gaga_core.identity.training_step import start_from_zeros
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import permuted, true_map
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=4, per_object=150, n_cameras=4, seed=2)


def test_masks_and_classes_are_paired_one_to_one_by_their_probability(scene: Synthetic) -> None:
    """No other pairing has a greater sum of mean probabilities; class 0 is nobody's."""
    camera = scene.cameras[0]
    true = true_map(scene, camera)
    views = run_stage(
        sample_rows(scene.gaussians, [camera], lambda _: true, choose("cpu"), RowConfig())
    )
    (batch,) = view_batches(views, len(scene.gaussians))
    training = start_from_zeros(len(scene.gaussians), 9, seed=0)
    rng = np.random.default_rng(0)
    training.encodings[:] = rng.normal(size=training.encodings.shape)
    labels = assigned(training, batch)
    ids = np.unique(batch.labels)
    chosen = [np.unique(labels[batch.labels == i]) for i in ids]
    assert all(len(one) == 1 and one[0] > 0 for one in chosen)
    assert len(np.unique(labels)) == len(ids)
    chance = training.field().probabilities(batch.rows.multiply(training.encodings))
    mean = np.stack([chance[batch.labels == i].mean(axis=0) for i in ids])
    best = sum(mean[k, int(one[0])] for k, one in enumerate(chosen))
    for _ in range(300):
        other = 1 + rng.permutation(9)[: len(ids)]
        assert mean[np.arange(len(ids)), other].sum() <= best + 1e-6


def test_one_view_is_learned_and_ids_of_no_view_matter(scene: Synthetic) -> None:
    camera = scene.cameras[0]
    true = true_map(scene, camera)
    labels = []
    for seed in (1, 2):
        shown = permuted(true, seed, top=20)
        config = LiftingConfig(iterations=120)

        def label_map(_: Camera, shown: IntArray = shown) -> IntArray:
            return shown

        stage = lift_by_assignment(scene.gaussians, [camera], label_map, choose("cpu"), config)
        labels.append(run_stage(stage).labels)
    frame = choose("cpu").label_splat(scene.gaussians, camera, labels[0])
    inside = (true > 0) & (frame.confidence > 0.9)
    for k in np.unique(true[inside]):
        of_object = frame.labels[inside & (true == k)]
        assert (of_object == np.bincount(of_object).argmax()).mean() > 0.9
    pairs = {(int(a), int(b)) for a, b in zip(labels[0], labels[1], strict=True)}
    assert len(pairs) <= 2 * len(np.unique(true)) + 2  # the same parts under other names
    with pytest.raises(ValueError, match="at least 1"):
        replace(LiftingConfig(), iterations=0)
