"""Two captures as a stage: brought together, compared, and written where a person looks.

The second one is a scene of the same place, or a scan of a thing that stands in the first.
"""

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.cameras.given import Lens
from gaga_core.io.cameras.poses import find_poses
from gaga_core.io.files import atomic_write, refuse_links
from gaga_core.io.folder.scene_folder import find_model, is_scene_folder, open_scene_folder
from gaga_core.io.images import write_rgb
from gaga_core.io.splats.packing import READS
from gaga_core.io.splats.splat_files import model_fingerprint
from gaga_core.io.splats.spz import OURS
from gaga_core.pipeline.place import find_photos
from gaga_core.pipeline.search import describe_project
from gaga_core.pipeline.settings import AlignConfig
from gaga_core.placing.photos import FEWEST, list_photos
from gaga_core.placing.photos import STAGE as LOOKS
from gaga_core.placing.sfm import TITLES
from gaga_core.progress import Progress, Stage, joined, part, portion
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake, bake_stage
from gaga_core.scene.captures import by_photos, changes
from gaga_core.scene.captures.alignment import Alignment, By, Capture, NotAlignedError
from gaga_core.scene.captures.by_photos import align_by_photos_stage
from gaga_core.scene.captures.changes import Change, find_changes_stage
from gaga_core.scene.edits import Edit, append, recolor, transform
from gaga_core.scene.edits.values import together
from gaga_core.scene.objects import group_name
from gaga_core.scene.orientation import guess_up, views_around
from gaga_core.scene.project import READS_OBJECTS, Project, meant_in, open_path_stage
from gaga_core.scene.scene import Revision, Scene
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.bounds import robust_box
from gaga_core.scene.tint import mean_color, tint_affine

_TINT, _TINTED = (0.95, 0.55, 0.15), 0.5  # color of a second scene while it is shown, and how much
STAGE = "Align"
_DRAW, _FEATURES, _MATCHES = "Draw the surfaces", TITLES["features"], TITLES["match"]
# Seconds of a photo, of a pair of them, or of two captures, of halves of the demo on two cores.
_RATES = {
    _DRAW: 0.1, LOOKS: 0.02, _FEATURES: 0.17, _MATCHES: 0.0095, by_photos.STAGE: 5.5,
    changes.STAGE: 1.4,
}  # fmt: skip
OPENING = {READS: 1.0, READS_OBJECTS: 1.0}  # of `open_capture_stage`: either of them
_WORKSPACE = ".gaga-align"  # next to the first scene's files, while photos are matched


@dataclass(frozen=True, eq=False)
class Aligned:
    """The result."""

    first: str  # names of the captures
    second: str
    alignment: Alignment
    changes: tuple[Change, ...] | None  # None: not asked for, or one has no splats
    is_metric: bool = False  # a unit of the first capture is a metre

    def sentence(self) -> str:
        """How the second one lies."""
        return self.alignment.sentence(is_metric=self.is_metric)

    def lines(self) -> tuple[str, ...]:
        """One sentence a change; one that says that there is none, or why it is not known."""
        if self.changes is None:
            return ("What changed is not known: it takes splats with groups in both scenes.",)
        told = tuple(c.sentence(is_metric=self.is_metric) for c in self.changes)
        return told or ("Nothing came, went or moved.",)

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        found = None if self.changes is None else [change.to_json() for change in self.changes]
        names = {"first": self.first, "second": self.second}
        return names | {"alignment": self.alignment.to_json(), "changes": found}


def open_capture_stage(path: Path) -> Stage[tuple[Capture, Project | None]]:
    """What ``path`` holds; a folder whose photos are placed, here or by another program, needs no
    splats."""
    if path.is_dir() and find_model(path) is None and meant_in(path) is None:
        is_scene = is_scene_folder(path)
        folder = open_scene_folder(path) if is_scene else None
        if folder is not None and folder.cameras:
            return Capture(path.absolute().name, folder.cameras, folder.image_paths), None
        if (capture := _by_given_poses(path)) is not None:
            return capture, None
        if is_scene:
            raise GagaError(f"{path} has neither splats nor placed photos. Make splats first.")
    project = yield from open_path_stage(path)
    return capture_of(project), project


