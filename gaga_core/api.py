"""The interface of `gaga_core` for scripts and notebooks: functions, and a `Scene` of objects.

Everything here runs to its end and shows a bar on standard error, or calls ``on_progress`` at each
step instead. Errors that a person can fix are `GagaError`. What lies behind are the stages and
edits that the command and the window run; modules other than this one may change.
"""

import base64
import html
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from PIL import Image

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.masks import dense_labels
from gaga_core.pipeline.film import FilmConfig, painter_stage
from gaga_core.pipeline.search import describe_project, search, train_views
from gaga_core.pipeline.settings import Quality, ReconstructConfig
from gaga_core.progress import Progress, Stage, run_stage, show_stage
from gaga_core.query.group_facts import outside_color
from gaga_core.scene.bake import bake
from gaga_core.scene.edits import separate
from gaga_core.scene.edits.history import History
from gaga_core.scene.object_picture import object_picture, object_view
from gaga_core.scene.objects import group_indices, group_name, object_table
from gaga_core.scene.orientation import estimate_up
from gaga_core.scene.project import (
    PROJECT_FILE,
    Project,
    files_read,
    is_saved_of,
    open_path_stage,
    require_other_file,
    save_project,
)
from gaga_core.scene.scene import State
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.click import click_views
from gaga_core.segmentation.base import ModelCard, Picture, Provider, fingerprint_of

__all__ = [
    "Objects",
    "Scene",
    "SceneObject",
    "find_objects",
    "lift",
    "open_scene",
    "reconstruct",
    "run",
    "score",
    "segment",
]

T = TypeVar("T")
OnProgress = Callable[[Progress], None]
RGB = tuple[float, float, float]
Shown = Literal["rgb", "groups", "depth"]
_PICTURE = 480  # pixels of a picture in a notebook


