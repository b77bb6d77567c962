"""Geometry of given poses: which may show the same, how two sets lie to each other, what moved."""

import numpy as np

from gaga_core.arrays import DoubleArray

_ROUNDS = 10  # of weights: from five on the result changes by rounding only
_APART = np.radians(75.0)  # between viewing directions: SIFT matches nothing beyond
_TURN_OF_A_STEP = np.radians(30.0)  # as far apart as a step to the nearest neighbours


def pairs_by_pose(poses: DoubleArray, neighbours: int) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of each view of poses (V, 3, 4) and the nearest ones that may overlap.

    Nearness is the way between the cameras, in units of the way to the nearest ones, and the angle
    between their viewing directions, in steps of `_TURN_OF_A_STEP`.
    """
    n = len(poses)
    places = centres(poses)
    ways = np.linalg.norm(places[:, None] - places, axis=2)
    angles = np.arccos(np.clip(poses[:, 2, :3] @ poses[:, 2, :3].T, -1, 1))
    k = min(4, n - 1)
    step = max(float(np.median(np.sort(ways, axis=1)[:, k])), 1e-12)
    far = ways / step + angles / _TURN_OF_A_STEP
    far[angles > _APART] = np.inf
    np.fill_diagonal(far, np.inf)
    pairs = set()
    for i in range(n):
        for j in np.argsort(far[i], kind="stable")[:neighbours].tolist():
            if np.isfinite(far[i, j]):
                pairs.add((min(i, j), max(i, j)))
    return sorted(pairs)


def centres(poses: DoubleArray) -> DoubleArray:
    """Camera centres (V, 3), world, of poses (V, 3, 4)."""
    return -np.einsum("vij,vi->vj", poses[:, :, :3], poses[:, :, 3])


def similarity_between(source: DoubleArray, target: DoubleArray) -> DoubleArray:
    """The map (4, 4), target_from_source, of the cameras ``source`` (V, 3, 4) to ``target``.

    The rotation is what the ways between the cameras and the turn of each camera say together,
    by their residuals: of cameras on one line the turns count, of noisy turns the ways. What is
    far off counts less (re-weighted least squares).
    """
    turns = np.einsum("vji,vjk->vik", target[:, :, :3], source[:, :, :3])
    a, b = centres(source), centres(target)
    by_turn, by_way = np.ones(len(a)), np.zeros(len(a))
    in_place = np.ones((len(a), 1)) / len(a)
    scale, rotation, offset = 1.0, np.eye(3), np.zeros(3)
    for _ in range(_ROUNDS):
        mean_a, mean_b = (in_place * a).sum(axis=0), (in_place * b).sum(axis=0)
        ways = scale * (b - mean_b)[:, :, None] * (a - mean_a)[:, None]
        said = np.einsum("v,vij->ij", by_turn, turns) + np.einsum("v,vij->ij", by_way, ways)
        u, _, vt = np.linalg.svd(said)
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        turned, there = (a - mean_a) @ rotation.T, b - mean_b
        spread = float((in_place * turned**2).sum())
        scale = float((in_place * turned * there).sum()) / max(spread, 1e-18)
        scale = scale if scale > 0 else 1.0
        offset = mean_b - scale * rotation @ mean_a
        off = np.linalg.norm(turns - rotation, axis=(1, 2)) / np.sqrt(2)  # radians
        off_place = np.linalg.norm(scale * turned - there, axis=1)
        near, near_place = max(float(np.median(off)), 1e-9), float(np.median(off_place))
        near_place = max(near_place, 1e-9 * scale * np.sqrt(spread), 1e-15)
        by_turn = 1 / (near * np.maximum(off, near))
        by_way = 1 / (near_place * np.maximum(off_place, near_place))
        in_place = (by_way / by_way.sum())[:, None]
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = scale * rotation, offset
    return world


def moved_by(before: DoubleArray, after: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Way (V,) and turn (V,) in degrees of each camera between poses (V, 3, 4)."""
    way: DoubleArray = np.linalg.norm(centres(before) - centres(after), axis=1)
    chord = np.linalg.norm(before[:, :, :3] - after[:, :, :3], axis=(1, 2)) / np.sqrt(8)
    return way, np.degrees(2 * np.arcsin(np.clip(chord, 0, 1)))
