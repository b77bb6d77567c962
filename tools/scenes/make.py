"""Scenes of scanned objects as scene folders: photos, poses, splats and truth.

A seed and a split give one scene, always the same; one that is there is not made again.
"""

import json
import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gaga_core.color import rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.raster import choose
from tools.scenes.arrange import KINDS, Kind, arrange, cameras, kind_of
from tools.scenes.draw import Look, discs, gaussians_of

VERSION = 2  # raise it whenever scenes change: older ones are made again
Split = Literal["train", "val", "test"]
_SPLITS: tuple[Split, ...] = ("train", "val", "test")  # each has seeds of its own
_DENSE = 4.0  # times the splats: what photos are taken of
_MOST_POINTS = 8000  # of the COLMAP model


@dataclass(frozen=True)
class SceneConfig:
    """What one scene is made of."""

    seed: int = 0
    split: Split = "train"
    kind: Kind = "table"
    width: int = 480
    height: int = 360
    views: int = 0  # 0: drawn, 20 to 60


def make_scene(folder: Path, scans: Path, config: SceneConfig) -> bool:
    """Make the scene in ``folder``; False where it is there already.

    ``GagaError`` when ``scans`` holds no scans or nothing comes to rest.
    """
    manifest, facts = folder / "manifest.json", {"version": VERSION, **asdict(config)}
    if manifest.is_file():
        there = json.loads(manifest.read_text("utf-8"))
        if all(there.get(key) == value for key, value in facts.items()):
            return False
    with staging_folder(folder.parent) as staging:
        _write(staging / folder.name, scans, config, facts)
        publish_all(staging, [folder.name], folder.parent)
    return True


def _write(folder: Path, scans: Path, config: SceneConfig, facts: dict[str, object]) -> None:
    key = (_SPLITS.index(config.split), config.seed, KINDS.index(config.kind))
    rng = np.random.default_rng(key)
    found = arrange(scans, config.split, config.kind, rng)
    if not found.objects:
        raise GagaError(f"Seed {config.seed}: nothing came to rest. Take another seed.")
    n_views = config.views or int(rng.integers(20, 61))
    views = cameras(found, n_views, (config.width, config.height), rng)
    look, strength = Look.drawn(len(found.blocks), rng), float(rng.uniform(0.3, 1.0))
    dense, dense_labels = gaussians_of(discs(found, look, _DENSE, rng), 0.0, rng)
    splats, labels = gaussians_of(discs(found, look, 1.0, rng), strength, rng)
    for part in ("images", "gt/instance", "sparse/0"):
        (folder / part).mkdir(parents=True)
    rasterizer, sky = choose("cpu"), rng.uniform(0.4, 0.9) + rng.normal(0, 0.03, 3)
    for camera in views:
        image = rasterizer.render(dense, camera, background=sky).image
        write_rgb(folder / "images" / camera.name, image)
        truth = rasterizer.label_splat(dense, camera, dense_labels).labels
        write_labels(folder / "gt" / "instance" / f"{Path(camera.name).stem}.png", truth)
    write_splats(folder / "point_cloud.ply", splats)
    np.save(folder / "gt" / "splat_labels.npy", labels)
    chosen = np.sort(rng.choice(len(labels), min(_MOST_POINTS, len(labels)), replace=False))
    colors = np.clip(rgb_from_dc(splats.sh[chosen, 0]), 0, 1) * 255
    points = splats.means[chosen].astype(np.float64)
    write_colmap(folder / "sparse" / "0", views, points, np.round(colors).astype(np.uint8))
    called = [thing.name for thing in found.objects] + ["furniture"] * found.n_furniture
    things = [{"id": k, "name": name} for k, name in enumerate(called, start=1)]
    names = [camera.name for camera in views]
    test = names[4::8]
    told = {
        "objects.json": {"background_id": 0, "objects": things},
        "split.json": {"train": [name for name in names if name not in test], "test": test},
        "manifest.json": {**facts, "noise": strength, "objects": [t["name"] for t in things]},
    }
    for name, value in told.items():
        (folder / name).write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def main(
    out: Path,
    seeds: str = "0..0",
    split: Split = "train",
    kind: Kind | Literal["mixed"] = "mixed",
    scans: Path | None = None,
    views: int = 0,
) -> None:
    """Drop scanned objects and write a scene folder for each seed.

    Args:
        out: where the scene folders go
        seeds: first and last seed, as 0..39
        split: which seeds and objects: test scenes alone show the objects that are kept back
        kind: of all scenes; mixed: by seed, every third of one object alone
        scans: folder of .glb and masses_kg.json; default ycb_meshes in $GAGA_TEST_DATA
        views: photos of a scene; 0: 20 to 60
    """
    try:
        first, last = _range(seeds)
        if scans is None:
            if "GAGA_TEST_DATA" not in os.environ:
                raise GagaError("There are no scans: give their folder by --scans.")
            scans = Path(os.environ["GAGA_TEST_DATA"]) / "ycb_meshes"
        for seed in range(first, last + 1):
            config = SceneConfig(seed, split, kind_of(seed) if kind == "mixed" else kind)
            config = SceneConfig(seed, split, config.kind, views=views)
            name = f"{split}_{seed:03d}_{config.kind}"
            new = make_scene(out.absolute() / name, scans, config)
            there = "" if new else " (there)"
            sys.stdout.write(f"{seed - first + 1}/{last - first + 1} {name}{there}\n")
            sys.stdout.flush()
    except GagaError as error:
        sys.exit(str(error))


def _range(text: str) -> tuple[int, int]:
    first, _, last = text.partition("..")
    if not first.isdecimal() or not (last or first).isdecimal() or int(last or first) < int(first):
        raise GagaError(f"Seeds are a first and a last as 0..39, not {text!r}.")
    return int(first), int(last or first)
