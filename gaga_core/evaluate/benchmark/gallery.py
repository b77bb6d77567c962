"""A data set without truth is shown: a film around the scene and a contact sheet of its test views.

Mip-NeRF 360 is qualitative in the paper. The sheet has a row for each view: photo, picture, groups.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write
from gaga_core.io.folder.scene_folder import SceneFolder, select_views
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.video import VideoConfig, ffmpeg_program
from gaga_core.pipeline.film import FilmConfig, as_bytes, film_stage, painted_labels
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.camera_path import CameraPath, Keyframe, Shot
from gaga_core.scene.objects import group_colors
from gaga_core.scene.scene import Scene

SHEET, FILM = "contact_sheet.png", "film.mp4"
_ROWS = 8  # test views on a sheet, spread over all
_WIDTH = 400  # pixels of a picture on it
_KEYS, _SECONDS = 12, 1.0  # of the film: keyframes among the training views, between two


def show_scene(
    folder: SceneFolder,  # its gaga/ holds what is written
    gaussians: Gaussians,
    labels: IntArray,  # (N,) groups
    maps: Sequence[Path],  # group maps of the test views, in their order
    rasterizer: Rasterizer,
    out: Path,
) -> Stage[tuple[str, ...]]:
    """Write `SHEET` and `FILM` into ``out``; returns sentences for people."""
    cameras = select_views(folder, "test")
    chosen = np.linspace(0, len(cameras) - 1, min(_ROWS, len(cameras))).round().astype(int)
    rows = []
    for i, k in enumerate(chosen):
        camera = cameras[k]
        yield Progress("Contact sheet", i, len(chosen), camera.name)
        photo = folder.image_paths.get(camera.name)
        rows.append(_row(camera, photo, gaussians, read_labels(maps[k]), rasterizer))
    with atomic_write(out / SHEET) as temporary:
        Image.fromarray(np.concatenate(rows)).save(temporary, format="PNG")
    told = f"shown, not scored: {out / SHEET}"
    try:
        ffmpeg_program("Writing a film")
    except GagaError as error:
        return (f"{told}.", str(error))
    yield from _film(folder, Scene.of(gaussians, labels), rasterizer, out / FILM)
    return (f"{told} and {FILM}.",)


def _row(
    camera: Camera,
    photo: Path | None,
    gaussians: Gaussians,
    groups: IntArray,  # (H, W)
    rasterizer: Rasterizer,
) -> UInt8Array:
    """Photo, picture and groups of one view, next to each other."""
    small = camera.resized(_WIDTH, max(1, round(camera.height * _WIDTH / camera.width)))
    size = (small.width, small.height)
    image = rasterizer.render(gaussians, small).image
    found = [np.zeros((small.height, small.width, 3), np.uint8)]
    if photo is not None:
        found = [np.asarray(Image.fromarray(read_rgb(photo)).resize(size))]
    found.append(as_bytes(image))
    painted = Image.fromarray(painted_labels(groups))
    found.append(np.asarray(painted.resize(size, Image.Resampling.NEAREST)))
    return np.concatenate(found, axis=1)


def _film(folder: SceneFolder, scene: Scene, rasterizer: Rasterizer, target: Path) -> Stage[Path]:
    """Along the training views: the picture on the left, its groups on the right."""
    cameras = select_views(folder, "train")
    chosen = np.linspace(0, len(cameras) - 1, min(_KEYS, len(cameras))).round().astype(int)
    middle = scene.gaussians.means.mean(axis=0)
    keys = tuple(
        Keyframe(
            Shot.of_camera(
                cameras[k], max(float(np.linalg.norm(cameras[k].position - middle)), 1e-6)
            ),
            _SECONDS,
        )
        for k in np.unique(chosen)
    )
    first = cameras[0]
    width = min(640, first.width) // 2 * 2
    height = max(16, round(first.height * width / first.width) // 2 * 2)
    config = FilmConfig(video=VideoConfig(max(2 * width, 16), height, fps=12))
    colors = group_colors(scene.labels)
    colors[scene.labels == 0] = 0

    def paint(camera: Camera) -> UInt8Array:
        K = camera.K.copy()
        K[0, 2] = camera.width // 2 / 2
        half = replace(camera, K=K, width=camera.width // 2)
        shown = [
            as_bytes(rasterizer.render(scene.gaussians, half, channels=channels).image)
            for channels in (None, colors)
        ]
        return np.concatenate(shown, axis=1)

    return (yield from film_stage(scene, CameraPath(keys), target, config, painter=paint))
