"""Masks of one view as a class-agnostic segmenter would give them, made from the true instances.

What a real one does wrong, view by view and without memory of other views: ids mean nothing, some
objects come in parts, some with a neighbour, some not at all, edges are ragged, crumbs are lost,
and walls and floor are segments like any other.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.demo import room
from gaga_core.masks import dense_labels


@dataclass(frozen=True)
class Faults:
    """How often what goes wrong, per segment and view."""

    split: float = 0.27  # comes as two or three parts
    merge: float = 0.10  # melts with a neighbour
    miss: float = 0.10  # not found
    crumb: float = 0.0002  # of the picture: smaller pieces are dropped
    smallest_split: float = 0.0012  # of the picture: smaller segments come in one piece


@dataclass(frozen=True, eq=False)
class SimulatedMask:
    """A mask inside a window of the picture, with some room around it."""

    window: tuple[slice, slice]  # rows, columns
    mask: BoolArray  # (h, w)


def segmenter_masks(
    truth: IntArray, camera: Camera, rng: np.random.Generator, faults: Faults | None = None
) -> IntArray:
    """Label map (H, W) with ids 1..M in random order, 0 = none, of true instances (H, W)."""
    f = faults or Faults()
    n_objects = int(truth.max(initial=0))
    parts = room_parts(camera)
    things = np.where(truth > 0, truth, np.where(parts > 0, n_objects + parts, 0))
    things = merged(things, n_objects, f, rng)
    found: list[SimulatedMask] = []
    for thing in segments_of(things):
        if rng.random() < f.miss:
            continue
        big = thing.mask.sum() > f.smallest_split * truth.size
        found += _parts(thing, rng) if big and rng.random() < f.split else [thing]
    return painted(found, truth.shape, f, rng)


def segments_of(things: IntArray) -> list[SimulatedMask]:
    """Each label of a map (H, W) as a mask, by id."""
    found = []
    for k, (rows, columns) in _windows(things):
        window = (
            slice(max(rows.start - 3, 0), rows.stop + 3),
            slice(max(columns.start - 3, 0), columns.stop + 3),
        )
        found.append(SimulatedMask(window, things[window] == k))
    return found


def _windows(labels: IntArray) -> list[tuple[int, tuple[slice, slice]]]:
    """Each label with the smallest window around it."""
    found = enumerate(ndimage.find_objects(labels), start=1)
    return [(k, (window[0], window[1])) for k, window in found if window is not None]


def room_parts(camera: Camera) -> IntArray:
    """Which part of the empty room each pixel (H, W) sees: 1 floor, 2 back wall, 3 left wall,
    0 outside. From the open side none hides another."""
    u = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    v = (np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    x, y, z = camera.cam_from_world[:3, :3].astype(np.float32)  # the camera's axes in the world
    rays = [u[None, :] * x[k] + v[:, None] * y[k] + z[k] for k in range(3)]
    low, high = (room.LEFT, room.FRONT, 0.0), (room.RIGHT, room.BACK, room.TOP)
    parts = np.zeros(rays[0].shape, np.int32)
    for part, axis, level in ((1, 2, 0.0), (2, 1, room.BACK), (3, 0, room.LEFT)):
        with np.errstate(divide="ignore"):
            distance = (level - camera.position[axis]) / rays[axis]
        hit = distance > 0
        for k in range(3):
            if k != axis:
                at = camera.position[k] + distance * rays[k]
                hit &= (at >= low[k]) & (at <= high[k])
        parts[hit] = part
    return parts


def merged(things: IntArray, n_objects: int, f: Faults, rng: np.random.Generator) -> IntArray:
    """The same map (H, W) where some objects took the id of the object they touch the most."""
    same = np.arange(things.max(initial=0) + 1, dtype=np.int32)
    taken: set[int] = set()
    for thing in segments_of(things):
        k = int(things[thing.window][thing.mask][0])
        if k > n_objects or k in taken or rng.random() >= f.merge:
            continue
        rim = ndimage.binary_dilation(thing.mask, iterations=2) & ~thing.mask
        around = things[thing.window][rim]
        around = around[(around > 0) & (around <= n_objects)]
        if len(around) == 0:
            continue
        other = int(np.bincount(around).argmax())
        if other not in taken:
            same[k] = other
            taken |= {k, other}
    result: IntArray = same[things]
    return result


def _parts(thing: SimulatedMask, rng: np.random.Generator) -> list[SimulatedMask]:
    """The segment cut by one or two straight lines near its middle; slivers are lost."""
    rows, columns = np.nonzero(thing.mask)
    v, u = np.mgrid[0 : thing.mask.shape[0], 0 : thing.mask.shape[1]]
    pieces = [thing.mask]
    for _ in range(1 + int(rng.random() < 0.35)):
        angle = rng.uniform(0, np.pi)
        at_u = columns.mean() + rng.normal(0, 0.35) * columns.std()
        at_v = rows.mean() + rng.normal(0, 0.35) * rows.std()
        side = (u - at_u) * np.cos(angle) + (v - at_v) * np.sin(angle) > 0
        pieces = [half for piece in pieces for half in (piece & side, piece & ~side)]
    return [SimulatedMask(thing.window, p) for p in pieces if p.sum() > 0.12 * len(rows)]


def painted(
    segments: list[SimulatedMask], shape: tuple[int, ...], f: Faults, rng: np.random.Generator
) -> IntArray:
    """Segments with ragged edges, painted over each other in random order, crumbs removed."""
    labels = np.zeros(shape, np.int32)
    outwards = _raggedness(shape, rng)
    for new_id, k in enumerate(rng.permutation(len(segments)), start=1):
        segment = segments[int(k)]
        labels[segment.window][_ragged(segment.mask, outwards[segment.window])] = new_id
    return _without_crumbs(labels, max(4, round(f.crumb * labels.size)))


def _raggedness(shape: tuple[int, ...], rng: np.random.Generator) -> IntArray:
    """By how much edges move outwards, pixel by pixel: -1 to 2, in patches of a few pixels."""
    rough: DoubleArray = ndimage.gaussian_filter(rng.normal(size=shape), 2.5)
    level = np.digitize(rough / rough.std(), [-0.6, 0.5, 1.2])
    result: IntArray = (level - 1).astype(np.int32)
    return result


def _ragged(mask: BoolArray, outwards: IntArray) -> BoolArray:
    once = _grown(mask)
    less = ~_grown(~mask)
    result: BoolArray = np.choose(outwards + 1, [less, mask, once, _grown(once)])
    return result


def _grown(mask: BoolArray) -> BoolArray:
    """The mask and its four-neighbours."""
    result = mask.copy()
    result[1:] |= mask[:-1]
    result[:-1] |= mask[1:]
    result[:, 1:] |= mask[:, :-1]
    result[:, :-1] |= mask[:, 1:]
    return result


def _without_crumbs(labels: IntArray, smallest: int) -> IntArray:
    """Pieces of a label that hang apart and are smaller than ``smallest`` pixels become 0; ids
    close up."""
    for k, window in _windows(labels):
        view = labels[window]
        pieces, n = ndimage.label(view == k)
        small = np.bincount(pieces.ravel(), minlength=n + 1) < smallest
        small[0] = False
        view[small[pieces]] = 0
    return dense_labels(labels)[0]
