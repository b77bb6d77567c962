"""Click to segment with a promptable model: masks of renderings, lifted and merged by votes.

The model is asked for the thing in the view that was clicked; its mask, where the depths pass the
gate (section 3.2 of the paper), votes for splats. Those show in views around the thing, where the
clicks and the middle of what is chosen so far are the next prompts. A mask there that does not fit
what is chosen so far has no vote.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import GateConfig, ViewMasks, depth_bounds
from gaga_core.grouping.votes import splat_groups
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import NEAR, Frame, Rasterizer
from gaga_core.scene.orientation import estimate_up
from gaga_core.scene.selection.click_cut import Click
from gaga_core.segmentation.prompter import Candidates, Prompter

STAGE = "Ask the model"
_AROUND = (45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)  # degrees, in this order
_SIDE = 640  # pixels, longer side of a rendering
_FITS = 0.4  # IoU of a mask with what is chosen so far from which on it votes
_SHOWN = 20  # pixels of what is chosen so far that a view must show
_MISS = 0.02  # share of its depth by which a click may miss the surface that a view shows
_GATE = GateConfig(iqr_floor=0.02, guard_near=True)


@dataclass(frozen=True, eq=False)
class Lifted:
    """What the model's masks mean in 3D."""

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
    """The Gaussians of the thing that clicks mean, asked for in ``camera`` first.

    Raises ``GagaError`` when the view does not show the first click, or the model finds nothing.
    """
    votes = np.zeros((len(gaussians), 2), np.float32)
    first = _small(camera)
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
    """Ask for the thing in one view and vote; False when the view has nothing to say."""
    frame = rasterizer.render(gaussians, view)
    shown = None
    if chosen.any():
        shown = splat_groups(rasterizer, gaussians, view, chosen.astype(np.int32)) == 1
        if shown.sum() < _SHOWN:
            return False
    points, is_on = _prompts(view, frame, clicks, shown)
    if not is_on.any():
        return False
    mask = _best(prompter(_image(frame), points, is_on), points, is_on, shown)
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
    """How each pixel votes (H, W): 1 on the thing, 0 off it, -1 not at all."""
    depth = frame.median_depth
    low, high = depth_bounds(ViewMasks.of(mask.astype(np.int32)), depth, frame.alpha, _GATE)[1]
    passes = (depth > low) & (depth < high)
    return np.where(mask & ~passes, -1, mask).astype(np.int32)


def _image(frame: Frame) -> UInt8Array:
    return np.rint(np.clip(np.nan_to_num(frame.image), 0, 1) * 255).astype(np.uint8)


def _small(camera: Camera) -> Camera:
    scale = min(1.0, _SIDE / max(camera.width, camera.height))
    return camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))


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
    result: DoubleArray = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return result
