"""Two captures of one place brought together: halves of photos, placed apart, then aligned.

Each draw parts the photos of a scene in two; each half is placed as a person would place it (no
EXIF, no poses, draft), and the second is aligned to the first. The truth are the known poses: a
similarity brings each half's cameras to them. In the second part three objects stand elsewhere in
the second half's photos, both halves are trained, and what is listed as changed is counted.
``python -m tests.bench.bench_align halves|changed FIRST LAST`` prints single draws.
"""

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaga_core.api import run
from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import fit_similarity, turned
from gaga_core.io.cameras.colmap import read_colmap
from gaga_core.io.files import assets
from gaga_core.io.images import write_rgb
from gaga_core.io.splats.splat_files import read_splats
from gaga_core.pipeline.align import Aligned, align_stage, open_capture_stage, workspace_of
from gaga_core.pipeline.place import place_photos
from gaga_core.pipeline.settings import AlignConfig, ReconstructConfig
from gaga_core.placing.poses import similarity_between
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene.captures.alignment import Capture, difference
from gaga_core.scene.frame import inverse
from tests.bench.figures import Figure, data_folder, is_long
from tests.bench.workers import run_worker
from tools.demo.objects import TABLE_TOP
from tools.demo.scene import build, items, photo_cameras
from tools.demo.shapes import Item

_DRAWS = 10
_CHANGED_DRAWS = 4
_PHOTOS = {"demo": 40, "garden": 60}  # of both halves together
_TURN, _SCALE = 0.5, 0.5  # degrees and percent that an aligned pair may be off
_MOVED = 3  # objects
_MOVABLE = ("teapot", "mug", "oil bottle", "candle", "lemon", "bananas")  # nothing lies on them
_FLAT = ("table", "table runner")  # things may stand there
_TABLE = ((-0.65, -0.36), (0.65, 0.36))  # metres, x and y
_LOW = 0.05  # metres: what begins so near to the table's top stands on it
_TRIES = 2000  # places that are looked at
_LEAST = 0.15  # metres from where an object stood
_SAME = 0.05  # of the depth: a point that is farther from the true surface is of another one
_NEAR = 0.07  # metres: a group's middle is that near the object's


def figures() -> list[Figure]:
    """How far off the aligned halves are, and what is found of three moved objects."""
    found = []
    for name in _PHOTOS:
        if name != "demo" and not data_folder(name).is_dir():
            continue
        drawn = run_worker("tests.bench.bench_align", ["halves", name, "0", str(_DRAWS)])
        title = f"align: halves of {name}, {_DRAWS} draws"
        bar = f">= {0.9 * _DRAWS:g}"
        found += [
            Figure(f"{title}, within {_TURN} degrees and {_SCALE} %", drawn["good"], "", bar),
            Figure(f"{title}, refused", drawn["refused"], ""),
            Figure(f"{title}, median angle", drawn["degrees"], "degrees"),
            Figure(f"{title}, median error of scale", drawn["percent"], "%"),
        ]
    if is_long():
        drawn = run_worker("tests.bench.bench_align", ["changed", "demo", "0", str(_CHANGED_DRAWS)])
        title, n = f"align: {_MOVED} objects moved, {_CHANGED_DRAWS} draws", _MOVED * _CHANGED_DRAWS
        found += [
            Figure(f"{title}, listed", drawn["listed"], "", f">= {n}"),
            Figure(f"{title}, entries too many", drawn["wrong"], "", "<= 0"),
        ]
    return found


def halves(name: str, seed: int) -> tuple[float, float] | None:
    """Degrees and percent by which one draw is off; None: refused in words."""
    with tempfile.TemporaryDirectory(prefix="gaga-bench-") as folder:
        return off(name, place_halves(name, seed, Path(folder)))


def place_halves(name: str, seed: int, folder: Path) -> list[Path]:
    """Two new scene folders in ``folder``, each of one half of the photos."""
    photos, truth = _scene(name)
    order = np.random.default_rng(seed).permutation(len(truth))[: _PHOTOS[name]]
    scenes = []
    for k, rows in enumerate(np.array_split(order, 2)):
        shots, scene = folder / f"shots-{k}", folder / f"scene-{k}"
        shots.mkdir()
        for i in rows:
            (shots / truth[i].name).symlink_to(photos / "images" / truth[i].name)
        run_stage(place_photos(shots, scene, ReconstructConfig(poses="ignore")))
        scenes.append(scene)
    return scenes


