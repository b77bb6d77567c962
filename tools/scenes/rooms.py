"""Three kinds of benchmark scene with known groups, each another one for every seed.

"room": boxes, balls, cylinders and stacks of them, scattered on the floor and on tables of the
demo's empty room, seen from anywhere in its open half. "table": the objects of the demo, most of
them in another place and some left out, seen by a sweep of cameras. "contents": bowls of fruit,
rows of books, chairs, seen as a room. What the pictures show and what
is associated are two models: the truth is a fine one, the splats under test are a coarse one with
noise and floaters, so that true labels on them do not score 1 either. Masks have faults of the
strength of Segment Anything: 30 % of the segments split, 12 % merged with a neighbour, 10 % missed,
ragged edges (`tools.demo.scene`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.masks import MaskSet
from gaga_core.raster import choose
from tools.demo import objects
from tools.demo.objects import BACK, FRONT, LEFT, RIGHT, TOP, plain, rgb, shell
from tools.demo.scene import (
    Faults,
    gaussians_of,
    items,
    photo_cameras,
    posed,
    room_parts,
    segmenter_masks,
)
from tools.demo.shapes import (
    ALL_FACES,
    Item,
    Material,
    Part,
    Surface,
    box,
    cover,
    ellipsoid,
    joined,
    pose,
    revolve,
    rounded_box,
)

Kind = Literal["room", "table", "contents"]
FAULTS = Faults(split=0.30, merge=0.12, miss=0.10)
_FINISH = Material(plain((0.6, 0.55, 0.5)))
_FLOATERS = 0.025  # of the splats under test


@dataclass(frozen=True, eq=False)
class Bench:
    """A scene under test."""

    gaussians: Gaussians  # coarse, with floaters
    labels: IntArray  # (N,) true group: objects 1..K, floor and walls K + 1.., floaters 0
    train: tuple[Camera, ...]
    test: tuple[Camera, ...]
    masks: MaskSet  # of the train views
    truth: dict[str, IntArray]  # true label map (H, W) of every view


def bench_scene(
    kind: Kind,
    seed: int,
    *,
    n_splats: int = 40_000,
    n_train: int = 28,
    n_test: int = 8,
    size: tuple[int, int] = (320, 240),
    faults: Faults = FAULTS,
) -> Bench:
    """The scene of one seed: everything in it is drawn from (kind, seed)."""
    stream = get_args(Kind).index(kind)
    rng = np.random.default_rng((seed, stream, 0))
    things = _ITEMS[kind](rng)
    fine = surface_of(things, 2.5 * n_splats, np.random.default_rng((seed, stream, 1)))
    coarse = surface_of(things, n_splats, np.random.default_rng((seed, stream, 2)))
    gaussians, labels = splats_under_test(
        coarse, len(things), np.random.default_rng((seed, stream, 3))
    )
    cameras = cameras_of(kind, n_train + n_test, size, rng)
    true_model = grey_splats(fine, rng)
    truth, segments = {}, {}
    for k, camera in enumerate(cameras):
        shown = choose("cpu").label_splat(true_model, camera, fine.labels).labels
        parts = room_parts(camera)
        truth[camera.name] = np.where(shown > 0, shown, np.where(parts > 0, len(things) + parts, 0))
        truth[camera.name] = truth[camera.name].astype(np.int32)
        segments[camera.name] = segmenter_masks(
            shown, camera, np.random.default_rng((seed, stream, 4, k)), faults
        )
    test = set(rng.permutation(len(cameras))[:n_test].tolist())
    train = tuple(c for k, c in enumerate(cameras) if k not in test)
    masks = MaskSet({c.name: partial(segments.__getitem__, c.name) for c in train}, "bench masks")
    held_out = tuple(c for k, c in enumerate(cameras) if k in test)
    return Bench(gaussians, labels, train, held_out, masks, truth)


def surface_of(things: Sequence[Item], n_splats: float, rng: np.random.Generator) -> Surface:
    """Discs of room and objects, about ``n_splats`` of them."""
    probe = sum(len(cover(item, 1, 3.0, rng)) for item in things) + len(shell(3.0, rng))
    coarseness = 3.0 * (probe / n_splats) ** (1 / 1.9)
    found = [shell(coarseness, rng)]
    found += [cover(item, k, coarseness, rng) for k, item in enumerate(things, start=1)]
    return joined(found)


def grey_splats(surface: Surface, rng: np.random.Generator) -> Gaussians:
    """Grey splats: color plays no part in association."""
    return gaussians_of(surface, np.zeros((len(surface), 1, 3), np.float32), rng)


def splats_under_test(
    surface: Surface, n_things: int, rng: np.random.Generator
) -> tuple[Gaussians, IntArray]:
    """Splats as training leaves them: off the surface by a part of their size, opacities of all
    kinds, floaters; and their true labels, where the room's parts have labels of their own."""
    exact = grey_splats(surface, rng)
    n, n_floaters = len(surface), round(_FLOATERS * len(surface))
    jitter = rng.normal(0, 0.35, (n, 3)) * np.exp(exact.log_scales[:, :2]).mean(axis=1)[:, None]
    logits = np.clip(rng.normal(2.5, 1.5, n), -1.5, 5).astype(np.float32)
    moved = replace(exact, means=(exact.means + jitter).astype(np.float32), logit_opacities=logits)
    gaussians = moved.take(np.concatenate([np.arange(n), rng.integers(0, n, n_floaters)]))
    low, high = (LEFT, FRONT, 0.05), (RIGHT, BACK, TOP)
    gaussians.means[n:] = rng.uniform(low, high, (n_floaters, 3))
    gaussians.logit_opacities[n:] = -1
    labels = np.where(surface.labels > 0, surface.labels, n_things + _wall_of(surface.points))
    return gaussians, np.concatenate([labels, np.zeros(n_floaters)]).astype(np.int32)


