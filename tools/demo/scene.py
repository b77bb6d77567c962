"""The demo scene: what stands where, its splats, its cameras, and masks of its views.

Every surface is a parametric patch; discs are laid on it in staggered rows; light is baked into
them; photos and masks are then made from the splats, so that poses, truth and model agree.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at, matrices_to_quats
from gaga_core.masks import dense_labels
from tools.demo import objects
from tools.demo.lighting import Lights, bake
from tools.demo.objects import BACK, FRONT, LEFT, RIGHT, TABLE_TOP, TOP, rgb
from tools.demo.shapes import Coordinates, Item, Part, Surface, cover, joined, moved, pose

TEAL, MUSTARD, RUST = rgb("2f6f7d"), rgb("d9a441"), rgb("b9553a")
NAVY, SAGE, PLUM = rgb("2e4560"), rgb("8a9a6b"), rgb("7a4a5c")
_SHELF = (-0.30, BACK - 0.012, 1.42)


def items() -> list[Item]:
    """All objects; the first is the table."""
    return [*_furniture(), *_breakfast(), *_fruit(), *_left_end(), *_shelf()]


def _item(name: str, found: list[Part], at: Coordinates, yaw: float = 0.0, **turn: float) -> Item:
    return Item(name, tuple(found), pose(at, yaw=yaw, **turn))


def _on_table(name: str, found: list[Part], x: float, y: float, yaw: float = 0.0) -> Item:
    return _item(name, found, (x, y, TABLE_TOP + 0.001), yaw)


def _furniture() -> list[Item]:
    walnut = rgb("6b4a30")
    dusk = objects.picture(0.62, 0.46, objects.landscape(rgb("eeb98a"), rgb("7f9db0"), 3), walnut)
    dawn = objects.picture(0.40, 0.52, objects.landscape(rgb("f0d9a8"), rgb("c98a7a"), 11), walnut)
    return [
        _item("table", objects.table(), (0, 0, 0)),
        _item("rug", objects.rug(), (0.05, -0.15, 0.001)),
        _item("chair", objects.chair(TEAL), (1.13, 0.10, 0.014), 116),
        _item("chair", objects.chair(TEAL), (-1.03, 0.08, 0.014), -97),
        _item("picture of hills at dusk", dusk, (0.78, BACK - 0.016, 1.50)),
        _item("picture of hills at dawn", dawn, (LEFT + 0.016, -0.15, 1.42), 90),
        _item("wall clock", objects.clock(), (1.46, BACK - 0.002, 1.62)),
        _item("plant pot", objects.pot(rgb("c07a55")), (1.42, 0.82, 0.001)),
        _item("rubber plant", objects.rubber_plant(), (1.42, 0.82, 0.26)),
    ]


def _breakfast() -> list[Item]:
    mug = objects.mug(TEAL) + objects.tea(0.0372, 0.078)
    plate = objects.plate(rgb("f4ecdb"), TEAL)
    pink = objects.doughnut(rgb("ec9aa6"), 1)
    return [
        _on_table("table runner", objects.runner(0.46, 0.86, 0.004), 0.02, 0.0),
        _on_table("teapot", objects.teapot(RUST), -0.15, 0.03, 12),
        _on_table("mug", mug, -0.27, -0.19, -150),
        _on_table("mug", mug, 0.03, -0.15, -35),
        _on_table("mug", mug, 0.64, -0.04, -70),
        _on_table("plate", plate, 0.17, -0.29),
        _on_table("plate", plate, 0.49, -0.27),
        _item("doughnut", pink, (0.17, -0.29, TABLE_TOP + 0.013), 20),
        _item("doughnut", objects.doughnut(rgb("5b3622"), 5), (0.49, -0.27, TABLE_TOP + 0.013), 70),
        _on_table("vase", objects.vase(rgb("4f6f86")), 0.10, 0.21),
        _item("flowers", objects.bouquet(), (0.10, 0.21, TABLE_TOP + 0.225)),
        _on_table("oil bottle", objects.bottle(rgb("3f5a2a")), 0.64, 0.27),
        _on_table("candle", objects.candle(rgb("f1e6cc"), 0.13), -0.29, 0.17),
        _on_table("candle", objects.candle(rgb("f1e6cc"), 0.13), -0.22, 0.31),
    ]


def _fruit() -> list[Item]:
    x, y, z = 0.40, 0.05, TABLE_TOP
    red = objects.apple(rgb("c0322b"), rgb("e9b84a"), 2)
    green = objects.apple(rgb("b9a83a"), rgb("9dbb4a"), 7)
    return [
        _on_table("fruit bowl", objects.bowl(NAVY), x, y),
        _item("apple", red, (x - 0.062, y - 0.045, z + 0.044), 30, tilt=12),
        _item("apple", red, (x - 0.050, y + 0.058, z + 0.046), 200, tilt=-9),
        _item("green apple", green, (x + 0.058, y + 0.060, z + 0.046), 80, roll=14),
        _item("orange", objects.orange(1), (x + 0.045, y - 0.052, z + 0.046), 10, roll=20),
        _item("orange", objects.orange(1), (x + 0.002, y + 0.004, z + 0.090), 120, tilt=-15),
        _item("lemon", objects.lemon(3), (x - 0.26, y + 0.12, z + 0.001), 35),
        _item("bananas", objects.bananas(), (x - 0.02, y + 0.30, z + 0.003), -12),
    ]


def _left_end() -> list[Item]:
    x, y, z = -0.53, -0.17, TABLE_TOP + 0.001
    die = objects.die(rgb("f3ecdc"), rgb("8e2f2a"))
    lowest = objects.book((0.17, 0.24, 0.036), PLUM, objects.GOLD, 1)
    middle = objects.book((0.155, 0.22, 0.028), SAGE, rgb("efe3c8"), 2)
    uppermost = objects.book((0.13, 0.19, 0.024), MUSTARD, NAVY, 3)
    return [
        _on_table("table lamp", objects.lamp(TEAL, rgb("f3dfb8")), -0.54, 0.22),
        _item("book", lowest, (x, y, z), 78),
        _item("book", middle, (x + 0.01, y, z + 0.036), 98),
        _item("book", uppermost, (x, y + 0.005, z + 0.064), 70),
        _on_table("die", die, -0.30, -0.345, 25),
        _item("die", moved(die, pose((0, 0, 0.036), roll=90)), (-0.225, -0.34, z - 0.018), 60),
    ]


def _shelf() -> list[Item]:
    x, y, z = _SHELF
    found = [_item("wall shelf", objects.shelf(), _SHELF)]
    row = [
        ((0.15, 0.215, 0.034), NAVY, objects.GOLD),
        ((0.14, 0.23, 0.026), RUST, rgb("efe3c8")),
        ((0.15, 0.205, 0.040), TEAL, rgb("efe3c8")),
        ((0.13, 0.19, 0.024), MUSTARD, NAVY),
    ]
    at = x - 0.42
    for k, (size, cloth, accent) in enumerate(row):
        upright = objects.book(size, cloth, accent, 10 + k)
        where = (at, y - 0.018 - size[0] / 2, z + 0.001 + size[1] / 2)
        found.append(_item("book", upright, where, 90, roll=90))
        at += size[2] + 0.003
    small = objects.pot(rgb("e6dcc6"), 0.29)
    found += [
        _item("small pot", small, (x - 0.17, y - 0.10, z + 0.001)),
        _item("cactus", objects.cactus(), (x - 0.17, y - 0.10, z + 0.074)),
        _item("globe", objects.globe(), (x + 0.08, y - 0.105, z + 0.001), 200),
    ]
    for dx, dz, yaw, color in ((0.25, 0, 8, RUST), (0.315, 0, -6, TEAL), (0.28, 0.05, 22, MUSTARD)):
        at_block = (x + dx, y - 0.09, z + 0.001 + dz)
        found.append(_item("toy block", objects.block(color), at_block, yaw))
    return found


SPREAD = 0.66  # standard deviation of a splat, in steps to the next disc
_ROOM_SPREAD = 0.85  # walls are plain: rather smooth than crisp
_THICKNESS = 0.12  # of the smaller one in the plane


def gaussians_of(surface: Surface, sh: FloatArray, rng: np.random.Generator) -> Gaussians:
    """Flat splats in the surface's plane, nearly opaque."""
    n = len(surface)
    across = np.cross(surface.normals, surface.tangents)
    axes = np.stack([surface.tangents, across, surface.normals], axis=2)
    in_plane = np.clip(surface.sizes, 0.0012, None)
    in_plane *= np.where(surface.labels == 0, _ROOM_SPREAD, SPREAD)[:, None]
    # No splat is much longer than wide by accident of a patch's corner.
    in_plane = np.minimum(in_plane, 3.5 * in_plane.min(axis=1, keepdims=True))
    thick = np.maximum(_THICKNESS * in_plane.min(axis=1), 2e-4)
    opacity = rng.uniform(0.970, 0.992, n)
    return Gaussians(
        means=surface.points.astype(np.float32),
        quats=matrices_to_quats(axes).astype(np.float32),
        log_scales=np.log(np.column_stack([in_plane, thick])).astype(np.float32),
        logit_opacities=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh=np.ascontiguousarray(sh, np.float32),
    )


