"""The demo's folder: written in full next to its place, then renamed; replaced when outdated.

What makes the scene (numba, scipy) is imported when a demo is made, not when one is opened.
"""

import json
import shutil
from dataclasses import asdict
from pathlib import Path

import msgspec

from gaga_core.demo.config import DemoConfig
from gaga_core.errors import GagaError
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.json_file import read_json
from gaga_core.progress import Stage

VERSION = 1  # grows whenever another scene comes out of the same seed
STAMP = "demo.json"
_OWN = {"images", "gt", "masks", "sparse", "point_cloud.ply", "objects.json", "split.json", STAMP}


def make_demo_stage(
    folder: Path, seed: int = 0, *, config: DemoConfig | None = None
) -> Stage[Path]:
    """Write the demo's scene folder and return it.

    It is made next to ``folder`` and renamed at the end: a cancelled demo leaves nothing. An older
    demo there is replaced; what was worked out in its ``gaga`` folder is kept as ``gaga-before``.
    Raises `GagaError` when ``folder`` holds other things.
    """
    # Only making a scene needs numba and scipy; opening one that is there must stay fast.
    from gaga_core.demo.make import scene_stage

    wanted = config or DemoConfig(seed=seed)
    folder = folder.absolute()
    _refuse_other_files(folder)
    with staging_folder(folder.parent) as staging:
        made = staging / folder.name
        yield from scene_stage(made, wanted)
        _write_stamp(made, wanted)
        _keep_others(folder, made)
        publish_all(staging, [folder.name], folder.parent)
    return folder


def ensure_demo(folder: Path, *, config: DemoConfig | None = None) -> Stage[Path]:
    """Make the demo in ``folder`` unless this version of it is there already, whole."""
    wanted = config or DemoConfig()
    if not is_complete(folder, wanted):
        yield from make_demo_stage(folder, config=wanted)
    return folder


def is_complete(folder: Path, config: DemoConfig) -> bool:
    """Whether ``folder`` holds this version of the demo with all its files."""
    try:
        stamp = read_json(folder / STAMP, dict[str, object], "")
        version = stamp.pop("version", None)
        made_of = msgspec.convert(stamp, DemoConfig)
    except (GagaError, ValueError):  # the second of a stamp of another version
        return False
    if version != VERSION or made_of != config:
        return False
    names = [f"view_{k:03d}" for k in range(config.n_views)]
    files = ["point_cloud.ply", "split.json", "objects.json"]
    files += [f"sparse/0/{n}.txt" for n in ("cameras", "images", "points3D")]
    files += [f"images/{n}.jpg" for n in names]
    files += [f"{kind}/{n}.png" for kind in ("masks/sim", "gt/instance") for n in names]
    return all((folder / file).is_file() for file in files)


def _write_stamp(folder: Path, config: DemoConfig) -> None:
    stamp = json.dumps({"version": VERSION, **asdict(config)}, indent=1)
    (folder / STAMP).write_text(stamp + "\n", encoding="utf-8")


def _refuse_other_files(folder: Path) -> None:
    if folder.exists() and not (folder.is_dir() and _is_demo_or_empty(folder)):
        raise GagaError(
            f"{folder} holds other files. Choose an empty or a new folder for the demo scene."
        )


def _is_demo_or_empty(folder: Path) -> bool:
    return (folder / STAMP).is_file() or not any(folder.iterdir())


def _keep_others(old: Path, new: Path) -> None:
    """Copy what a person put into or worked out in an older demo; its groups no longer fit the new
    splats and go to ``gaga-before``."""
    if not old.is_dir():
        return
    for entry in sorted(old.iterdir()):
        if entry.name in _OWN:
            continue
        target = new / ("gaga-before" if entry.name == "gaga" else entry.name)
        if entry.is_dir():
            shutil.copytree(entry, target, dirs_exist_ok=True)
        else:
            shutil.copy2(entry, target)