def off(name: str, scenes: Sequence[Path]) -> tuple[float, float] | None:
    """Degrees and percent by which two placed halves are off; None: refused in words."""
    photos, truth = _scene(name)
    splats = read_splats(photos / ("point_cloud.sog" if name == "demo" else "point_cloud.ply"))
    try:
        found = _aligned(*scenes)[0]
    except GagaError as refused:
        sys.stderr.write(f"{refused}\n")
        return None
    first, second = (_to_truth(scene, truth, splats) for scene in scenes)
    turn, scale = difference(found.alignment.world, inverse(first) @ second)
    return float(np.degrees(turn)), 100 * scale


def _scene(name: str) -> tuple[Path, tuple[Camera, ...]]:
    photos = assets() / "demo" if name == "demo" else data_folder(name)
    return photos, tuple(read_colmap(photos / "sparse" / "0").cameras)


def _aligned(first: Path, second: Path) -> tuple[Aligned, list[Capture]]:
    opened = [run_stage(open_capture_stage(path))[0] for path in (first, second)]
    stage = align_stage(opened[0], opened[1], AlignConfig(), workspace_of(first))
    return run_stage(stage), opened


def _to_truth(scene: Path, truth: Sequence[Camera], splats: Gaussians) -> DoubleArray:
    """Similarity (4, 4) from the world of a placed half to the true one, by what both see: points
    of the half, and where the true cameras see a true surface at their pixels.

    By the cameras alone it would be another one: a focal length that is off moves all cameras away
    from all surfaces, and it is surfaces that have to lie on each other.
    """
    model = read_colmap(scene / "sparse" / "0")
    known = {camera.name: camera for camera in truth}
    pairs = [(camera, known[camera.name]) for camera in model.cameras]
    poses = [np.array([pair[k].cam_from_world[:3] for pair in pairs]) for k in (0, 1)]
    world = similarity_between(poses[0], poses[1])
    own, true, engine = [], [], choose("cpu")
    for camera, view in pairs:
        pixels, depths = camera.project(model.points)
        rows = np.flatnonzero(camera.shows(pixels, depths))
        at = pixels[rows] * (view.width / camera.width, view.height / camera.height)
        u, v = np.minimum(at.astype(np.int64), (view.width - 1, view.height - 1)).T
        depth = engine.render(splats, view).median_depth[v, u].astype(np.float64)
        rays = (at - view.K[:2, 2]) / view.K.diagonal()[:2]
        seen = np.column_stack([rays, np.ones(len(rays))]) * depth[:, None]
        seen = (seen - view.cam_from_world[:3, 3]) @ view.cam_from_world[:3, :3]
        there = turned(model.points[rows], world[:3, :3]) + world[:3, 3]
        is_same = np.abs(np.linalg.norm(there - seen, axis=1)) < _SAME * depth
        own.append(model.points[rows[is_same]])
        true.append(seen[is_same])
    a, b = np.concatenate(own), np.concatenate(true)
    keep = np.ones(len(a), np.bool_)
    for _ in range(10):  # edges of surfaces are not where they seem to be
        world[:3] = fit_similarity(a[keep], b[keep])
        off = np.linalg.norm(turned(a, world[:3, :3]) + world[:3, 3] - b, axis=1)
        keep = off <= 3 * np.median(off)
    return world


def changed(seed: int) -> tuple[int, int]:
    """Moved objects that are listed as moved, and entries that are none of these."""
    moved, rooms = moved_items(seed)
    truth = photo_cameras(_PHOTOS["demo"], (640, 480), np.random.default_rng((0, 1)))
    order, engine = np.random.default_rng(seed).permutation(len(truth)), choose("cpu")
    models = [build(120_000, 0, stands=found) for found in (items(), rooms)]
    with tempfile.TemporaryDirectory(prefix="gaga-bench-") as folder:
        scenes = []
        for k, rows in enumerate(np.array_split(order, 2)):
            shots, scene = Path(folder) / f"shots-{k}", Path(folder) / f"scene-{k}"
            shots.mkdir()
            for i in rows:
                image = engine.render(models[k].gaussians, truth[i]).image
                write_rgb(shots / truth[i].name, image)
            run(shots, scene)
            scenes.append(scene)
        found, opened = _aligned(*scenes)
        world = _to_truth(scenes[0], truth, models[0].gaussians)
    return _counted(
        found, opened, world, [items()[k - 1] for k in moved], [rooms[k - 1] for k in moved]
    )