_N_AT_ONE = 147_000  # splats at coarseness 1; their number falls with its square
_FINE_EDGES = 1.9  # ... nearly: discs at bends and edges grow fewer more slowly


@dataclass(frozen=True, eq=False)
class Model:
    """Splats with the truth about them."""

    gaussians: Gaussians
    labels: IntArray  # (N,) object of each splat: 1.., 0 = floor and walls
    names: tuple[str, ...]  # of objects 1..


def build(
    n_splats: int,
    seed: int,
    *,
    without: Container[int] = (),
    stands: Sequence[Item] | None = None,
) -> Model:
    """Build about ``n_splats`` splats of ``stands``: by default of all ``items``.

    ``without``: ids of objects to leave out; all others stand where they stand with them, in light
    that nothing of these keeps off.
    """
    rng = np.random.default_rng((seed, 0))
    coarseness = (_N_AT_ONE / n_splats) ** (1 / _FINE_EDGES)
    found = items() if stands is None else stands
    surfaces = [objects.shell(coarseness, rng)]
    surfaces += [cover(item, k, coarseness, rng) for k, item in enumerate(found, start=1)]
    surface = joined([part for k, part in enumerate(surfaces) if k not in without])
    gaussians = gaussians_of(surface, bake(surface, Lights(), rng), rng)
    return Model(gaussians, surface.labels, tuple(item.name for item in found))


