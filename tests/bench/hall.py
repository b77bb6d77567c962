"""A hall of boxes of any size: many objects and views, masks with faults, a process of its own.

``python -m tests.bench.hall OBJECTS VIEWS [WIDTH HEIGHT] [PRESET]`` makes it, associates it and
prints one line of JSON. Boxes stand on a floor, a square of ground for each; a camera walks among
them and looks around. Masks are drawn box by box, far ones first, with faults: a box is cut in two
(the same way each time), melts with its neighbour, or is missed; what is few pixels large has no
mask. The floor has a mask, too. Splats lie on the boxes and on the floor, 480 for each box.
"""

import json
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, run_stage
from gaga_core.raster import choose
from tests.bench.figures import peak_mib

_ON_BOX, _ON_FLOOR = 400, 80  # splats of a box, and of the ground around it
SPLIT, MERGE, MISS = 0.15, 0.06, 0.1  # chance of each box in each view
_AROUND = 1.5  # scene units around the hall from which it is seen, too
_LEAST = 40  # pixels of a mask
_FAR = 10.0  # scene units beyond which boxes have no masks
_MATCH = 0.5  # IoU


@dataclass(frozen=True, eq=False)
class Hall:
    """Boxes 1..K on a floor; a box occupies [low, high]."""

    low: DoubleArray  # (K, 3)
    high: DoubleArray  # (K, 3)
    size: tuple[int, int]  # squares of ground along x and y
    gaussians: Gaussians
    labels: IntArray  # (N,) box of each splat, 0 = floor


@dataclass(frozen=True)
class Cost:
    """What one run took, and how good the groups are."""

    objects: int
    views: int
    masks: int
    cpu_s: float  # of the association
    peak_mib: float  # of the process
    precision: float  # share of the groups of boxes that are one box (IoU > 0.5)
    recall: float  # share of the boxes that are one group
    parts: dict[str, float]  # CPU seconds by what the progress said


