"""Weights-free masks: how well they cover true objects, what a photo costs, what groups they make.

The demo scene is made here; ycb_table is read where it lies (GAGA_TEST_DATA) and left out where it
does not. Depth is rendered from the scene's splats. Best IoU: of each true object of each photo
with the region that covers it best, meaned over all.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.evaluate.group_scores import Score
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.io.folder.scene_folder import SceneFolder, read_model, select_views
from gaga_core.io.images import read_rgb
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.segmentation.regions import regions
from tests.bench.figures import Figure, median_ms
from tests.bench.known_scenes import held_out_score, known_scenes, true_labels

_STEP = 4  # every fourth photo
_BARS = {"ycb_table": {"color": ">= 0.62", "depth": ">= 0.70"}}


@dataclass(frozen=True, eq=False)
class _Photo:
    image: UInt8Array  # (H, W, 3)
    depth: FloatArray  # (H, W)
    truth: IntArray  # (H, W)


_SUPPORT = {"ycb_table": 1}  # the table is no object


def figures() -> list[Figure]:
    """Cover, cost and groups of each scene that is there."""
    found: list[Figure] = []
    for name, folder in known_scenes("demo", "ycb_table"):
        gaussians = run_stage(read_model(folder))
        photos = [_photo(folder, gaussians, camera) for camera in folder.cameras[::_STEP]]
        found += _covers(name, photos)
        found += _costs(name, photos[0])
        for kind in ("color", "depth"):
            score = _groups(folder, gaussians, with_depth=kind == "depth")
            title = f"regions: {name}, {kind}, robust groups"
            found.append(Figure(f"{title}, IoU", score.iou, ""))
            found.append(Figure(f"{title}, precision", score.precision, ""))
            found.append(Figure(f"{title}, recall", score.recall, ""))
    return found


def _photo(folder: SceneFolder, gaussians: Gaussians, camera: Camera) -> _Photo:
    nothing = np.zeros((len(gaussians), 1), np.float32)
    depth = choose("cpu").render(gaussians, camera, channels=nothing).median_depth
    image = read_rgb(folder.require_image(camera.name))
    return _Photo(image, depth, true_labels(folder, camera))


def _covers(scene: str, photos: list[_Photo]) -> list[Figure]:
    found = []
    for kind in ("color", "depth"):
        best = []
        for photo in photos:
            labels = regions(photo.image, photo.depth if kind == "depth" else None)
            best += _best_ious(photo.truth, labels, _SUPPORT.get(scene, 0))
        bar = _BARS.get(scene, {}).get(kind, "")
        found.append(Figure(f"regions: {scene}, {kind}, best IoU", float(np.mean(best)), "", bar))
    return found


def _best_ious(truth: IntArray, labels: IntArray, support: int) -> list[float]:
    """Best IoU of every true id > 0 of the picture but that of what the objects stand on."""
    n = int(labels.max()) + 1
    pairs = truth.astype(np.int64) * n + labels
    joint = np.bincount(pairs.ravel(), minlength=(int(truth.max()) + 1) * n).reshape(-1, n)
    true_area, area = joint.sum(axis=1), joint.sum(axis=0)
    best = (joint / np.maximum(true_area[:, None] + area - joint, 1)).max(axis=1)
    return [float(best[k]) for k in np.flatnonzero(true_area) if k not in (0, support)]


def _costs(scene: str, photo: _Photo) -> list[Figure]:
    """Against a plain segmentation of the same picture at the same size."""
    from skimage.segmentation import felzenszwalb

    small = _shrunk(photo.image)
    plain = median_ms(lambda: felzenszwalb(small, scale=300))
    color = median_ms(lambda: regions(photo.image))
    depth = median_ms(lambda: regions(photo.image, photo.depth))
    return [
        Figure(f"regions: {scene}, a photo, color", color, "CPU-ms", "<= 1000"),
        Figure(f"regions: {scene}, a photo, depth", depth, "CPU-ms", "<= 1000"),
        Figure(f"regions: {scene}, a photo with depth to felzenszwalb", depth / plain, "x"),
    ]


def _shrunk(image: UInt8Array) -> UInt8Array:
    """The photo at the 480 pixels width at which regions are made."""
    from PIL import Image

    height, width = image.shape[:2]
    return np.array(Image.fromarray(image).resize((480, round(480 * height / width))))


def _groups(folder: SceneFolder, gaussians: Gaussians, *, with_depth: bool) -> Score:
    """Held-out views after associating the regions of the others, void left out."""
    engine, train = choose("cpu"), select_views(folder, "train")
    maps = {}
    for camera in train:
        photo = _photo(folder, gaussians, camera)
        maps[camera.name] = regions(photo.image, photo.depth if with_depth else None)
    loaders = {name: partial(maps.__getitem__, name) for name in maps}
    masks = MaskSet(loaders, "regions", are_regions=True)
    config = AssociateConfig.of("robust")
    found = run_stage(associate_stage(gaussians, train, masks, engine, config))
    test = select_views(folder, "test")
    truth = {camera.name: true_labels(folder, camera) for camera in test}
    return held_out_score(gaussians, found.labels, test, truth)