def _wall_of(points: DoubleArray) -> IntArray:
    """1 floor, 2 back wall, 3 left wall: the nearest one, as `room_parts` numbers them."""
    x, y, z = points.T
    away = np.stack([np.abs(z), np.abs(y - BACK), np.abs(x - LEFT)])
    return (away.argmin(axis=0) + 1).astype(np.int32)


def cameras_of(
    kind: Kind, n: int, size: tuple[int, int], rng: np.random.Generator
) -> tuple[Camera, ...]:
    """Named in no order along their way: photos of a collection, not of a film."""
    names = [f"view_{k:03d}.jpg" for k in rng.permutation(n)]
    if kind == "table":
        sweep = photo_cameras(n, size, rng)
        return tuple(replace(c, name=name) for c, name in zip(sweep, names, strict=True))
    found = []
    for name in names:
        azimuth, distance = rng.uniform(np.radians(-130), np.radians(25)), rng.uniform(0.9, 2.3)
        eye = (distance * np.cos(azimuth), distance * np.sin(azimuth), rng.uniform(0.7, 2.0))
        x, y, z = rng.uniform((-1.1, -0.9, 0.0), (1.1, 0.9, 0.7))
        found.append(posed(eye, (x, y, z), 50.0, size, name))
    return tuple(found)


def _table_items(rng: np.random.Generator) -> list[Item]:
    """The demo's objects; of those on the table some are missing and all stand elsewhere."""
    found = []
    for item in items():
        on_table = 0.7 < item.matrix[2, 3] < 1.0 and abs(item.matrix[0, 3]) < 0.8
        if on_table and rng.random() < 0.15:
            continue
        matrix = item.matrix.copy()
        if on_table:
            matrix[:2, 3] += rng.uniform(-0.06, 0.06, 2)
        found.append(replace(item, matrix=matrix))
    return found


def _room_items(rng: np.random.Generator) -> list[Item]:
    """Two tables, and boxes, balls and cylinders on them and on the floor, often in contact."""
    tops: list[tuple[float, float, float, float]] = []  # x, y, half size, height
    found: list[Item] = []
    for x, y in ((-0.75, 0.45), (0.75, 0.35)):
        height, half = rng.uniform(0.35, 0.6), rng.uniform(0.38, 0.5)
        at = (x + rng.uniform(-0.1, 0.1), y + rng.uniform(-0.1, 0.1), height / 2)
        found.append(solid("box", (2 * half, 2 * half, height), at, rng.uniform(-10, 10)))
        tops.append((at[0], at[1], 0.75 * half, height))
    tops += [(0.0, -0.6, 0.9, 0.0)] * 2
    standing: list[tuple[float, float, float, float]] = []  # x, y, radius, height of the foot
    for _ in range(int(rng.integers(32, 45))):
        size = rng.uniform(0.08, 0.24, 3)
        for _ in range(40):
            x, y, half, z = tops[int(rng.integers(len(tops)))]
            x, y = x + rng.uniform(-half, half), y + rng.uniform(-half, half)
            radius = 0.43 * float(size[:2].max())
            if all(np.hypot(x - a, y - b) > r + radius for a, b, r, foot in standing if foot == z):
                break
        standing.append((x, y, radius, z))
        shape = str(rng.choice(["box", "ball", "cylinder"]))
        found.append(solid(shape, size, (x, y, z + size[2] / 2), rng.uniform(0, 90)))
        if shape == "box" and rng.random() < 0.3:
            tops.append((x, y, 0.2 * min(size[0], size[1]), z + size[2]))
    return found


