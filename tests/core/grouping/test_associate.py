"""Association on scenes with known groups."""

from functools import partial

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.grouping import views
from gaga_core.grouping.associate import AssociateConfig, Association, BankSnapshot, associate_stage
from gaga_core.grouping.views import views_as_masked
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import masks_of, permuted, true_map
from tests.scenes import Synthetic, objects_scene


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=6, n_cameras=8, seed=1)


@pytest.fixture(scope="module")
def association(scene: Synthetic) -> Association:
    masks = masks_of(scene, scene.cameras)
    return run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose()))


def test_perfect_masks_give_the_true_groups(scene: Synthetic, association: Association) -> None:
    pairs = set()
    for i, camera in enumerate(scene.cameras):
        truth = true_map(scene, camera)
        masks = permuted(truth, i)
        groups = association.mask_groups[camera.name][masks]
        pairs |= set(zip(truth[truth > 0].tolist(), groups[truth > 0].tolist(), strict=True))
    assert len(pairs) == 7  # each true object has one group in all views, and no two share one
    assert len({group for _, group in pairs}) == 7
    assert association.bank.n_groups == 7
    assert (association.views_per_group[1:] == len(scene.cameras)).all()


def test_voted_labels_follow_the_truth(scene: Synthetic, association: Association) -> None:
    truth = np.where(scene.labels > 0, scene.labels, 7)
    table = np.zeros((8, 8), np.int64)
    np.add.at(table, (truth, association.labels), 1)
    group_of = table.argmax(axis=1)
    voted = association.confidence > 0
    assert voted.mean() > 0.6
    assert (association.labels[voted] == group_of[truth[voted]]).mean() > 0.97


def test_who_no_mask_sees_keeps_the_banks_group(scene: Synthetic) -> None:
    """Every third splat is too faint to be drawn: nothing votes for it."""
    gaussians = scene.gaussians.take(np.arange(len(scene.gaussians)))
    gaussians.logit_opacities[::3] = -9
    masks = masks_of(scene, scene.cameras)
    result = run_stage(associate_stage(gaussians, scene.cameras, masks, choose()))
    assert (result.confidence[::3] == 0).all()
    assert (result.labels[::3] == np.maximum(result.bank.group[::3], 0)).all()
    assert (result.labels[::3] > 0).mean() > 0.3


def test_snapshots_are_values_of_their_own(scene: Synthetic) -> None:
    masks = masks_of(scene, scene.cameras[:3])
    stage = associate_stage(scene.gaussians, scene.cameras, masks, choose())
    snapshots, copies, steps = [], [], []
    for step in stage:
        steps.append((step.done, step.total))
        if isinstance(step.payload, BankSnapshot):
            snapshots.append(step.payload)
            copies.append(step.payload.bank.group.copy())
    assert [s.view for s in snapshots] == ["000.png", "001.png", "002.png"]
    for snapshot, copy in zip(snapshots, copies, strict=True):
        assert (snapshot.bank.group == copy).all()
    assert (snapshots[0].bank.group >= 0).sum() < (snapshots[2].bank.group >= 0).sum()
    assert steps == sorted(steps)
    assert len({total for _, total in steps}) == 1


def test_views_go_by_name_and_need_masks(scene: Synthetic) -> None:
    masks = masks_of(scene, [scene.cameras[4], scene.cameras[2]])
    backwards = scene.cameras[::-1]
    result = run_stage(associate_stage(scene.gaussians, backwards, masks, choose()))
    views = [decision.view for decision in result.bank.log]
    assert list(dict.fromkeys(views)) == ["002.png", "004.png"]
    assert any("6 of 8 photos have no masks" in note for note in result.notes)


def test_the_same_again_bit_for_bit(
    scene: Synthetic, association: Association, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_THREADS", "1")
    masks = masks_of(scene, scene.cameras)
    again = run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose()))
    assert (again.bank.group == association.bank.group).all()
    assert again.bank.log == association.bank.log
    assert (again.labels == association.labels).all()
    assert (again.confidence == association.confidence).all()