def hall(n_boxes: int, seed: int = 0) -> Hall:
    """The hall of one seed."""
    rng = np.random.default_rng(seed)
    columns = int(np.ceil(np.sqrt(n_boxes * 1.6)))
    rows = -(-n_boxes // columns)
    place = np.stack(np.divmod(np.arange(n_boxes), columns)[::-1], axis=1) + 0.5
    middle = place + rng.uniform(-0.12, 0.12, (n_boxes, 2))
    half = rng.uniform(0.17, 0.34, (n_boxes, 2))
    low = np.c_[middle - half, np.zeros(n_boxes)]
    high = np.c_[middle + half, rng.uniform(0.25, 0.9, n_boxes)]
    points, thin = _on_boxes(low, high, rng)
    floor = np.zeros((n_boxes * _ON_FLOOR, 3))
    floor[:, :2] = rng.uniform(0, 1, (len(floor), 2)) * (columns, rows)
    n, n_box = len(points) + len(floor), len(points)
    scales = np.full((n, 3), np.log(0.045), np.float32)
    scales[n_box:] = np.log(0.075)
    scales[np.arange(n), np.append(thin, np.full(len(floor), 2))] = np.log(0.006)
    gaussians = Gaussians(
        means=np.concatenate([points, floor]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=scales,
        logit_opacities=np.full(n, 3.0, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )
    labels = np.zeros(n, np.int32)
    labels[:n_box] = np.repeat(np.arange(1, n_boxes + 1), _ON_BOX)
    return Hall(low, high, (columns, rows), gaussians, labels)


def _on_boxes(
    low: DoubleArray, high: DoubleArray, rng: np.random.Generator
) -> tuple[DoubleArray, IntArray]:
    """Points on the sides and tops, evenly by area, and the axis (N,) that they are thin along."""
    size = high - low
    area = np.stack([size[:, 1] * size[:, 2], size[:, 0] * size[:, 2], size[:, 0] * size[:, 1] / 2])
    share = np.cumsum(area / area.sum(axis=0), axis=0).T
    box = np.repeat(np.arange(len(low)), _ON_BOX)
    axis = (rng.uniform(size=len(box))[:, None] > share[box]).sum(axis=1).clip(0, 2)
    at = rng.uniform(size=(len(box), 3))
    at[np.arange(len(box)), axis] = np.where(axis == 2, 1, at[np.arange(len(box)), axis] > 0.5)
    return low[box] + at * size[box], axis.astype(np.int32)


def cameras(scene: Hall, n: int, size: tuple[int, int], seed: int = 1) -> tuple[Camera, ...]:
    """Cameras all over the hall that look at boxes some squares away."""
    rng = np.random.default_rng(seed)
    K = np.array([[0.7 * size[0], 0, size[0] / 2], [0, 0.7 * size[0], size[1] / 2], [0, 0, 1]])
    # Evenly over the ground: the sequence of Roberts, 2018.
    even = (rng.uniform(size=2) + np.outer(np.arange(n), (0.7548776662, 0.5698402910))) % 1
    ground = even * (np.array(scene.size) + 2 * _AROUND) - _AROUND
    eyes = np.c_[ground, rng.uniform(2.6, 4.0, n)]
    found = []
    for i, eye in enumerate(eyes):
        # Towards the middle of the hall from its border, anywhere from its middle.
        inner = rng.uniform(0.15, 0.85, 2) * scene.size
        way = inner - eye[:2]
        way *= rng.uniform(2.0, 4.5) / max(float(np.linalg.norm(way)), 1e-6)
        target = np.array([*(eye[:2] + way), 0.3])
        pose = look_at(eye, target, np.array([0, 0, 1.0]))
        found.append(Camera(K, pose, *size, f"{i:05d}.png"))
    return tuple(found)


def draw_masks(scene: Hall, camera: Camera, rng: np.random.Generator) -> IntArray:
    """The label map (H, W) of a segmenter that errs, under ids of this view."""
    n = len(scene.low)
    fault = rng.uniform(size=n)
    ids = rng.permutation(2 * n + 1).astype(np.int64) + 1
    of_box, of_half = ids[:n].copy(), ids[n : 2 * n]
    melts = np.flatnonzero(fault < MERGE)
    of_box[melts] = of_box[np.maximum(melts - 1, 0)]
    missed = (fault >= MERGE) & (fault < MERGE + MISS)
    is_split = (fault >= MERGE + MISS) & (fault < MERGE + MISS + SPLIT)
    middle = (scene.low + scene.high) / 2
    distance = np.linalg.norm(middle - camera.position, axis=1)
    of_box[missed | (distance > _FAR)] = 0
    picture = Image.new("I", (camera.width, camera.height), 0)
    pen = ImageDraw.Draw(picture)
    _draw_floor(scene, camera, pen, int(ids[-1]))
    z = camera.project(middle)[1]
    for k in np.argsort(-distance):
        if z[k] < 0.3:
            continue
        halves = [(scene.low[k], scene.high[k], of_box[k])]
        if is_split[k] and of_box[k]:
            cut = scene.low[k, 0] + 0.5 * (scene.high[k, 0] - scene.low[k, 0])
            left, right = scene.high[k].copy(), scene.low[k].copy()
            left[0] = right[0] = cut
            halves = [(scene.low[k], left, of_box[k]), (right, scene.high[k], of_half[k])]
            if camera.position[0] < cut:  # the farther half first
                halves.reverse()
        for low, high, label in halves:
            _draw_box(low, high, camera, pen, int(label))
    drawn = np.asarray(picture).astype(np.int32)
    values, dense, counts = np.unique(drawn, return_inverse=True, return_counts=True)
    values[counts < _LEAST] = 0
    return values[dense].reshape(drawn.shape).astype(np.int32)


def _draw_floor(scene: Hall, camera: Camera, pen: ImageDraw.ImageDraw, label: int) -> None:
    """The ground up to `_FAR`, square by square."""
    x, y = np.meshgrid(np.arange(scene.size[0]), np.arange(scene.size[1]))
    squares = np.stack([x.ravel(), y.ravel()], axis=1)
    near = np.linalg.norm(squares + 0.5 - camera.position[:2], axis=1) < _FAR
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    for square in squares[near]:
        points = np.c_[square + corners, np.zeros(4)]
        pixels, z = camera.project(points)
        if (z > 0.1).all():
            pen.polygon([tuple(p) for p in pixels.tolist()], fill=label)


_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (1, 3, 7, 5))


def _draw_box(
    low: DoubleArray, high: DoubleArray, camera: Camera, pen: ImageDraw.ImageDraw, label: int
) -> None:
    """All faces of a box; which of them are seen does not matter for its outline."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    pixels, z = camera.project(low + corners * (high - low))
    if (z < 0.1).any():
        return
    for face in _FACES:
        pen.polygon([tuple(pixels[c].tolist()) for c in face], fill=label)


def _load(path: Path) -> IntArray:
    return np.load(path).astype(np.int32)


def score(labels: IntArray, truth: IntArray, n_boxes: int) -> tuple[float, float]:
    """Precision and recall of groups as boxes. The floor is void: its splats are left out, and so
    are groups that hold hardly any others."""
    width = int(labels.max(initial=0)) + 1
    cells = np.bincount(truth.astype(np.int64) * width + labels, minlength=(n_boxes + 1) * width)
    table = cells.reshape(n_boxes + 1, width)[1:]
    sizes = table.sum(axis=0)
    iou = table[:, 1:] / (table.sum(axis=1)[:, None] + sizes[1:] - table[:, 1:])
    groups = sizes[1:] >= 20
    return float((iou[:, groups] > _MATCH).any(axis=0).mean()), float((iou > _MATCH).any(1).mean())


def associate_hall(
    n_boxes: int, n_views: int, size: tuple[int, int], preset: str, folder: Path
) -> Cost:
    """Make the hall, draw its masks into ``folder`` and associate them."""
    scene = hall(n_boxes)
    views = cameras(scene, n_views, size)

    def draw(i: int) -> IntArray:
        return draw_masks(scene, views[i], np.random.default_rng((2, i)))

    return associate_views(scene.gaussians, scene.labels, views, draw, preset, folder)


def associate_views(
    gaussians: Gaussians,
    truth: IntArray,  # (N,) object 1.. of each splat, 0 = void
    views: Sequence[Camera],
    draw: Callable[[int], IntArray],  # the label map (H, W) of the i-th view
    preset: str,
    folder: Path,  # where label maps are kept
) -> Cost:
    """Associate the masks of all views; the objects are the labels of the truth."""
    n_masks = 0
    for i, camera in enumerate(views):
        labels = draw(i)
        values, dense = np.unique(labels, return_inverse=True)
        n_masks += int((values > 0).sum())
        ids = dense.reshape(labels.shape) + (values[0] > 0)
        np.save(folder / f"{camera.name}.npy", ids.astype(np.uint16))
    masks = MaskSet({c.name: partial(_load, folder / f"{c.name}.npy") for c in views}, "bench")
    parts: dict[str, float] = defaultdict(float)
    last, kind = time.process_time(), "start"

    def watch(step: Progress) -> None:
        nonlocal last, kind
        now = time.process_time()
        parts[kind] += now - last
        last, kind = now, _kind(step.message)

    config, start = AssociateConfig.of(preset), time.process_time()
    found = run_stage(associate_stage(gaussians, views, masks, choose("cpu"), config), watch)
    parts[kind] += time.process_time() - last
    cpu_s = time.process_time() - start
    n_objects = int(truth.max())
    precision, recall = score(found.labels, truth, n_objects)
    return Cost(
        objects=n_objects,
        views=len(views),
        masks=n_masks,
        cpu_s=cpu_s,
        peak_mib=peak_mib(),
        precision=precision,
        recall=recall,
        parts={name: round(value, 2) for name, value in parts.items()},
    )


def _kind(message: str) -> str:
    """What a message of the progress is about, without its numbers."""
    words = [word for word in message.replace(":", " ").split() if not any(map(str.isdigit, word))]
    return " ".join(words) or "a view"


if __name__ == "__main__":
    words = sys.argv[1:]
    picture = (int(words[2]), int(words[3])) if len(words) > 3 else (480, 360)
    with tempfile.TemporaryDirectory() as name:
        cost = associate_hall(
            int(words[0]),
            int(words[1]),
            picture,
            words[-1] if len(words) in (3, 5) else "robust",
            Path(name),
        )
    sys.stdout.write(json.dumps(asdict(cost)) + "\n")
