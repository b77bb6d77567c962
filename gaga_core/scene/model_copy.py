"""Files of splats that other programs change: noticed at every save, and replaced by a copy."""

from pathlib import Path
from uuid import uuid4

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.io.files import fingerprint
from gaga_core.io.ply import write_ply
from gaga_core.scene.scene import Scene

File = tuple[Path, str]  # and the fingerprint of its content
Copies = dict[tuple[Path, str], File]  # by the folder with the copy, and the former fingerprint


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
    return not path.is_file() or fingerprint(path) != digest


def current_file(
    wanted: File, target: Path, scene: Scene, rows: tuple[int, int] | None, copies: Copies
) -> File:
    """The file that a project in ``target`` must name, where ``wanted`` was opened.

    The file itself when it is as it was, else a copy of it in ``target``: one that ``copies``
    knows, or a new .ply of the splats ``rows`` (first, end; rows of all files, `Scene.source`).
    Raises ``ModelChangedError`` when a copy is needed and ``rows`` is None.
    """
    copied = copies.get((target, wanted[1]))
    for file in (wanted, copied):
        if file is not None and not has_changed(file):
            return file
    if rows is None:
        raise ModelChangedError(wanted[0])
    sources, places = np.unique(scene.source, return_index=True)
    first, end = np.searchsorted(sources, rows)
    path = target / f"model-{uuid4().hex[:12]}.ply"
    write_ply(path, scene.gaussians.take(places[first:end]))
    copies[target, wanted[1]] = path, fingerprint(path)
    return copies[target, wanted[1]]
