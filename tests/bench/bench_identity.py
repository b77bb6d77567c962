"""Identity encodings: cached rows of W against rasterizing, and the vote against training."""

import time
from dataclasses import replace

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.evaluate.group_scores import score_pairs
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.grouping.views import load_labels
from gaga_core.grouping.votes import VOID_BELOW, associated_labels, vote_labels
from gaga_core.identity.closed_form import Voted, code_book, vote_identity
from gaga_core.identity.field import IdentityField, decode_view
from gaga_core.identity.fit import fit_identity
from gaga_core.identity.linear_kernels import D
from gaga_core.identity.refine import refine_identity
from gaga_core.identity.rows import Batch, LinearRows
from gaga_core.identity.train import PaperConfig, train_identity
from gaga_core.identity.training_step import (
    IdentityGradients,
    IdentityRates,
    adam_step,
    cross_entropy,
    start_from_zeros,
)
from gaga_core.progress import run_stage
from gaga_core.raster.base import PixelWeights
from gaga_core.raster.cpu.prepare import TiledView, prepare
from gaga_core.raster.cpu.project_kernels import TILE
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.bench.figures import Figure, median_ms
from tests.bench.rerender_kernels import blend_wide_backward
from tests.scenes import objects_scene, orbit_cameras
from tools.scenes.rooms import Kind, bench_scene

_N, _GROUPS, _VIEWS = 200_000, 100, 40
_STEPS = 50  # that rasterize; 10,000 are extrapolated from them
_PAPER_STEPS = 10_000
_KINDS: tuple[Kind, ...] = ("room", "table")
_SEEDS = (31, 32, 33)


def figures() -> list[Figure]:
    """Every figure of this file; times are CPU times of all threads together."""
    gaussians, labels = _surfaces()
    camera = orbit_cameras(_VIEWS, width=640, height=480, radius=2.0)[0]
    return [
        *_operators(gaussians, camera),
        *_vote(gaussians, labels),
        _code_book(),
        *_held_out(),
    ]


def _surfaces() -> tuple[Gaussians, IntArray]:
    """Balls and a floor of ``_N`` small, mostly opaque splats, and their ``_GROUPS`` labels."""
    per_object = _N // (_GROUPS + 2)
    scene = objects_scene(_GROUPS - 1, per_object)
    n = len(scene.gaussians)
    shrink = np.log(np.sqrt(400 / per_object) * 0.4)
    logits = np.random.default_rng(0).normal(2, 2, n).astype(np.float32)
    log_scales = (scene.gaussians.log_scales + shrink).astype(np.float32)
    labels = np.where(scene.labels > 0, scene.labels, _GROUPS).astype(np.int32)
    return replace(scene.gaussians, log_scales=log_scales, logit_opacities=logits), labels


def _operators(gaussians: Gaussians, camera: Camera) -> list[Figure]:
    """W E and W^T dF of a whole view against a 16-channel render and its backward pass."""
    cpu, n = CpuRasterizer(), len(gaussians)
    rng = np.random.default_rng(0)
    encodings = rng.normal(size=(n, D)).astype(np.float32)
    n_pixels = camera.width * camera.height
    slopes = rng.normal(size=(n_pixels, D)).astype(np.float32)
    forward = median_ms(lambda: cpu.render(gaussians, camera, channels=encodings))
    view = prepare(gaussians, camera)
    by_tile = _by_tile(slopes, camera)
    backward = median_ms(lambda: _backward(view, camera, by_tile, n))
    result = [
        Figure("identity: 16-channel render, 200k, 640x480", forward, "ms"),
        Figure("identity: its backward pass (features only)", backward, "ms"),
    ]
    for w_min, name, bar in ((1 / 255, "w > 1/255", ">= 10"), (0.0, "all weights", "")):
        weights = cpu.weights(gaussians, camera, np.arange(n_pixels), w_min=w_min)
        rows = LinearRows.of(weights, n)
        _check(rows, weights, w_min, view, camera, slopes, by_tile)
        linear = median_ms(lambda r=rows: r.multiply(encodings))  # type: ignore[misc]
        linear += median_ms(lambda r=rows: r.multiply_transposed(slopes))  # type: ignore[misc]
        result.append(Figure(f"identity: W E and W^T dF, {name}", linear, "ms"))
        title = f"identity: render and backward to W E and W^T dF, {name}"
        result.append(Figure(title, (forward + backward) / linear, "x", bar))
    return result


