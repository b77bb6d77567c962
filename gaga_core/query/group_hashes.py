"""Digests of groups: equal as long as a group has the same splats, looking the same."""

import hashlib

import numpy as np

from gaga_core.arrays import IntArray, LongArray
from gaga_core.query.group_facts import compact_rows
from gaga_core.scene.scene import Scene

_MIX = np.array([0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D, 0x27D4EB2F], np.int64)


def group_digests(scene: Scene) -> tuple[IntArray, LongArray]:
    """Groups (G,) of ``scene`` that have live splats, without 0, and their digests (G,).

    A digest changes when splats join or leave, move or are recolored; not with the group's id or
    name, nor with what else is in the scene.
    """
    from gaga_core.query.group_facts_kernels import hash_groups
    from gaga_core.raster.cpu.prepare import for_kernel

    rows, ids = compact_rows(scene.labels)
    g, p = scene.gaussians, scene.placements
    words = _bits(g.means) @ _MIX[:3]
    words = words * 31 + _bits(g.sh[:, 0]) @ _MIX[1:]
    words ^= _bits(g.logit_opacities[:, None])[:, 0]
    placed = [
        int.from_bytes(
            hashlib.blake2b(m.tobytes() + c.tobytes() + o.tobytes(), digest_size=7).digest()
        )
        for m, c, o in zip(p.matrix, p.color, p.opacity, strict=True)
    ]
    words ^= np.array(placed, np.int64)[scene.placement]
    digest = np.zeros(len(ids), np.int64)
    counts = np.zeros(len(ids), np.int64)
    hash_groups(rows, for_kernel(scene.state, np.uint8), words, digest, counts)
    live = np.flatnonzero((counts > 0) & (ids > 0))
    return ids[live], digest[live]


def _bits(values: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> LongArray:
    """The bits of float32 numbers, as int64."""
    return np.ascontiguousarray(values, np.float32).view(np.int32).astype(np.int64)
