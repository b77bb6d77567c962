"""Code book, identity field, and the files of Gaussian Grouping and Gaga."""

import os
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.identity.classifier_io import (
    COLUMNS,
    encodings_of,
    read_classifier,
    with_encodings,
    write_classifier,
)
from gaga_core.identity.closed_form import code_book
from gaga_core.identity.field import (
    Identity,
    IdentityField,
    decode_view,
    encoding_colors,
    load_identity,
    save_identity,
)
from gaga_core.identity.linear_kernels import D
from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.raster import choose
from tests.scenes import objects_scene, random_gaussians


def _field(n: int, n_groups: int, *, scale: float = 10.0) -> tuple[IdentityField, np.ndarray]:
    labels = np.random.default_rng(n_groups).integers(0, n_groups + 1, n).astype(np.int32)
    book = code_book(n_groups)
    weight = np.float32(scale) * book.codes
    return IdentityField(book.encodings(labels), weight, np.zeros(n_groups + 1, np.float32)), labels


@pytest.mark.parametrize("n_groups", [0, 1, 15, 16, 17, 100, 300, 700])
def test_codes_decode_to_their_labels(n_groups: int) -> None:
    field, labels = _field(2000, n_groups)
    assert np.array_equal(field.labels(), labels)


@pytest.mark.parametrize("n_groups", [2, 15, 50, 100, 300])
def test_codes_are_further_apart_than_random_ones(n_groups: int) -> None:
    book = code_book(n_groups)
    cosines = book.codes.astype(np.float64) @ book.codes.T
    assert np.allclose(np.diag(cosines), 1, atol=1e-6)
    np.fill_diagonal(cosines, -1)
    assert cosines.max() == pytest.approx(book.max_cosine, abs=1e-6)
    random = np.random.default_rng(0).normal(size=(n_groups + 1, D))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    by_chance = random @ random.T
    np.fill_diagonal(by_chance, -1)
    assert book.max_cosine < 0.75 * by_chance.max()


def test_few_codes_are_a_simplex() -> None:
    """17 points on the sphere of R^16 can be -1/16 apart, and no better."""
    assert code_book(16).max_cosine == pytest.approx(-1 / 16, abs=1e-3)


def test_codes_depend_on_the_seed_alone() -> None:
    first, again, other = (code_book(40, seed=seed).codes for seed in (2, 2, 3))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_classify_is_softmax_and_argmax() -> None:
    field, _ = _field(10, 30, scale=2.0)
    features = np.random.default_rng(0).normal(size=(3000, D)).astype(np.float32)
    scores = features.astype(np.float64) @ field.weight.T + field.bias
    exact = np.exp(scores) / np.exp(scores).sum(axis=1, keepdims=True)
    labels, confidence = field.classify(features)
    assert np.allclose(field.probabilities(features), exact, rtol=1e-4)
    assert (labels == exact.argmax(axis=1)).mean() > 0.999
    assert np.allclose(confidence, exact.max(axis=1), rtol=1e-4)


def test_fields_check_their_shapes() -> None:
    field, _ = _field(5, 3)
    with pytest.raises(ValueError, match="encodings"):
        IdentityField(field.encodings[:, :8], field.weight, field.bias)
    with pytest.raises(ValueError, match="bias"):
        IdentityField(field.encodings, field.weight, field.bias[:2])
    with pytest.raises(ValueError, match="encodings"):
        IdentityField(field.encodings.astype(np.float64), field.weight, field.bias)
    with pytest.raises(ValueError, match="labels"):
        Identity(field, np.zeros(4, np.int32), np.zeros(5, np.float32), "vote")


def test_decoded_views_are_the_splatted_labels() -> None:
    scene = objects_scene(n_objects=6, n_cameras=2)
    labels = np.where(scene.labels > 0, scene.labels, 7).astype(np.int32)
    book = code_book(7)
    field = IdentityField(book.encodings(labels), 10 * book.codes, np.zeros(8, np.float32))
    for camera in scene.cameras:
        decoded = decode_view(field, scene.gaussians, camera, choose(), void_below=0.3)
        splat = choose().label_splat(scene.gaussians, camera, labels)
        alpha = choose().render(scene.gaussians, camera).alpha
        shown = alpha >= 0.3
        assert (decoded.labels[shown] == splat.labels[shown]).mean() > 0.97
        assert (decoded.labels[~shown] == 0).all()
        assert (decoded.confidence[~shown] == 0).all()


def test_identity_file_round_trip(tmp_path: Path) -> None:
    field, labels = _field(50, 9)
    identity = Identity(field, labels, np.linspace(0, 1, 50, dtype=np.float32), "refine")
    save_identity(tmp_path / "identity.npz", identity)
    again = load_identity(tmp_path / "identity.npz")
    for name in ("encodings", "weight", "bias"):
        assert np.array_equal(getattr(again.field, name), getattr(field, name))
    assert np.array_equal(again.labels, labels)
    assert np.array_equal(again.confidence, identity.confidence)
    assert again.mode == "refine"


