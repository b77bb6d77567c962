"""Models that Gaussian Grouping and Gaga trained open with their objects, and ours load there."""

from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.export.export import export_scene_stage
from gaga_core.identity.classifier_io import with_encodings, write_classifier
from gaga_core.identity.field import Identity, IdentityField, save_identity
from gaga_core.identity.linear_kernels import D
from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import run_stage
from tests.core.scene.projects import opened
from tests.scenes import objects_scene, random_gaussians

_N, _K = 500, 300  # more classes than a byte holds


def _trained(seed: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    shapes = (_N, D), (_K, D), (_K,)
    encodings, weight, bias = (rng.normal(size=s).astype(np.float32) for s in shapes)
    return encodings, weight, bias


def _model_folder(folder: Path) -> Path:
    """The layout that the published trainings leave."""
    encodings, weight, bias = _trained()
    place = folder / "point_cloud" / "iteration_30000"
    place.mkdir(parents=True)
    write_ply(place / "point_cloud.ply", with_encodings(random_gaussians(_N), encodings))
    layer = torch.nn.Conv2d(D, _K, 1)
    with torch.no_grad():
        layer.weight.copy_(torch.tensor(weight).reshape(_K, D, 1, 1))
        layer.bias.copy_(torch.tensor(bias))  # type: ignore[union-attr]
    torch.save(layer.state_dict(), place / "classifier.pth")
    return place


def _labels_by_their_code(folder: Path, n_classes: int) -> IntArray:
    """What the published code makes of a folder: columns by name, a 1 x 1 convolution, argmax."""
    vertices = PlyData.read(str(folder / "point_cloud.ply")).elements[0]
    objects = np.zeros((len(vertices.data), D, 1))
    for channel in range(D):
        objects[:, channel, 0] = np.asarray(vertices[f"obj_dc_{channel}"])
    features = torch.tensor(objects, dtype=torch.float).transpose(1, 2)  # (N, 1, D)
    classifier = torch.nn.Conv2d(D, n_classes, kernel_size=1)
    classifier.load_state_dict(torch.load(folder / "classifier.pth", weights_only=True))
    with torch.no_grad():
        logits = classifier(features.permute(2, 0, 1))  # (D, N, 1) -> (K, N, 1)
    result: IntArray = torch.softmax(logits, 0).argmax(0)[:, 0].numpy().astype(np.int32)
    return result


@pytest.mark.parametrize("part", ["", "point_cloud/iteration_30000/point_cloud.ply"])
def test_a_trained_model_opens_with_its_objects(tmp_path: Path, part: str) -> None:
    place = _model_folder(tmp_path)
    scene = opened(tmp_path / part).scene
    encodings, weight, bias = _trained()
    scores = np.exp((encodings @ weight.T + bias).astype(np.float64))
    probability = (scores / scores.sum(axis=1, keepdims=True)).max(axis=1)
    assert np.array_equal(scene.labels, _labels_by_their_code(place, _K))
    assert scene.confidence is not None
    np.testing.assert_allclose(scene.confidence, 255 * probability, atol=0.51)


def test_without_a_classifier_it_opens_without_objects(tmp_path: Path) -> None:
    (_model_folder(tmp_path) / "classifier.pth").unlink()
    assert not opened(tmp_path).scene.labels.any()


def test_a_damaged_classifier_is_told_with_the_way_around(tmp_path: Path) -> None:
    (_model_folder(tmp_path) / "classifier.pth").write_bytes(b"nothing")
    with pytest.raises(GagaError, match=r"move classifier\.pth away"):
        opened(tmp_path)


def test_groups_of_a_classifier_are_kept_by_an_export_and_a_project(tmp_path: Path) -> None:
    _model_folder(tmp_path)
    project = opened(tmp_path)
    out = tmp_path / "kept.ply"
    run_stage(export_scene_stage(project.scene, out, groups=True))
    assert np.array_equal(opened(out).scene.labels, project.scene.labels)


def test_an_export_with_identity_is_read_alike_by_their_code(tmp_path: Path) -> None:
    synthetic = objects_scene()
    root, out = tmp_path / "scene", tmp_path / "point_cloud" / "iteration_10000"
    (root / "gaga").mkdir(parents=True)
    out.mkdir(parents=True)
    write_ply(root / "point_cloud.ply", synthetic.gaussians)
    rng = np.random.default_rng(1)
    n = len(synthetic.gaussians)
    field = IdentityField(
        rng.normal(size=(n, D)).astype(np.float32),
        rng.normal(size=(40, D)).astype(np.float32),
        rng.normal(size=40).astype(np.float32),
    )
    labels, confidence = field.classify(field.encodings)
    save_identity(root / "gaga" / "identity.npz", Identity(field, labels, confidence, "paper"))
    status = main(["export", str(root), "--out", str(out / "point_cloud.ply"), "--identity"])
    assert status == 0
    assert np.array_equal(_labels_by_their_code(out, 40), labels)
    assert np.array_equal(opened(tmp_path).scene.labels, labels)  # and by ourselves


def test_a_model_of_others_is_exported_with_its_own_identities(tmp_path: Path) -> None:
    place = _model_folder(tmp_path / "theirs")
    out = tmp_path / "ours"
    out.mkdir()
    command = ["export", str(tmp_path / "theirs"), "--out", str(out / "point_cloud.ply")]
    assert main([*command, "--identity"]) == 0
    assert np.array_equal(_labels_by_their_code(out, _K), _labels_by_their_code(place, _K))


def test_identities_need_a_ply(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _model_folder(tmp_path)
    out = tmp_path / "small.splat"
    assert main(["export", str(tmp_path), "--out", str(out), "--identity"]) == 1
    assert "Choose --form ply" in capsys.readouterr().err
    assert not out.exists()


def test_a_classifier_of_other_width_is_refused(tmp_path: Path) -> None:
    place = _model_folder(tmp_path)
    state = torch.nn.Conv2d(8, 30, 1).state_dict()
    torch.save(state, place / "classifier.pth")
    with pytest.raises(GagaError, match="weights of shape"):
        opened(tmp_path)
    write_classifier(place / "classifier.pth", np.ones((2, D), np.float32), np.ones(2, np.float32))
    assert opened(tmp_path).scene.labels.max() <= 1