def _run(stage: Stage[T], on_progress: OnProgress | None, *, compiles: bool = False) -> T:
    if compiles:
        from gaga_core.pipeline.compile_kernels import after_warm_up

        stage = after_warm_up(stage)
    return show_stage(stage) if on_progress is None else run_stage(stage, on_progress)


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of an open scene. Its edits go through the scene's history."""

    scene: "Scene" = field(repr=False)
    id: int

    @property
    def name(self) -> str:
        """The name that a person gave, else a description, else "group 12"."""
        return group_name(self.scene.project.scene, self.id)

    @property
    def indices(self) -> IntArray:
        """Its splats (K,) that are not deleted: rows of `Scene.project`'s Gaussians."""
        return group_indices(self.scene.project.scene, self.id)

    def __len__(self) -> int:
        return len(self.indices)

    @property
    def color(self) -> RGB:
        """Mean color from outside, 0..1: that which the window shows."""
        project = self.scene.project
        color = outside_color(project.scene, self.indices, project.opened_views)
        red, green, blue = color.tolist()
        return red, green, blue

    def recolor(self, color: RGB, *, strength: float = 1.0) -> None:
        """Give it this mean ``color``, 0..1, and keep its shading; ``strength`` 0..1 blends."""
        self._edit({"op": "recolor", "color": list(color), "strength": strength})

    def move(self, by: tuple[float, float, float]) -> None:
        """Shift it by x, y, z in scene units, in the world."""
        self._edit({"op": "move", "by": list(by)})

    def rotate(self, axis: tuple[float, float, float], degrees: float) -> None:
        """Turn it about a line through its middle along ``axis``, in the world."""
        self._edit({"op": "rotate", "axis": list(axis), "degrees": degrees})

    def scale(self, factor: float) -> None:
        """Make it larger or smaller about its middle."""
        self._edit({"op": "scale", "factor": factor})

    def rename(self, name: str) -> None:
        """Give it a name."""
        self._edit({"op": "rename", "name": name})

    def delete(self) -> None:
        """Delete it; `Scene.undo` brings it back."""
        self._edit({"op": "delete"})

    def isolate(self) -> None:
        """Hide everything else."""
        self._edit({"op": "isolate"})

    def clean(self) -> None:
        """Take out splats that do not belong to it, as *Clean up* of the window."""
        self._edit({"op": "clean"})

    def duplicate(self, by: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> "SceneObject":
        """Copy it, shifted by x, y, z in scene units; returns the copy, which is a new object."""
        self._edit({"op": "duplicate", "by": list(by)})
        scene = self.scene.project.scene
        return SceneObject(self.scene, int(scene.labels[-1]))

    def export(self, path: str | Path) -> Path:
        """Write it alone as a file of splats; the end of the name says which kind."""
        from gaga_core.export.export import export_scene_stage

        require_other_file(self.scene.project, Path(path))
        scene, own = self.scene.project.scene, self.indices
        state = scene.state | np.uint8(State.HIDDEN)
        state[own] = scene.state[own]
        run_stage(export_scene_stage(replace(scene, state=state), Path(path)))
        return Path(path)

    def picture(self, side: int = 256) -> UInt8Array:
        """Draw it alone as large as fits: (side, side, 3)."""
        project = self.scene.project
        table = object_table(project.scene)
        row = table.row(self.id)
        if row is None:
            raise GagaError(f"{self.name} has no splats.")
        cameras = train_views(project)
        up, radius = estimate_up(cameras), max(float(table.radius[row]), 1e-6)
        view = object_view(table.centre[row], radius, cameras, up)
        return object_picture(bake(project.scene, indices=self.indices), view, side)

    def _edit(self, operation: dict[str, object]) -> None:
        self.scene.edit([operation | {"groups": [self.id]}])

    def _repr_png_(self) -> bytes:
        return _png(self.picture())


class Objects(Mapping[int, SceneObject]):
    """The objects of a scene by id, ascending; a name, or words that mean one, find it as well."""

    def __init__(self, scene: "Scene") -> None:
        self._scene = scene

    def __getitem__(self, key: int | str) -> SceneObject:
        if isinstance(key, int):
            if key not in self._ids():
                raise KeyError(key)
            return SceneObject(self._scene, key)
        wanted = key.casefold()
        named = [one for one in self.values() if one.name.casefold() == wanted]
        found = named or self._scene.query(key)
        if not found:
            raise KeyError(key)
        return found[0]

    def __iter__(self) -> Iterator[int]:
        return iter(self._ids())

    def __len__(self) -> int:
        return len(self._ids())

    def _ids(self) -> list[int]:
        labels = self._scene.project.scene.labels
        if not (labels > 0).any():
            return []
        ids = object_table(self._scene.project.scene).ids
        return [group for group in ids.tolist() if group > 0]

    def _repr_html_(self) -> str:
        return _table(self._scene)


def _table(scene: "Scene") -> str:
    """The objects as a table in HTML: swatch, id, name, splats."""
    table, rows = object_table(scene.project.scene), []
    for group, name, n, rgb in zip(table.ids, table.names, table.counts, table.colors, strict=True):
        swatch = "#" + "".join(f"{round(255 * float(value)):02x}" for value in rgb)
        cells = (f'<span style="color:{swatch}">■</span>', str(group), html.escape(name), f"{n:,}")
        if group > 0:
            rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    heads = "<tr><th></th><th>id</th><th>name</th><th>splats</th></tr>"
    return f"<table>{heads}{''.join(rows)}</table>"


def _png(picture: UInt8Array) -> bytes:
    data = io.BytesIO()
    Image.fromarray(picture).save(data, "PNG")
    return data.getvalue()


class Scene:
    """A scene that is open: its objects, edits with undo, pictures and exports."""

    def __init__(self, project: Project) -> None:
        self.project = project  # the document that the window shows
        self.history = History(project.scene)
        if (project.scene.labels > 0).any():
            describe_project(project)  # objects without a name are called by what they look like

    def __repr__(self) -> str:
        n = np.count_nonzero(~self.project.scene.has(State.DELETED))
        return f"<Scene {self.project.name}: {n:,} splats, {len(self.objects)} objects>"

    def __len__(self) -> int:
        return len(self.project.scene)

    @property
    def objects(self) -> Objects:
        """Its objects: ``scene.objects[3]``, ``scene.objects["chair"]``."""
        return Objects(self)

    @property
    def views(self) -> tuple[Camera, ...]:
        """Cameras of the photos, else views all around the splats."""
        folder = self.project.placed_folder
        if folder is not None and folder.cameras:
            return folder.cameras
        scene = self.project.scene
        return click_views((), world_means(scene, np.arange(len(scene), dtype=np.int32)))

    def query(self, text: str, *, view: str | int | None = None) -> list[SceneObject]:
        """Objects that ``text`` means, the best first: names, colors, sizes, places.

        ``view`` is the one from which left and right are meant.
        """
        camera = None if view is None else self._camera(view)
        cameras = train_views(self.project)
        answer = search(self.project.scene, text, cameras=cameras, camera=camera)
        return [SceneObject(self, int(group)) for group in answer.groups[: answer.n_meant]]

    def click(
        self,
        clicks: Sequence[tuple[str | int, float, float]],
        *,
        name: str = "",
        on_progress: OnProgress | None = None,
    ) -> SceneObject:
        """Make an object of what clicks in views mean: (view, u, v), pixels of the photo.

        A view is the name or the number of a photo; of a file of splats, a number.
        """
        from gaga_core.pipeline.click import ViewClick, click_stage

        has_photos = self.project.placed_folder is not None
        places = [
            ViewClick(self._camera(view).name if has_photos else str(view), u, v)
            for view, u, v in clicks
        ]
        found = _run(click_stage(self.project, places), on_progress, compiles=True)
        scene = self.project.scene
        self.history.do(separate(scene, found.splats, "Make object"))
        made = SceneObject(self, int(scene.labels[found.splats[0]]))
        if name:
            made.rename(name)
        return made

    def edit(self, script: Sequence[Mapping[str, object]]) -> tuple[str, ...]:
        """Apply a list of operations (an edit script); returns the titles of what changed."""
        steps = [dict(operation) for operation in script]
        project = self.project
        return run_script(project.scene, steps, self.history, lambda: project.training_views)

    def undo(self) -> str | None:
        """Take back the last edit; returns its title, None without any."""
        return self.history.undo()

    def redo(self) -> str | None:
        """Do again what was undone last; returns its title, None without any."""
        return self.history.redo()

    def render(
        self, view: str | int | Camera = 0, what: Shown = "rgb", *, longest_side: int | None = None
    ) -> UInt8Array:
        """A picture (H, W, 3) from a view, by name, number or camera, with edits applied.

        ``groups`` shows the objects in their colors. At most ``longest_side`` pixels.
        """
        camera = view if isinstance(view, Camera) else self._camera(view)
        camera = camera if longest_side is None else camera.at_most(longest_side)
        stage = painter_stage(self.project.scene, [camera], FilmConfig(what))
        return run_stage(stage)(camera)

    def export(self, path: str | Path, *, on_progress: OnProgress | None = None) -> Path:
        """Write what is visible: .ply, .splat, .spz, .sog, .glb, or a web page (.html)."""
        from gaga_core.export.export import export_scene_stage
        from gaga_core.export.options import ExportOptions
        from gaga_core.export.page import content_of

        require_other_file(self.project, Path(path))
        options = ExportOptions(up=self.project.up, page=content_of(self.project))
        stage = export_scene_stage(self.project.scene, Path(path), groups=True, options=options)
        _run(stage, on_progress)
        return Path(path)

    def export_objects(self, folder: str | Path, *, on_progress: OnProgress | None = None) -> Path:
        """Write each object as a .ply of its own; returns groups.json, which lists them."""
        from gaga_core.export.export import export_objects_stage
        from gaga_core.export.options import ExportOptions

        options = ExportOptions(up=self.project.up)
        kept = files_read(self.project)
        stage = export_objects_stage(self.project.scene, Path(folder), options=options, kept=kept)
        return _run(stage, on_progress)

    def save(self, path: str | Path | None = None) -> Path:
        """Save all edits as a project that the window opens (default: where it was opened).

        In place of a project of the same splats in ``path``, as a script does that runs again; a
        folder with anything else in it is refused.
        """
        if path is None:
            return save_project(self.project)
        target = Path(path).parent if Path(path).name == PROJECT_FILE else Path(path)
        is_own = target.resolve() == self.project.saves_to.resolve()
        again = not is_own and is_saved_of(self.project, target)
        return save_project(self.project, target, overwrites=again)

    def _camera(self, view: str | int) -> Camera:
        if isinstance(view, int):
            return self.views[view]
        for camera in self.views:
            if view in (camera.name, Path(camera.name).stem):
                return camera
        raise GagaError(f"There is no view {view}. The first one is {self.views[0].name}.")

    def _repr_png_(self) -> bytes:
        return _png(self.render(longest_side=_PICTURE))

    def _repr_html_(self) -> str:
        """Show the picture and the table of objects in a notebook."""
        picture = base64.b64encode(self._repr_png_()).decode()
        title = html.escape(repr(self).strip("<>"))
        shown = f'<img alt="{title}" src="data:image/png;base64,{picture}">'
        return f"<p>{title}</p>{shown}{_table(self)}"


def open_scene(path: str | Path, *, on_progress: OnProgress | None = None) -> Scene:
    """Open a scene folder, a saved project, exported objects, or a file of splats."""
    return Scene(_run(open_path_stage(Path(path)), on_progress))


def reconstruct(
    photos: str | Path,
    scene: str | Path,
    *,
    quality: Quality = "draft",
    config: ReconstructConfig | None = None,
    on_progress: OnProgress | None = None,
) -> Scene:
    """Make a scene folder of a folder of photos or a video: place the photos, train splats.

    What is there already is not made again. ``config`` has all settings, in place of ``quality``.
    """
    from gaga_core.pipeline.reconstruct import reconstruct_scene

    settings = config or ReconstructConfig(quality=quality)
    stage = reconstruct_scene(Path(photos), Path(scene), settings)
    _run(stage, on_progress, compiles=True)
    return open_scene(scene, on_progress=on_progress)


@dataclass(frozen=True, eq=False)
class _FunctionProvider:
    """Masks by a function of a photo."""

    function: Callable[[UInt8Array], IntArray]
    cues: frozenset[str] = frozenset()
    work_width: int = 0

    @property
    def name(self) -> str:
        """That of the function."""
        return self.function.__name__

    @property
    def card(self) -> ModelCard:
        """Nothing is known of it."""
        return ModelCard(self.name, "")

    def fingerprint(self) -> str:
        """The name alone: what it does is not known, so its masks are always made again."""
        return fingerprint_of(self.name)

    def label_map(self, picture: Picture) -> Stage[IntArray]:
        """The return value of the function."""
        yield Progress("Make masks", 0, 1)
        return dense_labels(np.asarray(self.function(picture.image), np.int32))[0]


def segment(
    scene: str | Path,
    provider: str | Callable[[UInt8Array], IntArray] = "regions",
    *,
    views: str | Sequence[str] = "train",
    on_progress: OnProgress | None = None,
) -> Path:
    """Make 2D masks of the photos of a scene folder; returns the folder of the masks.

    ``provider`` is a name of ``gaga masks --list`` ("regions" needs no model), or a function from a
    photo (H, W, 3) uint8 to labels (H, W) int32, 0 = none, which need not agree between photos.
    """
    from gaga_core.pipeline.segment import segment_scene
    from gaga_core.segmentation.choose import provider_named

    maker: Provider
    maker = provider_named(provider) if isinstance(provider, str) else _FunctionProvider(provider)
    folder, again = open_scene_folder(Path(scene)), isinstance(maker, _FunctionProvider)
    stage = segment_scene(folder, maker, views=views, redo=again)
    return _run(stage, on_progress, compiles=True).folder


def find_objects(
    scene: str | Path,
    *,
    masks: str | Path | None = None,
    preset: Literal["robust", "paper", "released"] = "robust",
    detail: float | None = None,
    on_progress: OnProgress | None = None,
) -> Scene:
    """Associate the masks of a scene folder, so that every Gaussian gets an object.

    ``masks`` is a folder or a provider's name (default: the only one). ``detail`` 0..1: how fine
    objects made of regions are. A saved project of the scene keeps its own objects.
    """
    from gaga_core.pipeline.associate import associate_scene

    config = AssociateConfig.of(preset).at_detail(detail)
    stage = associate_scene(open_scene_folder(Path(scene)), masks, config)
    _run(stage, on_progress, compiles=True)
    return open_scene(scene, on_progress=on_progress)


def lift(
    scene: str | Path,
    mode: Literal["vote", "refine", "paper"] | None = None,
    *,
    on_progress: OnProgress | None = None,
) -> Path:
    """Give every Gaussian an identity encoding of its object; returns the file of encodings."""
    from gaga_core.pipeline.lift import lift_scene

    stage = lift_scene(open_scene_folder(Path(scene)), mode)
    return Path(_run(stage, on_progress, compiles=True).file)


def run(
    photos: str | Path,
    scene: str | Path | None = None,
    *,
    on_progress: OnProgress | None = None,
) -> Scene:
    """Go from photos, a video or a scene folder to objects: everything that is missing is made.

    ``scene`` is the folder to make (default: next to the photos, as NAME-scene).
    """
    from gaga_core.pipeline.reconstruct import source_of
    from gaga_core.pipeline.run import run_folder

    source, root = source_of(Path(photos))
    if scene is not None:
        source, root = Path(photos), Path(scene)
    _run(run_folder(root, photos=source), on_progress, compiles=True)
    return open_scene(root, on_progress=on_progress)


def score(pred: str | Path, gt: str | Path) -> dict[str, object]:
    """IoU, precision and recall of predicted label maps against true ones (Algorithm 1)."""
    from gaga_core.evaluate.group_scores import evaluate

    return evaluate(Path(pred), Path(gt)).to_json()