def _check(
    rows: LinearRows,
    weights: PixelWeights,
    w_min: float,
    view: TiledView,
    camera: Camera,
    slopes: FloatArray,
    by_tile: FloatArray,
) -> None:
    """The two ways to the gradient must agree, or their times say nothing."""
    if w_min > 0 or len(weights.indices) == 0:
        return
    exact = np.zeros((rows.n_gaussians, D), np.float32)
    exact[view.order] = _backward(view, camera, by_tile, rows.n_gaussians)
    error = np.abs(exact - rows.multiply_transposed(slopes)).max() / np.abs(exact).max()
    if error > 1e-4:
        raise ValueError(f"gradients of the two ways differ by {error}")


def _by_tile(slopes: FloatArray, camera: Camera) -> FloatArray:
    """Gradients of a picture (H * W, 16) as (tiles, TILE, 16, TILE)."""
    nx, ny = -(-camera.width // TILE), -(-camera.height // TILE)
    padded = np.zeros((ny * TILE, nx * TILE, D), np.float32)
    padded[: camera.height, : camera.width] = slopes.reshape(camera.height, camera.width, D)
    tiles = padded.reshape(ny, TILE, nx, TILE, D).transpose(0, 2, 1, 4, 3)
    return np.ascontiguousarray(tiles.reshape(nx * ny, TILE, D, TILE))


def _backward(view: TiledView, camera: Camera, by_tile: FloatArray, n: int) -> FloatArray:
    out = np.zeros((len(view.order), D), np.float32)
    size = np.array([camera.width, camera.height], np.int64)
    blend_wide_backward(view.splats, view.offsets, view.ids, by_tile, size, out)
    return out


def _vote(gaussians: Gaussians, labels: IntArray) -> list[Figure]:
    """Mode "vote", its fit included, of 40 views against 10,000 steps that rasterize their view."""
    cpu, n = CpuRasterizer(), len(gaussians)
    cameras = orbit_cameras(_VIEWS, width=640, height=480, radius=2.0)
    maps = {c.name: cpu.label_splat(gaussians, c, labels).labels for c in cameras}

    def vote() -> None:
        nobody = np.full(n, -1, np.int32)
        votes = run_stage(vote_labels(gaussians, cameras, lambda c: maps[c.name], _GROUPS, cpu))
        voted = Voted(votes.labels, votes.confidence)
        closed = run_stage(vote_identity(gaussians, voted, nobody, _GROUPS, cameras, cpu))
        run_stage(fit_identity(gaussians, closed, cameras, lambda c: maps[c.name], cpu))

    seconds = median_ms(vote, runs=3) / 1e3
    step = _rasterizing_steps(gaussians, cameras, maps)
    return [
        Figure("identity: vote and fit, 40 views 640x480, 200k, 100 groups", seconds, "CPU-s"),
        Figure(f"identity: a step that rasterizes, mean of {_STEPS}", step, "CPU-s"),
        Figure(
            "identity: 10k steps that rasterize (extrapolated) to vote",
            _PAPER_STEPS * step / seconds,
            "x",
            ">= 300",
        ),
    ]


def _rasterizing_steps(
    gaussians: Gaussians, cameras: tuple[Camera, ...], maps: dict[str, IntArray]
) -> float:
    """CPU seconds of a step as published: render a whole view, cross-entropy, backward, Adam."""
    cpu, n = CpuRasterizer(), len(gaussians)
    training = start_from_zeros(n, _GROUPS, 0)
    gradients = IdentityGradients.zeros(training)
    n_pixels = cameras[0].width * cameras[0].height
    pixels = np.arange(n_pixels, dtype=np.int32)
    # The layer's part on the rendered features: an operator that is the unit matrix.
    ones = PixelWeights(np.arange(n_pixels + 1), pixels, np.ones(n_pixels, np.float32))
    unit = LinearRows.of(ones, n_pixels)
    layer = replace(training, encodings=np.empty((n_pixels, D), np.float32))
    slopes = IdentityGradients(
        np.empty((n_pixels, D), np.float32), gradients.weight, gradients.bias
    )

    def step(camera: Camera) -> None:
        gradients.clear()
        frame = cpu.render(gaussians, camera, channels=training.encodings)
        layer.encodings[:] = frame.image.reshape(-1, D)
        cross_entropy(layer, Batch(unit, maps[camera.name].ravel()), slopes)
        view = prepare(gaussians, camera)  # counted twice: it is a few per cent
        by_view = _backward(view, camera, _by_tile(slopes.encodings, camera), n)
        gradients.encodings[view.order] = by_view
        adam_step(training, gradients, IdentityRates())

    step(cameras[0])
    start = time.process_time()
    for i in range(_STEPS):
        step(cameras[i % len(cameras)])
    return (time.process_time() - start) / _STEPS


def _code_book() -> Figure:
    return Figure("identity: greatest cosine of 301 codes", code_book(300).max_cosine, "", "<= 0.4")


def _held_out() -> list[Figure]:
    """IoU of test views, mean over scenes on which nothing was decided."""
    table = np.array([_ious(kind, seed) for kind in _KINDS for seed in _SEEDS])
    bare, vote, refine, trained = 100 * table.mean(axis=0)
    name = f"identity: held-out IoU, {len(table)} scenes"
    return [
        Figure(f"{name}, labels of the vote, splatted", bare, "points"),
        Figure(f"{name}, vote", vote, "points"),
        Figure(f"{name}, vote less its splatted labels", vote - bare, "points", ">= 0"),
        Figure(f"{name}, refine", refine, "points"),
        Figure(f"{name}, refine less vote", refine - vote, "points"),
        Figure(f"{name}, 2,000 steps from zeros", trained, "points"),
        Figure(f"{name}, vote less 2,000 steps", vote - trained, "points", ">= 0"),
    ]


def _ious(kind: Kind, seed: int) -> tuple[float, float, float, float]:
    """IoU of the test views of a scene: voted labels splatted, vote, refine, 2,000 steps."""
    bench, cpu = (
        bench_scene(kind, seed, n_splats=20_000, n_train=20, size=(240, 180)),
        CpuRasterizer(),
    )
    gaussians, train = bench.gaussians, bench.train
    config = AssociateConfig.of("robust")
    found = run_stage(associate_stage(gaussians, train, bench.masks, cpu, config))
    n_groups = found.bank.n_groups

    def label_map(camera: Camera) -> IntArray:
        masks = load_labels(bench.masks, camera)[0]
        return associated_labels(masks, found.mask_groups[camera.name])

    voted = Voted(found.labels, found.confidence)
    closed = run_stage(vote_identity(gaussians, voted, found.bank.group, n_groups, train, cpu))
    closed = run_stage(fit_identity(gaussians, closed, train, label_map, cpu)).closed
    refined, _ = run_stage(refine_identity(gaussians, closed, train, label_map, cpu))
    paper = PaperConfig(iterations=2000)
    trained, _ = run_stage(train_identity(gaussians, n_groups, train, label_map, cpu, paper))
    truth = [bench.truth[camera.name] for camera in bench.test]

    def iou(field: IdentityField) -> float:
        shown = [
            decode_view(field, gaussians, camera, cpu, void_below=VOID_BELOW).labels
            for camera in bench.test
        ]
        return score_pairs(zip(truth, shown, strict=True))[1].iou

    splatted = [cpu.label_splat(gaussians, c, closed.identity.labels).labels for c in bench.test]
    exact = score_pairs(zip(truth, splatted, strict=True))[1].iou
    fields = (closed.identity.field, refined.field, trained.field)
    vote, refine, full = (iou(field) for field in fields)
    return exact, vote, refine, full
