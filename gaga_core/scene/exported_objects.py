"""Open exported objects again: the files that groups.json names, with names, colors and order."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage
from gaga_core.scene.edits.values import joined, read_added_stage
from gaga_core.scene.folders import Folders
from gaga_core.scene.manifest import MANIFEST, ManifestEntry, read_manifest
from gaga_core.scene.objects import group_colors
from gaga_core.scene.scene import RGB, Added, Scene

_MOST_ID = (1 << 31) - 1
_NO_SPLATS = ("mesh", "collider", "box", "html")  # forms, as the manifest names them


def manifest_in(path: Path) -> Path | None:
    """The groups.json that ``path``, a file or a folder, means; None when it means none."""
    file = path if path.name == MANIFEST else path / MANIFEST
    return file if file.is_file() else None


def open_objects_stage(manifest: Path) -> Stage[tuple[Scene, Path, str]]:
    """Read all objects of an export as one scene, the first file as the one that was opened.

    Returns the scene, that file and its fingerprint. Ids, names, colors, folders and parents are
    those of the export. Raises ``GagaError`` when the manifest is damaged, names nothing, or a file
    is gone.
    """
    content = read_manifest(manifest)
    entries = content.groups
    if content.form in _NO_SPLATS:
        raise GagaError(
            f"{manifest.parent} holds objects as {content.form}, which has no splats. Open the "
            "scene that they are of, or export them as splats."
        )
    if not entries:
        raise GagaError(f"{manifest} names no objects, so there is nothing to open.")
    if not all(0 < entry.id <= _MOST_ID for entry in entries):
        raise GagaError(f"{manifest} is damaged: an id of an object cannot be. Export them again.")
    parts: list[Gaussians] = []
    digests: list[str] = []
    files = [(manifest.parent / entry.file).absolute() for entry in entries]
    for i, file in enumerate(files):
        yield Progress("Read the objects", i, len(files), file.name)
        if not file.is_file():
            raise GagaError(f"{file} is gone, which {manifest.name} names. Put it back.")
        splats, digest = yield from read_added_stage(file)
        parts.append(splats)
        digests.append(digest)
    counts = [len(splats) for splats in parts]
    ids = np.array([entry.id for entry in entries], np.int32)
    scene = Scene.of(_all_joined(parts), np.repeat(ids, counts))
    starts = np.cumsum([0, *counts[:-1]]).tolist()
    scene.added = tuple(
        Added(str(file), digest, first, n)
        for file, digest, first, n in zip(files, digests, starts, counts, strict=True)
    )[1:]
    _take_order(scene, entries)
    return scene, files[0], digests[0]


def _take_order(scene: Scene, entries: Sequence[ManifestEntry]) -> None:
    """Names, colors, folders and parents of the export."""
    plain = group_colors(np.array([entry.id for entry in entries], np.int32))
    colors: dict[int, RGB] = {}
    for entry, usual in zip(entries, plain, strict=True):
        red, green, blue = (min(max(value, 0.0), 1.0) for value in entry.color)
        if np.abs(np.array((red, green, blue)) - usual).max() > 1e-3:
            colors[entry.id] = (red, green, blue)
    names = {entry.id: " ".join(entry.name.split()) for entry in entries}
    scene.names = {g: name for g, name in sorted(names.items()) if name not in ("", f"group {g}")}
    scene.colors = dict(sorted(colors.items()))
    parents = {entry.id: entry.parent for entry in entries if entry.parent in names}
    try:
        scene.folders = Folders.of((), {entry.id: entry.folder for entry in entries}, parents)
    except ValueError as error:
        raise GagaError(f"{MANIFEST} is damaged ({error}). Export the objects again.") from error


def _all_joined(parts: Sequence[Gaussians]) -> Gaussians:
    """All splats as one set, in order: pairs first, so that none is copied often."""
    while len(parts) > 1:
        pairs = [
            joined(parts[i], parts[i + 1]) if i + 1 < len(parts) else parts[i]
            for i in range(0, len(parts), 2)
        ]
        parts = pairs
    return parts[0]
