"""The linear operator on cached rows of W, and the step that trains on it."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.sparse import csr_matrix

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.linear_kernels import D, softmax_rows
from gaga_core.identity.rows import (
    Batch,
    LinearRows,
    RowConfig,
    ViewRows,
    join_rows,
    mixed_batches,
    sample_rows,
    take_rows,
    view_batches,
)
from gaga_core.identity.training_step import (
    IdentityGradients,
    IdentityRates,
    Training,
    adam_step,
    agreement,
    batch_of_step,
    cross_entropy,
    start_from_zeros,
)
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.raster.base import PixelWeights
from tests.core.identity.noisy import ROWS, G
from tests.scenes import Synthetic, orbit_cameras, random_gaussians

_N, _K = 300, 7


@pytest.fixture(scope="module")
def weights() -> PixelWeights:
    """All pixels of a small view of random splats, every weight kept."""
    camera = orbit_cameras(1, width=80, height=60)[0]
    pixels = np.arange(camera.width * camera.height)
    return choose().weights(random_gaussians(_N), camera, pixels)


@pytest.fixture(scope="module")
def rows(weights: PixelWeights) -> LinearRows:
    return LinearRows.of(weights, _N)


def _normal(*shape: int, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def _labels(n: int) -> IntArray:
    return np.random.default_rng(3).integers(0, _K, n).astype(np.int32)


def _training() -> Training:
    """A state as in the middle of a run: nothing is zero."""
    training = start_from_zeros(_N, _K - 1, 0)
    training.encodings[:] = _normal(_N, D, seed=1)
    return training


def test_w_e_is_the_rendered_feature_map(rows: LinearRows) -> None:
    camera = orbit_cameras(1, width=80, height=60)[0]
    encodings = _normal(_N, D)
    image = choose().render(random_gaussians(_N), camera, channels=encodings).image
    assert np.abs(image).max() > 0.5
    assert np.abs(rows.multiply(encodings) - image.reshape(-1, D)).max() < 1e-4


def test_transposed_operator_is_the_transpose(rows: LinearRows) -> None:
    encodings, slopes = _normal(_N, D), _normal(len(rows), D, seed=1)
    forward = (rows.multiply(encodings).astype(np.float64) * slopes).sum()
    backward = (rows.multiply_transposed(slopes).astype(np.float64) * encodings).sum()
    assert abs(forward) > 1
    assert backward == pytest.approx(forward, rel=1e-5)


def test_the_transpose_writes_rows_that_have_entries_alone(weights: PixelWeights) -> None:
    rows = LinearRows.of(take_rows(weights, 1000, 1400), _N)
    out = np.full((_N, D), 7, np.float32)
    assert rows.multiply_transposed(np.zeros((len(rows), D), np.float32), out) is out
    assert 0 < len(rows.touched) < _N
    assert (out[rows.touched] == 0).all()
    assert (np.delete(out, rows.touched, axis=0) == 7).all()


def test_rows_split_and_joined_are_the_same(weights: PixelWeights) -> None:
    cuts = [0, 17, 17, 900, len(weights.indptr) - 1]
    joined = join_rows([take_rows(weights, a, b) for a, b in pairwise(cuts)])
    for name in ("indptr", "indices", "weights"):
        assert np.array_equal(getattr(joined, name), getattr(weights, name))


def test_results_do_not_depend_on_threads(
    rows: LinearRows, monkeypatch: pytest.MonkeyPatch
) -> None:
    batch, results = Batch(rows, _labels(len(rows))), []
    for threads in ("1", "4"):
        monkeypatch.setenv("GAGA_THREADS", threads)
        training = _training()
        gradients = IdentityGradients.zeros(training)
        fit = cross_entropy(training, batch, gradients)
        adam_step(training, gradients, IdentityRates())
        results.append((fit, training.encodings, training.weight, training.bias))
    assert results[0][0] == results[1][0]
    for one, many in zip(results[0][1:], results[1][1:], strict=True):
        assert np.array_equal(one, many)


def test_softmax_of_large_and_equal_scores() -> None:
    scores = np.concatenate([_normal(50, 40) * 30, np.zeros((1, 40)), np.full((1, 40), 900)])
    features = np.zeros((1, D), np.float32)
    for row in scores.astype(np.float32):
        out = np.empty((1, 40), np.float32)
        softmax_rows(features, np.zeros((D, 40), np.float32), row, out)
        exact = np.exp(row.astype(np.float64) - row.max())
        assert np.allclose(out[0], exact / exact.sum(), rtol=1e-5, atol=1e-30)


def _torch_state(training: Training) -> list[torch.Tensor]:
    values = (training.encodings, training.weight, training.bias)
    return [torch.tensor(value.astype(np.float64), requires_grad=True) for value in values]


def _agrees(gradients: IdentityGradients, tensors: list[torch.Tensor]) -> None:
    ours = (gradients.encodings, gradients.weight, gradients.bias)
    for mine, tensor in zip(ours, tensors, strict=True):
        assert tensor.grad is not None
        exact = tensor.grad.numpy()
        assert np.abs(exact).max() > 0
        assert np.abs(mine - exact).max() < 1e-5 * np.abs(exact).max()


def test_cross_entropy_and_its_gradients(weights: PixelWeights, rows: LinearRows) -> None:
    training, labels = _training(), _labels(len(rows))
    gradients = IdentityGradients.zeros(training)
    fit = cross_entropy(training, Batch(rows, labels), gradients, 0.25)
    E, weight, bias = tensors = _torch_state(training)
    dense = csr_matrix((weights.weights, weights.indices, weights.indptr), (len(rows), _N))
    scores = (torch.tensor(dense.toarray().astype(np.float64)) @ E) @ weight.T + bias
    loss = torch.nn.functional.cross_entropy(scores, torch.tensor(labels.astype(np.int64)))
    (0.25 * loss).backward()  # type: ignore[no-untyped-call]
    assert fit.loss == pytest.approx(loss.item(), rel=1e-5)
    right = (scores.argmax(dim=1).numpy() == labels).mean()
    assert fit.accuracy == pytest.approx(right, abs=2 / len(labels))
    _agrees(gradients, tensors)


def test_a_start_from_zeros_is_chance(rows: LinearRows) -> None:
    training = start_from_zeros(_N, _K - 1, 0)
    assert not training.encodings.any()
    training.weight[:], training.bias[:] = 0, 0
    fit = cross_entropy(training, Batch(rows, _labels(len(rows))))
    assert fit.loss == pytest.approx(np.log(_K), rel=1e-5)


def test_agreement_is_the_published_regulariser() -> None:
    """Against `loss_cls_3d` of Gaussian Grouping, written as it stands there."""
    training = _training()
    rng = np.random.default_rng(5)
    sampled = rng.choice(_N, 40, replace=False)
    near = np.stack([sampled, *(rng.integers(0, _N, 40) for _ in range(4))], axis=1)
    gradients = IdentityGradients.zeros(training)
    loss = agreement(training, near.astype(np.int32), 2.0, gradients)
    E, weight, bias = tensors = _torch_state(training)
    p = torch.softmax(E @ weight.T + bias, dim=1)
    own, others = p[torch.tensor(sampled)].unsqueeze(1), p[torch.tensor(near)]
    kl = (own * (torch.log(own + 1e-10) - torch.log(others + 1e-10))).sum(dim=-1)
    exact = 2.0 * kl.mean() / _K
    exact.backward()  # type: ignore[no-untyped-call]
    assert loss == pytest.approx(exact.item(), rel=1e-4)
    _agrees(gradients, tensors)


def test_adam_is_torchs() -> None:
    training = _training()
    tensors = [t.detach().float().requires_grad_() for t in _torch_state(training)]
    rates = IdentityRates()
    groups = [
        {"params": tensors[:1], "lr": rates.encodings},
        {"params": tensors[1:], "lr": rates.layer},
    ]
    optimiser = torch.optim.Adam(groups, eps=1e-15)
    for step in range(5):
        gradients = IdentityGradients(
            _normal(_N, D, seed=step), _normal(_K, D, seed=step), _normal(_K, seed=step)
        )
        gradients.encodings[::3] = 0
        adam_step(training, gradients, rates)
        slopes = (gradients.encodings, gradients.weight, gradients.bias)
        for tensor, slope in zip(tensors, slopes, strict=True):
            tensor.grad = torch.tensor(slope)
        optimiser.step()
    for mine, tensor in zip(_torch_state(training), tensors, strict=True):
        assert torch.allclose(mine.detach().float(), tensor.detach(), atol=2e-6)
    start = _training().encodings
    assert np.array_equal(training.encodings[::3], start[::3])  # no gradient yet: no move


def test_every_view_comes_once_before_any_comes_twice() -> None:
    epochs = [[batch_of_step(9 * e + i, 9, seed=4) for i in range(9)] for e in range(3)]
    assert all(sorted(epoch) == list(range(9)) for epoch in epochs)
    assert epochs[0] != epochs[1]


# --- Cached rows of the blending matrix: which pixels, how many, in which batches.


def _rows(scene: Synthetic, label_map: LabelMap, config: RowConfig) -> list[ViewRows]:
    return run_stage(sample_rows(scene.gaussians, scene.cameras, label_map, choose(), config))


def test_rows_are_labelled_pixels_spread_over_the_view(
    scene: Synthetic, label_map: LabelMap, maps: dict[str, IntArray]
) -> None:
    for view in _rows(scene, label_map, RowConfig(per_view=1000)):
        truth = maps[view.view]
        assert len(view.labels) == 1000
        assert (view.labels > 0).all()
        share = np.bincount(truth[truth > 0], minlength=G + 1) / (truth > 0).sum()
        got = np.bincount(view.labels, minlength=G + 1) / 1000
        assert np.abs(share - got).max() < 0.03


@pytest.mark.parametrize("void", [False, True])
def test_all_pixels_when_no_number_is_given(
    scene: Synthetic, label_map: LabelMap, maps: dict[str, IntArray], void: bool
) -> None:
    views = _rows(scene, label_map, RowConfig(per_view=0, w_min=0, train_void=void))
    wanted = [maps[v.view].size if void else int((maps[v.view] > 0).sum()) for v in views]
    assert [len(view.labels) for view in views] == wanted


def test_rows_keep_to_the_memory(scene: Synthetic, label_map: LabelMap) -> None:
    limit = 3_000_000
    views = _rows(scene, label_map, RowConfig(per_view=0, memory_bytes=limit))
    used = sum(16 * len(view.weights.indices) for view in views)
    assert 0.4 * limit < used < 1.1 * limit


def test_batches_hold_every_row_once(scene: Synthetic, label_map: LabelMap) -> None:
    views = _rows(scene, label_map, RowConfig(per_view=333))
    whole = np.sort(np.concatenate([view.weights.weights for view in views]))
    mixed = mixed_batches(views, len(scene.gaussians))
    by_view = view_batches(views, len(scene.gaussians))
    for batches in (mixed, by_view):
        assert len(batches) == len(scene.cameras)
        got = np.concatenate([batch.rows.by_pixel.weights for batch in batches])
        assert np.array_equal(np.sort(got), whole)
    sizes = [len(batch.labels) for batch in mixed]
    assert max(sizes) - min(sizes) <= len(scene.cameras)


def test_nothing_labelled_is_told(scene: Synthetic) -> None:
    with pytest.raises(GagaError, match="No pixel"):
        _rows(scene, lambda c: np.zeros((c.height, c.width), np.int32), ROWS)