def _by_given_poses(path: Path) -> Capture | None:
    """The photos in ``path`` as another program placed them; None where none did.

    Raises ``GagaError`` when their poses cannot be used.
    """
    source = find_photos(path) or path
    given = find_poses(source) if source.is_dir() and list_photos(source) else None
    if given is None:
        return None
    cameras: list[Camera] = []
    lenses: dict[str, Lens] = {}
    for pose in given.poses:
        if (lens := pose.lens) is None:
            continue
        cameras.append(Camera(lens.K, pose.cam_from_world, lens.width, lens.height, pose.name))
        if lens.is_bent:
            lenses[pose.name] = lens
    if not cameras:
        raise GagaError(f"{given.file} says nothing of the lens. Make splats first: that finds it.")
    photos = {camera.name: source / camera.name for camera in cameras}
    return Capture(path.absolute().name, tuple(cameras), photos, lenses=lenses)


def capture_of(project: Project) -> Capture:
    """The scene of ``project`` with its photos, as it is now, and its groups described."""
    behind = frozenset[int]()
    if project.scene.labels.any():
        behind = describe_project(project).background
    folder, name, scene = project.placed_folder, project.name, replace(project.scene)
    if folder is None:
        return Capture(name, scene=scene, behind=behind)
    return Capture(name, folder.cameras, folder.image_paths, scene, behind)


def align_stage(
    first: Capture,
    second: Capture,
    config: AlignConfig,
    workspace: Path,  # a folder of its own, removed at the end
) -> Stage[Aligned]:
    """Bring ``second`` to ``first`` and say what changed.

    Raises ``NotAlignedError`` where that cannot be trusted.
    """
    stage = _align_stage(first, second, config, workspace)
    return (yield from joined(stage, STAGE, usual_seconds(first, second, config)))