def solid(
    shape: str, size: Sequence[float] | DoubleArray, centre: tuple[float, float, float], yaw: float
) -> Item:
    """Return a box, a ball or a cylinder of a size (3,), metres, turned by ``yaw`` degrees."""
    a, b, c = (0.5 * float(s) for s in size)
    if shape == "ball":
        patches = [ellipsoid((a, b, c))]
    elif shape == "cylinder":
        patches = [revolve([(0, -c), (a, -c), (a, c), (0, c)], smooth=False)]
    else:
        patches = rounded_box((2 * a, 2 * b, 2 * c), 0.01)
    parts = tuple(Part(patch, _FINISH, (0.011, 0.011)) for patch in patches)
    return Item(shape, parts, pose(centre, yaw=yaw))


_CLOTH = ("2e4560", "b9553a", "2f6f7d", "d9a441", "8a9a6b", "7a4a5c")
_CHAIRS = ((-0.05, -0.45, 160.0), (1.0, -0.55, -150.0))  # x, y, yaw
_FRUIT_UP = 0.046  # height of their centres in the bowl


def contents_items(rng: np.random.Generator) -> list[Item]:
    """What is hard to tell apart: 2 tables, 2 chairs, 4 bowls with fruit, 4 rows of books.

    Fruit touches the bowl and other fruit, books of a row touch along their covers, and a chair has
    legs, a seat and a back. Nothing here took part in any choice of a threshold.
    """
    found = [
        Item("chair", tuple(objects.chair(rgb(_CLOTH[k]))), pose((x, y, 0.001), yaw=yaw))
        for k, (x, y, yaw) in enumerate(_CHAIRS)
    ]
    for x, y in ((-0.85, 0.35), (0.65, 0.4)):
        height = rng.uniform(0.4, 0.6)
        wood = box((1.1, 0.9, height), 0.01, Material(plain((0.6, 0.55, 0.5))), {ALL_FACES: 0.011})
        found.append(Item("table", tuple(wood), pose((x, y, height / 2))))
        for dx, dy in ((-0.32, -0.22), (0.3, -0.2)):
            found += _bowl(x + dx, y + dy, height + 0.001, rng)
        for dx in (-0.45, 0.05):
            found += _row(x + dx, y + 0.25, height + 0.001, rng)
    return found


def _bowl(x: float, y: float, z: float, rng: np.random.Generator) -> list[Item]:
    """A bowl with three or four apples and oranges around its middle."""
    n, start = int(rng.integers(3, 5)), rng.uniform(0, 360)
    color = rgb(str(rng.choice(_CLOTH)))
    found = [Item("bowl", tuple(objects.bowl(color)), pose((x, y, z)))]
    for k in range(n):
        angle = np.radians(start + 360 * k / n)
        at = (x + 0.066 * np.cos(angle), y + 0.066 * np.sin(angle), z + _FRUIT_UP)
        is_apple = rng.random() < 0.5
        fruit = objects.apple(rgb("c0322b"), rgb("e9b84a"), k) if is_apple else objects.orange(k)
        name = "apple" if is_apple else "orange"
        found.append(Item(name, tuple(fruit), pose(at, yaw=rng.uniform(0, 360))))
    return found


def _row(x: float, y: float, z: float, rng: np.random.Generator) -> list[Item]:
    """Four to six upright books, next to each other along x, spines to the front."""
    found = []
    for cloth in rng.permutation(_CLOTH)[: int(rng.integers(4, 7))]:
        size = (rng.uniform(0.13, 0.17), rng.uniform(0.19, 0.25), rng.uniform(0.028, 0.05))
        bound = objects.book(size, rgb(str(cloth)), objects.GOLD, int(rng.integers(100)))
        at = (x, y, z + size[1] / 2)
        found.append(Item("book", tuple(bound), pose(at, yaw=90, roll=90)))
        x += size[2] + 0.003
    return found


_ITEMS: Mapping[Kind, Callable[[np.random.Generator], list[Item]]] = {
    "room": _room_items,
    "table": _table_items,
    "contents": contents_items,
}