def moved_items(seed: int) -> tuple[list[int], list[Item]]:
    """Numbers (1..) of three objects, and all objects of the demo with these elsewhere."""
    rng, found = np.random.default_rng((seed, 17)), items()
    model = build(30_000, 0)
    discs: dict[int, tuple[DoubleArray, float]] = {}  # what stands on the table: middle, radius
    for k, item in enumerate(found, start=1):
        own = model.gaussians.means[model.labels == k].astype(np.float64)
        if item.name not in _FLAT and abs(own[:, 2].min() - TABLE_TOP) < _LOW:
            middle = (own[:, :2].min(axis=0) + own[:, :2].max(axis=0)) / 2
            discs[k] = middle, float(np.linalg.norm(own[:, :2] - middle, axis=1).max())
    can = [k for k, item in enumerate(found, start=1) if item.name in _MOVABLE]
    places = rng.uniform(_TABLE[0], _TABLE[1], (_TRIES, 2))
    moved: list[int] = []
    for k in rng.permutation(can).tolist():
        middle, radius = discs[k]
        others = [disc for other, disc in discs.items() if other != k]
        far = np.linalg.norm(places - middle, axis=1) >= max(_LEAST, 2 * radius)
        gaps = [np.linalg.norm(places - m, axis=1) - radius - r for m, r in others]
        free = places[far & (np.min(gaps, axis=0) > 0)]
        if len(free) and len(moved) < _MOVED:
            discs[k] = free[0], radius
            matrix = found[k - 1].matrix.copy()
            matrix[:2, 3] += free[0] - middle
            found[k - 1] = replace(found[k - 1], matrix=matrix)
            moved.append(k)
    return moved, found


def _counted(
    found: Aligned,
    opened: Sequence[Capture],
    world: DoubleArray,  # truth from the first capture
    before: Sequence[Item],
    after: Sequence[Item],
) -> tuple[int, int]:
    """An entry is right where one of the objects stood, and leads to where one of that name stands:
    nobody can tell two equal candles apart."""
    to, wrong = list(range(len(after))), 0
    left, scenes = list(range(len(before))), [capture.scene for capture in opened]
    worlds = world, world @ found.alignment.world
    for change in found.changes or ():
        sys.stderr.write(f"  {change.sentence(is_metric=False)}\n")
        places = []
        for scene, group, own in zip(scenes, (change.first, change.second), worlds, strict=True):
            if scene is not None and group is not None:
                means = scene.gaussians.means[scene.labels == group].astype(np.float64)
                places.append(turned(np.median(means, axis=0)[None], own[:3, :3])[0] + own[:3, 3])
        fits = [
            (i, j)
            for i in left
            for j in to
            if change.kind == "moved"
            and before[i].name == after[j].name
            and np.linalg.norm(places[0][:2] - before[i].matrix[:2, 3]) < _NEAR
            and np.linalg.norm(places[1][:2] - after[j].matrix[:2, 3]) < _NEAR
        ]
        if fits:
            left.remove(fits[0][0])
            to.remove(fits[0][1])
        else:
            wrong += 1
    for i in left:
        sys.stderr.write(f"  not listed: {before[i].name}\n")
    return len(before) - len(left), wrong


def _main(part: str, name: str, first: int, last: int) -> dict[str, float]:
    if part == "changed":
        counts = [changed(seed) for seed in range(first, last)]
        sys.stderr.write(f"{counts}\n")
        return {"listed": sum(n for n, _ in counts), "wrong": sum(n for _, n in counts)}
    rows = [halves(name, seed) for seed in range(first, last)]
    known = [row for row in rows if row is not None]
    for seed, row in enumerate(rows, start=first):
        sys.stderr.write(f"{name} {seed}: {row}\n")
    return {
        "good": sum(turn <= _TURN and scale <= _SCALE for turn, scale in known),
        "refused": len(rows) - len(known),
        "degrees": float(np.median([row[0] for row in known])),
        "percent": float(np.median([row[1] for row in known])),
    }


if __name__ == "__main__":
    part, name, first, last = sys.argv[1:]
    sys.stdout.write(json.dumps(_main(part, name, int(first), int(last))) + "\n")
