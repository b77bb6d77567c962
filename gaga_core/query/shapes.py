"""Shape words that were measured: flat, long, tall, box-like, round.

The first three are ratios of extents. Of the others a sample of splats is looked at: on a box the
largest of the three normalized coordinates is the same everywhere, on a ball the distance from the
middle is, on a can that stands the larger of height and distance from the axis; whichever varies
least, and clearly so, gives the word.
"""

from typing import Literal

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray
from gaga_core.query.group_facts import GroupFacts
from gaga_core.scene.scene import Scene, State

Shape = Literal["flat", "long", "tall", "box", "round", ""]

_FLAT, _FLAT_WIDTH = 0.2, 0.4  # thinnest and middle extent of flat things, shares of the longest
_LONG = 0.35  # middle extent of long things
_UPRIGHT = 0.8  # height of long things that stand, share of the longest side
_SAMPLE = 300  # splats of a group that are looked at
_FEWEST = 60
_TURNS = 6  # about the vertical, within a quarter turn, that a box is tried at
_EDGE = 94  # percentile of a coordinate at which a side lies
_VARIES = 0.2  # most that a norm varies (deviation over mean) on a surface
_CLEARLY, _CLEARLY_BOX = 0.86, 0.7  # of another norm's variation
_SOLID = 0.55  # thinnest extent of a ball


def shapes_of(scene: Scene, facts: GroupFacts) -> tuple[Shape, ...]:
    """The shape word of each group of ``facts``, "" where none was measured."""
    longest = np.maximum(facts.extents[:, 0], 1e-12)
    middle, thin = facts.extents[:, 1] / longest, facts.extents[:, 2] / longest
    order = np.argsort(scene.labels, kind="stable")
    starts = np.searchsorted(scene.labels[order], facts.ids)
    ends = np.searchsorted(scene.labels[order], facts.ids, "right")
    words: list[Shape] = []
    for row, (start, end) in enumerate(zip(starts, ends, strict=True)):
        if middle[row] < _LONG:
            upright = facts.height[row] > _UPRIGHT * float((facts.hi - facts.lo)[row].max())
            words.append("tall" if upright else "long")
        elif thin[row] < _FLAT and middle[row] > _FLAT_WIDTH:
            words.append("flat")
        else:
            chosen = order[start:end]
            points = _upright(scene, facts, row, chosen[:: -(-len(chosen) // _SAMPLE)])
            words.append(_body(points, float(thin[row])))
    return tuple(words)


def _upright(scene: Scene, facts: GroupFacts, row: int, splats: AnyArray) -> DoubleArray:
    """Positions (K, 3) in the upright frame of those of ``splats`` that are in the group's box."""
    there = splats[(scene.state[splats] & np.uint8(State.DELETED)) == 0]
    matrix = facts.frame @ scene.placements.matrix[scene.placement[there]]
    means = scene.gaussians.means[there]
    points = np.einsum("kij,kj->ki", matrix[:, :, :3], means) + matrix[:, :, 3]
    inside = ((points >= facts.lo[row]) & (points <= facts.hi[row])).all(axis=1)
    result: DoubleArray = points[inside]
    return result


def _body(points: DoubleArray, thin: float) -> Shape:
    if len(points) < _FEWEST:
        return ""
    own = _normalized(points)
    ball = _variation(np.linalg.norm(own, axis=1))
    can = _variation(np.maximum(np.linalg.norm(own[:, :2], axis=1), np.abs(own[:, 2])))
    box = np.inf
    for turn in np.arange(_TURNS) * np.pi / 2 / _TURNS:
        c, s = np.cos(turn), np.sin(turn)
        turned = _normalized(points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
        box = min(box, _variation(np.abs(turned).max(axis=1)))
    if box < _VARIES and box < _CLEARLY_BOX * min(ball, can):
        return "box"
    curved = min(ball, can) if thin > _SOLID else can
    return "round" if curved < _VARIES and curved < _CLEARLY * box else ""


def _normalized(points: DoubleArray) -> DoubleArray:
    """Coordinates that are -1 and 1 at the sides."""
    low, high = np.percentile(points, [100 - _EDGE, _EDGE], axis=0)
    result: DoubleArray = (2 * points - low - high) / np.maximum(high - low, 1e-12)
    return result


def _variation(values: DoubleArray) -> float:
    return float(values.std() / max(float(values.mean()), 1e-12))
