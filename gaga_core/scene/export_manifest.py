"""The file groups.json next to exported objects: one description writes and reads it."""

import json
from pathlib import Path

import msgspec
import numpy as np

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


def write_manifest(content: Manifest, folder: Path) -> None:
    """Write groups.json into ``folder``."""
    plain = msgspec.to_builtins(content, enc_hook=np.generic.item)
    text = json.dumps(plain, indent=1, ensure_ascii=False)
    (folder / MANIFEST).write_text(text + "\n", encoding="utf-8")


def read_manifest(manifest: Path) -> Manifest:
    """Read the manifest of an export. Raises ``GagaError`` when it is damaged."""
    return read_json(manifest, Manifest, _CURE)


def listed_files(manifest: Path) -> list[Path]:
    """The files that the manifest of an export names; others in its folder are not its own.

    Raises ``GagaError`` when it is damaged.
    """
    return [manifest.parent / entry.file for entry in read_manifest(manifest).groups]
