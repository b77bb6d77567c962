"""The file groups.json next to exported objects: one description writes and reads it.

A folder may hold several exports: each file is described by the manifest of the export that wrote
it last, groups.json or groups-2.json and so on.
"""

import json
import re
from collections.abc import Collection
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace as changed

from gaga_core.errors import GagaError
from gaga_core.io.json_file import PathText, read_json

_Direction = tuple[float, float, float]
MANIFEST = "groups.json"
MANIFEST_VERSION = 1
_CURE = "Export the objects again."


class BoxEntry(msgspec.Struct, frozen=True):
    """A box with axes of its own, the longest first."""

    centre: tuple[float, float, float]  # world
    axes: tuple[_Direction, _Direction, _Direction]  # unit, of its sides
    size: tuple[float, float, float]  # lengths of the sides, scene units


class ManifestEntry(msgspec.Struct, frozen=True):
    """One exported object."""

    id: int
    name: str
    color: tuple[float, float, float]  # red, green, blue, 0..1
    count: int  # splats in the file
    bbox: list[tuple[float, float, float]]  # two corners of the centres, world; none: no splats
    file: PathText  # next to the manifest
    oriented_box: BoxEntry | None = None  # turned as the object lies; older files lack it
    folder: str = ""  # of the object list, "Kitchen/Cups"; older files lack it
    parent: int = 0  # id of the exported object that it lies under; 0 = none; older files lack it
    psnr: float | None = None  # dB against the object before it was decimated; None: it was not


class Manifest(msgspec.Struct, frozen=True):
    """Content of groups.json."""

    version: int
    source: str  # the scene
    groups: list[ManifestEntry]  # colors 0..1, boxes in the world of the files
    form: str = ""  # of the files: one of splats, "mesh", "collider" or "box"; older files lack it
    up: _Direction = (0.0, 0.0, 0.0)  # unit, in the axes of a .ply; zeros: older files lack it
    units: float = 1.0  # of the files per scene unit
    left_out: list[str] = []  # names of objects without a surface


def is_manifest(path: Path) -> bool:
    """Whether ``path`` is a manifest of exported objects, by its name."""
    return re.fullmatch(r"groups(-\d+)?\.json", path.name) is not None and path.is_file()


def manifests_in(folder: Path) -> list[Path]:
    """The manifests of all exports into a folder, groups.json first."""
    found = [path for path in folder.glob("groups*.json") if is_manifest(path)]
    return sorted(found, key=lambda path: (len(path.name), path.name))


def place_manifest(
    folder: Path, files: Collection[str]
) -> tuple[str, dict[str, Manifest], list[str]]:
    """Where an export of ``files`` to ``folder`` is described, next to what is there.

    Returns the name of its manifest; those of former exports that lose some of their files to it,
    as they are to be written again; and the names of those that lose all, to be removed. A
    manifest that cannot be read stays as it is.
    """
    changed_ones: dict[str, Manifest] = {}
    emptied: list[str] = []
    kept: set[str] = set()
    for path in manifests_in(folder):
        try:
            former = read_manifest(path)
        except GagaError:  # damaged, or of something else
            kept.add(path.name)
            continue
        rest = [entry for entry in former.groups if entry.file not in files]
        if not rest:
            emptied.append(path.name)
            continue
        kept.add(path.name)
        if len(rest) < len(former.groups):
            changed_ones[path.name] = changed(former, groups=rest)
    n, name = 1, MANIFEST
    while name in kept:
        n += 1
        name = f"groups-{n}.json"
    return name, changed_ones, [other for other in emptied if other != name]


def write_manifest(content: Manifest, folder: Path, name: str = MANIFEST) -> None:
    """Write a manifest into ``folder``."""
    plain = msgspec.to_builtins(content, enc_hook=np.generic.item)
    text = json.dumps(plain, indent=1, ensure_ascii=False)
    (folder / name).write_text(text + "\n", encoding="utf-8")


def read_manifest(manifest: Path) -> Manifest:
    """Read the manifest of an export. Raises ``GagaError`` when it is damaged."""
    return read_json(manifest, Manifest, _CURE)


def listed_files(manifest: Path) -> list[Path]:
    """The files that the manifest of an export names; others in its folder are not its own.

    Raises ``GagaError`` when it is damaged.
    """
    return [manifest.parent / entry.file for entry in read_manifest(manifest).groups]
