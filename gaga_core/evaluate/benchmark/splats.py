"""Splats of a benchmark scene that has none, or none of so few views: trained on training views."""

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.evaluate.benchmark.files import digest_of
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.scene_folder import SceneFolder
from gaga_core.io.splat_files import read_splats_stage
from gaga_core.pipeline.reconstruct import ReconstructConfig, train_scene
from gaga_core.progress import Stage
from gaga_core.raster.base import Rasterizer

RECORD = "splats.json"  # what the splats next to it were made of


def trained_splats(
    folder: SceneFolder, config: ReconstructConfig, out: Path, rasterizer: Rasterizer
) -> Stage[Gaussians]:
    """Splats of the training views of ``folder`` alone, kept in ``out``.

    Test views take no part, not even to measure on; views of neither part likewise. What was made
    of the same photos and settings is read again. Raises ``GagaError`` without photos.
    """
    lacking = [name for name in folder.train if name not in folder.image_paths]
    if lacking or not folder.train:
        raise GagaError(
            f"There are no splats of {folder.root.name}, and {len(lacking)} of its "
            f"{len(folder.train)} training photos are missing, so none can be trained. Put the "
            "photos there, or name the folder of the trained models."
        )
    wanted = _record_of(folder, config)
    model = out / "point_cloud.ply"
    if model.is_file() and _recorded(out / RECORD) == wanted:
        return (yield from read_splats_stage(model))
    kept = {camera.name: camera for camera in folder.cameras}
    alone = replace(folder, cameras=tuple(kept[name] for name in folder.train), test=())
    gaussians = yield from train_scene(alone, config, rasterizer=rasterizer, out=out)
    with atomic_write(out / RECORD) as temporary:
        temporary.write_text(json.dumps(wanted, indent=1) + "\n", encoding="utf-8")
    return gaussians


def _recorded(path: Path) -> dict[str, object]:
    """What splats were made of; nothing where it is not known."""
    try:
        return read_foreign_json(path, dict[str, object])
    except GagaError:
        return {}


def _record_of(folder: SceneFolder, config: ReconstructConfig) -> dict[str, object]:
    poses = [camera.cam_from_world.tolist() for camera in folder.cameras]
    return {
        "config": asdict(config),
        "views": list(folder.train),
        "photos": [digest_of(folder.image_paths[name]) for name in folder.train],
        "poses": hashlib.sha256(str(poses).encode()).hexdigest()[:16],
    }
