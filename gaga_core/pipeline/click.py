"""Click to segment, headless: places in views of a scene -> one object of its splats."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.camera import NEAR, Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import GateConfig, ViewMasks, depth_bounds
from gaga_core.grouping.votes import splat_groups
from gaga_core.io.folder.scene_folder import select_views
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Frame, Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.orientation import estimate_up
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra
from gaga_core.scene.selection.by_screen import pick
from gaga_core.scene.selection.click import (
    Click,
    boxed,
    click_graph_stage,
    click_views,
    clicked,
    nothing_yet,
)
from gaga_core.segmentation.sam import Candidates, Prompter

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
    """Answer to the clicks."""

    splats: IntArray  # (K,) ascending
    n_clicks: int


def click_stage(
    project: Project,
    clicks: Sequence[ViewClick],
    box: ViewBox | None = None,
    *,
    prompter: Prompter | None = None,
) -> Stage[ClickedObject]:
    """The splats that clicks on an object and off it, in their order, select; a box comes first.

    Views are those of the scene folder, or the numbers from 0 of the views around a lone file of
    splats. With a ``prompter`` a model is asked, in the view of the first click. Raises
    ``GagaError`` for a view that is not there, a place outside of it, one without a surface, and a
    box that holds no whole object.
    """
    scene, engine = project.scene, choose()
    if box is None and not any(click.is_on for click in clicks[:1]):
        raise GagaError("Click the object first: give --click or --box before --not.")
    folder = project.placed_folder
    cameras = () if folder is None else folder.cameras
    views = click_views(cameras, algebra.world_means(scene, algebra.everything(scene)))
    if prompter is not None and box is not None:
        raise GagaError("A model segments by clicks. Give --click instead of --box.")
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
            raise GagaError(
                f"There is no whole object in the box in {box.view}. Give a larger one."
            )
    for place in places:
        answer = clicked(graph, answer, place)
    splats = graph.splats(answer.samples)
    splats = splats[algebra.selectable(project.scene)[splats]]
    if len(splats) == 0:
        raise GagaError("Nothing is left of the object: the last clicks removed all of it.")
    return ClickedObject(splats, len(clicks) + (box is not None))


def model_answer_stage(
    scene: Scene,
    cameras: Sequence[Camera],
    camera: Camera,
    clicks: Sequence[Click],
    prompter: Prompter,
    rasterizer: Rasterizer,
) -> Stage[IntArray]:
    """The selectable splats (K,), ascending, that a model says ``clicks`` mean.

    It is asked in ``camera`` first; those of the photos, ``cameras``, tell which way is up. Raises
    ``GagaError`` when the model finds nothing there.
    """
    rows = np.flatnonzero(scene.visible).astype(np.int32)
    gaussians = yield from bake_stage(scene, indices=rows)
    up = estimate_up(cameras)
    lifted = yield from model_clicks_stage(gaussians, camera, clicks, prompter, rasterizer, up=up)
    splats: IntArray = rows[lifted.splats]
    return splats[algebra.selectable(scene)[splats]]


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
    """Point of the surface under a click."""
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


# --- Click to segment with a promptable model: masks of renderings, lifted and merged by votes.
# The model is asked for the object in the view that was clicked; its mask, where the depths pass
# the gate (section 3.2 of the paper), votes for splats. Those show in views around the object,
# where the clicks and the middle of what is chosen so far are the next prompts. A mask there that
# does not fit what is chosen so far has no vote.


STAGE = "Ask the model"
_AROUND = (45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)  # degrees, in this order
_SIDE = 640  # pixels, longer side of a rendering
_FITS = 0.4  # IoU of a mask with what is chosen so far from which on it votes
_SHOWN = 20  # pixels of what is chosen so far that a view must show
_MISS = 0.02  # share of its depth by which a click may miss the surface that a view shows
_GATE = GateConfig(iqr_floor=0.02, guard_near=True)


@dataclass(frozen=True, eq=False)
class Lifted:
    """Object of the model's masks in 3D."""

    splats: IntArray  # (K,) rows of the Gaussians, ascending
    n_views: int  # whose masks voted


def model_clicks_stage(
    gaussians: Gaussians,
    camera: Camera,
    clicks: Sequence[Click],
    prompter: Prompter,
    rasterizer: Rasterizer,
    *,
    up: DoubleArray | None = None,
) -> Stage[Lifted]:
    """The Gaussians of the object that clicks mean, asked for in ``camera`` first.

    Raises ``GagaError`` when the view does not show the first click, or the model finds nothing.
    """
    votes = np.zeros((len(gaussians), 2), np.float32)
    first = camera.at_most(_SIDE)
    views = [first]
    n_voted = 0
    while views:
        view = views.pop(0)
        n_all = 1 + len(_AROUND)
        n_done = 0 if view is first else n_all - len(views) - 1
        yield Progress(STAGE, n_done, n_all, f"view {n_done + 1} of {n_all}")
        chosen = votes[:, 1] > votes[:, 0]
        if _vote(gaussians, view, clicks, prompter, rasterizer, chosen, votes):
            n_voted += 1
        if view is first:
            found = votes[:, 1] > votes[:, 0]
            if not found.any():
                raise GagaError("The model finds nothing there. Click the middle of the object.")
            middle = np.median(gaussians.means[found].astype(np.float64), axis=0)
            views = _views_around(first, middle, estimate_up([camera]) if up is None else up)
    splats = np.flatnonzero(votes[:, 1] > votes[:, 0]).astype(np.int32)
    return Lifted(splats, n_voted)


