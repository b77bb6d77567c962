"""Scenes with truth as samples of their surfaces, kept between runs."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import gaga_core
from gaga_core.arrays import IntArray, LongArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import GateConfig, ViewMasks
from gaga_core.grouping.robust.surface_graph import finite
from gaga_core.grouping.robust.surface_points import DepthMaps, in_picture
from gaga_core.grouping.surfaces.borders import Seen
from gaga_core.grouping.surfaces.objects import HierarchyConfig, colors_of_samples
from gaga_core.grouping.surfaces.surfels import (
    Neighbourhood,
    Surfels,
    sample_surfels,
    small_pieces,
)
from gaga_core.io.files import atomic_write
from gaga_core.io.folder.scene_folder import open_scene_folder, read_model, select_views
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene.selection.click import click_views
from gaga_core.segmentation.regions import FURTHER_STEPS, RegionsConfig, regions_at
from tools.scenes.parts import PaintedKind, painted_scene

_MISS = 0.02  # share of its depth by which a sample may miss the surface that a view shows
_FEW_VIEWS = (28, 10, 20, 28, 14, 36)  # of a scene, by its seed
_ITERATIONS, _SIDE = 700, 320  # of a training; pixels of its pictures
ALONE = "_alone"  # what names of scenes without surroundings end in
_CUT_OUT = (1, 1, 1, 3)  # objects that are cut out of a scene, by its seed
_LEAST_SPLATS = 300  # of an object that is cut out
_WIDTHS = (480, 480, 400)  # pixels of the regions, by its seed


@dataclass(frozen=True, eq=False)
class Labelled:
    """Samples of a scene and their true objects."""

    name: str
    seen: Seen
    truth: IntArray  # (S,) object 1.., 0 = none
    n_splats: LongArray  # (S,) next to each sample
    views: tuple[Camera, ...]


def scene_samples(folder: Path, cache: Path, seed: int, *, all_views: bool = False) -> Labelled:
    """Samples of a scene folder with ``gt``: of ``gt/splat_labels.npy`` where it is there, else of
    the label maps of its views."""

    def look() -> Labelled:
        scene = open_scene_folder(folder)
        cameras = _some(select_views(scene, "train"), seed, all_views=all_views)
        gaussians = run_stage(read_model(scene))
        photos = {c.name: read_rgb(scene.require_image(c.name)) for c in cameras}
        made = _looked(folder.name, gaussians, cameras, photos, _WIDTHS[seed % len(_WIDTHS)])
        labels = folder / "gt" / "splat_labels.npy"
        if labels.is_file():
            return _with_truth(made, gaussians, np.load(labels))
        every = select_views(scene, "all")
        paths = [(c, folder / "gt" / "instance" / f"{Path(c.name).stem}.png") for c in every]
        maps = [(c, read_labels(path)) for c, path in paths if path.is_file()]
        return _with_shown_truth(made, gaussians, maps)

    return _kept(cache / f"{folder.name}.npz", look)


def trained_samples(folder: Path, work: Path, cache: Path, *, all_views: bool = False) -> Labelled:
    """Samples of the same photos and poses with splats of our own short training: real noise."""
    copy = work / "trained" / folder.name
    if not (copy / "point_cloud.ply").is_file():
        for name in ("images", "sparse", "gt/instance"):
            shutil.copytree(folder / name, copy / name, dirs_exist_ok=True)
        shutil.copy(folder / "split.json", copy / "split.json")
        config = ReconstructConfig(iterations=_ITERATIONS, max_side=_SIDE)
        gaga_core.reconstruct(copy / "images", copy, config=config)
    found = scene_samples(copy, cache / "trained", 0, all_views=all_views)
    return replace(found, name=f"trained_{found.name}")


def cut_out_samples(folder: Path, cache: Path, seed: int) -> Labelled:
    """Samples of one object of the scene without anything around it, or of some next to each other,
    as files of splats from other programs are; seen from all around, as clicks see such a file."""

    def look() -> Labelled:
        gaussians = run_stage(read_model(open_scene_folder(folder)))
        labels = np.load(folder / "gt" / "splat_labels.npy")
        rng = np.random.default_rng(seed)
        n_splats = np.bincount(labels, minlength=2)
        whole = 1 + np.flatnonzero(n_splats[1:] >= _LEAST_SPLATS)
        centres = np.array([np.median(gaussians.means[labels == k], axis=0) for k in whole])
        away = np.linalg.norm(centres - centres[rng.integers(len(whole))], axis=1)
        chosen = whole[np.argsort(away)[: _CUT_OUT[seed % len(_CUT_OUT)]]]
        rows = np.flatnonzero(np.isin(labels, chosen))
        alone, engine = gaussians.take(rows), choose("cpu")
        cameras = click_views((), alone.means)
        frames = {c.name: np.nan_to_num(engine.render(alone, c).image) for c in cameras}
        photos = {k: np.rint(255 * np.clip(i, 0, 1)).astype(np.uint8) for k, i in frames.items()}
        made = _looked(folder.name, alone, cameras, photos, _WIDTHS[0])
        return _with_truth(made, alone, labels[rows])

    return replace(_kept(cache / f"{folder.name}.npz", look), name=folder.name + ALONE)


def painted_samples(
    kind: PaintedKind, seed: int, cache: Path, *, all_views: bool = False
) -> Labelled:
    """Samples of a generated scene."""

    def look() -> Labelled:
        scene = painted_scene(kind, seed)
        cameras = _some(scene.train, seed, all_views=all_views)
        made = _looked(f"{kind}_{seed}", scene.gaussians, cameras, scene.photos, _WIDTHS[0])
        return _with_truth(made, scene.gaussians, scene.labels)

    return _kept(cache / f"{kind}_{seed}.npz", look)


def _some(cameras: Sequence[Camera], seed: int, *, all_views: bool) -> tuple[Camera, ...]:
    """Some of the cameras, in their order: people take few photos and many."""
    n = len(cameras) if all_views else _FEW_VIEWS[seed % len(_FEW_VIEWS)]
    drawn = np.random.default_rng(seed).permutation(len(cameras))[:n]
    return tuple(cameras[k] for k in np.sort(drawn))


def _looked(
    name: str,
    gaussians: Gaussians,
    cameras: tuple[Camera, ...],
    photos: Mapping[str, UInt8Array],
    width: int,
) -> Labelled:
    """The samples as the association of regions takes them, without truth."""
    engine, nothing = choose("cpu"), np.zeros((len(gaussians), 1), np.float32)
    depths, maps, steps = DepthMaps(cameras), dict[str, list[IntArray]](), (1.0, *FURTHER_STEPS)
    for camera in cameras:
        frame = engine.render(gaussians, camera, channels=nothing)
        config, photo = RegionsConfig(width=width), photos[camera.name]
        maps[camera.name] = regions_at(steps, photo, frame.median_depth, None, config)
        depths.add(camera.name, frame.median_depth, frame.alpha, GateConfig().alpha_min)
    sample = sample_surfels(
        cameras,
        lambda camera: ViewMasks.of(maps[camera.name][0]),
        lambda camera: maps[camera.name][1:],
        depths,
        HierarchyConfig().surfels,
    )
    surfels = run_stage(sample)
    rows = np.flatnonzero(finite(gaussians))
    nearest = cKDTree(surfels.points).query(gaussians.means[rows].astype(np.float64))[1]
    n_splats = np.bincount(np.asarray(nearest), minlength=len(surfels.points))
    near, color = (
        Neighbourhood.of(surfels.points),
        colors_of_samples(gaussians, rows, surfels.points),
    )
    seen = Seen.of(surfels, near, color, small_pieces(surfels, near), len(cameras))
    return Labelled(name, seen, np.zeros(len(surfels.points), np.int32), n_splats, cameras)


def _with_truth(made: Labelled, gaussians: Gaussians, labels: IntArray) -> Labelled:
    """With the label of the splat that is nearest to each sample, of labels (N,)."""
    rows = np.flatnonzero(finite(gaussians))
    tree = cKDTree(gaussians.means[rows].astype(np.float64))
    nearest = np.asarray(tree.query(made.seen.surfels.points)[1])
    return replace(made, truth=labels[rows[nearest]].astype(np.int32))


def _with_shown_truth(
    made: Labelled, gaussians: Gaussians, maps: Sequence[tuple[Camera, IntArray]]
) -> Labelled:
    """With the label that most label maps show at each sample."""
    points, engine = made.seen.surfels.points, choose("cpu")
    nothing = np.zeros((len(gaussians), 1), np.float32)
    votes = np.zeros((len(points), 1 + max(int(labels.max()) for _, labels in maps)), np.int32)
    for camera, labels in maps:
        depth = engine.render(gaussians, camera, channels=nothing).median_depth
        inside, rows, columns, z = in_picture(camera, points)
        seen = np.abs(z - depth[rows, columns]) < _MISS * depth[rows, columns]
        np.add.at(votes, (inside[seen], labels[rows[seen], columns[seen]]), 1)
    return replace(made, truth=votes.argmax(axis=1).astype(np.int32))


def _kept(path: Path, look: Callable[[], Labelled]) -> Labelled:
    """What ``look`` returns, from the file of an earlier time where it is there."""
    if not path.is_file():
        made = look()
        surfels, views = made.seen.surfels, made.views
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            np.savez(
                file,
                points=surfels.points,
                normals=surfels.normals,
                regions=surfels.regions.astype(np.uint16),
                further=surfels.further.astype(np.uint16),
                n_views=surfels.n_views,
                color=made.seen.color,
                piece=made.seen.piece,
                truth=made.truth,
                n_splats=made.n_splats,
                K=np.array([c.K for c in views]),
                cam_from_world=np.array([c.cam_from_world for c in views]),
                size=np.array([(c.width, c.height) for c in views]),
            )
    z = np.load(path)
    regions, further = z["regions"].astype(np.int32), z["further"].astype(np.int32)
    surfels = Surfels(z["points"], z["normals"], regions, z["n_views"], further)
    poses = zip(z["K"], z["cam_from_world"], z["size"].tolist(), strict=True)
    views = tuple(Camera(K, pose, w, h, f"{i}") for i, (K, pose, (w, h)) in enumerate(poses))
    near = Neighbourhood.of(surfels.points)
    seen = Seen.of(surfels, near, z["color"], z["piece"], len(views))
    return Labelled(path.stem, seen, z["truth"], z["n_splats"], views)