def test_damaged_identity_files_are_told(tmp_path: Path) -> None:
    field, labels = _field(50, 9)
    identity = Identity(field, labels, np.zeros(50, np.float32), "vote")
    path = tmp_path / "identity.npz"
    save_identity(path, identity)
    whole = path.read_bytes()
    for cut in (0, 10, len(whole) // 2, len(whole) - 4):
        path.write_bytes(whole[:cut])
        with pytest.raises(GagaError, match=r"identity\.npz"):
            load_identity(path)
    np.savez(path, encodings=field.encodings)
    with pytest.raises(GagaError, match="damaged"):
        load_identity(path)
    save_identity(path, Identity(field, labels + 99, np.zeros(50, np.float32), "vote"))
    with pytest.raises(GagaError, match="labels: 108 is not in 0 to 9"):
        load_identity(path)


def test_encodings_survive_a_ply(tmp_path: Path) -> None:
    gaussians = random_gaussians(40)
    assert encodings_of(gaussians) is None
    encodings = np.random.default_rng(0).normal(size=(40, D)).astype(np.float32)
    write_ply(tmp_path / "a.ply", with_encodings(gaussians, encodings))
    again = read_ply(tmp_path / "a.ply")
    found = encodings_of(again)
    assert found is not None
    assert np.array_equal(found, encodings)
    replaced = encodings_of(with_encodings(again, encodings + 1))
    assert replaced is not None
    assert np.array_equal(replaced, encodings + 1)
    part = {name: again.extra[name] for name in COLUMNS[:8]}
    with pytest.raises(GagaError, match="8 of the 16 columns"):
        encodings_of(replace(again, extra=part))


def test_classifier_is_the_state_of_their_layer(tmp_path: Path) -> None:
    """Both ways: what they save is read, what we write loads into their module."""
    path = tmp_path / "classifier.pth"
    theirs = torch.nn.Conv2d(D, 300, 1)
    torch.save(theirs.state_dict(), path)
    weight, bias = read_classifier(path)
    assert weight.shape == (300, D)
    assert np.array_equal(weight, theirs.weight.detach().numpy()[:, :, 0, 0])
    assert np.array_equal(bias, theirs.bias.detach().numpy())  # type: ignore[union-attr]
    write_classifier(path, weight + 1, bias)
    ours = torch.nn.Conv2d(D, 300, 1)
    ours.load_state_dict(torch.load(path, weights_only=True))
    assert np.array_equal(ours.weight.detach().numpy()[:, :, 0, 0], weight + 1)


class _Trap:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, (str(self.path),)


def test_nothing_in_a_classifier_file_is_executed(tmp_path: Path) -> None:
    path, sprung = tmp_path / "classifier.pth", tmp_path / "sprung"
    torch.save({"weight": _Trap(sprung), "bias": torch.zeros(3)}, path)
    with pytest.raises(GagaError, match="damaged"):
        read_classifier(path)
    path.write_bytes(pickle.dumps(_Trap(sprung), protocol=2))
    with pytest.raises(GagaError, match="damaged"):
        read_classifier(path)
    assert not sprung.exists()


def test_damaged_classifiers_are_told(tmp_path: Path) -> None:
    path = tmp_path / "classifier.pth"
    with pytest.raises(GagaError, match="does not exist"):
        read_classifier(path)
    write_classifier(path, np.ones((30, D), np.float32), np.ones(30, np.float32))
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for cut in rng.integers(0, len(whole) - 30, 40):
        path.write_bytes(whole[:cut])
        with pytest.raises(GagaError):
            read_classifier(path)
    for _ in range(300):
        flipped = bytearray(whole)
        for at in rng.integers(0, len(whole), 4):
            flipped[at] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(flipped))
        try:
            weight, bias = read_classifier(path)
        except GagaError:
            continue
        assert len(weight) == len(bias)
    for state in (
        [1, 2],
        {"weight": torch.zeros(3, D)},
        {"weight": torch.zeros(3, 8, 1, 1), "bias": torch.zeros(3)},
        {"weight": torch.zeros(3, D, 1, 1), "bias": torch.zeros(4)},
        {"weight": torch.zeros(3, D, 1, 1, dtype=torch.int64), "bias": torch.zeros(3)},
        {"weight": torch.tensor(1.0), "bias": torch.tensor(1.0)},
        {"weight": torch.full((3, D, 1, 1), torch.nan), "bias": torch.zeros(3)},
        {"weight": torch.zeros(3, D, 1, 1), "bias": torch.full((3,), torch.inf)},
    ):
        torch.save(state, path)
        with pytest.raises(GagaError):
            read_classifier(path)


def test_colors_do_not_follow_the_signs_of_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another LAPACK gives other signs."""
    encodings = np.random.default_rng(0).normal(size=(500, D)).astype(np.float32)
    here, eigh = encoding_colors(encodings), np.linalg.eigh
    for seed in range(5):
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], D)

        def other(matrix: DoubleArray, signs: DoubleArray = signs) -> Any:
            values, axes = eigh(matrix)
            return values, axes * signs

        monkeypatch.setattr(np.linalg, "eigh", other)
        np.testing.assert_array_equal(encoding_colors(encodings), here)
