"""Scenes with photos, splats and true label maps: real ones of this machine, and the demo."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.evaluate.group_scores import Score, score_pairs
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import splat_groups
from gaga_core.io.demo_scene import copy_demo_stage
from gaga_core.io.folder.scene_folder import SceneFolder, open_scene_folder
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.bench.figures import data_folder


def known_scenes(*names: str) -> Iterator[tuple[str, SceneFolder]]:
    """The real scenes of these names that are on this machine, and the demo scene ("demo")."""
    for name in names:
        if name == "demo":
            with tempfile.TemporaryDirectory() as scratch:
                demo = run_stage(copy_demo_stage(Path(scratch) / "demo"))
                yield name, open_scene_folder(demo)
        elif data_folder(name).is_dir():
            yield name, open_scene_folder(data_folder(name))


def true_labels(folder: SceneFolder, camera: Camera) -> IntArray:
    """The true label map of a photo."""
    return read_labels(folder.root / "gt" / "instance" / f"{Path(camera.name).stem}.png")


def held_out_score(
    gaussians: Gaussians,
    labels: IntArray,
    views: Sequence[Camera],
    truth: Mapping[str, IntArray],
) -> Score:
    """Algorithm 1 of the labels (N,), splatted into views, with void left out."""
    engine = choose("cpu")
    shown = (splat_groups(engine, gaussians, camera, labels) for camera in views)
    return score_pairs(zip((truth[camera.name] for camera in views), shown, strict=True))[1]