def test_masks_of_another_size_are_resized_with_a_note(
    scene: Synthetic, association: Association
) -> None:
    exact = masks_of(scene, scene.cameras)

    def doubled(name: str) -> IntArray:
        return exact.loaders[name]().repeat(2, axis=0).repeat(2, axis=1)

    masks = MaskSet({name: partial(doubled, name) for name in exact.names})
    result = run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose()))
    assert (result.labels == association.labels).all()
    assert any("8 of 8 photos had another size" in note for note in result.notes)


def test_300_objects_keep_300_groups() -> None:
    scene = _grid_scene()
    camera = scene.cameras[0]
    maps = {f"{i}.png": permuted(true_map(scene, camera), i, 60_000) for i in range(2)}
    cameras = [Camera(camera.K, camera.cam_from_world, 400, 300, name) for name in maps]
    masks = MaskSet({name: partial(maps.__getitem__, name) for name in maps})
    result = run_stage(associate_stage(scene.gaussians, cameras, masks, choose()))
    assert result.bank.n_groups == 300
    assert len(np.unique(result.labels[result.labels > 0])) == 300


def _grid_scene() -> Synthetic:
    """A wall of 20 x 15 small balls seen from the front."""
    ball = objects_scene(n_objects=1, per_object=30, seed=2)
    is_ball = np.flatnonzero(ball.labels == 1)
    gaussians = ball.gaussians.take(np.tile(is_ball, 300))
    local = ball.gaussians.means[is_ball] - ball.gaussians.means[is_ball].mean(axis=0)
    place = np.stack(np.meshgrid(np.arange(20), np.arange(15), [0.0]), axis=-1).reshape(-1, 3)
    gaussians.means[:] = (place[:, None] + local[None]).reshape(-1, 3)
    K = np.array([[340.0, 0, 200], [0, 340, 150], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, 3] = [-9.5, -7, 18]
    labels = np.repeat(np.arange(1, 301), len(is_ball)).astype(np.int32)
    return Synthetic(gaussians, labels, (Camera(K, pose, 400, 300, "0.png"),))


def test_nothing_to_associate_is_a_plain_sentence(scene: Synthetic) -> None:
    with pytest.raises(GagaError, match="no masks"):
        run_stage(associate_stage(scene.gaussians, scene.cameras, MaskSet(), choose()))
    other = MaskSet({"other.png": lambda: np.zeros((2, 2), np.int32)}, "masks/sam")
    with pytest.raises(GagaError, match="None of the 8 photos has masks in masks/sam"):
        run_stage(associate_stage(scene.gaussians, scene.cameras, other, choose()))
    nothing = scene.gaussians.take(np.zeros(0, np.int64))
    with pytest.raises(GagaError, match="no Gaussians"):
        run_stage(associate_stage(nothing, scene.cameras, masks_of(scene, scene.cameras), choose()))


def test_all_gaussians_ablation_ignores_depth(scene: Synthetic) -> None:
    masks = masks_of(scene, scene.cameras[:1])
    gated = run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose()))
    free = AssociateConfig(depth="none")
    ungated = run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose(), free))
    assert (ungated.bank.group >= 0).sum() > (gated.bank.group >= 0).sum()


@pytest.mark.parametrize("bad", [{"threshold": 0.0}, {"depth": "deep"}, {"histogram_bytes": 0}])
def test_config_is_checked(bad: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"threshold|depth|histogram"):
        AssociateConfig(**bad)  # type: ignore[arg-type]


def test_views_larger_than_masks_are_made_tell_no_more(
    scene: Synthetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Photos of 12 megapixels took ten times as long; the paper's way looks at all pixels."""
    masks, side = (
        masks_of(scene, scene.cameras),
        max(scene.cameras[0].width, scene.cameras[0].height),
    )
    monkeypatch.setattr(views, "LARGEST", side)
    larger = tuple(camera.resized(3 * camera.width, 3 * camera.height) for camera in scene.cameras)
    config = AssociateConfig.of("robust")
    one, other = (
        run_stage(associate_stage(scene.gaussians, cameras, masks, choose(), config))
        for cameras in (scene.cameras, larger)
    )
    assert np.array_equal(one.labels, other.labels)
    assert views_as_masked(larger, masks, "paper")[0].width == 3 * scene.cameras[0].width
