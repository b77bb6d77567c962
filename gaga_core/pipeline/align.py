"""Two captures as a stage: brought together, compared, and written where a person looks.

The second one is a scene of the same place, or a scan of a thing that stands in the first.
"""

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, refuse_links
from gaga_core.io.folder.scene_folder import find_model, is_scene_folder, open_scene_folder
from gaga_core.io.splats.splat_files import model_fingerprint
from gaga_core.io.splats.spz import OURS
from gaga_core.pipeline.settings import AlignConfig
from gaga_core.placing.photos import FEWEST
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake
from gaga_core.scene.captures.alignment import Alignment, Capture, NotAlignedError
from gaga_core.scene.captures.by_photos import align_by_photos_stage
from gaga_core.scene.captures.by_surfaces import drawn_stage
from gaga_core.scene.captures.changes import Change, find_changes_stage
from gaga_core.scene.edits import Edit, append, transform
from gaga_core.scene.edits.values import together
from gaga_core.scene.objects import group_name
from gaga_core.scene.project import Project, meant_in, open_path_stage
from gaga_core.scene.scene import Revision, Scene

_WORKSPACE = ".gaga-align"  # next to the first scene's files, while photos are matched


@dataclass(frozen=True, eq=False)
class Aligned:
    """The result."""

    first: str  # names of the captures
    second: str
    alignment: Alignment
    changes: tuple[Change, ...] | None  # None: not asked for, or one has no splats

    def lines(self) -> tuple[str, ...]:
        """One sentence a change; one that says that there is none, or why it is not known."""
        if self.changes is None:
            return ("What changed is not known: it takes splats with groups in both scenes.",)
        return tuple(c.sentence() for c in self.changes) or ("Nothing came, went or moved.",)

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        found = None if self.changes is None else [change.to_json() for change in self.changes]
        names = {"first": self.first, "second": self.second}
        return names | {"alignment": self.alignment.to_json(), "changes": found}


def open_capture_stage(path: Path) -> Stage[tuple[Capture, Project | None]]:
    """What ``path`` holds; a scene folder whose photos are placed needs no splats."""
    if is_scene_folder(path) and find_model(path) is None and meant_in(path) is None:
        folder = open_scene_folder(path)
        if not folder.cameras:
            raise GagaError(f"{path} has neither splats nor placed photos. Make splats first.")
        return Capture(path.absolute().name, folder.cameras, folder.image_paths), None
    project = yield from open_path_stage(path)
    return capture_of(project), project


def capture_of(project: Project) -> Capture:
    """The scene of ``project`` with its photos, as it is now."""
    folder, name, scene = project.placed_folder, _name_of(project), replace(project.scene)
    if folder is None:
        return Capture(name, scene=scene)
    return Capture(name, folder.cameras, folder.image_paths, scene)


def align_stage(
    first: Capture,
    second: Capture,
    config: AlignConfig,
    workspace: Path,  # a folder of its own, removed at the end
    behind: tuple[frozenset[int], frozenset[int]] = (frozenset(), frozenset()),
    rasterizer: Rasterizer | None = None,
) -> Stage[Aligned]:
    """Bring ``second`` to ``first`` and say what changed.

    Raises ``NotAlignedError`` where that cannot be trusted.
    """
    scenes, engine = (first.scene, second.scene), rasterizer
    has_photos = min(_n_photos(first), _n_photos(second)) >= FEWEST
    if config.by == "photos" and not has_photos:
        raise NotAlignedError(
            f"It takes {FEWEST} photos on disk in both. Align by the surfaces, or put them back."
        )
    refuse_links(workspace)
    shutil.rmtree(workspace, ignore_errors=True)
    try:
        shown = [first, second]
        if config.by == "surfaces" or not has_photos:
            engine = engine or choose()
            for i, capture in enumerate(shown):
                if capture.scene is None:
                    raise NotAlignedError(f"{capture.name} has neither photos on disk nor splats.")
                shown[i] = yield from drawn_stage(capture, workspace / f"drawn-{i}", engine)
        matching = workspace / "matching"
        limits = {"threads": config.threads, "seed": config.seed}
        found = yield from align_by_photos_stage(shown[0], shown[1], matching, **limits)
        if shown[0] is not first:
            found = replace(found, by="surfaces")
    finally:
        shutil.rmtree(workspace, ignore_errors=True)
    changes = None
    if config.changes and all(scene is not None and scene.labels.any() for scene in scenes):
        engine = engine or choose()
        changes = yield from find_changes_stage(first, second, found.world, engine, behind)
    return Aligned(first.name, second.name, found, changes)


def _n_photos(capture: Capture) -> int:
    return sum(camera.name in capture.photos for camera in capture.cameras)


def added_edit(scene: Scene, second: Project, world: DoubleArray) -> tuple[Edit, dict[int, int]]:
    """The edit that adds the visible splats of ``second`` to ``scene``, moved by ``world`` (4, 4),
    with its groups and their names; and what its groups are called here.

    The project names the file of an unedited scene, and keeps edited splats itself.
    """
    other = second.scene
    is_as_filed = (
        not (other.added or other.placement.any() or second.model_axes != OURS)
        and other.visible.all()
    )  # fmt: skip
    digest = model_fingerprint(second.model_path) if is_as_filed else ""
    splats, labels = bake(other), other.labels[other.visible]
    ids = np.unique(labels)
    names = {group: group_name(other, group) for group in ids.tolist() if group}
    path = second.folder.root if second.folder and not digest else second.model_path
    edit = append(scene, splats, path, digest, labels, names)
    if edit is None:
        raise GagaError(f"{path} shows no splats, so there is nothing to add.")
    after = replace(scene, revision=Revision())
    edit.apply(after)
    own = np.arange(len(scene), len(after))
    title = f"Add {_name_of(second)}"
    whole = together(title, (edit, transform(after, own, world[:3], title)))
    assert whole is not None
    _, first = np.unique(labels, return_index=True)
    fresh = after.labels[own][first]
    return whole, dict(zip(ids.tolist(), fresh.tolist(), strict=True))


def _name_of(project: Project) -> str:
    folder = project.folder
    return project.model_path.name if folder is None else folder.root.absolute().name


def workspace_of(first: Path) -> Path:
    """Folder for the work on the first scene, which is removed again."""
    return (first if first.is_dir() else first.parent) / _WORKSPACE


def result_path(first: Path, found: Aligned) -> Path:
    """Default file of the result: in the first scene folder, or next to the file."""
    name = f"align-{Path(found.second).stem}.json"
    return first / "gaga" / name if first.is_dir() else first.with_name(f"{first.stem}-{name}")


def write_aligned(path: Path, found: Aligned) -> None:
    """Write the result as JSON (see docs/formats.md)."""
    path.parent.mkdir(exist_ok=True)
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(found.to_json(), indent=1) + "\n", encoding="utf-8")
