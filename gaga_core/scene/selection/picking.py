"""What is under a pixel: the exact alpha-weighted vote of the splats that it shows."""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.raster.base import T_MIN
from gaga_core.raster.cpu.blend_kernels import pick_pixel
from gaga_core.raster.cpu.prepare import for_kernel, pose_and_lens
from gaga_core.scene.scene import Scene, State
from gaga_core.threads import run_chunks

_CHUNK = 65536


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
        among = pick(_only(scene, rows), camera, u, v, antialiased=antialiased)
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


def _only(scene: Scene, rows: IntArray) -> Scene:
    """The scene with these rows alone, as far as `pick` reads it."""
    g = scene.gaussians
    return replace(
        scene,
        gaussians=replace(g.bare(rows), comments=g.comments),
        labels=scene.labels[rows],
        state=scene.state[rows],
        placement=scene.placement[rows],
        source=scene.source[rows],
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
    means, quats = for_kernel(g.means, np.float32), for_kernel(g.quats, np.float32)
    log_scales = for_kernel(g.log_scales, np.float32)
    logits = for_kernel(g.logit_opacities, np.float32)
    state, placement = for_kernel(scene.state, np.uint8), for_kernel(scene.placement, np.int32)
    opacities = np.array(placements.opacity, np.float64)
    index = np.empty(n, np.int32)
    alphas, depths = np.empty(n), np.empty(n)
    counts = np.zeros(-(-n // _CHUNK), np.int64)
    pixel = np.array(at, np.float64)
    unseen = int(State.HIDDEN | State.DELETED)

    def work(start: int, stop: int) -> None:
        pick_pixel(
            means,
            quats,
            log_scales,
            logits,
            state,
            unseen,
            placement,
            poses,
            growth,
            opacities,
            lens,
            pixel,
            index,
            alphas,
            depths,
            counts,
            _CHUNK,
            start,
            stop,
        )

    run_chunks(work, n, _CHUNK)
    pieces = [np.arange(c * _CHUNK, c * _CHUNK + k) for c, k in enumerate(counts)]
    packed = np.concatenate([np.zeros(0, np.int64), *pieces])
    return index[packed], alphas[packed], depths[packed]
