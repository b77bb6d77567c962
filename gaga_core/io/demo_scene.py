"""The demo scene, a breakfast table in a sunlit room: copied from the assets, never drawn here.

`tools/demo` draws it. A copy is made next to its place, then renamed; an outdated one is replaced.
"""

import shutil
from collections.abc import Iterator
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.files import assets
from gaga_core.io.folder.scene_folder import place_aside
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.json_file import read_json
from gaga_core.io.splats.ply import write_ply
from gaga_core.io.splats.sog import read_sog_stage
from gaga_core.progress import Progress, Stage, run_stage

STAMP = "demo.json"  # of which version a copy is
_SHIPPED_MODEL, _MODEL = "point_cloud.sog", "point_cloud.ply"  # what stages of a scene folder read


def copy_demo_stage(folder: Path) -> Stage[Path]:
    """Copy the demo's scene folder to ``folder`` and return it.

    It is put together next to ``folder`` and renamed at the end: a cancelled copy leaves nothing.
    An older demo there is replaced; what was worked out in its ``gaga`` folder is kept by
    `place_aside`. Raises `GagaError` when ``folder`` holds other things.
    """
    source, folder = assets() / "demo", folder.absolute()
    if folder.exists() and not (folder.is_dir() and _is_demo_or_empty(folder)):
        raise GagaError(
            f"{folder} holds other files. Choose an empty or a new folder for the demo scene."
        )
    with staging_folder(folder.parent) as staging:
        made, files = staging / folder.name, list(_files(source))
        for done, name in enumerate(files):
            yield Progress("Copy the demo scene", done, len(files), name.as_posix())
            (made / name).parent.mkdir(parents=True, exist_ok=True)
            if name.name == _SHIPPED_MODEL:
                write_ply(made / _MODEL, run_stage(read_sog_stage(source / name)))
            else:
                shutil.copyfile(source / name, made / name)
        _keep_others(folder, made)
        publish_all(staging, [folder.name], folder.parent)
    return folder


def ensure_demo(folder: Path) -> Stage[Path]:
    """Copy the demo to ``folder`` unless this version of it is there already, whole."""
    if not is_complete(folder):
        yield from copy_demo_stage(folder)
    return folder


def is_complete(folder: Path) -> bool:
    """Whether ``folder`` holds this version of the demo with all its files."""
    source = assets() / "demo"
    try:
        stamps = [read_json(place / STAMP, dict[str, object], "") for place in (folder, source)]
    except GagaError:
        return False
    return stamps[0] == stamps[1] and all(_copied(folder, n).is_file() for n in _files(source))


def _files(source: Path) -> Iterator[Path]:
    """Names of the files in the assets, in order."""
    return (path.relative_to(source) for path in sorted(source.rglob("*")) if path.is_file())


def _copied(folder: Path, name: Path) -> Path:
    """Path of a file of the assets in a copy."""
    return folder / (_MODEL if name.name == _SHIPPED_MODEL else name)


def _is_demo_or_empty(folder: Path) -> bool:
    return (folder / STAMP).is_file() or not any(folder.iterdir())


def _keep_others(old: Path, new: Path) -> None:
    """Copy what a person put into or worked out in an older demo; its groups no longer fit the new
    splats and go to the next free `place_aside`."""
    for entry in sorted(old.iterdir()) if old.is_dir() else ():
        if (new / entry.name).exists():
            continue
        target = new / (place_aside(old).name if entry.name == "gaga" else entry.name)
        if entry.is_dir():
            shutil.copytree(entry, target, dirs_exist_ok=True)
        else:
            shutil.copy2(entry, target)