OVERVIEW = ((0.75, -2.05, 1.62), (0.02, 0.05, 0.93), 42.0)  # eye, target, field of view (degrees)
_GOLDEN = 0.6180339887498949
_UP = np.array([0.0, 0.0, 1.0])


def posed(
    eye: tuple[float, float, float],
    target: tuple[float, float, float],
    fov: float,
    size: tuple[int, int],
    name: str = "",
) -> Camera:
    """Camera with vertical field of view ``fov`` (degrees) and ``size`` (width, height)."""
    width, height = size
    focal = 0.5 * height / np.tan(np.radians(fov) / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(K, look_at(np.array(eye), np.array(target), _UP), width, height, name)


def photo_cameras(n: int, size: tuple[int, int], rng: np.random.Generator) -> tuple[Camera, ...]:
    """``n`` cameras named ``view_000.jpg`` ...: the overview, then a sweep from the left wall round
    the front to the back wall. Height and distance walk by the golden ratio, so that neighbours
    differ; every camera stands inside the room's open side and looks at the table."""
    eye, target, fov = OVERVIEW
    found = [posed(eye, target, fov + 6, size, "view_000.jpg")]
    for k in range(n - 1):
        azimuth = np.radians(-124 + 146 * (k + 0.5) / (n - 1))
        distance = 1.35 + 0.75 * ((k * _GOLDEN) % 1.0)
        height = 1.02 + 1.0 * ((k * _GOLDEN * _GOLDEN + 0.35) % 1.0)
        place = (distance * np.cos(azimuth), distance * np.sin(azimuth), height)
        aim = rng.uniform((-0.22, -0.08, 0.78), (0.28, 0.16, 1.00))
        look = (float(aim[0]), float(aim[1]), float(aim[2]))
        found.append(posed(place, look, 50.0, size, f"view_{k + 1:03d}.jpg"))
    return tuple(found)


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
    low, high = (LEFT, FRONT, 0.0), (RIGHT, BACK, TOP)
    parts = np.zeros(rays[0].shape, np.int32)
    for part, axis, level in ((1, 2, 0.0), (2, 1, BACK), (3, 0, LEFT)):
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
    return same[things]


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
    return (level - 1).astype(np.int32)


def _ragged(mask: BoolArray, outwards: IntArray) -> BoolArray:
    once = _grown(mask)
    less = ~_grown(~mask)
    return np.choose(outwards + 1, [less, mask, once, _grown(once)])


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
