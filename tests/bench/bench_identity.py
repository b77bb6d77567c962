"""Identity encodings: the vote against training."""

from dataclasses import replace

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.evaluate.group_scores import score_pairs
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.grouping.views import load_labels
from gaga_core.grouping.votes import VOID_BELOW, associated_labels, vote_labels
from gaga_core.identity.closed_form import Voted, code_book, fit_identity, vote_identity
from gaga_core.identity.field import IdentityField, decode_view
from gaga_core.identity.train import PaperConfig, refine_identity, train_identity
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.bench.figures import Figure, median_ms
from tests.scenes import objects_scene, orbit_cameras
from tools.scenes.rooms import Kind, bench_scene

_N, _GROUPS, _VIEWS = 200_000, 100, 40
_KINDS: tuple[Kind, ...] = ("room", "table")
_SEEDS = (31, 32, 33)


def figures() -> list[Figure]:
    """Every figure of this file; times are CPU times of all threads together."""
    gaussians, labels = _surfaces()
    return [_vote(gaussians, labels), _code_book(), *_held_out()]


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


def _vote(gaussians: Gaussians, labels: IntArray) -> Figure:
    """Mode "vote", its fit included, of 40 views."""
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
    return Figure("identity: vote and fit, 40 views 640x480, 200k, 100 groups", seconds, "CPU-s")


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
