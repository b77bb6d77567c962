"""A benchmark scene that still tells presets apart: many small objects, most of them of parts.

150 objects stand on tables and the floor of the demo's empty room, many in contact: jars with
lids, boxes with labels, lamps, stacks, and plain solids. Twenty views. Masks have the kinds of
faults that Segment Anything has, at the rates of `rooms.FAULTS`: an object comes as its parts (the
same ones in every view that splits it), all things on a table come as one mask with it, neighbours
melt, small things are missing. How easily an object falls into parts is its own trait, as it is for
a real segmenter, so a wrong split comes again in the next view. Truth is the whole object.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.color import dc_from_rgb
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.masks import MaskSet
from gaga_core.raster import choose
from tools.demo.scene import Faults, SimulatedMask, merged, painted, posed, room_parts, segments_of
from tools.demo.shapes import Item
from tools.scenes.rooms import Bench, bench_scene, grey_splats, solid, splats_under_test, surface_of

N_OBJECTS, N_TRAIN, N_TEST = 150, 20, 6
SIZE = (480, 360)  # pixels
_TABLES = ((-1.0, 0.75), (-0.1, 0.8), (0.85, 0.75), (-1.15, -0.1), (1.1, -0.1), (0.0, 0.05))
_FLOOR = ((-0.6, -0.85), (0.55, -0.85))


@dataclass(frozen=True)
class SamFaults:
    """How often a mask is not the object, per object and view."""

    parts: float = 0.30  # mean over objects: it comes as its parts
    trait: float = 3.0  # how much objects differ in that (Beta: smaller is more)
    wholes: float = 0.06  # of a table: it comes as one mask with all that stands on it
    merge: float = 0.12  # melts with a neighbour
    miss: float = 0.05  # not found, however large
    miss_small: float = 0.60  # ... and of a thing that is hardly a pixel wide
    small: float = 0.0006  # of the picture: where that has fallen to a third


@dataclass(frozen=True)
class Thing:
    """An object of parts."""

    parts: tuple[Item, ...]  # in the room
    support: int  # index of the thing that it stands on, -1 = floor


def parts_scene(seed: int, *, n_splats: int = 60_000, faults: SamFaults | None = None) -> Bench:
    """The scene of one seed; labels and truth are whole objects 1..150, then floor and walls."""
    f = faults or SamFaults()
    rng = np.random.default_rng((seed, 7, 0))
    things = objects_of(rng)
    parts = [part for thing in things for part in thing.parts]
    owner = np.array([0, *(k for k, t in enumerate(things, 1) for _ in t.parts)], np.int32)
    fine = surface_of(parts, 2.5 * n_splats, np.random.default_rng((seed, 7, 1)))
    coarse = surface_of(parts, n_splats, np.random.default_rng((seed, 7, 2)))
    coarse = replace(coarse, labels=owner[coarse.labels])
    gaussians, labels = splats_under_test(coarse, len(things), np.random.default_rng((seed, 7, 3)))
    cameras, true_model = _cameras(rng), grey_splats(fine, rng)
    trait = rng.beta(f.parts * f.trait, (1 - f.parts) * f.trait, len(things) + 1)
    truth, masks = {}, {}
    for k, camera in enumerate(cameras):
        shown = choose("cpu").label_splat(true_model, camera, fine.labels).labels
        room = room_parts(camera)
        whole = np.where(shown > 0, owner[shown], np.where(room > 0, len(things) + room, 0))
        truth[camera.name] = whole.astype(np.int32)
        view = View(shown, truth[camera.name], things, trait)
        masks[camera.name] = sam_masks(view, np.random.default_rng((seed, 7, 4, k)), f)
    test = set(rng.permutation(len(cameras))[:N_TEST].tolist())
    train = tuple(c for k, c in enumerate(cameras) if k not in test)
    held_out = tuple(c for k, c in enumerate(cameras) if k in test)
    own = MaskSet({c.name: partial(masks.__getitem__, c.name) for c in train}, "bench masks")
    return Bench(gaussians, labels, train, held_out, own, truth)


@dataclass(frozen=True, eq=False)
class View:
    """What a segmenter sees of a scene."""

    parts: IntArray  # (H, W) 1..P, 0 = none
    wholes: IntArray  # (H, W) true objects, then floor and walls
    things: Sequence[Thing]
    trait: DoubleArray  # (objects + 1,) how easily each falls into parts, 0..1


def sam_masks(view: View, rng: np.random.Generator, f: SamFaults) -> IntArray:
    """Label map (H, W) with ids 1..M in random order, 0 = none."""
    n = len(view.things)
    labels = _with_all_on_it(view, rng, f)
    labels = merged(labels, n, Faults(merge=f.merge), rng)
    found: list[SimulatedMask] = []
    for segment in segments_of(labels):
        share = segment.mask.sum() / labels.size
        if rng.random() < f.miss + f.miss_small * np.exp(-share / f.small):
            continue
        k = int(labels[segment.window][segment.mask][0])
        splits = k <= n and rng.random() < view.trait[k]
        found += _parts_of(segment, view.parts) if splits else [segment]
    return painted(found, labels.shape, Faults(), rng)


def _with_all_on_it(view: View, rng: np.random.Generator, f: SamFaults) -> IntArray:
    """True objects (H, W), where some tables took all that stands on them."""
    same = np.arange(int(view.wholes.max(initial=0)) + 1, dtype=np.int32)
    taken = {k for k in range(len(_TABLES)) if rng.random() < f.wholes}
    for k, thing in enumerate(view.things, start=1):
        if thing.support in taken and k < len(same):
            same[k] = thing.support + 1
    return same[view.wholes]


def _parts_of(segment: SimulatedMask, parts: IntArray) -> list[SimulatedMask]:
    """The segment as the parts that show in it; crumbs of them are lost."""
    inside = np.where(segment.mask, parts[segment.window], 0)
    found = [inside == k for k in np.unique(inside[inside > 0])]
    return [SimulatedMask(segment.window, mask) for mask in found if mask.sum() >= 4]


def _cameras(rng: np.random.Generator) -> tuple[Camera, ...]:
    """Photos of a collection: from anywhere in the open half, named in no order."""
    found = []
    for k in rng.permutation(N_TRAIN + N_TEST):
        azimuth, distance = rng.uniform(np.radians(-125), np.radians(15)), rng.uniform(1.6, 2.5)
        eye = (distance * np.cos(azimuth), distance * np.sin(azimuth), rng.uniform(1.0, 2.1))
        x, y, z = rng.uniform((-0.7, -0.3, 0.1), (0.7, 0.6, 0.5))
        found.append(posed(eye, (x, y, z), 55.0, SIZE, f"view_{k:03d}.jpg"))
    return tuple(found)


def objects_of(rng: np.random.Generator) -> list[Thing]:
    """Six tables, then small things on them and on the floor, until there are 150."""
    found, tops = [], []
    for k, (x, y) in enumerate(_TABLES):
        height, half = rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.36)
        item = solid("box", (2 * half, 2 * half, height), (x, y, height / 2), rng.uniform(-8, 8))
        found.append(Thing((item,), -1))
        tops.append((x, y, 0.85 * half, height, k))
    tops += [(x, y, 0.45, 0.0, -1) for x, y in _FLOOR]
    standing: list[tuple[int, float, float, float]] = []
    widest = 0.13
    while len(found) < N_OBJECTS:
        x0, y0, half, z, support = tops[int(rng.integers(len(tops)))]
        wide = rng.uniform(0.05, max(widest, 0.051))
        x, y = x0 + rng.uniform(-half, half), y0 + rng.uniform(-half, half)
        if all(k != support or np.hypot(x - a, y - b) > r + wide / 2 for k, a, b, r in standing):
            standing.append((support, x, y, wide / 2))
            found.append(Thing(_thing(wide, (x, y, z), rng), support))
            widest = 0.13
        else:  # it is full there: something smaller may fit
            widest *= 0.99
    return found


def _thing(
    wide: float, foot: tuple[float, float, float], rng: np.random.Generator
) -> tuple[Item, ...]:
    """One object, ``wide`` across, as solids on top of and on each other."""
    yaw = rng.uniform(0, 90)
    tall = wide * rng.uniform(0.7, 1.8)
    kind = str(rng.choice(["jar", "label", "lamp", "stack", "topped", "box", "ball", "cylinder"]))

    def at(shape: str, size: tuple[float, float, float], z: float, x: float = 0.0) -> Item:
        turn = np.radians(yaw)
        centre = (foot[0] + x * np.cos(turn), foot[1] + x * np.sin(turn), foot[2] + z)
        return solid(shape, size, centre, yaw)

    w = wide
    if kind == "jar":
        lid = 0.22 * tall
        return (
            at("cylinder", (w, w, tall), tall / 2),
            at("cylinder", (1.08 * w, 1.08 * w, lid), tall + lid / 2),
        )
    if kind == "label":
        slab = (0.01, 0.6 * w, 0.5 * tall)
        return at("box", (w, w, tall), tall / 2), at("box", slab, tall / 2, x=w / 2)
    if kind == "lamp":
        return (
            at("cylinder", (0.8 * w, 0.8 * w, 0.2 * w), 0.1 * w),
            at("cylinder", (0.25 * w, 0.25 * w, tall), 0.2 * w + tall / 2),
            at("ball", (w, w, 0.8 * w), 0.2 * w + tall + 0.35 * w),
        )
    if kind == "stack":
        rows = [(w, 0.3 * w), (0.8 * w, 0.35 * w), (0.6 * w, 0.3 * w)]
        feet = np.cumsum([0.0, *(h for _, h in rows)])
        return tuple(at("box", (a, a, h), z + h / 2) for (a, h), z in zip(rows, feet, strict=False))
    if kind == "topped":
        return at("box", (w, w, tall), tall / 2), at("ball", (0.6 * w,) * 3, tall + 0.28 * w)
    return (at(kind, (w, w, tall), tall / 2),)


PaintedKind = Literal["room", "table", "contents", "parts"]
PAINTED_KINDS: tuple[PaintedKind, ...] = get_args(PaintedKind)
_ROOM_PARTS = 3  # labels of floor and walls, after those of the objects
_N_TRAIN, _SIZE = 40, (480, 360)  # views; pixels


@dataclass(frozen=True, eq=False)
class Painted:
    """A scene with photos and truth."""

    gaussians: Gaussians  # in the colors of the photos
    labels: IntArray  # (N,) object 1.., 0 = room and floaters
    photos: Mapping[str, UInt8Array]  # (H, W, 3) of the train views
    train: tuple[Camera, ...]
    test: tuple[Camera, ...]
    truth: Mapping[str, IntArray]  # (H, W) of the test views, 0 = room


def painted_scene(kind: PaintedKind, seed: int) -> Painted:
    """The scene of one seed: rooms, tables and contents of 40 photos, objects of parts of 20."""
    made = (
        parts_scene(seed)
        if kind == "parts"
        else bench_scene(kind, seed, n_train=_N_TRAIN, size=_SIZE)
    )
    n_things = int(made.labels.max()) - _ROOM_PARTS
    labels = np.where(made.labels > n_things, 0, made.labels).astype(np.int32)
    colors = _colors(made.gaussians, labels, np.random.default_rng(seed))
    photos = {}
    for camera in made.train:
        image = choose("cpu").render(made.gaussians, camera, channels=colors).image
        photos[camera.name] = (np.clip(image, 0, 1) * 255).astype(np.uint8)
    truth = {c.name: made.truth[c.name] for c in made.test}
    objects = {name: np.where(t > n_things, 0, t).astype(np.int32) for name, t in truth.items()}
    painted = replace(made.gaussians, sh=np.ascontiguousarray(dc_from_rgb(colors)[:, None]))
    return Painted(painted, labels, photos, made.train, made.test, objects)


def _colors(gaussians: Gaussians, labels: IntArray, rng: np.random.Generator) -> FloatArray:
    """Colors (N, 3) by label, with stripes and light."""
    n = int(labels.max()) + 1
    one = rng.uniform(0.1, 0.9, (n, 3))
    two = np.clip(one + rng.normal(0, 0.2, (n, 3)), 0, 1)
    wave: DoubleArray = (gaussians.means * rng.uniform(10, 60, (n, 3))[labels]).sum(axis=1)
    thinnest = gaussians.log_scales.argmin(axis=1)
    normals = quats_to_matrices(gaussians.quats)[np.arange(len(labels)), :, thinnest]
    light = 0.45 + 0.55 * np.abs(normals @ np.array([0.3, -0.5, 0.8]))
    color = np.where(np.sin(wave)[:, None] > 0, one[labels], two[labels]) * light[:, None]
    return np.ascontiguousarray(color, dtype=np.float32)