def usual_seconds(first: Capture, second: Capture, config: AlignConfig) -> dict[str, float]:
    """Seconds that each step of `align_stage` takes on a machine like the one that was measured."""
    known = (_n_photos(capture) or _MOST for capture in (first, second))
    n = sum(min(n, by_photos.MOST_PHOTOS) for n in known)
    counts = {_DRAW: n} if _by_surfaces(first, second, config) else {}
    counts |= {LOOKS: n, _FEATURES: n, _MATCHES: n * (n - 1) // 2, by_photos.STAGE: 1}
    if _is_compared(first, second, config):
        counts[changes.STAGE] = 1
    seconds = {step: _RATES[step] * count for step, count in counts.items()}
    if not _by_surfaces(first, second, config):
        return seconds
    return {by_photos.OF_SURFACES.get(step, step): s for step, s in seconds.items()}


def _by_surfaces(first: Capture, second: Capture, config: AlignConfig) -> bool:
    return config.by == "surfaces" or min(_n_photos(first), _n_photos(second)) < FEWEST


def _is_compared(first: Capture, second: Capture, config: AlignConfig) -> bool:
    scenes = first.scene, second.scene
    return config.changes and all(scene is not None and scene.labels.any() for scene in scenes)


def _align_stage(
    first: Capture, second: Capture, config: AlignConfig, workspace: Path
) -> Stage[Aligned]:
    engine = choose()
    has_photos = min(_n_photos(first), _n_photos(second)) >= FEWEST
    if config.by == "photos" and not has_photos:
        raise NotAlignedError(
            f"It takes {FEWEST} photos on disk in both. Align by the surfaces, or put them back."
        )
    refuse_links(workspace)
    shutil.rmtree(workspace, ignore_errors=True)
    try:
        shown = [first, second]
        if _by_surfaces(first, second, config):
            for i, capture in enumerate(shown):
                if capture.scene is None:
                    raise NotAlignedError(f"{capture.name} has neither photos on disk nor splats.")
                drawing = _drawn_stage(capture, workspace / f"drawn-{i}", engine)
                shown[i] = yield from part(drawing, i, len(shown), _DRAW)
        matching = workspace / "matching"
        how: By = "photos" if shown[0] is first else "surfaces"
        found = yield from align_by_photos_stage(
            shown[0], shown[1], matching, threads=config.threads, seed=config.seed, by=how
        )
    finally:
        shutil.rmtree(workspace, ignore_errors=True)
    compared = None
    if _is_compared(first, second, config):
        compared = yield from find_changes_stage(first, second, found.world, engine)
    is_metric = first.scene is not None and first.scene.frame.is_metric
    return Aligned(first.name, second.name, found, compared, is_metric)


# --- By the splats alone: each scene is drawn from where its photos were taken, or from all around
# where no cameras are known, and the pictures are matched as photos are. Features of drawn surfaces
# have a scale of their own, which features of bare geometry lack: two scans rarely have the same
# units.


_SIDE = 640  # pixels of a picture
_MOST = 24  # pictures of a capture
_RINGS = ((-35.0, 6), (5.0, 9), (40.0, 9))  # elevation in degrees, views around
_FIELD, _ROOM = np.radians(50.0), 0.8  # field of view, and how far it is filled


def _drawn_stage(capture: Capture, folder: Path, rasterizer: Rasterizer) -> Stage[Capture]:
    """``capture`` with drawn pictures in ``folder`` instead of photos."""
    assert capture.scene is not None
    gaussians = yield from portion(bake_stage(capture.scene), 0, 0, _DRAW)
    views = capture.cameras
    if views:
        chosen = np.linspace(0, len(views) - 1, min(len(views), _MOST)).round().astype(int)
        views = tuple(views[i].at_most(_SIDE) for i in chosen)
    else:
        box, up = robust_box(gaussians.means, 0.98), guess_up(gaussians)
        views = views_around(box, up, _RINGS, side=_SIDE, field=_FIELD, room=_ROOM)
    folder.mkdir(parents=True)
    named = [replace(view, name=f"{i:03d}.png") for i, view in enumerate(views)]
    for i, view in enumerate(named):
        yield Progress(_DRAW, i, len(named))
        write_rgb(folder / view.name, rasterizer.render(gaussians, view).image)
    return replace(
        capture, cameras=tuple(named), photos={view.name: folder / view.name for view in named}
    )


def _n_photos(capture: Capture) -> int:
    return sum(camera.name in capture.photos for camera in capture.cameras)


@dataclass(frozen=True, eq=False)
class Addition:
    """A second scene in the first one."""

    edit: Edit
    groups: dict[int, int]  # ids of its groups there, by those that they have in their own scene
    shown: Edit  # the same with its splats tinted, to tell the two apart


def addition_of(scene: Scene, second: Project, world: DoubleArray) -> Addition:
    """Add the visible splats of ``second`` to ``scene``, moved by ``world`` (4, 4), selected, with
    its groups and their names.

    The project names the file of an unedited scene, and keeps edited splats itself.
    """
    other, title = second.scene, f"Add {second.name}"
    is_edited = bool(other.added or other.placement.any() or not other.visible.all())
    is_filed = not is_edited and second.model_axes == OURS
    digest = model_fingerprint(second.model_path) if is_filed else ""
    splats, labels = bake(other), other.labels[other.visible]
    ids, first = np.unique(labels, return_index=True)
    names = {group: group_name(other, group) for group in ids.tolist() if group}
    names[0] = second.stem
    path = second.model_path if digest else second.source
    edit = append(scene, splats, path, digest, labels, names)
    if edit is None or len(splats) == 0:
        raise GagaError(f"{second.name} shows no splats, so there is nothing to add.")
    after = replace(scene, revision=Revision())
    edit.apply(after)
    own = np.arange(len(scene), len(after))
    placed = transform(after, own, world[:3], title)  # None: it stands there already
    edit = together(title, (edit, placed))
    assert edit is not None
    groups = dict(zip(ids.tolist(), after.labels[own][first].tolist(), strict=True))
    if placed is not None:
        placed.apply(after)
    tint = recolor(after, own, tint_affine(mean_color(after, own), _TINT, _TINTED), title=title)
    shown = together(title, (edit, tint))
    assert shown is not None
    return Addition(edit, groups, shown)


def middle_of_first(first: Scene, second: Scene) -> DoubleArray:
    """Where a scene that could not be aligned is put (4, 4), to be moved by hand: around the middle
    of the first one, as large as that."""
    boxes = [robust_box(world_means(scene), 0.9) for scene in (first, second)]
    middles = [(lo + hi) / 2 for lo, hi in boxes]
    sizes = [float(np.linalg.norm(hi - lo)) for lo, hi in boxes]
    world = np.diag([*[sizes[0] / max(sizes[1], 1e-12)] * 3, 1.0])
    world[:3, 3] = middles[0] - world[:3, :3] @ middles[1]
    return world


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
