"""Scenes with an object, and what is behind it: the truth that a filled hole is compared with."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats, multiply_quats
from gaga_core.io.folder.scene_folder import open_scene_folder, select_views
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.splats.ply import read_ply
from gaga_core.raster import choose
from gaga_core.scene.edits.values import joined
from tools.demo.lighting import Lights, bake
from tools.demo.objects import TABLE_TOP, table
from tools.demo.scene import build, gaussians_of, photo_cameras
from tools.demo.shapes import Item, Surface, pose
from tools.scenes.rooms import solid, surface_of

_BEHIND = 0.003  # of the depth: what lies deeper is hidden
_LEFT = 0.5  # share of the light that a splat keeps that a training still makes
_SEEN = 0.5  # pixels of all photos: a training makes no splat that shows less
_SIZE = (400, 300)
_EMPTY = 0.9  # share of an object's foot that must stand on the bare table


@dataclass(frozen=True, eq=False)
class FillCase:
    """An object that hides something."""

    name: str
    gaussians: Gaussians  # as trained on photos that show the object
    labels: IntArray  # (N,)
    group: int  # of the object
    truth: Gaussians  # the scene that never had it
    train: tuple[Camera, ...]
    test: tuple[Camera, ...]


def trained(gaussians: Gaussians, is_object: BoolArray, cameras: Sequence[Camera]) -> BoolArray:
    """Splats (N,) that photos of the scene with the object would have made.

    All but those whose middle is shown without the object (``is_object`` (N,)) and not with it,
    and that lose more than half of their light by it. In a coarse wall the middle alone says
    little: depths of its pixels are those of other splats.
    """
    kept = np.ones(len(gaussians), np.bool_)
    without = np.flatnonzero(~is_object)
    middle, light = shown(gaussians, cameras)
    bare_middle, bare_light = shown(gaussians.take(without), cameras)
    kept[without] = ~bare_middle | (light[without] > _LEFT * bare_light)
    return kept | middle


def shown(gaussians: Gaussians, cameras: Sequence[Camera]) -> tuple[BoolArray, FloatArray]:
    """Splats (N,) whose middle some camera sees, and their light in all pictures (N,), pixels."""
    weight = np.zeros((len(gaussians), 1), np.float32)
    points, middle = gaussians.means.astype(np.float64), np.zeros(len(gaussians), np.bool_)
    for camera in cameras:
        nothing = np.zeros((camera.height, camera.width), np.int32)
        choose("cpu").vote(gaussians, camera, nothing, weight)
        depth = choose("cpu").render(gaussians, camera).median_depth
        pixels, z = camera.project(points)
        column, row = np.floor(pixels).astype(int).T
        inside = (z > 0) & (column >= 0) & (column < camera.width)
        inside &= (row >= 0) & (row < camera.height)
        front = depth[np.where(inside, row, 0), np.where(inside, column, 0)]
        middle |= inside & (z < front * (1 + _BEHIND))
    return middle & (weight[:, 0] > _SEEN), weight[:, 0]


def solid_cases(seed: int, n_objects: int, n_splats: int) -> Iterator[FillCase]:
    """Boxes, cylinders and balls on the demo's wooden table, lit with their shadows.

    Each in turn is the object; the truth is lit without it.
    """
    rng = np.random.default_rng((seed, 7))
    things = [Item("table", tuple(table()), pose((0, 0, 0), yaw=0.0)), *_solids(rng, n_objects)]
    surface = surface_of(things, n_splats, np.random.default_rng((seed, 8)))
    cameras = photo_cameras(20, _SIZE, np.random.default_rng((seed, 9)))
    test = cameras[3::5]
    train = tuple(camera for camera in cameras if camera not in test)
    whole = _lit(surface, seed)
    for group in range(2, len(things) + 1):
        kept = trained(whole, surface.labels == group, train)
        rest = surface.take(surface.labels != group)
        yield FillCase(
            f"solids {seed}: {things[group - 1].name} {group}",
            whole.take(kept),
            surface.labels[kept],
            group,
            _lit(rest, seed),
            train,
            test,
        )


def _solids(rng: np.random.Generator, n: int) -> list[Item]:
    """Solids of chance apart from each other on the table."""
    found: list[Item] = []
    places: list[tuple[float, float, float]] = []  # x, y, radius
    while len(found) < n:
        size = rng.uniform((0.08, 0.08, 0.08), (0.2, 0.2, 0.24))
        shape = ("box", "cylinder", "ball")[int(rng.integers(3))]
        x, y = rng.uniform((-0.55, -0.26), (0.55, 0.26))
        radius = float(np.linalg.norm(size[:2]) / 2)
        if all(np.hypot(x - a, y - b) > radius + r + 0.03 for a, b, r in places):
            at = (float(x), float(y), TABLE_TOP + float(size[2]) / 2)
            found.append(solid(shape, size, at, float(rng.uniform(0, 180))))
            places.append((float(x), float(y), radius))
    return found


def _lit(surface: Surface, seed: int) -> Gaussians:
    rng = np.random.default_rng((seed, 10))
    sh = bake(surface, Lights(), rng)
    return gaussians_of(surface, sh, np.random.default_rng((seed, 11)))


def demo_cases(seed: int, groups: Sequence[int], n_splats: int) -> Iterator[FillCase]:
    """Objects of the demo; the truth is the demo lit without the object: no shadow either."""
    model = build(n_splats, seed)
    cameras = photo_cameras(24, _SIZE, np.random.default_rng((seed, 1)))
    test = cameras[3::6]
    train = tuple(camera for camera in cameras if camera not in test)
    for group in groups:
        kept = trained(model.gaussians, model.labels == group, train)
        truth = build(n_splats, seed, without={group}).gaussians
        name = f"demo {seed} {model.names[group - 1]} {group}"
        yield FillCase(
            name, model.gaussians.take(kept), model.labels[kept], group, truth, train, test
        )


def placed_cases(folder: Path, n_cases: int, seed: int) -> Iterator[FillCase]:
    """Trained splats of a real object put onto empty places of the trained table it stands on.

    The truth is the scene as it was trained. The object casts no shadow there.
    """
    scene = open_scene_folder(folder)
    assert scene.model_path is not None
    whole = read_ply(scene.model_path)
    views = [
        camera.resized(*_SIZE)
        for camera in (*select_views(scene, "train"), *select_views(scene, "test"))
    ]
    n_train = len(scene.train)
    train, test = tuple(views[:n_train][::2]), tuple(views[n_train:][::2])
    labels = _true_labels(whole, scene.root, views[:n_train][::4])
    rng = np.random.default_rng(seed)
    objects = [int(g) for g in np.unique(labels) if g > 1 and (labels == g).sum() > 150]
    level = whole.means[(labels == 1) & (whole.opacities > 0.5)].astype(np.float64)
    top = float(np.median(level[:, 2]))
    level = level[np.abs(level[:, 2] - top) < 0.03 * np.ptp(level[:, :2], axis=0).max()]
    others = whole.means[labels > 1].astype(np.float64)
    made = 0
    for group in rng.permutation(objects).tolist() * 4:
        own = whole.take(labels == group)
        moved = _on_empty_place(own, level, others, top, rng)
        if moved is None:
            continue
        both = joined(whole, moved)
        kept = trained(both, np.arange(len(both)) >= len(whole), train)
        new = int(labels.max()) + 1
        all_labels = np.append(labels, np.full(len(moved), new, np.int32))
        name = f"{folder.name} object {group}, {made}"
        yield FillCase(name, both.take(kept), all_labels[kept], new, whole, train, test)
        made += 1
        if made == n_cases:
            return


def _true_labels(gaussians: Gaussians, root: Path, cameras: Sequence[Camera]) -> IntArray:
    truth = []
    for camera in cameras:
        found = read_labels(root / "gt" / "instance" / f"{Path(camera.name).stem}.png")
        rows = (np.arange(camera.height) * found.shape[0]) // camera.height
        columns = (np.arange(camera.width) * found.shape[1]) // camera.width
        truth.append(np.ascontiguousarray(found[np.ix_(rows, columns)], np.int32))
    votes = np.zeros((len(gaussians), int(max(t.max() for t in truth)) + 1), np.float32)
    for camera, found in zip(cameras, truth, strict=True):
        choose("cpu").vote(gaussians, camera, found, votes)
    return votes.argmax(axis=1).astype(np.int32)


def _on_empty_place(
    own: Gaussians,
    level: DoubleArray,
    others: DoubleArray,
    top: float,
    rng: np.random.Generator,
) -> Gaussians | None:
    """The object turned by chance about z on a bare place of the table; None without one."""
    solid = own.means[own.opacities > 0.3].astype(np.float64)
    foot = np.percentile(solid, [2, 98], axis=0)
    radius = float(np.linalg.norm((foot[1] - foot[0])[:2]) / 2)
    lo, hi = np.percentile(level[:, :2], [3, 97], axis=0)
    for _ in range(300):
        at = rng.uniform(lo, hi)
        if np.linalg.norm(others[:, :2] - at, axis=1).min() < 1.15 * radius:
            continue
        angles = np.arctan2(level[:, 1] - at[1], level[:, 0] - at[0])
        ring = np.abs(np.linalg.norm(level[:, :2] - at, axis=1) - radius) < 0.4 * radius
        sectors = np.histogram(angles[ring], 12, (-np.pi, np.pi))[0]
        if (sectors > 0).mean() < _EMPTY:
            continue
        turn = rng.uniform(0, 2 * np.pi)
        c, s = np.cos(turn), np.sin(turn)
        rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        middle = np.append(foot.mean(axis=0)[:2], foot[0, 2])
        target = np.append(at, top)
        means = (own.means - middle) @ rotation.T + target
        quats = multiply_quats(matrices_to_quats(rotation[None])[0], own.quats.astype(np.float64))
        return replace(own, means=means.astype(np.float32), quats=quats.astype(np.float32))
    return None