def _vote(
    gaussians: Gaussians,
    view: Camera,
    clicks: Sequence[Click],
    prompter: Prompter,
    rasterizer: Rasterizer,
    chosen: BoolArray,  # (N,) so far
    votes: FloatArray,  # (N, 2) off, on: added to
) -> bool:
    """Segment the object in one view and vote; False when the view has nothing to say."""
    frame = rasterizer.render(gaussians, view)
    shown = None
    if chosen.any():
        shown = splat_groups(rasterizer, gaussians, view, chosen.astype(np.int32)) == 1
        if shown.sum() < _SHOWN:
            return False
    points, is_on = _prompts(view, frame, clicks, shown)
    if not is_on.any():
        return False
    shot = np.rint(np.clip(np.nan_to_num(frame.image), 0, 1) * 255).astype(np.uint8)
    mask = _best(prompter(shot, points, is_on), points, is_on, shown)
    if mask is None:
        return False
    rasterizer.vote(gaussians, view, _ballot(mask, frame), votes)
    return True


def _prompts(
    view: Camera, frame: Frame, clicks: Sequence[Click], shown: BoolArray | None
) -> tuple[FloatArray, BoolArray]:
    """Pixels (n, 2) of the clicks that the view shows, and of the middle of what is chosen."""
    pixels, z = view.project(np.array([click.point for click in clicks], np.float64))
    points: list[tuple[float, float]] = []
    is_on: list[bool] = []
    for click, (u, v), depth in zip(clicks, pixels.tolist(), z.tolist(), strict=True):
        if depth < NEAR or not (0 <= u < view.width and 0 <= v < view.height):
            continue
        if abs(float(frame.median_depth[int(v), int(u)]) - depth) < _MISS * depth:
            points.append((u, v))
            is_on.append(click.is_on)
    if shown is not None:
        deep = ndimage.distance_transform_edt(np.pad(shown, 1))[1:-1, 1:-1]
        row, column = np.unravel_index(int(deep.argmax()), deep.shape)
        points.append((float(column) + 0.5, float(row) + 0.5))
        is_on.append(True)
    return np.array(points, np.float32).reshape(-1, 2), np.array(is_on, np.bool_)


def _best(
    found: Candidates, points: FloatArray, is_on: BoolArray, shown: BoolArray | None
) -> BoolArray | None:
    """The mask that fits what is chosen so far; in the first view the best one that obeys most of
    the prompts. None when none does."""
    if len(found.masks) == 0:
        return None
    if shown is None:
        columns, rows = points.astype(np.int64).T
        obeyed = (found.masks[:, rows, columns] == is_on).sum(axis=1)
        best = int(np.lexsort((-found.scores, -obeyed))[0])
        return found.masks[best] if obeyed[best] > 0 else None
    both = (found.masks & shown).sum(axis=(1, 2))
    iou = both / np.maximum((found.masks | shown).sum(axis=(1, 2)), 1)
    return found.masks[int(iou.argmax())] if iou.max() >= _FITS else None


def _ballot(mask: BoolArray, frame: Frame) -> IntArray:
    """How each pixel votes (H, W): 1 on the object, 0 off it, -1 not at all."""
    depth = frame.median_depth
    low, high = depth_bounds(ViewMasks.of(mask.astype(np.int32)), depth, frame.alpha, _GATE)[1]
    passes = (depth > low) & (depth < high)
    return np.where(mask & ~passes, -1, mask).astype(np.int32)


def _views_around(camera: Camera, middle: DoubleArray, up: DoubleArray) -> list[Camera]:
    """``camera`` turned about the line through ``middle`` along ``up``."""
    views = []
    for degrees in _AROUND:
        turn = _rotation(up, np.radians(degrees))
        moved = np.eye(4)
        moved[:3, :3] = turn
        moved[:3, 3] = middle - turn @ middle
        pose = camera.cam_from_world @ np.linalg.inv(moved)
        views.append(replace(camera, cam_from_world=pose, name=f"{degrees:+.0f} degrees"))
    return views


def _rotation(axis: DoubleArray, angle: float) -> DoubleArray:
    """Rotation (3, 3) about a unit axis (Rodrigues)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
