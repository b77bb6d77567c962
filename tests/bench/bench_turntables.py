"""Objects on turntables, from photos alone to one group: placed, trained and found by default.

The tankard (69 real photos, white paper, a long lens without EXIF) as it is, with its true masks as
foreground, and with its published poses; with ``GAGA_BENCH_LONG=1`` twelve generated ones, too.
``python -m tests.bench.bench_turntables NAME [FOLDER]`` prints one, "tankard foreground" or one of
the twelve, and keeps its scene in FOLDER.
"""

import json
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import BoolArray
from gaga_core.errors import GagaError
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.pipeline.run import RunConfig, run_folder
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene.project import open_path_stage
from gaga_core.training.views import read_view
from tests.bench.figures import Figure, data_folder, is_long
from tests.bench.workers import run_worker
from tests.captures.turntables import TWELVE, photograph_turntable

_TANKARD = ("tankard", "tankard foreground", "tankard poses")
_GROUP = 0.9  # IoU of one group with the object
_SIDE = 800  # pixels of the views that are measured


@dataclass(frozen=True)
class Made:
    """What became of one capture."""

    placed: int
    photos: int
    psnr: float  # dB, of the object's pixels of held-out photos; 0: there are none
    iou: float  # of the best group, over all photos
    alpha: float  # mean, outside of the object and of what our masks keep


def figures() -> list[Figure]:
    """The tankard in its three forms; how many of the twelve come out, where that is asked for."""
    found = []
    for name in _TANKARD if data_folder("tankard").is_dir() else ():
        made = Made(**run_worker("tests.bench.bench_turntables", [name]))
        found += [
            Figure(f"{name}: photos placed", made.placed, "", f">= {made.photos}"),
            Figure(f"{name}: held-out PSNR of the object", made.psnr, "dB", ">= 26"),
            Figure(f"{name}: IoU of the best group", made.iou, "", f">= {_GROUP}"),
            Figure(f"{name}: alpha outside the object", made.alpha, "", "<= 0.05"),
        ]
    if is_long() and data_folder("ycb_meshes").is_dir():
        all_made = [Made(**run_worker("tests.bench.bench_turntables", [kind])) for kind in TWELVE]
        n_placed = sum(made.placed >= 0.9 * made.photos for made in all_made)
        n_whole = sum(made.iou >= _GROUP for made in all_made)
        found += [
            Figure("twelve turntables: placed", n_placed, "", ">= 11"),
            Figure(f"twelve turntables: one group of IoU {_GROUP}", n_whole, "", ">= 10"),
        ]
    return found


def measure(name: str, folder: Path) -> Made:
    """Make a scene of one capture in ``folder``, or look again at the one that is there."""
    photos, masks, scene = folder / "photos", folder / "masks", folder / "scene"
    config = ReconstructConfig()
    if name in TWELVE:
        if not photos.is_dir():
            photograph_turntable(TWELVE[name], data_folder("ycb_meshes"), photos, masks)
    else:
        data = data_folder("tankard")
        masks = data / "foreground"
        if not photos.is_dir():
            photos.mkdir()
            for path in sorted((data / "photos").iterdir()):
                (photos / path.name).symlink_to(path)
        if name.endswith("foreground"):
            config = ReconstructConfig(foreground=str(masks))
        elif name.endswith("poses"):
            config = ReconstructConfig(poses_from=str(data / "poses_bounds.npy"))
    n = len(list(photos.iterdir()))
    try:
        run_stage(run_folder(scene, RunConfig(reconstruct=config), photos=photos))
    except GagaError as refused:
        sys.stderr.write(f"{name}: {refused}\n")
        return Made(0, n, 0.0, 0.0, 1.0)
    return _looked_at(scene, masks, n)


def _looked_at(path: Path, masks: Path, n: int) -> Made:
    folder, engine = open_scene_folder(path), choose("cpu")
    scene = run_stage(open_path_stage(path)).scene
    n_groups = int(scene.labels.max()) + 1
    both, either, size = np.zeros((3, n_groups))
    errors, outside = [], []
    for camera in folder.cameras:
        view = read_view(camera, folder.image_paths[camera.name], _SIDE)
        shape = (view.camera.width, view.camera.height)
        truth = _mask(masks / f"{Path(camera.name).stem}.png", shape)
        frame = engine.render(scene.gaussians, view.camera)
        labels = engine.label_splat(scene.gaussians, view.camera, scene.labels).labels
        labels = np.where(frame.alpha >= 0.5, labels, 0)
        size += np.bincount(labels.ravel(), minlength=n_groups)
        both += np.bincount(labels[truth], minlength=n_groups)
        either += truth.sum()
        kept = folder.foreground.get(camera.name)
        free = ~truth if kept is None else ~(truth | _mask(kept, shape))
        outside.append(float(frame.alpha[free].mean()))
        if camera.name in folder.test:
            error = (np.clip(frame.image, 0, 1) - view.picture / 255.0)[truth]
            errors.append(float((error**2).mean()))
    iou = both / np.maximum(either + size - both, 1)
    quality = -10 * float(np.log10(np.mean(errors))) if errors else 0.0
    return Made(
        len(folder.cameras), n, quality, float(iou[1:].max(initial=0)), float(np.mean(outside))
    )


def _mask(path: Path, size: tuple[int, int]) -> BoolArray:
    with Image.open(path) as image:
        return np.asarray(image.convert("L").resize(size)) > 127


if __name__ == "__main__":
    name, *kept = sys.argv[1:]
    with tempfile.TemporaryDirectory(prefix="gaga-bench-") as temporary:
        made = measure(name, Path(kept[0] if kept else temporary))
    sys.stdout.write(json.dumps(asdict(made)) + "\n")
