"""The splats as points of one picture: what gestures on the picture select from.

Projected once per camera and scene; a stroke then asks for a mask of pixels as often as the mouse
moves, one pass over (N,) integers each time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, check_shape
from gaga_core.camera import NEAR, Camera
from gaga_core.raster.base import T_MIN
from gaga_core.raster.cpu.blend_kernels import pick_pixel
from gaga_core.raster.cpu.prepare import for_kernel, pose_and_lens
from gaga_core.scene.merge_splats import kernel_columns
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.selection_kernels import covered, project_centres
from gaga_core.threads import run_chunks

# A splat counts as visible surface up to this far behind the median depth, relative to depth:
# centres of a surface's splats lie a little on both sides of it.
_SURFACE_SLACK = 0.02
_CHUNK = 65536


@dataclass(frozen=True, eq=False)
class Screen:
    """Projected centre of each splat."""

    pixel: IntArray  # (N,) row * width + column; -1 = cannot be selected in this picture
    width: int
    height: int

    def inside(self, mask: BoolArray) -> IntArray:
        """Splats (K,), ascending, that are drawn on a set pixel of ``mask`` (H, W)."""
        check_shape("mask", mask, (self.height, self.width), np.bool_)
        n = len(self.pixel)
        rows, counts = np.empty(n, np.int32), np.zeros(-(-n // _CHUNK), np.int64)
        flat = for_kernel(mask, np.bool_).ravel()

        run_chunks(partial(covered, self.pixel, flat, rows, counts, _CHUNK), n, _CHUNK)
        pieces = [rows[c * _CHUNK : c * _CHUNK + k] for c, k in enumerate(counts)]
        return np.concatenate([np.zeros(0, np.int32), *pieces])


def screen(scene: Scene, camera: Camera, surface_depth: FloatArray | None = None) -> Screen:
    """Project the centres of all splats that can be selected, placements applied.

    With ``surface_depth`` (H, W), a picture's median depth at the camera's size, only the visible
    surface; without it, through everything.
    """
    surface = np.zeros((0, 0), np.float32)
    if surface_depth is not None:
        check_shape("surface_depth", surface_depth, (camera.height, camera.width))
        surface = for_kernel(surface_depth, np.float32)
    pose, lens = pose_and_lens(camera)
    poses = scene.placements.cam_from_file(pose)
    means = for_kernel(scene.gaussians.means, np.float32)
    state, placement = for_kernel(scene.state, np.uint8), for_kernel(scene.placement, np.int32)
    unwanted = int(State.HIDDEN | State.DELETED | State.LOCKED)
    pixel = np.empty(len(scene), np.int32)
    size = camera.width, camera.height
    view = poses, lens, surface, _SURFACE_SLACK, NEAR, *size
    work = partial(project_centres, *(means, state, unwanted, placement, *view, pixel))
    run_chunks(work, len(scene), _CHUNK)
    return Screen(pixel, camera.width, camera.height)


# --- Shapes drawn on the picture as masks of pixels (H, W) bool.
# A pixel belongs to a shape when its centre (x + 0.5, y + 0.5) lies in it.


ScreenPoint = tuple[float, float]


def rectangle(corners: tuple[float, float, float, float], width: int, height: int) -> BoolArray:
    """The rectangle (u0, v0, u1, v1), pixels, any corner order: every pixel that it touches."""
    u0, v0, u1, v1 = corners
    left, right = sorted((u0, u1))
    top, bottom = sorted((v0, v1))
    mask = np.zeros((height, width), np.bool_)
    rows = slice(max(int(np.floor(top)), 0), max(int(np.ceil(bottom)), 0))
    mask[rows, max(int(np.floor(left)), 0) : max(int(np.ceil(right)), 0)] = True
    return mask


def polygon(points: Sequence[ScreenPoint], width: int, height: int) -> BoolArray:
    """The inside of a closed outline, a lasso's or a polygon's; empty under three points."""
    mask = np.zeros((height, width), np.bool_)
    if len(points) < 3:
        return mask
    # Imported when first needed: it takes a large part of a second.
    from skimage.draw import polygon as pixels_inside

    outline = np.asarray(points, np.float64) - 0.5
    shape = (height, width)
    rows, columns = pixels_inside(outline[:, 1], outline[:, 0], shape)  # type: ignore[no-untyped-call]
    mask[rows, columns] = True
    return mask


def stroke(mask: BoolArray, start: ScreenPoint, stop: ScreenPoint, radius: float) -> None:
    """Paint a round brush of ``radius`` pixels from ``start`` to ``stop`` into ``mask`` (H, W).

    A brush that is moved in many small steps paints the union of its steps.
    """
    height, width = mask.shape
    a, b = np.asarray(start, np.float64), np.asarray(stop, np.float64)
    lo = np.floor(np.minimum(a, b) - radius).astype(int)
    hi = np.ceil(np.maximum(a, b) + radius).astype(int) + 1
    left, top = max(lo[0], 0), max(lo[1], 0)
    right, bottom = min(hi[0], width), min(hi[1], height)
    if left >= right or top >= bottom:
        return
    u = np.arange(left, right) + 0.5 - a[0]
    v = (np.arange(top, bottom) + 0.5 - a[1])[:, None]
    along = b - a
    length2 = float(along @ along)
    share = np.clip((u * along[0] + v * along[1]) / length2, 0, 1) if length2 > 0 else 0.0
    near = (u - share * along[0]) ** 2 + (v - share * along[1]) ** 2 <= radius * radius
    mask[top:bottom, left:right] |= near


# --- The object under a pixel: the exact alpha-weighted vote of the splats that it shows.


@dataclass(frozen=True, eq=False)
class Pick:
    """The splats that contribute to one pixel, and what they are."""

    group: int  # label of greatest summed weight; 0 if splats of no group win
    weight: float  # that sum, 0..1
    indices: IntArray  # (K,) front to back
    weights: FloatArray  # (K,) blending weights
    depth: float  # camera depth at which half of the light is gone
    point: DoubleArray  # (3,) world, at that depth
    splat: int  # of greatest weight


def pick(
    scene: Scene,
    camera: Camera,
    u: float,
    v: float,
    *,
    antialiased: bool | None = None,
    rows: IntArray | None = None,
) -> Pick | None:
    """Blend the one pixel whose centre is (u, v), as the rasterizer would; ``None`` if it is empty.

    Hidden and deleted splats do not count; placements do (position, shape, opacity). For the pixel
    in column x and row y pass x + 0.5 and y + 0.5. ``antialiased``: the mode of the display;
    None = that of the file. ``rows`` (K,) ascending: look at these splats alone (`lod.pick_rows`).
    """
    if rows is not None:
        only = replace(
            scene,
            gaussians=replace(scene.gaussians.bare(rows), comments=scene.gaussians.comments),
            labels=scene.labels[rows],
            state=scene.state[rows],
            placement=scene.placement[rows],
            source=scene.source[rows],
        )
        among = pick(only, camera, u, v, antialiased=antialiased)
        if among is None:
            return None
        return replace(among, indices=rows[among.indices], splat=int(rows[among.splat]))
    look = scene.gaussians.is_antialiased if antialiased is None else antialiased
    index, alphas, depths = _hits(scene, camera, (u, v), look)
    if len(index) == 0:
        return None
    # Order of the rasterizer: depth as float32, ties by index.
    order = np.argsort(depths.astype(np.float32), kind="stable")
    after = np.cumprod(1.0 - alphas[order])
    done = np.flatnonzero(after < T_MIN)
    n = int(done[0]) if len(done) else len(order)
    order, after = order[:n], after[:n]
    weights = alphas[order] * np.append(1.0, after[:-1])
    index = index[order]
    found, member = np.unique(scene.labels[index], return_inverse=True)
    sums = np.bincount(member, weights=weights)
    best = int(sums.argmax())
    # A pixel that stays more than half open has no median depth: take the middle of what it shows.
    covered = np.cumsum(weights)
    middle = int(np.searchsorted(covered, 0.5 if covered[-1] >= 0.5 else covered[-1] / 2))
    depth = float(depths[order[min(middle, n - 1)]])
    return Pick(
        group=int(found[best]),
        weight=float(sums[best]),
        indices=index,
        weights=weights.astype(np.float32),
        depth=depth,
        point=camera.unproject(u, v, depth),
        splat=int(index[weights.argmax()]),
    )


def _hits(
    scene: Scene, camera: Camera, at: tuple[float, float], antialiased: bool
) -> tuple[IntArray, DoubleArray, DoubleArray]:
    """Index, alpha and depth of the splats that the pixel shows, in the order of the scene."""
    g, placements = scene.gaussians, scene.placements
    n = len(scene)
    pose, lens = pose_and_lens(camera, antialiased)
    poses = placements.cam_from_file(pose)
    growth = np.linalg.norm(placements.matrix[:, :, :3], ord=2, axis=(1, 2)) ** 2
    shape = kernel_columns(g)[:4]
    state, placement = for_kernel(scene.state, np.uint8), for_kernel(scene.placement, np.int32)
    opacities = np.array(placements.opacity, np.float64)
    index = np.empty(n, np.int32)
    alphas, depths = np.empty(n), np.empty(n)
    counts = np.zeros(-(-n // _CHUNK), np.int64)
    pixel = np.array(at, np.float64)
    unseen = int(State.HIDDEN | State.DELETED)
    splats = *shape, state, unseen, placement, poses, growth, opacities
    work = partial(pick_pixel, *(*splats, lens, pixel, index, alphas, depths, counts, _CHUNK))
    run_chunks(work, n, _CHUNK)
    pieces = [np.arange(c * _CHUNK, c * _CHUNK + k) for c, k in enumerate(counts)]
    packed = np.concatenate([np.zeros(0, np.int64), *pieces])
    return index[packed], alphas[packed], depths[packed]
