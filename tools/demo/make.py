"""``python -m tools.demo.make [FOLDER]``: draw the demo scene, by default as ``assets/demo``.

The same seed gives the same files: photos, poses, splats, masks and truth of one scene.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro
from tyro.conf import OmitArgPrefixes as Flat
from tyro.conf import Positional

from gaga_core.color import rgb_from_dc
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.files import assets
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.raster import choose
from tools.demo.scene import build, photo_cameras, segmenter_masks

VERSION = 1  # raise it whenever the scene changes: older copies that users have are replaced
_MOST_POINTS = 8000  # of the COLMAP model


@dataclass(frozen=True)
class DemoConfig:
    """Size and seed of the demo scene."""

    n_splats: int = 120_000  # about
    n_views: int = 40
    width: int = 640
    height: int = 480
    seed: int = 0

    def __post_init__(self) -> None:
        if self.n_splats < 100 or self.n_views < 2 or min(self.width, self.height) < 16:
            raise ValueError(f"demo: too little to make a scene of: {self}")


_ASSET, _AS_SHIPPED = assets() / "demo", DemoConfig()


def make_demo(folder: Positional[Path] = _ASSET, config: Flat[DemoConfig] = _AS_SHIPPED) -> Path:
    """Draw the scene and put it in place of ``folder``, which it returns."""
    folder = folder.absolute()
    with staging_folder(folder.parent) as staging:
        _draw(staging / folder.name, config)
        publish_all(staging, [folder.name], folder.parent)
    return folder


def _draw(folder: Path, config: DemoConfig) -> None:
    """Write all files of the scene into the new folder ``folder``."""
    for part in ("images", "gt/instance", "masks/sim", "sparse/0"):
        (folder / part).mkdir(parents=True)
    model = build(config.n_splats, config.seed)
    size, rng = (config.width, config.height), np.random.default_rng((config.seed, 1))
    cameras, rasterizer = photo_cameras(config.n_views, size, rng), choose("cpu")
    for k, camera in enumerate(cameras):
        label_map = f"{Path(camera.name).stem}.png"
        write_rgb(folder / "images" / camera.name, rasterizer.render(model.gaussians, camera).image)
        truth = rasterizer.label_splat(model.gaussians, camera, model.labels).labels
        write_labels(folder / "gt" / "instance" / label_map, truth)
        masks = segmenter_masks(truth, camera, np.random.default_rng((config.seed, 2, k)))
        write_labels(folder / "masks" / "sim" / label_map, masks)
    write_splats(folder / "point_cloud.sog", model.gaussians)
    rng, n = np.random.default_rng((config.seed, 3)), len(model.labels)
    chosen = np.sort(rng.choice(n, min(_MOST_POINTS, n), replace=False))
    colors = np.clip(rgb_from_dc(model.gaussians.sh[chosen, 0]), 0, 1) * 255
    points = model.gaussians.means[chosen].astype(np.float64)
    write_colmap(folder / "sparse" / "0", cameras, points, np.round(colors).astype(np.uint8))
    things = [{"id": k, "name": name} for k, name in enumerate(model.names, start=1)]
    names = [camera.name for camera in cameras]
    test = names[4::8]  # every eighth view; the overview is for training
    facts: dict[str, object] = {
        "objects.json": {"background_id": 0, "objects": things},
        "split.json": {"train": [name for name in names if name not in test], "test": test},
        "demo.json": {"version": VERSION, **asdict(config)},
    }
    for name, value in facts.items():
        (folder / name).write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(make_demo)
