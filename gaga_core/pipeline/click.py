"""Click to segment, headless: places in views of a scene -> one object of its splats."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.scene_folder import select_views
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.orientation import estimate_up
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra
from gaga_core.scene.selection.click_cut import Answer, Click, boxed, clicked, nothing_yet
from gaga_core.scene.selection.click_graph import ClickGraph, click_graph_stage
from gaga_core.scene.selection.click_views import click_views
from gaga_core.scene.selection.picking import pick

if TYPE_CHECKING:
    from gaga_core.segmentation.prompter import Prompter

_LEAST = 0.25  # opacity of a pixel at which it counts as a surface


@dataclass(frozen=True)
class ViewClick:
    """A click in a view, at (u, v) in pixels of its photo."""

    view: str
    u: float
    v: float
    is_on: bool = True


@dataclass(frozen=True)
class ViewBox:
    """A box in a view, pixels of its photo, any corner order."""

    view: str
    u0: float
    v0: float
    u1: float
    v1: float


@dataclass(frozen=True, eq=False)
class ClickedObject:
    """What the clicks mean."""

    splats: IntArray  # (K,) ascending
    n_clicks: int


def click_stage(
    project: Project,
    clicks: Sequence[ViewClick],
    box: ViewBox | None = None,
    *,
    rasterizer: Rasterizer | None = None,
    prompter: "Prompter | None" = None,
) -> Stage[ClickedObject]:
    """The splats that clicks on a thing and off it, in their order, select; a box comes first.

    Views are those of the scene folder, or the numbers from 0 of the views around a lone file of
    splats. With a ``prompter`` a model is asked, in the view of the first click. Raises
    ``GagaError`` for a view that is not there, a place outside of it, one without a surface, and a
    box that holds no whole object.
    """
    scene, engine = project.scene, rasterizer or choose()
    if box is None and not any(click.is_on for click in clicks[:1]):
        raise GagaError("Click the object first: give --click or --box before --not.")
    folder = project.placed_folder
    cameras = () if folder is None else folder.cameras
    views = click_views(cameras, algebra.world_means(scene, algebra.everything(scene)))
    if prompter is not None and box is not None:
        raise GagaError("A model is asked by clicks. Give --click instead of --box.")
    places = [_on_surface(project, views, click) for click in clicks]
    frame = None if box is None else _view(project, views, box.view)
    if prompter is not None:
        camera = _view(project, views, clicks[0].view)
        asked = model_answer_stage(scene, cameras, camera, places, prompter, engine)
        return ClickedObject((yield from asked), len(clicks))
    graph = yield from click_graph_stage(scene, views, engine)
    answer = nothing_yet(graph)
    if box is not None and frame is not None:
        gaussians = yield from bake_stage(scene)
        depth = engine.render(gaussians, frame).median_depth
        answer = boxed(graph, frame, (box.u0, box.v0, box.u1, box.v1), depth)
        if not answer.nodes.any():
            raise GagaError(f"No whole object lies in the box in {box.view}. Give a larger one.")
    for place in places:
        answer = clicked(graph, answer, place)
    splats = _selectable(project, graph, answer)
    if len(splats) == 0:
        raise GagaError("Nothing is left of the object: the last clicks took all of it away.")
    return ClickedObject(splats, len(clicks) + (box is not None))


def model_answer_stage(
    scene: Scene,
    cameras: Sequence[Camera],
    camera: Camera,
    clicks: Sequence[Click],
    prompter: "Prompter",
    rasterizer: Rasterizer,
) -> Stage[IntArray]:
    """The selectable splats (K,), ascending, that a model says ``clicks`` mean.

    It is asked in ``camera`` first; those of the photos, ``cameras``, tell which way is up. Raises
    ``GagaError`` when the model finds nothing there.
    """
    # Imported when first needed: torch takes a large part of the launch time.
    from gaga_core.pipeline.click_model import model_clicks_stage

    rows = np.flatnonzero(scene.visible).astype(np.int32)
    gaussians = yield from bake_stage(scene, indices=rows)
    up = estimate_up(cameras)
    lifted = yield from model_clicks_stage(gaussians, camera, clicks, prompter, rasterizer, up=up)
    splats: IntArray = rows[lifted.splats]
    return splats[algebra.selectable(scene)[splats]]


def _selectable(project: Project, graph: ClickGraph, answer: Answer) -> IntArray:
    rows = graph.splats(answer.samples)
    result: IntArray = rows[algebra.selectable(project.scene)[rows]]
    return result


def _view(project: Project, views: Sequence[Camera], name: str) -> Camera:
    folder = project.placed_folder
    if folder is not None:
        return select_views(folder, [name])[0]
    if not name.isdecimal() or int(name) >= len(views):
        raise GagaError(
            f"There is no view {name}. A file of splats has views 0 to {len(views) - 1} around it."
        )
    return views[int(name)]


def _on_surface(project: Project, views: Sequence[Camera], click: ViewClick) -> Click:
    """Where a click meets the surface."""
    camera = _view(project, views, click.view)
    where = f"({click.u:g}, {click.v:g}) in {click.view}"
    if not (0 <= click.u < camera.width and 0 <= click.v < camera.height):
        raise GagaError(
            f"The place {where} is outside: the view has {camera.width} x {camera.height} pixels."
        )
    found = pick(project.scene, camera, click.u, click.v)
    if found is None or float(np.sum(found.weights)) < _LEAST:
        raise GagaError(f"There is no surface at {where}. Click on something.")
    x, y, z = (float(value) for value in found.point)
    return Click((x, y, z), click.is_on)
