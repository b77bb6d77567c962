"""Compile the kernels before they are needed, with progress: once on a machine, half a minute.

What starts long work calls `after_warm_up` with the parts that it needs; the window runs
`warm_up_stage` of its own part in a job when `kernels.is_compiled` says no. Every step calls the
real operators on a scene of a few splats, so that no list of kernels and of their argument types
has to be kept.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.export.dataset.records import shown_objects
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.io.splats.ply import write_ply
from gaga_core.kernels import PARTS, STAGE, Part, is_compiled, mark_compiled
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, T, run_stage
from gaga_core.query.group_facts import group_digests, group_facts
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.raster.vote_slots import VoteSlots
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.lod.cut import choose_cut, covers_of, hidden_nodes
from gaga_core.scene.lod.edited import node_facts
from gaga_core.scene.objects import object_table
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.by_screen import pick, rectangle, screen
from gaga_core.scene.selection.click import click_graph_stage

_SIDE = 48  # pixels: several tiles
_N_VIEWS = 3
_TRAIN_STEPS = 24


@dataclass(frozen=True, eq=False)
class _Sample:
    """The smallest scene that goes through all of the code: two balls on a floor."""

    gaussians: Gaussians
    labels: IntArray  # (N,) 1, 2; 0 = floor
    cameras: tuple[Camera, ...]
    rasterizer: Rasterizer

    @property
    def scene(self) -> Scene:
        """The same as a scene with two objects."""
        return Scene.of(self.gaussians, self.labels)


def warm_up_stage(*parts: Part) -> Stage[None]:
    """Compile the kernels of ``parts`` (none: all), or load them from the disk.

    When a part has come to its end, `kernels.is_compiled` says so until the next upgrade.
    Cancelling it loses nothing: what was compiled stays, and has no share of the next bar.
    """
    sample = _sample()
    parts = parts or PARTS
    costs = {part: [_missing(part, step) for step in _STEPS[part]] for part in parts}
    total, done = sum(map(sum, costs.values())), 0
    for part in parts:
        for (name, _, work), cost in zip(_STEPS[part], costs[part], strict=True):
            yield Progress(STAGE, done, total, name)
            work(sample)
            mark_compiled(part, name)
            done += cost
        mark_compiled(part)
    yield Progress(STAGE, total, total)


def usual_seconds(*parts: Part) -> float:
    """Seconds that `warm_up_stage` of ``parts`` still takes on an idle core like the one that was
    measured."""
    missing = [part for part in parts if not is_compiled(part)]
    return sum(_missing(part, step) for part in missing for step in _STEPS[part]) / 10


def _missing(part: Part, step: "Step") -> int:
    """Its cost; 0 where it is compiled."""
    return 0 if is_compiled(part, step[0]) else step[1]


def after_warm_up(stage: Stage[T], *parts: Part) -> Stage[T]:
    """``stage``, behind `warm_up_stage` of those of ``parts`` (none: all) that are not compiled."""
    missing = [part for part in parts or PARTS if not is_compiled(part)]
    if missing:
        yield from warm_up_stage(*missing)
    return (yield from stage)


def _sample() -> _Sample:
    rng = np.random.default_rng(0)
    out = rng.normal(size=(2, 150, 3))
    out /= 3 * np.linalg.norm(out, axis=2, keepdims=True)
    balls = out + np.array([[[-0.5, 0, 0]], [[0.5, 0, 0]]])
    floor = np.c_[rng.uniform(-1.2, 1.2, (300, 2)), np.full(300, -0.35)]
    means = np.concatenate([floor, *balls]).astype(np.float32)
    n = len(means)
    gaussians = Gaussians(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.full((n, 3), -2.7, np.float32),
        logit_opacities=np.full(n, 3, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )
    K = np.array([[0.9 * _SIDE, 0, _SIDE / 2], [0, 0.9 * _SIDE, _SIDE / 2], [0, 0, 1]])
    cameras = []
    for i in range(_N_VIEWS):
        pose = look_at(np.array([0.4 * (i - 1), -2.2, 1.4]), np.zeros(3), np.array([0, 0, 1.0]))
        cameras.append(Camera(K, pose, _SIDE, _SIDE, f"{i}.png"))
    labels = np.repeat(np.array([0, 1, 2], np.int32), [300, 150, 150])
    return _Sample(gaussians, labels, tuple(cameras), choose("cpu"))


def _render(sample: _Sample) -> object:
    channels = np.zeros((len(sample.gaussians), 16), np.float32)
    return sample.rasterizer.render(sample.gaussians, sample.cameras[0], channels=channels)


def _labels(sample: _Sample) -> object:
    return sample.rasterizer.label_splat(sample.gaussians, sample.cameras[0], sample.labels)


def _outlines(sample: _Sample) -> None:
    camera, objects = sample.cameras[0], np.array([1, 2], np.int32)
    found = CpuRasterizer().labelled(sample.gaussians, camera, sample.labels, objects, 0.3)
    shown_objects(found.outlines, dict.fromkeys((1, 2), np.eye(4)), camera)


def _vote(sample: _Sample) -> None:
    histogram = np.zeros((len(sample.gaussians), 1), np.float32)
    pixels = np.zeros((_SIDE, _SIDE), np.int32)
    sample.rasterizer.vote(sample.gaussians, sample.cameras[0], pixels, histogram)
    slots = VoteSlots.empty(len(histogram))
    sample.rasterizer.vote(sample.gaussians, sample.cameras[0], pixels, slots)
    one = np.zeros(1, np.int32)
    slots.add(one, one, np.zeros((1, 1), np.float32))
    slots.add_one(one, one)


def _select(sample: _Sample) -> object:
    surface = sample.rasterizer.render(sample.gaussians, sample.cameras[0]).median_depth
    inside = rectangle((0, 0, _SIDE, _SIDE), _SIDE, _SIDE)
    return screen(sample.scene, sample.cameras[0], surface).inside(inside)


def _click(sample: _Sample) -> None:
    scene = Scene.of(sample.gaussians)
    graph = run_stage(click_graph_stage(scene, sample.cameras, sample.rasterizer))
    graph.splats(np.ones(len(graph.points), np.bool_))


def _train(sample: _Sample) -> object:
    """A training of a few steps: half size and full, every SH degree, density, held-out views."""
    # Loaded here: association and rendering do not use it.
    from gaga_core.training.settings import TrainConfig
    from gaga_core.training.start import first_splats_stage
    from gaga_core.training.train import train
    from gaga_core.training.views import TrainView, TrainViews

    pictures = [sample.rasterizer.render(sample.gaussians, c).image for c in sample.cameras]
    views = [
        TrainView(camera, (np.clip(picture, 0, 1) * 255).astype(np.uint8))
        for camera, picture in zip(sample.cameras, pictures, strict=True)
    ]
    draft = TrainConfig.of("draft")
    density = replace(draft.density, every=4, max_splats=800)
    config = replace(draft, iterations=_TRAIN_STEPS, density=density, longest_side=_SIDE)
    held_out = TrainViews(tuple(views[1:]), tuple(views[:1]))
    points = sample.gaussians.means[::4].astype(np.float64)  # so few that stereo adds more
    colors = np.full((len(points), 3), 128, np.uint8)
    initial = run_stage(
        first_splats_stage(points, colors, held_out.train, config, sample.rasterizer)
    )
    return train(initial, held_out, config, sample.rasterizer)


def _write(sample: _Sample) -> None:
    with tempfile.TemporaryDirectory() as folder:
        write_ply(Path(folder) / "sample.ply", sample.gaussians)


def _level_of_detail(sample: _Sample) -> None:
    scene = Scene.of(sample.gaussians)
    scene.state[0] = 2
    with tempfile.TemporaryDirectory() as folder:
        stage = build_lod_stage(sample.gaussians, Path(folder) / "lod", "sample")
        tree = run_stage(stage)
    node_facts(tree, scene)
    choose_cut(tree, tree.boxes, sample.cameras[0], 1000)
    splats = sample.gaussians
    covers = covers_of(splats.log_scales, splats.logit_opacities)
    hidden_nodes(tree.boxes, splats.means, covers, sample.cameras[0])


def _associate(sample: _Sample, preset: str, *, are_regions: bool = False) -> object:
    shown = {
        c.name: sample.rasterizer.label_splat(sample.gaussians, c, sample.labels).labels + 1
        for c in sample.cameras
    }
    loaders = {name: lambda labels=labels: labels for name, labels in shown.items()}
    return run_stage(
        associate_stage(
            sample.gaussians,
            sample.cameras,
            MaskSet(loaders, "sample", are_regions),
            sample.rasterizer,
            AssociateConfig.of(preset),
        )
    )


# Cost: tenths of a second of the processor that it compiled for, all in this order from an empty
# cache (x86-64, numba 0.68).
Step = tuple[str, int, Callable[[_Sample], object]]
# In the order in which a window needs them: clicks, outlines, the object list, names.
_STEPS: dict[Part, tuple[Step, ...]] = {
    "window": (
        ("clicks on objects", 14, lambda s: pick(s.scene, s.cameras[0], _SIDE / 2, _SIDE / 2)),
        ("object list", 4, lambda s: object_table(s.scene)),
        ("names", 23, lambda s: (group_facts(s.scene, s.cameras), group_digests(s.scene))),
        ("pictures", 52, lambda s: s.rasterizer.render(s.gaussians, s.cameras[0])),
        ("selection", 5, _select),
        ("clicks without objects", 132, _click),
        ("files", 3, _write),
    ),
    "grouping": (
        ("pictures of channels", 8, _render),
        ("label pictures", 16, _labels),
        ("votes", 24, _vote),
        ("association, paper", 11, lambda s: _associate(s, "paper")),
        ("association, released", 1, lambda s: _associate(s, "released")),
        ("association, robust", 88, lambda s: _associate(s, "robust")),
        ("association, regions", 1, lambda s: _associate(s, "robust", are_regions=True)),
    ),
    "training": (("training", 194, _train),),
    "export": (("labelled pictures", 95, _outlines),),
    "lod": (("level of detail", 35, _level_of_detail),),
}
