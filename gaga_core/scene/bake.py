"""Placements turned into plain splat parameters: what other tools read."""

from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.color import SH_C0, sh_rotation
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats, multiply_quats, quats_to_matrices
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.scene import Scene, of_scene_now

_CHUNK = 1 << 17  # splats worked on at once: bounds the float64 temporaries to some 100 MB
_RIGID = 1e-6  # how far from rotation times scale a matrix may be, relative
_OPACITY = 1e-6  # baked opacities stay this far from 0 and 1, where the logit ends


@dataclass(frozen=True, eq=False)
class Motion:
    """A placement's linear part taken apart: ``linear == turn * scale`` when ``is_similar``."""

    linear: DoubleArray  # (3, 3)
    offset: DoubleArray  # (3,)
    turn: DoubleArray  # (3, 3) nearest orthogonal matrix; a mirror has determinant -1
    scale: float  # uniform scale
    is_similar: bool  # a rotation times a uniform scale, no mirror

    @staticmethod
    def of(matrix: DoubleArray) -> "Motion":
        """Polar decomposition of ``matrix`` (3, 4)."""
        linear = matrix[:, :3]
        u, s, vt = np.linalg.svd(linear)
        turn = u @ vt
        is_similar = bool(s[0] - s[2] <= _RIGID * s[0] and np.linalg.det(turn) > 0)
        return Motion(linear, matrix[:, 3], turn, float(s.mean()), is_similar)

    @property
    def turns(self) -> bool:
        """Whether directions change at all."""
        return not np.array_equal(self.turn, np.eye(3))


STAGE = "Apply edits"


def bake(scene: Scene, *, indices: AnyArray | None = None) -> Gaussians:
    """The chosen splats (K,) with placements applied; see `bake_stage`."""
    return run_stage(bake_stage(scene, indices=indices))


@of_scene_now
def bake_stage(
    scene: Scene, *, indices: AnyArray | None = None, is_step: bool = False
) -> Stage[Gaussians]:
    """Splats of ``indices`` (K,) (default: the visible ones) as they are seen, in row order.

    ``is_step``: its words tell its share, for `joined`; alone it would fill the bar before what it
    is for begins.

    Positions, rotations, scales, opacities and all SH bands follow the placement; a map that
    stretches or mirrors changes each covariance to ``A S A^T``, taken apart again. The turn of SH
    is the rotation nearest to the map. Splats whose placement changes nothing, and parameters that
    it leaves alone, keep their exact bits. Of the extra columns the normals turn along (as
    directions; zeros stay zeros); all others pass through.
    """
    splats = sorted_indices(scene.visible if indices is None else indices, len(scene))
    total, done = len(splats) if is_step else 0, 0
    yield Progress(STAGE, done, total)
    if len(splats) == len(scene) and not scene.placement.any():
        return scene.gaussians
    out = scene.gaussians.take(splats)
    index = scene.placement[splats]
    order = np.argsort(index, kind="stable")
    rows, starts = np.unique(index[order], return_index=True)
    for row, piece in zip(rows, np.split(order, starts[1:]), strict=len(rows) > 0):
        for start in range(0, len(piece), _CHUNK):
            chunk = piece[start : start + _CHUNK]
            if row != 0:
                _bake_row(scene, int(row), out, chunk)
            done += len(chunk) if is_step else 0
            yield Progress(STAGE, done, total)
    return out


def _bake_row(scene: Scene, row: int, out: Gaussians, at: LongArray) -> None:
    """Apply placement ``row`` to the rows ``at`` of ``out``, which is ours to write."""
    table = scene.placements
    if not np.array_equal(table.matrix[row], np.eye(3, 4)):
        _move(Motion.of(table.matrix[row]), out, at)
    if not np.array_equal(table.color[row], np.eye(3, 4)):
        out.sh[at] = baked_color(out.sh[at], table.color[row])
    if table.opacity[row] != 1.0:
        logits = np.clip(out.logit_opacities[at].astype(np.float64), -700, 700)
        opacity = np.clip(table.opacity[row] / (1 + np.exp(-logits)), _OPACITY, 1 - _OPACITY)
        out.logit_opacities[at] = np.log(opacity / (1 - opacity))


def _move(motion: Motion, out: Gaussians, at: LongArray) -> None:
    out.means[at] = out.means[at] @ motion.linear.T + motion.offset
    if np.array_equal(motion.linear, np.eye(3)):
        return
    if motion.is_similar:
        if motion.turns:
            q = matrices_to_quats(motion.turn[None])[0]
            out.quats[at] = multiply_quats(q, out.quats[at].astype(np.float64))
        if motion.scale != 1.0:
            out.log_scales[at] += np.float32(np.log(motion.scale))
    else:
        out.quats[at], out.log_scales[at] = stretched(
            motion.linear, out.quats[at], out.log_scales[at]
        )
    if motion.turns:
        if out.sh_degree > 0:
            out.sh[at] = sh_rotation(motion.turn, out.sh_degree).astype(np.float32) @ out.sh[at]
        normals = [out.extra[name] for name in ("nx", "ny", "nz") if name in out.extra]
        if len(normals) == 3 and all(column.dtype.kind == "f" for column in normals):
            before = np.stack([column[at] for column in normals], axis=1)
            if before.any():  # zeros keep their sign
                for column, values in zip(normals, (before @ motion.turn.T).T, strict=True):
                    column[at] = values


def stretched(
    linear: DoubleArray, quats: FloatArray, log_scales: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Quaternions (N, 4) and log scales (N, 3) of covariances ``A S A^T``, A any linear map (3, 3).

    With S = (R D)(R D)^T the singular values of A R D are the new deviations and its left vectors
    the new axes: no squares, so thin splats stay thin.
    """
    size = log_scales.max(axis=1, keepdims=True).astype(np.float64)
    relative = np.exp(log_scales - size)  # scales of 1e-30 and 1e30 do not leave the range
    u, s, _ = np.linalg.svd(linear @ (quats_to_matrices(quats) * relative[:, None, :]))
    u[:, :, 2] *= np.sign(np.linalg.det(u))[:, None]
    tiny = np.finfo(np.float64).tiny
    new_scales = np.log(np.maximum(s, tiny)) + size
    return matrices_to_quats(u).astype(np.float32), new_scales.astype(np.float32)


def baked_color(sh: FloatArray, affine: DoubleArray) -> FloatArray:
    """SH (N, S, 3) of the color ``affine`` (3, 4) @ (c, 1): DC gets scale and offset, rest scale.

    c = 0.5 + C0 dc + rest, hence dc' = A dc + (A 0.5 + b - 0.5) / C0 and rest' = A rest.
    """
    scale, offset = affine[:, :3], affine[:, 3]
    result = sh @ scale.T
    result[:, 0] += (scale @ np.full(3, 0.5) + offset - 0.5) / SH_C0
    return result.astype(np.float32)


def with_groups(gaussians: Gaussians, labels: IntArray) -> Gaussians:
    """``gaussians`` with a column ``group`` (N,) int32, in place of one of that name."""
    kept = {k: v for k, v in gaussians.extra.items() if k != "group"}
    return replace(gaussians, extra=MappingProxyType({**kept, "group": labels.astype(np.int32)}))
