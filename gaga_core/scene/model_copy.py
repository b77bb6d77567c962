"""Files of splats that other programs change: noticed at every save, and replaced by a copy."""

from dataclasses import dataclass, field
from pathlib import Path
from uuid import uuid4

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.io.files import fingerprint
from gaga_core.io.model_files import is_same_model
from gaga_core.io.ply import write_ply
from gaga_core.scene.scene import Scene

File = tuple[Path, str]  # and the fingerprint of its content


@dataclass(eq=False)
class KnownCopies:
    """Copies that saves have written, and a folder of files that will be removed."""

    files: dict[tuple[Path, str], File] = field(default_factory=dict)  # by folder, fingerprint
    leaving: Path | None = None  # an autosave: files of splats in it are copied as if changed


class ModelChangedError(GagaError):
    """A file of splats is not the one that was opened."""

    def __init__(self, path: Path) -> None:
        what = "was changed by another program" if path.is_file() else "is gone"
        super().__init__(
            f"{path} {what} since it was opened, so a project that names it could not be opened "
            "again. Save with a copy of the splats as they were opened."
        )
        self.path = path


def has_changed(wanted: File) -> bool:
    """Whether a file is not there or has another content than its fingerprint says."""
    path, digest = wanted
    return not path.is_file() or not is_same_model(path, digest)


def current_file(
    wanted: File, target: Path, scene: Scene, rows: tuple[int, int] | None, known: KnownCopies
) -> File:
    """The file that a project in ``target`` must name, where ``wanted`` was opened.

    The file itself when it is as it was and stays, else a copy of it in ``target``: one that
    ``known`` has, or a new .ply of the splats ``rows`` (first, end; rows of all files,
    `Scene.source`).
    Raises ``ModelChangedError`` when a copy is needed and ``rows`` is None.
    """
    copied = known.files.get((target, wanted[1]))
    leaves = known.leaving is not None and wanted[0].is_relative_to(known.leaving)
    for file in (None if leaves else wanted, copied):
        if file is not None and not has_changed(file):
            return file
    if rows is None:
        raise ModelChangedError(wanted[0])
    sources, places = np.unique(scene.source, return_index=True)
    first, end = np.searchsorted(sources, rows)
    path = target / f"model-{uuid4().hex[:12]}.ply"
    write_ply(path, scene.gaussians.take(places[first:end]))
    known.files[target, wanted[1]] = path, fingerprint(path)
    return known.files[target, wanted[1]]
